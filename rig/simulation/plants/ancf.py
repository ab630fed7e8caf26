"""The reference plant: Exudyn with beams of ANCF cable elements (`finite_elements`), solved segment by segment."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.model.components import DIRECTIONS
from rig.model.description import Rig, Sensor, Station, contact_rows, rig_stations
from rig.model.quantities import Quantity
from rig.simulation.motion import Forces, ForceSignal, Motion, Progress, forces_of
from rig.simulation.plants.connectors import ChangingModulus, ExtraPhysics, Section, modulus_update
from rig.simulation.plants.finite_elements import add_loads, build, item
from rig.simulation.plants.loading import (
    base_motion_from_rig_or_force,
    check_softening_limits,
    connections,
    has_static_load,
    softening_limits_m,
    true_force,
)
from rig.simulation.plants.mesh import Mesh, coordinates_at_rest, station_weights

ELEMENT_COUNT = 20
STEPS_PER_BLOCK = 4096


def simulate(
    rig: Rig,
    force_n: ForceSignal,
    step_s: float,
    progress: Progress,
    min_element_count: int = ELEMENT_COUNT,
    extra_physics: tuple[ExtraPhysics, ...] = (),
) -> Iterator[Motion]:
    """Motion from rest, with at least `min_element_count` elements per beam and a node wherever something acts on it.

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
    inputs = _inputs_of(rig, force_n, step_s, extra_physics)
    system_container = exu.SystemContainer()
    try:
        mbs = system_container.AddSystem()
        meshes, connector_numbers, load_numbers = build(
            exu, mbs, rig, inputs.initial_forces_n, min_element_count, extra_physics
        )
        instruments = _instruments(exu, mbs, rig, meshes, connector_numbers)
        _register_inputs(mbs, rig, meshes, load_numbers, inputs, step_s, extra_physics)
        mbs.Assemble()
        if has_static_load(rig):
            mbs.systemData.SetODE2Coordinates(coordinates_at_rest(rig, meshes), exu.ConfigurationType.Initial)
        solver_settings, step_count = _solver_settings(exu, rig, step_s), len(force_n) - 1
        for first_step in range(0, step_count, STEPS_PER_BLOCK):
            steps = range(first_step, min(first_step + STEPS_PER_BLOCK, step_count))
            _advance(exu, mbs, solver_settings, steps, step_s)
            yield _motion(rig, mbs, instruments, inputs, steps, step_s)
            progress(steps.stop / step_count)
    finally:
        system_container.Reset()


@dataclass(frozen=True)
class _Inputs:
    """Inputs at every step: the loads (true forces, then tones) and the motion of the base.

    `base_signals` is displacement, velocity and acceleration, empty where the base stands still.
    """

    measured_forces_n: Forces
    loads_n: tuple[Float[np.ndarray, " steps"], ...]
    base_signals: tuple[Float[np.ndarray, " steps"], ...]

    @property
    def initial_forces_n(self) -> list[float]:
        """First values of the true forces."""
        return [float(history[0]) for history in self.loads_n[: len(self.measured_forces_n.signals)]]

    def base_motion_over(self, step_span: slice) -> list[Float[np.ndarray, " some"] | float]:
        """Displacement, velocity and acceleration of the base over a span of steps; zeros without base motion."""
        return [history[step_span] for history in self.base_signals] or [0.0] * 3


def _inputs_of(rig: Rig, force_n: ForceSignal, step_s: float, extra_physics: tuple[ExtraPhysics, ...]) -> _Inputs:
    """Loads and base motion of a run.

    Raises RigError if the number of forces is not the rig's, or loads or base motion act on a beam of sections.
    """
    measured_forces_n, time_s = forces_of(rig, force_n), np.arange(len(force_n)) * step_s
    base_signals = base_motion_from_rig_or_force(rig, measured_forces_n, step_s)
    if (base_signals or has_static_load(rig)) and any(isinstance(part, Section) for part in extra_physics):
        raise RigError("the ancf plant takes static loads and base motion on uniform beams only; leave them out")
    true_forces_n = (true_force(rig, signal[:], step_s) for signal in measured_forces_n.signals)
    return _Inputs(measured_forces_n, (*true_forces_n, *(tone.force_n(time_s) for tone in rig.tones)), base_signals)


def _register_inputs(
    mbs: Any,
    rig: Rig,
    meshes: list[Mesh],
    load_numbers: list[int],
    inputs: _Inputs,
    step_s: float,
    extra_physics: tuple[ExtraPhysics, ...],
) -> None:
    """Register the function that sets loads, base acceleration and changing moduli before every step."""
    set_base = add_loads(mbs, rig, meshes) if has_static_load(rig) or inputs.base_signals else None
    modulus_updates = [modulus_update(mbs, meshes, part) for part in extra_physics if isinstance(part, ChangingModulus)]

    def apply_excitation(system: Any, time_s: float) -> bool:
        step_number = round(time_s / step_s)
        for load_number, history_n in zip(load_numbers, inputs.loads_n, strict=True):
            system.SetLoadParameter(load_number, "load", float(history_n[step_number]))
        if inputs.base_signals and set_base:
            set_base(float(inputs.base_signals[2][step_number]))
        for update_modulus in modulus_updates:
            update_modulus(step_number, time_s)
        return True

    mbs.SetPreStepUserFunction(apply_excitation)


@dataclass(frozen=True)
class _Instruments:
    """Readers of a segment: all transverse coordinates by time derivative, and the contact forces with their columns.

    `weights_by_station` and `sensor_weights` weigh them in a station's displacement and a sensor's quantity.
    """

    reader_by_order: dict[int, Callable[[], Float[np.ndarray, "rows samples"]]]
    contact_force_columns: list[tuple[int, int]]
    weights_by_station: dict[Station, Float[np.ndarray, " rows"]]
    sensor_weights: list[tuple[Quantity, Float[np.ndarray, " rows"]]]
    softening_limits_m: Float[np.ndarray, " connections"]


def _instruments(exu: Any, mbs: Any, rig: Rig, meshes: list[Mesh], connector_numbers: list[int]) -> _Instruments:
    """Exudyn sensors on every node and on the connectors of the contacts."""
    readers = {
        order: _coordinate_reader(exu, mbs, meshes, order)
        for order in {0, *(sensor.measures.order for sensor in rig.sensors)}
    }
    force_columns = []
    for connector_number, contact in zip(connector_numbers, contact_rows(rig), strict=False):
        output_options = {"storeInternal": True, "outputVariableType": exu.OutputVariableType.Force}
        sensor_number = int(mbs.AddSensor(item("SensorObject")(objectNumber=connector_number, **output_options)))
        force_columns.append((sensor_number, 2 + DIRECTIONS.index(contact.at.direction) if contact.law.spatial else 1))
    stations = {*rig_stations(rig), *(contact.at for contact in connections(rig))}
    return _Instruments(
        reader_by_order=readers,
        contact_force_columns=force_columns,
        weights_by_station={station: station_weights(meshes, station) for station in stations},
        sensor_weights=[(sensor.measures, _sensor_weights(rig, meshes, sensor)) for sensor in rig.sensors],
        softening_limits_m=softening_limits_m(rig),
    )


def _motion(rig: Rig, mbs: Any, instruments: _Instruments, inputs: _Inputs, steps: range, step_s: float) -> Motion:
    """Motion of the segment just solved; raises RigError if it diverged or a softening spring let go."""
    repeated_count = int(steps.start > 0)  # the first sample of a segment is the last of the one before
    by_order = {order: read()[:, repeated_count:] for order, read in instruments.reader_by_order.items()}
    if not all(np.isfinite(derivative).all() for derivative in by_order.values()):
        end_s = steps.stop * step_s
        raise RigError(f"the ancf plant diverged before {end_s:.3f} s at step {step_s} s; use a smaller step")
    sample_count = by_order[0].shape[1]
    step_span = slice(steps.stop + 1 - sample_count, steps.stop + 1)
    motion_m = {station: row @ by_order[0] for station, row in instruments.weights_by_station.items()}
    eta_m = [motion_m[c.at] - (motion_m[c.against] if c.against else 0) for c in connections(rig)]
    check_softening_limits(instruments.softening_limits_m, _stacked_rows(eta_m, sample_count))
    base, force_columns = inputs.base_motion_over(step_span), instruments.contact_force_columns
    sensed_values = [row @ by_order[q.order] + base[q.order] * q.translates for q, row in instruments.sensor_weights]
    contact_forces_n = [mbs.GetSensorStoredData(sensor)[repeated_count:, column] for sensor, column in force_columns]
    return Motion(
        start_s=(steps.start + repeated_count) * step_s,
        step_s=step_s,
        forces_n=inputs.measured_forces_n[step_span],
        sensed=_stacked_rows(sensed_values, sample_count),
        displacement_m=_stacked_rows([motion_m[station] + base[0] for station in rig_stations(rig)], sample_count),
        eta_m=_stacked_rows(eta_m[: len(force_columns)], sample_count),
        contact_force_n=_stacked_rows(contact_forces_n, sample_count),
    )


def _coordinate_reader(
    exu: Any, mbs: Any, meshes: list[Mesh], order: int
) -> Callable[[], Float[np.ndarray, "rows samples"]]:
    """Add sensors of one time derivative on every node; return a function that reads all transverse coordinates."""
    output_type = getattr(exu.OutputVariableType, ("Coordinates", "Coordinates_t", "Coordinates_tt")[order])
    sensor_columns = []
    for mesh in meshes:
        columns = [1 + coordinate for coordinate in mesh.node_transverse_indices]
        for node in mesh.node_numbers:
            sensor = item("SensorNode")(nodeNumber=node, storeInternal=True, outputVariableType=output_type)
            sensor_columns.append((mbs.AddSensor(sensor), columns))

    def read_coordinates() -> Float[np.ndarray, "rows samples"]:
        rows = [np.asarray(mbs.GetSensorStoredData(sensor))[:, columns].T for sensor, columns in sensor_columns]
        return np.concatenate(rows)

    return read_coordinates


def _solver_settings(exu: Any, rig: Rig, step_s: float) -> Any:
    settings = exu.SimulationSettings()
    integration = settings.timeIntegration
    integration.generalizedAlpha.spectralRadius = 0.9
    integration.newton.useModifiedNewton = True
    integration.newton.relativeTolerance = 1e-5
    # newtons; rounding alone leaves 2e-8 in the plane, and 1e-6 of the stiff tubes that move in space
    integration.newton.absoluteTolerance = 1e-5 if rig.in_space else 1e-6
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


def _stacked_rows(rows: list[Float[np.ndarray, " samples"]], sample_count: int) -> Float[np.ndarray, "rows samples"]:
    return np.stack(rows) if rows else np.zeros((0, sample_count))


def _sensor_weights(rig: Rig, meshes: list[Mesh], sensor: Sensor) -> Float[np.ndarray, " rows"]:
    """Measurement operator of a sensor over all transverse coordinates; the curvature is that of the elements."""
    derivative_weights = np.array([station_weights(meshes, sensor.station, order) for order in range(3)])
    return sensor.measures.operator(derivative_weights, rig.fibre_m(sensor))
