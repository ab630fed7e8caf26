"""The reference plant: Exudyn, beams of ANCF cable elements. It, `connectors` and `basis` alone import exudyn."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace
from scipy.linalg import eigh

from rig.errors import RigError
from rig.extras import needs_extra
from rig.model.beam import Beam
from rig.model.description import Body, PointSpring, Rig, Station, stations_of
from rig.model.modes import held_coordinates, with_attachments
from rig.model.oscillator import Oscillator
from rig.simulation.motion import ForceSignal, Motion, Progress, forces_of
from rig.simulation.plants.connectors import (
    ChangingModulus,
    Extra,
    GroundedForce,
    Section,
    add_contact,
    add_grounded,
    modulus_change,
)
from rig.simulation.plants.loading import base_motion, check_softening, connections, softening_limits_m, true_force
from rig.simulation.plants.mesh import (
    Mesh,
    by_node,
    coordinates_at_rest,
    inertia,
    mesh_positions,
    sensor_row,
    static_load,
    station_row,
)

ELEMENTS = 20
BLOCK_STEPS = 4096
AXIAL_FACTOR = 0.25
"""On the axial stiffness, whose waves would otherwise set the step. Much less, and the beams' own axial resonances come
down into the band of the force: at 0.01 the cradle's, at 129 Hz, falsified its tip's acceleration there by a tenth."""


def simulate(
    rig: Rig,
    force_n: ForceSignal,
    step_s: float,
    progress: Progress,
    elements: int = ELEMENTS,
    extra: tuple[Extra, ...] = (),
) -> Iterator[Motion]:
    """The motion from rest, with about `elements` elements a beam and a node wherever something acts on it.

    Generalized-alpha (spectral radius 0.9) at a fixed step; use a dyadic one, so that time adds up exactly. Each beam
    has the damping matrix M Phi diag(2 zeta omega) Phi' M of its finite elements, hence the same damping ratio in
    every elastic mode and none in the rigid ones. Coordinates are taken relative to the base, whose motion is an
    inertial load. The solver runs in segments of 4096 steps, each continued from the
    coordinates, velocities and accelerations of the one before. `extra` is what no Rig describes.

    Yields one Motion a segment. Raises RigError if the solver fails or the motion is not finite.
    """
    with needs_extra("simulate", "the plant ancf (Exudyn)"):
        import exudyn as exu

    exu.config.printToConsole = False
    exu.config.suppressWarnings = True
    base = base_motion(rig, len(force_n), step_s)
    if (base or rig.loads) and any(isinstance(e, Section) for e in extra):
        raise RigError("the ancf plant takes static loads and base motion on uniform beams only; leave them out")
    forces_n, limits_m = forces_of(rig, force_n), softening_limits_m(rig)
    applied_n = [true_force(rig, one[:], step_s) for one in forces_n.signals]
    container = exu.SystemContainer()
    try:
        mbs = container.AddSystem()
        meshes, connectors, loads = build(exu, mbs, rig, [float(one[0]) for one in applied_n], elements, extra)
        time_s = np.arange(len(force_n)) * step_s
        histories_n = [*applied_n, *(tone.force_n(time_s) for tone in rig.tones)]
        readers = {
            order: _read_nodes(exu, mbs, meshes, order) for order in {0, *(s.measures.order for s in rig.sensors)}
        }
        force_readers = [
            mbs.AddSensor(
                _item("SensorObject")(
                    objectNumber=c, storeInternal=True, outputVariableType=exu.OutputVariableType.Force
                )
            )
            for c in connectors[: len(rig.contacts)]
        ]
        set_base = _add_loads(mbs, rig, meshes) if rig.loads or base else None
        changes = [modulus_change(mbs, meshes, e) for e in extra if isinstance(e, ChangingModulus)]

        def apply_force(system: Any, time_s: float) -> bool:
            sample = round(time_s / step_s)
            for load, history_n in zip(loads, histories_n, strict=True):
                system.SetLoadParameter(load, "load", float(history_n[sample]))
            if base and set_base:
                set_base(float(base[2][sample]))
            for change in changes:
                change(sample, time_s)
            return True

        mbs.SetPreStepUserFunction(apply_force)
        mbs.Assemble()
        if rig.loads:
            mbs.systemData.SetODE2Coordinates(coordinates_at_rest(rig, meshes), exu.ConfigurationType.Initial)
        settings = _settings(exu, step_s)
        rows = {s: station_row(meshes, s) for s in {*stations_of(rig), *(c.at for c in connections(rig))}}
        sensors = [(s.measures, sensor_row(rig, meshes, s)) for s in rig.sensors]
        for first in range(0, len(force_n) - 1, BLOCK_STEPS):
            last = min(first + BLOCK_STEPS, len(force_n) - 1)
            _advance(exu, mbs, settings, first, last, step_s)
            keep = slice(0 if first == 0 else 1, None)
            moved = {order: read()[:, keep] for order, read in readers.items()}
            if not all(np.isfinite(m).all() for m in moved.values()):
                raise RigError(
                    f"the ancf plant diverged before {last * step_s:.3f} s at step {step_s} s; use a smaller step"
                )
            displaced = {s: row @ moved[0] for s, row in rows.items()}
            between = [displaced[c.at] - (displaced[c.against] if c.against else 0) for c in connections(rig)]
            check_softening(limits_m, _stack(between, moved[0].shape[1]))
            now = slice(last + 1 - (count := moved[0].shape[1]), last + 1)
            carried = [history[now] for history in base] if base else [0.0] * 3
            sensed = [row @ moved[m.order] + carried[m.order] * m.translates for m, row in sensors]
            yield Motion(
                start_s=(first + (0 if first == 0 else 1)) * step_s,
                step_s=step_s,
                forces_n=forces_n[now],
                sensed=_stack(sensed, count),
                displacement_m=_stack([displaced[s] + carried[0] for s in stations_of(rig)], count),
                eta_m=_stack(between[: len(rig.contacts)], count),
                contact_force_n=_stack([mbs.GetSensorStoredData(s)[keep, 1] for s in force_readers], count),
            )
            progress(last / (len(force_n) - 1))
    finally:
        container.Reset()


def build(
    exu: Any, mbs: Any, rig: Rig, first_n: Sequence[float], elements: int, extra: tuple[Extra, ...] = ()
) -> tuple[list[Mesh], list[int], list[int]]:
    """Bodies, damping, contacts and loads; returns the meshes, the connectors and the loads' numbers.

    The connectors are those of the contacts, then those of cubic springs, dampers and the extra forces. The loads are
    the exciting forces, with their first values, and the tones.
    """
    grounded = [e for e in extra if isinstance(e, GroundedForce)]
    sections = [e for e in extra if isinstance(e, Section)]
    needed = [g.station for g in grounded]
    needed += [Station(s.beam, x) for s in sections for x in (s.start_m, s.end_m)]
    nodes = tuple(PointSpring(station=station) for station in needed)  # no springs, but a node at each of these
    rig = replace(rig, springs=(*rig.springs, *nodes))
    ground_node = mbs.AddNode(_item("NodePointGround")())
    ground = int(mbs.AddMarker(_item("MarkerNodeCoordinate")(nodeNumber=ground_node, coordinate=0)))
    meshes = [_add_body(mbs, rig, body, ground, elements, sections) for body in rig.bodies]
    _add_attachments(mbs, rig, meshes)
    _add_damping(mbs, rig, meshes)

    def marker(station: Station | None) -> int:
        if station is None:
            return ground
        mesh = next(m for m in meshes if m.body.name == station.body)
        return int(
            mbs.AddMarker(
                _item("MarkerNodeCoordinate")(
                    nodeNumber=mesh.node_at(station.position_m), coordinate=mesh.transverse[0]
                )
            )
        )

    connectors = [add_contact(exu, mbs, marker(c.against), marker(c.at), c.law) for c in connections(rig)]
    connectors += [add_grounded(exu, mbs, ground, marker(g.station), g) for g in grounded]
    pushed = [*zip(rig.forces, first_n, strict=True), *((tone.station, 0.0) for tone in rig.tones)]
    loads = [int(mbs.AddLoad(_item("LoadCoordinate")(markerNumber=marker(at), load=n))) for at, n in pushed]
    return meshes, connectors, loads


def _add_body(mbs: Any, rig: Rig, body: Body, ground: int, elements: int, sections: list[Section]) -> Mesh:
    add = _ADDED.get(type(body))
    if add is None:
        raise RigError(f"the ancf plant meshes beams, and {body.name!r} is a modal basis; simulate it with modal")
    return add(mbs, rig, body, ground, elements, sections)


def _add_mass(mbs: Any, rig: Rig, body: Oscillator, ground: int, _elements: int, _sections: list[Section]) -> Mesh:
    whole = with_attachments(rig, body)
    node = int(mbs.AddNode(_item("Node1D")(referenceCoordinates=[0.0])))
    mbs.AddObject(_item("Mass1D")(nodeNumber=node, physicsMass=whole.mass_kg))
    marker = mbs.AddMarker(_item("MarkerNodeCoordinate")(nodeNumber=node, coordinate=0))
    mbs.AddObject(
        _item("CoordinateSpringDamper")(
            markerNumbers=[ground, marker], stiffness=whole.stiffness_n_per_m, damping=whole.damping_n_s_per_m
        )
    )
    return Mesh(body, np.zeros(1), (node,))


def _add_beam(mbs: Any, rig: Rig, body: Beam, ground: int, elements: int, sections: list[Section]) -> Mesh:
    def fix(node: int, coordinates: tuple[int, ...]) -> None:
        for coordinate in coordinates:
            marker = mbs.AddMarker(_item("MarkerNodeCoordinate")(nodeNumber=node, coordinate=coordinate))
            mbs.AddObject(_item("CoordinateConstraint")(markerNumbers=[ground, marker]))

    positions = mesh_positions(rig, body, elements)
    nodes = tuple(int(mbs.AddNode(_item("NodePoint2DSlope1")(referenceCoordinates=[x, 0, 1, 0]))) for x in positions)
    for (left, right), length, middle in zip(
        pairwise(nodes), np.diff(positions), (positions[1:] + positions[:-1]) / 2, strict=True
    ):
        here = [s for s in sections if s.beam == body.name and s.start_m < middle < s.end_m]
        stiffer, heavier = (float(np.prod([getattr(s, f) for s in here])) for f in ("stiffness_factor", "mass_factor"))
        axial = AXIAL_FACTOR * body.youngs_modulus_pa * body.width_m * body.thickness_m
        mbs.AddObject(
            _item("ObjectANCFCable2D")(
                nodeNumbers=[left, right],
                length=length,
                massPerLength=heavier * body.mass_per_length_kg_per_m,
                bendingStiffness=stiffer * body.bending_stiffness_n_m2,
                axialStiffness=heavier * axial,
            )
        )
    if body.clamped:  # a free beam needs no hold lengthwise: no force acts there, its centre stays
        fix(nodes[0], (0, 1, 3)[: 1 + held_coordinates(rig, body)])
    return Mesh(body, positions, nodes)


_ADDED: dict[type, Callable[..., Mesh]] = {Beam: _add_beam, Oscillator: _add_mass}
"""The bodies that this plant meshes, and how."""


def _add_attachments(mbs: Any, rig: Rig, meshes: list[Mesh]) -> None:
    """A beam's point masses, linear springs and clamps that give, as mass and stiffness of one node each."""

    def add(station: Station, **matrices: Float[np.ndarray, "4 4"]) -> None:
        mesh = next(m for m in meshes if m.body.name == station.body)
        if not mesh.body.is_mass:
            mbs.AddObject(_item("ObjectGenericODE2")(nodeNumbers=[mesh.node_at(station.position_m)], **matrices))

    for point in rig.masses:
        add(point.station, massMatrix=np.diag([point.mass_kg, point.mass_kg, 0.0, 0.0]))
    for spring in rig.springs:
        add(
            spring.station, stiffnessMatrix=np.diag([0.0, spring.stiffness_n_per_m, 0.0, spring.rotational_n_m_per_rad])
        )
    for clamp in rig.clamps:
        add(Station(clamp.body), stiffnessMatrix=np.diag([0.0, 0.0, 0.0, clamp.rotational_n_m_per_rad]))


def _add_loads(mbs: Any, rig: Rig, meshes: list[Mesh]) -> Callable[[float], None]:
    """Static loads and the base's inertial load; the returned function sets the base's acceleration."""
    constant, carried = static_load(rig, meshes), inertia(rig, meshes)
    item = _item("ObjectGenericODE2")
    loaded = [
        mbs.AddObject(item(nodeNumbers=list(mesh.nodes), forceVector=vector))
        for mesh, vector in zip(meshes, by_node(meshes, constant), strict=True)
    ]

    def set_base(acceleration_m_per_s2: float) -> None:
        for number, vector in zip(loaded, by_node(meshes, constant - carried * acceleration_m_per_s2), strict=True):
            mbs.SetObjectParameter(number, "forceVector", vector)

    return set_base


def _add_damping(mbs: Any, rig: Rig, meshes: list[Mesh]) -> None:
    """The same damping ratio for every elastic mode of the finite elements, as a damping matrix on the beam's nodes."""
    mbs.Assemble()
    mass, stiffness, _ = mbs.ComputeLinearizedSystem()
    first = 0
    for mesh in meshes:
        size = mesh.per_node * len(mesh.nodes)
        if not mesh.body.is_mass:
            free = free_coordinates(rig, mesh)
            inside = np.ix_(first + free, first + free)
            squares, shapes = eigh(stiffness[inside], mass[inside])
            rate = 2 * mesh.body.damping_ratio * np.sqrt(np.maximum(squares, 0))
            rate[: mesh.body.rigid_modes] = 0
            momentum = mass[inside] @ shapes
            damping = np.zeros((size, size))
            damping[np.ix_(free, free)] = (momentum * rate) @ momentum.T
            mbs.AddObject(_item("ObjectGenericODE2")(nodeNumbers=list(mesh.nodes), dampingMatrix=damping))
        first += size


def free_coordinates(rig: Rig, mesh: Mesh) -> Int[np.ndarray, " free"]:
    """Among all coordinates of a beam's nodes, the transverse ones that no clamp holds."""
    transverse = np.array([4 * i + c for i in range(len(mesh.nodes)) for c in mesh.transverse])
    return transverse[held_coordinates(rig, mesh.body) :]


def _read_nodes(exu: Any, mbs: Any, meshes: list[Mesh], order: int) -> Callable[[], Float[np.ndarray, "rows samples"]]:
    """Sensors on every node for one derivative in time; the returned function gives all transverse coordinates."""
    output = getattr(exu.OutputVariableType, ("Coordinates", "Coordinates_t", "Coordinates_tt")[order])
    sensors = [
        (mbs.AddSensor(_item("SensorNode")(nodeNumber=node, storeInternal=True, outputVariableType=output)), mesh)
        for mesh in meshes
        for node in mesh.nodes
    ]

    def read() -> Float[np.ndarray, "rows samples"]:
        stored = [np.asarray(mbs.GetSensorStoredData(s))[:, [1 + c for c in mesh.transverse]].T for s, mesh in sensors]
        return np.concatenate(stored)

    return read


def _settings(exu: Any, step_s: float) -> Any:
    settings = exu.SimulationSettings()
    integration = settings.timeIntegration
    integration.generalizedAlpha.spectralRadius = 0.9
    integration.newton.useModifiedNewton = True
    integration.newton.relativeTolerance = 1e-5
    integration.newton.absoluteTolerance = 1e-6  # newtons; rounding alone leaves 2e-8
    integration.adaptiveStep = False
    integration.verboseMode = 0
    settings.linearSolverType = exu.LinearSolverType.EigenSparse
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = step_s
    return settings


def _advance(exu: Any, mbs: Any, settings: Any, first: int, last: int, step_s: float) -> None:
    integration = settings.timeIntegration
    integration.startTime = first * step_s
    integration.endTime = last * step_s
    integration.numberOfSteps = last - first
    integration.generalizedAlpha.computeInitialAccelerations = first == 0
    integration.generalizedAlpha.resetAccelerations = first == 0
    try:
        solved = mbs.SolveDynamic(settings, updateInitialValues=True)
    except exu.SolverError as error:
        solved, reason = False, str(error).strip().splitlines()[-1]
    else:
        reason = "no reason given"
    if not solved:
        raise RigError(
            f"the ancf plant failed between {first * step_s:.3f} and {last * step_s:.3f} s at step {step_s} s "
            f"({reason}); use a smaller step or a softer contact"
        )


def _item(name: str) -> Any:
    from exudyn import itemInterface

    return getattr(itemInterface, name)


def _stack(rows: list[Float[np.ndarray, " samples"]], samples: int) -> Float[np.ndarray, "rows samples"]:
    return np.stack(rows) if rows else np.zeros((0, samples))
