"""The reference plant: Exudyn with beams of ANCF cable elements (`finite_elements`), solved segment by segment."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.model.components import DIRECTIONS
from rig.model.description import Rig, Sensor, Station, contact_rows, stations_of
from rig.model.quantities import Quantity
from rig.simulation.motion import Forces, ForceSignal, Motion, Progress, forces_of
from rig.simulation.plants.connectors import ChangingModulus, ExtraPhysics, Section, modulus_change
from rig.simulation.plants.finite_elements import add_loads, build, item
from rig.simulation.plants.loading import (
    check_softening,
    connections,
    has_static_load,
    shaken_base,
    softening_limits_m,
    true_force,
)
from rig.simulation.plants.mesh import Mesh, coordinates_at_rest, station_row

ELEMENT_COUNT = 20
BLOCK_STEPS = 4096


def simulate(
    rig: Rig,
    force_n: ForceSignal,
    step_s: float,
    progress: Progress,
    element_count: int = ELEMENT_COUNT,
    extra_physics: tuple[ExtraPhysics, ...] = (),
) -> Iterator[Motion]:
    """Motion from rest, with about `element_count` elements per beam and a node wherever something acts on it.

    Generalized-alpha (spectral radius 0.9) at a fixed step; use a dyadic one, so that time adds up exactly. Each beam
    has the damping matrix M Phi diag(2 zeta omega) Phi' M of its finite elements, hence the same damping ratio in
    every elastic mode and none in the rigid ones. Coordinates are taken relative to the base, whose motion is an
    inertial load. The solver runs in segments of 4096 steps, each continued from the coordinates, velocities and
    accelerations of the one before. `extra_physics` is what no Rig describes.

    Yields one Motion per segment. Raises RigError if the solver fails or the motion is not finite.
    """
    with needs_extra("simulate", "the plant ancf (Exudyn)"):
        import exudyn as exu

    exu.config.printToConsole = False
    exu.config.suppressWarnings = True
    excitation = _excitation(rig, force_n, step_s, extra_physics)
    container = exu.SystemContainer()
    try:
        mbs = container.AddSystem()
        meshes, connectors, loads = build(exu, mbs, rig, excitation.first_n, element_count, extra_physics)
        instruments = _instruments(exu, mbs, rig, meshes, connectors)
        _excite(mbs, rig, meshes, loads, excitation, step_s, extra_physics)
        mbs.Assemble()
        if has_static_load(rig):
            mbs.systemData.SetODE2Coordinates(coordinates_at_rest(rig, meshes), exu.ConfigurationType.Initial)
        settings, step_count = _settings(exu, step_s), len(force_n) - 1
        for first_step in range(0, step_count, BLOCK_STEPS):
            steps = range(first_step, min(first_step + BLOCK_STEPS, step_count))
            _advance(exu, mbs, settings, steps, step_s)
            yield _motion(rig, mbs, instruments, excitation, steps, step_s)
            progress(steps.stop / step_count)
    finally:
        container.Reset()


@dataclass(frozen=True)
class _Excitation:
    """Excitation at every step: the loads (true forces, then tones) and the motion of the base.

    `base` is displacement, velocity and acceleration, empty where the base stands still.
    """

    measured_forces_n: Forces
    loads_n: tuple[Float[np.ndarray, " steps"], ...]
    base: tuple[Float[np.ndarray, " steps"], ...]

    @property
    def first_n(self) -> list[float]:
        """First values of the true forces."""
        return [float(history[0]) for history in self.loads_n[: len(self.measured_forces_n.signals)]]

    def base_motion_over(self, span: slice) -> list[Float[np.ndarray, " some"] | float]:
        """Displacement, velocity and acceleration of the base over a span of steps; zeros without base motion."""
        return [history[span] for history in self.base] or [0.0] * 3


def _excitation(rig: Rig, force_n: ForceSignal, step_s: float, extra_physics: tuple[ExtraPhysics, ...]) -> _Excitation:
    """Excitation of a run.

    Raises RigError if the number of forces is not the rig's, or loads or base motion act on a beam of sections.
    """
    measured_forces_n, time_s = forces_of(rig, force_n), np.arange(len(force_n)) * step_s
    base_signals = shaken_base(rig, measured_forces_n, step_s)
    if (base_signals or has_static_load(rig)) and any(isinstance(part, Section) for part in extra_physics):
        raise RigError("the ancf plant takes static loads and base motion on uniform beams only; leave them out")
    true_forces_n = (true_force(rig, signal[:], step_s) for signal in measured_forces_n.signals)
    return _Excitation(measured_forces_n, (*true_forces_n, *(tone.force_n(time_s) for tone in rig.tones)), base_signals)


def _excite(
    mbs: Any,
    rig: Rig,
    meshes: list[Mesh],
    loads: list[int],
    excitation: _Excitation,
    step_s: float,
    extra_physics: tuple[ExtraPhysics, ...],
) -> None:
    """Register the function that sets loads, base acceleration and changing moduli before every step."""
    set_base = add_loads(mbs, rig, meshes) if has_static_load(rig) or excitation.base else None
    modulus_updates = [modulus_change(mbs, meshes, part) for part in extra_physics if isinstance(part, ChangingModulus)]

    def apply_excitation(system: Any, time_s: float) -> bool:
        step = round(time_s / step_s)
        for load_number, history_n in zip(loads, excitation.loads_n, strict=True):
            system.SetLoadParameter(load_number, "load", float(history_n[step]))
        if excitation.base and set_base:
            set_base(float(excitation.base[2][step]))
        for update_modulus in modulus_updates:
            update_modulus(step, time_s)
        return True

    mbs.SetPreStepUserFunction(apply_excitation)


@dataclass(frozen=True)
class _Instruments:
    """Readers of a segment: all transverse coordinates by time derivative, and the contact forces with their columns.

    `displacement_rows` and `sensor_rows` weigh them in a station's displacement and a sensor's quantity.
    """

    coordinate_readers: dict[int, Callable[[], Float[np.ndarray, "rows samples"]]]
    contact_force_sensors: list[tuple[int, int]]
    displacement_rows: dict[Station, Float[np.ndarray, " rows"]]
    sensor_rows: list[tuple[Quantity, Float[np.ndarray, " rows"]]]
    limits_m: Float[np.ndarray, " connections"]


def _instruments(exu: Any, mbs: Any, rig: Rig, meshes: list[Mesh], connectors: list[int]) -> _Instruments:
    """Exudyn sensors on every node and on the connectors of the contacts."""
    readers = {
        order: _read_nodes(exu, mbs, meshes, order) for order in {0, *(sensor.measures.order for sensor in rig.sensors)}
    }
    force_sensors = []
    for connector, contact in zip(connectors, contact_rows(rig), strict=False):
        force = {"storeInternal": True, "outputVariableType": exu.OutputVariableType.Force}
        number = int(mbs.AddSensor(item("SensorObject")(objectNumber=connector, **force)))
        force_sensors.append((number, 2 + DIRECTIONS.index(contact.at.direction) if contact.law.spatial else 1))
    stations = {*stations_of(rig), *(contact.at for contact in connections(rig))}
    return _Instruments(
        coordinate_readers=readers,
        contact_force_sensors=force_sensors,
        displacement_rows={station: station_row(meshes, station) for station in stations},
        sensor_rows=[(sensor.measures, _sensor_row(rig, meshes, sensor)) for sensor in rig.sensors],
        limits_m=softening_limits_m(rig),
    )


def _motion(
    rig: Rig, mbs: Any, instruments: _Instruments, excitation: _Excitation, steps: range, step_s: float
) -> Motion:
    """Motion of the segment just solved; raises RigError if it diverged or a softening spring let go."""
    repeated = int(steps.start > 0)  # the first sample of a segment is the last of the one before
    coordinates = {order: read()[:, repeated:] for order, read in instruments.coordinate_readers.items()}
    if not all(np.isfinite(derivative).all() for derivative in coordinates.values()):
        end_s = steps.stop * step_s
        raise RigError(f"the ancf plant diverged before {end_s:.3f} s at step {step_s} s; use a smaller step")
    count = coordinates[0].shape[1]
    span = slice(steps.stop + 1 - count, steps.stop + 1)
    moved_m = {station: row @ coordinates[0] for station, row in instruments.displacement_rows.items()}
    eta_m = [moved_m[c.at] - (moved_m[c.against] if c.against else 0) for c in connections(rig)]
    check_softening(instruments.limits_m, _stack(eta_m, count))
    base, force_sensors = excitation.base_motion_over(span), instruments.contact_force_sensors
    sensed = [row @ coordinates[q.order] + base[q.order] * q.translates for q, row in instruments.sensor_rows]
    forces_n = [mbs.GetSensorStoredData(sensor)[repeated:, column] for sensor, column in force_sensors]
    return Motion(
        start_s=(steps.start + repeated) * step_s,
        step_s=step_s,
        forces_n=excitation.measured_forces_n[span],
        sensed=_stack(sensed, count),
        displacement_m=_stack([moved_m[station] + base[0] for station in stations_of(rig)], count),
        eta_m=_stack(eta_m[: len(force_sensors)], count),
        contact_force_n=_stack(forces_n, count),
    )


def _read_nodes(exu: Any, mbs: Any, meshes: list[Mesh], order: int) -> Callable[[], Float[np.ndarray, "rows samples"]]:
    """Add sensors of one time derivative on every node; return a function that reads all transverse coordinates."""
    output_type = getattr(exu.OutputVariableType, ("Coordinates", "Coordinates_t", "Coordinates_tt")[order])
    sensors = []
    for mesh in meshes:
        columns = [1 + coordinate for coordinate in mesh.transverse_coordinates]
        for node in mesh.node_numbers:
            sensor = item("SensorNode")(nodeNumber=node, storeInternal=True, outputVariableType=output_type)
            sensors.append((mbs.AddSensor(sensor), columns))

    def read_coordinates() -> Float[np.ndarray, "rows samples"]:
        rows = [np.asarray(mbs.GetSensorStoredData(sensor))[:, columns].T for sensor, columns in sensors]
        return np.concatenate(rows)

    return read_coordinates


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


def _advance(exu: Any, mbs: Any, settings: Any, steps: range, step_s: float) -> None:
    integration = settings.timeIntegration
    integration.startTime = steps.start * step_s
    integration.endTime = steps.stop * step_s
    integration.numberOfSteps = len(steps)
    integration.generalizedAlpha.computeInitialAccelerations = steps.start == 0
    integration.generalizedAlpha.resetAccelerations = steps.start == 0
    try:
        is_solved = mbs.SolveDynamic(settings, updateInitialValues=True)
    except exu.SolverError as error:
        is_solved, reason = False, str(error).strip().splitlines()[-1]
    else:
        reason = "no reason given"
    if not is_solved:
        raise RigError(
            f"the ancf plant failed between {steps.start * step_s:.3f} and {steps.stop * step_s:.3f} s at step "
            f"{step_s} s ({reason}); use a smaller step or a softer contact"
        )


def _stack(rows: list[Float[np.ndarray, " samples"]], sample_count: int) -> Float[np.ndarray, "rows samples"]:
    return np.stack(rows) if rows else np.zeros((0, sample_count))


def _sensor_row(rig: Rig, meshes: list[Mesh], sensor: Sensor) -> Float[np.ndarray, " rows"]:
    """Measurement operator of a sensor over all transverse coordinates; the curvature is that of the elements."""
    derivatives = np.array([station_row(meshes, sensor.station, order) for order in range(3)])
    return sensor.measures.operator(derivatives, rig.fibre_m(sensor))
