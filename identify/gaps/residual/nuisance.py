"""Columns of nuisance parameters: changes of the residual by gains, delays, positions, modes and masses that a
laboratory never knows exactly, per standard deviation of their priors; and rigs with fitted values applied."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from msgspec.structs import replace

from identify.gaps.residual.gauges import gauge_nuisance_changes, without_slow_bending
from identify.gaps.residual.linear import LinearModel, ground_spring_correction
from identify.gaps.residual.record import Record
from identify.gaps.residual.unfolding import transverse_station_indices
from identify.gaps.residual.windowed import has_ground_forces, with_measured_motion_dampers_only
from identify.linear.free_motion import initial_state_changes, tuning_derivative
from identify.linear.model import Response, real_product
from identify.linear.nuisance import (
    SINGLE_FORCE_NAME,
    Change,
    Nuisance,
    NuisanceKind,
    ObservedSignals,
    changes_of,
    crosstalk_changes,
    elastic_mode_indices,
)
from identify.linear.observed_motion import BodyMotion, ObservedTransverse
from identify.linear.projection import Projection
from rig.model.description import Body, Rig, Sensor
from rig.model.modes import modes_of
from rig.model.tolerances import Tolerances

PULL_LIMIT = 6.0
"""Bound of every nuisance parameter in standard deviations: beyond it, something else is wrong. Derived: a normal
variable exceeds it once in 5e8."""
MODE_FREQUENCY_REACH = 1.3
"""Multiple of the highest frequency up to which modes have parameters of their own. Set by hand: higher modes act
nearly as static compliance."""
MODAL_KINDS = (NuisanceKind.MASS, NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
"""Parameters whose change moves the modes, and so is opposed by dampers to the ground."""


@dataclass(frozen=True)
class NuisanceColumns:
    """Decrease of the linear residual, the contact forces and the relative displacements per nuisance parameter.

    Each parameter is in its standard deviations. Relative displacements, of those at `eta_parameter_indices` alone, are
    spectra and, as `Record.at_finer_rate`, over time. Arrays are in single precision, except for records of sharp
    modes, where a nuisance parameter's shift and an effect's differ in the seventh digit.
    """

    parameters: tuple[Nuisance, ...]
    residual: Float[np.ndarray, "nuisances rows times"]
    contact_force_n: Float[np.ndarray, "nuisances contacts times"]
    eta_parameter_indices: Int[np.ndarray, " moving"]
    eta_m: Complex[np.ndarray, "moving contacts lines"]
    finer_eta_m: Float[np.ndarray, "moving contacts finer"]

    @property
    def flat_residual(self) -> Float[np.ndarray, "nuisances all"]:
        """Columns of the residual, nuisances x (rows times)."""
        return self.residual.reshape(len(self.parameters), -1)

    def residual_decrease(self, nuisance_pulls: Float[np.ndarray, " nuisances"]) -> Float[np.ndarray, "rows times"]:
        """Decrease of the linear residual by nuisance parameters."""
        return (nuisance_pulls.astype(self.residual.dtype) @ self.flat_residual).reshape(self.residual.shape[1:])

    def products_with(self, flat_residuals: Float[np.ndarray, "*some all"]) -> Float[np.ndarray, "nuisances *some"]:
        """Inner products of the columns with flattened residuals."""
        return (self.flat_residual @ flat_residuals.T.astype(self.residual.dtype, copy=False)).astype(float)


def nuisance_columns_of(record: Record, model: LinearModel) -> NuisanceColumns:
    """Columns of all parameters whose tolerance is above zero."""
    body_names = [response.body.name for response in model.responses]
    motion, signal_norm = _observed_motion(record, model), float(np.linalg.norm(record.acceleration_signals))
    changes = [
        _free_motion_change(record, model, change) for change in (*changes_of(motion), *crosstalk_changes(motion))
    ]
    changes += initial_state_changes(model.free_modes, body_names, model.sensor_response, signal_norm)
    contact_count, sample_count = len(model.rig.contacts), record.counted_slice.stop - record.counted_slice.start
    column_dtype = np.float64 if record.measured_modes else np.float32
    residual_columns = np.empty((len(changes), len(model.residual), sample_count), column_dtype)
    contact_columns_n = np.zeros((len(changes), contact_count, sample_count), np.float32)
    eta_parameter_indices, eta_columns_m = list[int](), list[Complex[np.ndarray, "contacts lines"]]()
    projection = model.projection if record.measured_modes else model.projection.in_single_precision()
    for index, change in enumerate(changes):
        residual_change, contact_change_n = _projected_change(record, model, projection, change)
        residual_columns[index] = residual_in_time(record, residual_change)
        contact_columns_n[index] = record.in_time(contact_change_n)
        if change.displacements is not None:
            eta_change_m = relative_displacements(record, model, change.displacements, change.sensors)
            if np.any(eta_change_m):
                eta_parameter_indices.append(index)
                eta_columns_m.append(eta_change_m.astype(np.complex64))
    eta_m = np.array(eta_columns_m, np.complex64).reshape(len(eta_parameter_indices), contact_count, record.omega.size)
    return NuisanceColumns(
        tuple(change.parameter for change in changes),
        residual_columns,
        contact_columns_n,
        np.array(eta_parameter_indices, dtype=int),
        eta_m,
        record.at_finer_rate(eta_m),
    )


def _free_motion_change(record: Record, model: LinearModel, change: Change) -> Change:
    """Change of a mode's frequency or damping in a record with measured modes, by its sampled free motion up to the
    faded end; any other change as it is."""
    parameter, tolerances = change.parameter, record.tolerances
    if not record.measured_modes or parameter.kind not in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING):
        return change
    acceleration_change = np.zeros_like(model.sensor_response)
    for mode in model.free_modes:
        response = model.responses[mode.body_index]
        if response.body.name == parameter.owner and parameter.mode_number in (None, mode.mode_index + 1):
            acceleration_change += tuning_derivative(mode, response, record.sampling, parameter.kind)
    stated = tolerances if parameter.mode_number is None else tolerances.of_mode(parameter.owner, parameter.mode_number)
    relative_tolerance = stated.frequency if parameter.kind is NuisanceKind.FREQUENCY else stated.damping
    signal_change = relative_tolerance * model.sensor_response * acceleration_change
    return Change(parameter, list(range(len(signal_change))), signal_change)


def _projected_change(
    record: Record, model: LinearModel, projection: Projection, change: Change
) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "contacts lines"]]:
    """Projected change, with that of the ground springs whose displacement differs from the measured one."""
    change = _with_damper_feedback(record, model, change)
    if change.displacements is None or not has_ground_forces(with_measured_motion_dampers_only(record, model.rig)):
        return projection.applied_to(change.signals, change.sensors)
    displacement_change, signal_change = np.zeros_like(model.sensor_response), np.zeros_like(model.sensor_response)
    displacement_change[change.sensors], signal_change[change.sensors] = change.displacements, change.signals
    return projection.applied_to(signal_change + ground_spring_correction(record, model, displacement_change))


def _with_damper_feedback(record: Record, model: LinearModel, change: Change) -> Change:
    """Change of a body's modes with what its dampers do against it; any other change as it is."""
    response = next((response for response in model.responses if response.body.name == change.parameter.owner), None)
    if change.parameter.kind not in MODAL_KINDS or response is None or response.feedback is None:
        return change
    shapes, sensor_response = _shapes_at(record, response, change.sensors), model.sensor_response[change.sensors]
    shows_motion = [record.sensors[index].measures.translates for index in change.sensors]
    fitted_count = min(shapes[shows_motion].shape)
    accelerations = np.zeros((response.mode_count, record.omega.size), dtype=complex)
    sensed_accelerations = (change.signals / sensor_response)[shows_motion]
    accelerations[:fitted_count] = np.linalg.pinv(shapes[shows_motion, :fitted_count]) @ sensed_accelerations
    feedback_acceleration = shapes @ (response.with_damper_feedback(accelerations) - accelerations)
    return dataclasses.replace(change, signals=change.signals + sensor_response * feedback_acceleration)


def _shapes_at(record: Record, response: Response, sensor_indices: Sequence[int]) -> Float[np.ndarray, "sensors modes"]:
    """Mode shapes of a body at some of the record's sensors, given by their indices."""
    return response.shapes([record.sensor_places[index] for index in sensor_indices])


def _observed_motion(record: Record, model: LinearModel) -> ObservedSignals:
    """Observed motion of a record under a linear model, from which changes by nuisance parameters follow."""
    explained_signals = record.acceleration_signals - model.residual[: len(record.sensors)] * model.error_deviation
    modal_accelerations = zip(model.responses, _corrected_modal_accelerations(record, model), strict=True)
    return ObservedSignals(
        sensors=record.sensors,
        displacement_sensors=record.sensors,
        tolerances=record.tolerances,
        omega=record.omega,
        sensor_response=model.sensor_response,
        signals=explained_signals - model.sensor_response * model.base_at_sensors,
        force_accelerations=model.acceleration_by_force[: 0 if model.base else None],
        displacements=model.displacements,
        bodies=tuple(BodyMotion(r, modal, _nuisance_mode_indices(record, r)) for r, modal in modal_accelerations),
        further_changes=gauge_nuisance_changes(record, model),
        base=model.observed_base,
        transverse=_observed_transverse(record, model),
    )


def _observed_transverse(record: Record, model: LinearModel) -> ObservedTransverse | None:
    """Motion in the other direction of a rig in space where both are measured; None without any."""
    pairs = transverse_station_indices([sensor.station for sensor in record.sensors])
    if not pairs:
        return None
    sensor_indices, transverse_indices = list(pairs), list(pairs.values())
    signals = model.sensor_response[sensor_indices] * model.accelerations[transverse_indices]
    return ObservedTransverse(sensor_indices, signals, model.displacements[transverse_indices])


def _nuisance_mode_indices(record: Record, response: Response) -> Int[np.ndarray, " some"]:
    """Modes with parameters of their own, by the nominal rig, so that all rigs have the same parameters."""
    mode_count = response.mode_count
    natural_hz = modes_of(record.rig, record.rig.body(response.body.name)).frequencies_hz(mode_count)
    elastic_indices = elastic_mode_indices(response, mode_count)  # whichever springs hold the body
    return elastic_indices[natural_hz[elastic_indices] < MODE_FREQUENCY_REACH * record.omega[-1] / (2 * np.pi)]


def _corrected_modal_accelerations(
    record: Record, model: LinearModel
) -> tuple[Complex[np.ndarray, "modes lines"], ...]:
    """Modal accelerations of each body: the modelled ones, corrected by the unexplained part of its sensors."""
    unexplained = model.residual[: len(record.sensors)] * model.error_deviation / model.sensor_response
    accelerations = model.modal_accelerations
    for response, body_accelerations in zip(model.responses, accelerations, strict=True):
        sensor_indices = record.motion_sensor_indices_on(response.body.name)
        if sensor_indices:
            sensed_mode_count = min(len(sensor_indices), response.mode_count)
            shapes = _shapes_at(record, response, sensor_indices)[:, :sensed_mode_count]
            correction = np.linalg.pinv(shapes) @ unexplained[sensor_indices]
            body_accelerations[:sensed_mode_count] += without_slow_bending(record, response, correction)
    return accelerations


def with_nonlinear_nuisance(
    rig: Rig, parameters: tuple[Nuisance, ...], pulls: Float[np.ndarray, " nuisances"], tolerances: Tolerances
) -> tuple[Rig, Float[np.ndarray, " nuisances"]]:
    """Rig with the nuisance parameters applied in which the residual is nonlinear, and their values, others zero.

    These are the frequencies and damping of single masses and the gains of their sensors: a resonance that is off by a
    fraction of its width is nonlinear. Without contacts the modes of every body are also scaled together; `tuned_modes`
    scales them one by one.
    """
    mass_names = {body.name for body in rig.bodies if body.is_mass}
    tuned_names = {body.name for body in rig.bodies if body.is_mass or not rig.contacts}
    applied = {Nuisance(kind, name) for name in tuned_names for kind in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)}
    applied |= {Nuisance(NuisanceKind.GAIN, s.name) for s in rig.sensors if s.station.body in mass_names}
    applied_pulls = np.where([parameter in applied for parameter in parameters], pulls, 0.0)
    return with_nuisance(rig, parameters, applied_pulls, tolerances), applied_pulls


def with_nuisance(
    rig: Rig, parameters: tuple[Nuisance, ...], pulls: Float[np.ndarray, " nuisances"], tolerances: Tolerances
) -> Rig:
    """Rig with fitted mass, frequencies and damping of its bodies, gains and delays of its channels.

    Stations are kept, as they link a contact to its sensors; so are single modes, high-passes and single gains of
    several forces.
    """
    pull_by_parameter = dict(zip(parameters, pulls.tolist(), strict=True))

    def change_of(kind: NuisanceKind, owner: str, tolerance: float) -> float:
        return tolerance * float(pull_by_parameter.get(Nuisance(kind, owner), 0.0))

    def factor_of(kind: NuisanceKind, owner: str, tolerance: float) -> float:
        return max(0.1, 1 + change_of(kind, owner, tolerance))

    def body_with_pulls(body: Body) -> Body:
        name = body.name
        body = body.scale_mass(factor_of(NuisanceKind.MASS, name, tolerances.mass))
        body = body.scale_frequencies(factor_of(NuisanceKind.FREQUENCY, name, tolerances.frequency))
        return body.scale_damping(factor_of(NuisanceKind.DAMPING, name, tolerances.damping))

    def sensor_with_pulls(sensor: Sensor) -> Sensor:
        name, stated = sensor.name, tolerances.of_sensor(sensor.name)
        gain = sensor.gain * factor_of(NuisanceKind.GAIN, name, stated.gain)
        return replace(sensor, gain=gain, delay_s=sensor.delay_s + change_of(NuisanceKind.DELAY, name, stated.delay_s))

    force_gain = rig.force_sensor.gain * factor_of(NuisanceKind.FORCE_GAIN, SINGLE_FORCE_NAME, tolerances.force_gain)
    return replace(
        rig,
        bodies=tuple(map(body_with_pulls, rig.bodies)),
        sensors=tuple(map(sensor_with_pulls, rig.sensors)),
        force_sensor=replace(rig.force_sensor, gain=force_gain),
    )


def residual_in_time(
    record: Record, residual_spectra: Complex[np.ndarray, "rows lines"]
) -> Float[np.ndarray, "rows times"]:
    """Residual over time, with unit variance where its lines have unit variance.

    Zero in a quiet start, where motion from before the record decays.
    """
    residual = line_to_time_residual_factor(record) * record.in_time(residual_spectra)
    residual[:, record.residual_times_s < record.excitation_start_s] = 0.0
    return residual


def line_to_time_residual_factor(record: Record) -> float:
    """Factor from lines of unit variance to a residual over time of unit variance."""
    return float(np.sqrt(record.transform_length * record.sample_count / (2 * record.omega.size)))


def relative_displacements(
    record: Record,
    model: LinearModel,
    displacements: Complex[np.ndarray, "some lines"],
    sensor_indices: list[int] | slice = slice(None),
) -> Complex[np.ndarray, "contacts lines"]:
    """Relative displacements at the contacts from displacements of some of the sensors there."""
    places = record.sensor_places
    signs = np.array([[(p == c.at) * 1.0 - (p == c.against) * 1.0 for p in places] for c in model.rig.contacts])
    return real_product(signs.reshape(-1, len(places))[:, sensor_indices], displacements)
