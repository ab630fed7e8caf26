"""Connectors of the ancf plant as symbolic formulas compiled by Exudyn: contacts, grounded forces, a modulus."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, no_type_check

from rig.model.contact_laws import ContactLaw, elementary
from rig.model.description import Station
from rig.simulation.plants.mesh import Mesh

STEPS_PER_MODULUS_UPDATE = 64


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
    """Section of a beam from `start_m` to `end_m`: factors on bending stiffness and mass (and lengthwise stiffness)."""

    beam: str
    start_m: float
    end_m: float
    stiffness_factor: float
    mass_factor: float


ExtraPhysics = GroundedForce | ChangingModulus | Section
"""Properties of a simulated reality that its Rig cannot describe."""


def add_contact(exu: Any, mbs: Any, against_marker: int, marker: int, law: ContactLaw) -> int:
    """Add a connector with a contact law between two markers; return its number."""
    _register_symbolic_functions(exu.symbolic)

    @no_type_check  # recorded symbolically from the plain function
    def force_n(_system, t, _number, eta, rate, _stiffness, _damping, _offset):
        if law.spatial:
            return [exu.symbolic.Real(0.0), *law.formula(law, (eta[1], eta[2]), (rate[1], rate[2]), t)]
        return law.formula(law, eta, rate, t)

    if law.spatial:
        return _add_connector(mbs, against_marker, marker, force_n, [0.0] * 3, [0.0] * 3)
    return _add_connector(mbs, against_marker, marker, force_n, law.stiffness_n_per_m, law.damping_n_s_per_m)


@cache
def _register_symbolic_functions(symbolic: Any) -> None:
    """Register Exudyn's symbolic functions with those of the contact laws, whose formulas it then compiles."""

    @no_type_check
    def beyond(eta, low, high):
        return symbolic.max(eta - high, 0.0) + symbolic.min(eta - low, 0.0)

    @no_type_check
    def select(condition, chosen, otherwise):
        return symbolic.IfThenElse(condition, symbolic.Real(1.0) * chosen, symbolic.Real(1.0) * otherwise)

    symbolic_functions = {"beyond": beyond, "select": select, "smaller": symbolic.min, "magnitude": symbolic.abs}
    symbolic_functions |= {"power": symbolic.pow, "root": symbolic.sqrt, "tanh": symbolic.tanh}
    for name, function in symbolic_functions.items():
        getattr(elementary, name).register(symbolic.Real, function)


def add_grounded(exu: Any, mbs: Any, ground_marker: int, marker: int, grounded_force: GroundedForce) -> int:
    """Add a connector from a marker to the ground with the formula of a grounded force; return its number."""

    @no_type_check  # recorded symbolically from the plain function
    def symbolic_force_n(_system, t, _number, w, rate, _stiffness, _damping, _offset):
        return grounded_force.force_n(exu.symbolic, t, w, rate)

    return _add_connector(mbs, ground_marker, marker, symbolic_force_n)


def modulus_update(mbs: Any, meshes: list[Mesh], change: ChangingModulus) -> Callable[[int, float], None]:
    """Function of (step, time) that updates the bending stiffness of a beam's elements every 64 steps."""
    mesh = next(mesh for mesh in meshes if mesh.body.name == change.beam)
    numbered_objects = [(number, mbs.GetObject(number)) for number in range(mbs.systemData.NumberOfObjects())]
    element_numbers = [
        object_number
        for object_number, exudyn_object in numbered_objects
        if exudyn_object["objectType"] == "ANCFCable2D" and int(exudyn_object["nodeNumbers"][0]) in mesh.node_numbers
    ]
    nominal_bending_n_m2 = {number: mbs.GetObjectParameter(number, "bendingStiffness") for number in element_numbers}

    def update_modulus(step: int, time_s: float) -> None:
        if step % STEPS_PER_MODULUS_UPDATE == 0:
            for number in element_numbers:
                mbs.SetObjectParameter(number, "bendingStiffness", nominal_bending_n_m2[number] * change.factor(time_s))

    return update_modulus


def _add_connector(
    mbs: Any,
    against_marker: int,
    marker: int,
    force_function: Callable[..., Any],
    stiffness: float | list[float] = 0.0,
    damping: float | list[float] = 0.0,
) -> int:
    from exudyn.advancedUtilities import CreateSymbolicUserFunction
    from exudyn.itemInterface import CartesianSpringDamper, CoordinateSpringDamper

    connector_type = CartesianSpringDamper if isinstance(stiffness, list) else CoordinateSpringDamper
    connector_number = mbs.AddObject(
        connector_type(markerNumbers=[against_marker, marker], stiffness=stiffness, damping=damping)
    )
    user_function = CreateSymbolicUserFunction(mbs, force_function, "springForceUserFunction", connector_number)
    mbs.SetObjectParameter(connector_number, "springForceUserFunction", user_function)
    mbs.variables[f"law of connector {connector_number}"] = user_function  # Exudyn does not keep it alive
    return int(connector_number)
