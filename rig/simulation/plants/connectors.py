"""What the ancf plant ties together by formulae that Exudyn runs compiled: contacts, grounded forces, a modulus."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, no_type_check

from rig.model.contact_law import DAMPING_DEPTH_M, FRICTION_SPEED_M_PER_S, DeadZone
from rig.model.description import Station
from rig.simulation.plants.mesh import Mesh

MODULUS_EVERY_STEPS = 64


@dataclass(frozen=True)
class GroundedForce:
    """A force between a station and the ground that no primitive of a Rig describes.

    `force_n(functions, t, w, rate)` gives the force against the displacement w, from time, displacement and velocity;
    `functions` has abs, sin, tanh and others, for numbers (numpy) as for symbols (exudyn.symbolic).
    """

    station: Station
    force_n: Callable[[Any, Any, Any, Any], Any]


@dataclass(frozen=True)
class ChangingModulus:
    """Young's modulus of a beam times `factor(t)`; its damping stays."""

    beam: str
    factor: Callable[[float], float]


@dataclass(frozen=True)
class Section:
    """From `start_m` to `end_m` a beam is so many times as stiff in bending and as heavy (and as stiff lengthwise)."""

    beam: str
    start_m: float
    end_m: float
    stiffness_factor: float
    mass_factor: float


Extra = GroundedForce | ChangingModulus | Section
"""What only a simulated reality has, beyond its Rig."""


def add_contact(exu: Any, mbs: Any, against: int, at: int, law: DeadZone) -> int:
    """A connector whose force is the dead zone; the markers' numbers are given, the connector's returned."""
    symbolic = exu.symbolic

    @no_type_check  # recorded symbolically from the plain function
    def dead_zone(_system, t, _number, eta, rate, stiffness, damping, _offset):
        def beyond(depth, size, ratio):
            share = symbolic.IfThenElse(size < DAMPING_DEPTH_M, size / DAMPING_DEPTH_M, symbolic.Real(1.0))
            secant = ratio * stiffness
            if law.exponent != 1.0:
                secant = secant * symbolic.pow(size / law.reference_depth_m, law.exponent - 1.0)
            elastic = (secant + law.cubic_n_per_m3 * depth * depth) * depth if law.cubic_n_per_m3 else secant * depth
            return elastic + damping * rate * share

        worn = law.wear_m_per_s * t
        below, above = eta + (law.lower_clearance_m + worn), eta - (law.upper_clearance_m + worn)
        inside = symbolic.IfThenElse(
            below < 0.0, beyond(below, -1.0 * below, law.lower_stiffness_ratio), symbolic.Real(0.0)
        )
        force = symbolic.IfThenElse(above > 0.0, beyond(above, above, 1.0), inside)
        if law.open_damping_n_s_per_m:
            force = force + law.open_damping_n_s_per_m * rate
        if law.friction_n:
            force = force + law.friction_n * symbolic.tanh(rate / FRICTION_SPEED_M_PER_S)
        return force

    return _connected(mbs, against, at, dead_zone, law.stiffness_n_per_m, law.damping_n_s_per_m)


def add_grounded(exu: Any, mbs: Any, ground: int, at: int, extra: GroundedForce) -> int:
    """A connector to the ground with the force's own formula."""

    @no_type_check  # recorded symbolically from the plain function
    def law(_system, t, _number, w, rate, _stiffness, _damping, _offset):
        return extra.force_n(exu.symbolic, t, w, rate)

    return _connected(mbs, ground, at, law)


def modulus_change(mbs: Any, meshes: list[Mesh], extra: ChangingModulus) -> Callable[[int, float], None]:
    """Called with a step's number and time, sets the bending stiffness of the beam's elements now and then."""
    mesh = next(m for m in meshes if m.body.name == extra.beam)
    objects = [(number, mbs.GetObject(number)) for number in range(mbs.systemData.NumberOfObjects())]
    elements = [n for n, o in objects if o["objectType"] == "ANCFCable2D" and int(o["nodeNumbers"][0]) in mesh.nodes]
    nominal = {number: mbs.GetObjectParameter(number, "bendingStiffness") for number in elements}

    def change(sample: int, time_s: float) -> None:
        if sample % MODULUS_EVERY_STEPS == 0:
            for number in elements:
                mbs.SetObjectParameter(number, "bendingStiffness", nominal[number] * extra.factor(time_s))

    return change


def _connected(
    mbs: Any, against: int, at: int, law: Callable[..., Any], stiffness: float = 0.0, damping: float = 0.0
) -> int:
    from exudyn.advancedUtilities import CreateSymbolicUserFunction
    from exudyn.itemInterface import CoordinateSpringDamper

    connector = mbs.AddObject(CoordinateSpringDamper(markerNumbers=[against, at], stiffness=stiffness, damping=damping))
    function = CreateSymbolicUserFunction(mbs, law, "springForceUserFunction", connector)
    mbs.SetObjectParameter(connector, "springForceUserFunction", function)
    mbs.variables[f"law of connector {connector}"] = function  # Exudyn does not keep it alive
    return int(connector)
