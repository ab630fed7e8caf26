"""Linear residual of a rig against a record, and the contact forces separated by least squares without contact laws.

The accelerations of all sensors at every line are

    A = G_F F + G_T T - G_K (k3 w^3 + F_c tanh(v / v0)) - G_C f + G_B a_base + error

with the accelerances G of measured forces F, tones T, cubic springs and friction to the ground (by the measured w and v
there), contact forces f and an unmeasured base motion. G holds the viscous dampers to the ground (those of free motion
follow the measured v, too). f is a least-squares estimate, and so is a_base under the prior of its spectrum. The rest,
in standard deviations of the error, is the linear residual. Where a sensor measures the base (`shaken_base`), w, v and
relative displacements are those against it; relative displacements are those against the estimated base, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.residual.initial_state import free_motion_of
from identify.gaps.residual.record import Record, place_of
from identify.gaps.residual.shaken_base import (
    BaseSpectra,
    unmeasured_base_accelerations,
    unmeasured_base_deviation,
)
from identify.gaps.residual.windowed import (
    GroundForceChanges,
    SensedMotion,
    SensorPlaces,
    ground_force_derivative,
    has_ground_forces,
    known_forces_of,
    linear_dampers,
    modal_response,
    response_to_force,
    static_modal_accelerations,
    with_measured_motion_dampers_only,
)
from identify.linear.free_motion import FreeMode
from identify.linear.joined import rig_with_joined_contacts
from identify.linear.model import (
    Response,
    ResponseCache,
    accelerances,
    input_shapes,
    real_product,
    relative_shapes,
    responses_of,
)
from identify.linear.observed_motion import ObservedBase
from identify.linear.projection import Projection, estimated_inputs_and_log_det, input_residual, projection
from identify.linear.slow_stiffness import slow_stiffness, static_contact_forces
from rig.model.description import Rig, Station

INITIAL_STATE_ROUNDS = 2
"""Further evaluations of forces along the free motion. Effort: a third one changes next to nothing."""
ModeFactors = Mapping[str, tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"]]]
"""Factors on the frequency and on the damping ratio of each mode, by body."""


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear model of a rig, fitted to a record.

    sensor_response is each sensor's signal per acceleration, error_deviation the standard deviation of its error.
    signal_per_input are the signals, in standard deviations, per unknown input: contact forces, then a base motion (or
    the noise of a measured one), then the noise of each measured force. residual is in standard deviations, its last
    rows the estimates of the latter two; prior_input_log_determinant is the cost of that freedom. acceleration_by_force
    are those at the sensors by each measured force, known_forces all with their stations, free_modes free motion of
    modes.
    """

    record: Record
    rig: Rig
    responses: tuple[Response, ...]
    sensor_response: Complex[np.ndarray, "sensors lines"]
    error_deviation: Float[np.ndarray, "sensors lines"]
    signal_per_input: Complex[np.ndarray, "inputs sensors lines"]
    residual: Complex[np.ndarray, "rows lines"]
    contact_force_n: Complex[np.ndarray, "contacts lines"]
    acceleration_by_force: Complex[np.ndarray, "forces sensors lines"]
    known_forces: tuple[tuple[Station, Complex[np.ndarray, " lines"]], ...]
    free_modes: tuple[FreeMode, ...]
    prior_input_log_determinant: float

    @cached_property
    def projection(self) -> Projection:
        """Projection of sensor signals onto what the unknown inputs cannot explain."""
        return projection(self.signal_per_input, self.error_deviation, len(self.rig.contacts))

    @property
    def modal_accelerations(self) -> tuple[Complex[np.ndarray, "modes lines"], ...]:
        """Modal accelerations of each body."""
        forces_n = np.stack([*(force_n for _, force_n in self.known_forces), *self.contact_force_n])
        stations = [station for station, _ in self.known_forces]
        accelerations = tuple(
            modal_response(self.record, self.rig, r, real_product(input_shapes(self.rig, r, stations).T, forces_n))
            + static_modal_accelerations(self.record, self.rig, r)
            for r in self.responses
        )
        for free_mode in self.free_modes:
            accelerations[free_mode.body_index][free_mode.mode_index] += free_mode.acceleration
        return accelerations

    @cached_property
    def missed_accelerations(self) -> Complex[np.ndarray, "sensors lines"]:
        """Accelerations of a free motion that the sensors miss."""
        return sum((mode.unsensed_acceleration for mode in self.free_modes), np.zeros_like(self.sensor_response))

    @cached_property
    def base(self) -> BaseSpectra | None:
        """Motion of a shaken base that is measured."""
        return self.record.base and self.record.base.deconvolved(self.rig, self.record.omega)

    @property
    def base_at_sensors(self) -> Complex[np.ndarray, "sensors lines"] | float:
        """Acceleration of the measured base as each sensor shows it; 0 without one."""
        return self.base.acceleration_at_sensors if self.base else 0.0

    @property
    def observed_base(self) -> ObservedBase | None:
        """Measured base, with what it causes at the sensors against it."""
        if self.base is None:
            return None
        base, by_base = self.base, self.acceleration_by_force[0] - self.base.acceleration_at_sensors
        return ObservedBase(base.sensor, base.sensor, base.acceleration, base.displacement, by_base)

    @property
    def unmeasured_base_m(self) -> Complex[np.ndarray, " lines"] | float:
        """Estimated displacement of an unmeasured base, m; 0 without one."""
        record, base_motion = self.record, self.rig.base_motion
        if base_motion is None or self.base:
            return 0.0
        deviation = unmeasured_base_deviation(base_motion, record.omega, record.sample_count, self.rig.sample_rate_hz)
        return np.asarray(self.residual[len(record.sensors)] * deviation * record.displacement_per_acceleration)

    @cached_property
    def accelerations(self) -> Complex[np.ndarray, "sensors lines"]:
        """Accelerations at the sensors, against a measured base: measured and missed ones."""
        measured_accelerations = self.record.acceleration_signals / self.sensor_response - self.base_at_sensors
        return np.asarray(measured_accelerations + self.missed_accelerations)

    @cached_property
    def displacements(self) -> Complex[np.ndarray, "sensors lines"]:
        """Displacements at the sensors, against a measured base: measured, and by missed accelerations."""
        missed_displacements = self.missed_accelerations * self.record.displacement_per_acceleration
        return _measured_displacements(self.record, self.rig) + missed_displacements

    @cached_property
    def motion(self) -> SensedMotion:
        """Motion at the sensors. A free motion jumps at the first sample; its velocities are the derivatives of the
        displacements without that jump."""
        velocities = 1j * self.record.omega * self.displacements + self.record.velocity_correction
        for free_mode in self.free_modes:
            velocities -= free_mode.initial_state[0] * free_mode.shape[:, None]
        return SensedMotion(self.displacements, velocities)

    @cached_property
    def eta_m(self) -> Complex[np.ndarray, "contacts lines"]:
        """Relative displacements at the contacts, without the slow part that integration loses."""
        sensor_places = sensor_places_of(self.record, self.rig)
        displacements = self.displacements - self.unmeasured_base_m
        eta_m = self.eta_by_unobserved_modes_m(self.known_forces, self.contact_force_n)
        for response in self.responses:
            eta_m += real_product(eta_weights(self.rig, response, sensor_places), displacements)
        for mode in self.free_modes:
            shape = self._unobserved_shapes(self.responses[mode.body_index], sensor_places)[:, mode.mode_index]
            eta_m += np.outer(shape, mode.acceleration * self.record.displacement_per_acceleration)
        return eta_m

    def eta_by_unobserved_modes_m(
        self,
        known_forces: Sequence[tuple[Station, Complex[np.ndarray, " lines"]]],
        contact_force_n: Complex[np.ndarray, "contacts lines"],
    ) -> Complex[np.ndarray, "contacts lines"]:
        """Relative displacements by forces in the modes that the sensors do not determine, m."""
        sensor_places = sensor_places_of(self.record, self.rig)
        forces_n = np.stack([*(force_n for _, force_n in known_forces), *contact_force_n])
        accelerations = np.zeros((len(self.rig.contacts), forces_n.shape[1]), dtype=complex)
        for response in self.responses:
            force_shapes = input_shapes(self.rig, response, [station for station, _ in known_forces])
            transfer = response.transfer(self._unobserved_shapes(response, sensor_places), force_shapes)
            accelerations += np.einsum("icl,il->cl", transfer, forces_n)
        return accelerations * self.record.displacement_per_acceleration

    def _unobserved_shapes(
        self, response: Response, sensor_places: SensorPlaces
    ) -> Float[np.ndarray, "contacts modes"]:
        """Mode shapes across the contacts, less the part that the body's sensors determine."""
        sensor_weights = eta_weights(self.rig, response, sensor_places)
        return relative_shapes(self.rig, response) - sensor_weights @ response.shapes(sensor_places)

    @cached_property
    def static_contact_n(self) -> Float[np.ndarray, " contacts"]:
        """Constant contact forces under static loads, N."""
        return static_contact_forces(self.rig, self.responses)

    @cached_property
    def slow_stiffness_n_per_m(self) -> Float[np.ndarray, "contacts contacts"]:
        """Stiffness of the bodies against slow relative displacements of the contacts, N/m."""
        return slow_stiffness(self.rig, self.responses)

    @cached_property
    def ground_force_changes(self) -> GroundForceChanges:
        """Changes of the forces of ground springs and dampers with those of the sensors' displacements."""
        rig = with_measured_motion_dampers_only(self.record, self.rig)
        return ground_force_derivative(self.record, rig, self.responses, self.record.sensor_places, self.motion)

    def contact_force_error_n(self, record: Record) -> Float[np.ndarray, " contacts"]:
        """Standard deviation over time of each contact force by the errors of the accelerations, N."""
        force_variance = np.sum(np.abs(self.projection.to_inputs[: len(self.rig.contacts)]) ** 2, axis=(1, 2))
        return np.asarray(np.sqrt(2 * force_variance / (record.transform_length * record.sample_count)))


def linear_model(
    record: Record,
    rig: Rig,
    unmodelled_share: float | Float[np.ndarray, "sensors lines"],
    cache: ResponseCache | None = None,
    mode_factors: ModeFactors | None = None,
) -> LinearModel:
    """Linear model of a rig that has the record's sensors and contacts.

    model_error is the share of each acceleration that no model of this kind explains. The noise of the measured force
    is a further unknown input, with a prior of its own size. Contacts between the same places are one. `cache` is
    shared by rigs that are compared with one record; `mode_factors` are those on frequencies and damping of modes.
    Forces that follow a free motion follow its fitted initial state, too, of which no sensor shows all.
    """
    rig = rig_with_joined_contacts(rig)
    responses = responses_of(rig, cache or ResponseCache(record.omega), record.zero_known)
    if mode_factors:
        responses = tuple(r.tuned(*mode_factors[r.body.name]) if r.body.name in mode_factors else r for r in responses)
    responses = tuple(response.damped_by(linear_dampers(record, rig)) for response in responses)
    displacements = _measured_displacements(record, rig)
    motion = SensedMotion(displacements, 1j * record.omega * displacements + record.velocity_correction)
    model = _linear_model_for_motion(record, rig, responses, unmodelled_share, motion)
    if model.free_modes and has_ground_forces(with_measured_motion_dampers_only(record, rig)):
        for _ in range(INITIAL_STATE_ROUNDS):
            model = _linear_model_for_motion(record, rig, responses, unmodelled_share, model.motion)
    return model


def _measured_displacements(record: Record, rig: Rig) -> Complex[np.ndarray, "sensors lines"]:
    """Measured displacements at the sensors, against a measured base."""
    displacements = record.displacement_signals / sensor_response_of(record, rig)
    return (
        displacements
        if record.base is None
        else displacements - record.base.deconvolved(rig, record.omega).displacement
    )


def _linear_model_for_motion(
    record: Record,
    rig: Rig,
    responses: tuple[Response, ...],
    unmodelled_share: float | Float[np.ndarray, "sensors lines"],
    motion: SensedMotion,
) -> LinearModel:
    """Linear model whose forces on the ground follow this motion at the sensors."""
    sensor_response, sensor_places = sensor_response_of(record, rig), sensor_places_of(record, rig)
    known_forces = known_forces_of(record, rig, responses, sensor_places, motion)
    contact_count, force_count = len(rig.contacts), len(rig.forces)
    accelerance_by_input = accelerances(rig, responses, [station for station, _ in known_forces], sensor_places)
    by_known_force = [
        response_to_force(record, rig, per_newton, force_n)
        for per_newton, (_, force_n) in zip(accelerance_by_input, known_forces, strict=False)
    ]
    if base := record.base and record.base.deconvolved(rig, record.omega):
        by_known_force[0] = by_known_force[0] + base.acceleration_at_sensors
    known_accelerations = sum(by_known_force[1:], by_known_force[0])
    if rig.loads:
        known_accelerations = known_accelerations + sum(
            real_product(r.shapes(sensor_places), static_modal_accelerations(record, rig, r)) for r in responses
        )
    error_deviation = np.sqrt(record.noise_variance + unmodelled_share**2 * record.smoothed_power)
    error_deviation = np.maximum(error_deviation, 1e-9 * error_deviation.max())
    scaled_response = sensor_response / error_deviation
    by_unknown_input = [accelerance_by_input[len(known_forces) :]]
    if base and np.any(base.noise_variance):
        by_unknown_input.append(np.sqrt(base.noise_variance) * (accelerance_by_input[:force_count] - 1))
    elif rig.base_motion and not base:
        by_base = unmeasured_base_accelerations(rig, rig.base_motion, responses, sensor_places, record.sample_count)
        by_unknown_input.append(by_base[None])
    has_force_noise = record.force_noise_variance > 0
    force_noise_n = np.sqrt(record.force_noise_variance[has_force_noise, None, None])
    by_unknown_input.append(force_noise_n / rig.force_sensor.gain * accelerance_by_input[:force_count][has_force_noise])
    signal_per_input = np.concatenate(by_unknown_input) * scaled_response
    signals = record.acceleration_signals / error_deviation - known_accelerations * scaled_response
    free_modes = free_motion_of(record, rig, responses, signal_per_input, error_deviation, scaled_response, signals)
    free_accelerations = sum((mode.sensed_acceleration for mode in free_modes), np.zeros_like(signals))
    signals = signals - scaled_response * free_accelerations
    unknown_inputs, prior_input_log_determinant = estimated_inputs_and_log_det(signal_per_input, signals, contact_count)
    sensor_residual = input_residual(signal_per_input, unknown_inputs, signals)
    return LinearModel(
        record=record,
        rig=rig,
        responses=responses,
        sensor_response=sensor_response,
        error_deviation=error_deviation,
        signal_per_input=signal_per_input,
        residual=np.concatenate([sensor_residual, unknown_inputs[contact_count:]]),
        contact_force_n=unknown_inputs[:contact_count],
        acceleration_by_force=np.stack(by_known_force[:force_count]),
        known_forces=known_forces,
        free_modes=free_modes,
        prior_input_log_determinant=prior_input_log_determinant,
    )


def sensor_response_of(record: Record, rig: Rig) -> Complex[np.ndarray, "sensors lines"]:
    """Response of each sensor to an acceleration, with gain, delay, high-pass and the factor on its signals."""
    sensor_by_name = {sensor.name: sensor for sensor in rig.sensors}
    responses = [sensor_by_name[sensor.name].response(record.omega) for sensor in record.sensors]
    return record.signal_factors[:, None] * np.stack(responses).astype(complex)


def sensor_places_of(record: Record, rig: Rig) -> SensorPlaces:
    """Places of the record's sensors in the rig."""
    sensor_by_name = {sensor.name: sensor for sensor in rig.sensors}
    return [place_of(sensor, sensor_by_name[sensor.name].station) for sensor in record.sensors]


def eta_weights(rig: Rig, response: Response, stations: SensorPlaces) -> Float[np.ndarray, "contacts sensors"]:
    """Weights of a body's sensors in the relative displacements."""
    places = [*(contact.at for contact in rig.contacts), *(contact.against for contact in rig.contacts)]
    weights = response.sensor_weights(stations, places)
    return weights[: len(rig.contacts)] - weights[len(rig.contacts) :]


def ground_spring_correction(
    record: Record, model: LinearModel, displacement_changes: Complex[np.ndarray, "sensors lines"]
) -> Complex[np.ndarray, "sensors lines"]:
    """Correction of the signals for the true, smaller displacement of ground springs and dampers."""
    return -signals_by_forces(model, record.sensor_places, model.ground_force_changes(displacement_changes))


def signals_by_forces(
    model: LinearModel, sensor_places: SensorPlaces, forces: Sequence[tuple[Station, Complex[np.ndarray, " lines"]]]
) -> Complex[np.ndarray, "sensors lines"]:
    """Signals of sensors at some stations by forces at others."""
    signals = np.zeros(model.sensor_response.shape, dtype=complex)
    for station, force_n in forces:
        for response in model.responses:
            if response.body.name == station.body:
                accelerance = response.transfer(response.shapes(sensor_places), response.shapes([station]))[0]
                signals += model.sensor_response * (accelerance * force_n)
    return signals
