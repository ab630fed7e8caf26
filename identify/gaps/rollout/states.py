"""State of a rig at any sample of a record, estimated from its sensors and given at its stations.

The sensors determine as many of each body's lowest modes as it has stations. Velocities are as accurate as the
channels. Displacements are not: for a mode at 50 Hz that moves by 0.8 mm, errors of gains and positions leave 0.2 mm,
as the rigid and lowest modes move by centimetres. Two sources are therefore combined by frequency: above
`CROSSOVER_RATIO` of a mode's natural frequency its displacement is that by the sensors, below it is the response to the
measured force F and the separated contact forces f with the accelerance A = -omega^2 / D,

    Q = W Q_sensors + (1 - W) A (phi_F F - phi_C f) / (i omega)^2

Modes that move slowly without resistance (rigid ones, single masses) use the sensors alone, with the slow motion b
that integration loses, as fitted with the rig. Finally the displacements are corrected by least squares to the relative
displacements of the fit, which the contact laws determine to some hundredths of a millimetre.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.fft import irfft, rfft

from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Residual
from identify.linear.joined import rig_with_joined_contacts
from identify.signals.kinematics import CORNER_HZ, kinematics
from rig.model.description import Body, Rig, Station
from rig.model.modes import Modes, modes_of
from rig.recording import Recording

CROSSOVER_RATIO = 0.3
"""Crossover from the displacement by forces to that by sensors, as a share of a mode's natural frequency. 0.15 to 0.7
make no difference."""
FORCE_ERROR_SHARE, SENSOR_ERROR_SHARE = 1e-2, 3e-3
"""Relative errors of a mode's displacement by forces, and of a station's displacement by its sensor."""
SOFTEST_HZ = 0.05
"""Frequency at which free modes are taken to be held when slow motion is shared out among the modes."""
EDGE_SAMPLE_COUNT = 16
"""Samples at either end of a record whose derivatives are inaccurate."""


@dataclass(frozen=True)
class MeasuredMotion:
    """Motion at a record's stations, measured with the sensors' gains and delays of one rig.

    displacement_m and velocity_m_per_s are those by the sensors with the slow motion, modal_states the displacement and
    velocity by the rig's lowest modes. They are valid from first_sample to stop_sample. derivative_orders are those
    that the sensors measure.
    """

    rig: Rig
    stations: tuple[Station, ...]
    sensor_names: tuple[str, ...]
    derivative_orders: tuple[int, ...]
    sample_rate_hz: float
    forces_n: Float[np.ndarray, "forces samples"]
    displacement_m: Float[np.ndarray, "stations samples"]
    velocity_m_per_s: Float[np.ndarray, "stations samples"]
    modal_states: Float[np.ndarray, "2 stations samples"]
    first_sample: int
    stop_sample: int

    @property
    def valid_slice(self) -> slice:
        return slice(self.first_sample, self.stop_sample)

    @property
    def compared_derivatives(self) -> list[int]:
        """Derivative in which each sensor's motion is compared: 0 of displacement sensors, else 1, the velocity."""
        return [min(order, 1) for order in self.derivative_orders]

    @property
    def compared_signals(self) -> list[Float[np.ndarray, " samples"]]:
        motions = (self.displacement_m, self.velocity_m_per_s)
        return [motions[derivative][sensor] for sensor, derivative in enumerate(self.compared_derivatives)]


def measured_motion(recording: Recording, rig: Rig, residual: Residual) -> MeasuredMotion:
    """Motion of a recording under a rig; `residual` is that of the fit, with slow motion and separated forces."""
    record = residual.model.record
    motion = kinematics(Recording(rig, recording.signals, recording.provenance), record.sensors[0].quantity)
    modes = _station_modes_of(rig, residual, motion.stations)
    slow_motion, slow_shapes = _slow_relative_motion(residual, motion.sample_count), modes.slow_motion_shapes()
    displacement_m = motion.displacement_m + slow_shapes @ slow_motion[0]
    velocity_m_per_s = motion.velocity_m_per_s + slow_shapes @ slow_motion[1]
    counted_start = record.counted_slice.start * record.decimation
    has_drift = any(drift is not None for drift in record.drifts)
    first_sample = max(motion.excited_from, counted_start if has_drift else 0, EDGE_SAMPLE_COUNT)
    stop_sample = min(motion.sample_count, (record.counted_slice.stop - 1) * record.decimation + 1) - EDGE_SAMPLE_COUNT
    valid_slice, is_by_force = slice(first_sample, stop_sample), modes.is_force_determined

    inverse_shapes = modes.inverse_shapes()
    modal_displacements_m = _complete_displacements(inverse_shapes @ displacement_m, modes, record)
    station_errors_m = SENSOR_ERROR_SHARE * _rms_by_row(displacement_m[:, valid_slice])
    mode_errors_m = np.sqrt(inverse_shapes**2 @ station_errors_m**2)
    mode_errors_m[is_by_force] = FORCE_ERROR_SHARE * _rms_by_row(modal_displacements_m[is_by_force, valid_slice])
    covariance = mode_errors_m[:, None] ** 2 * modes.contact_shapes.T
    contact_to_modes = covariance @ np.linalg.pinv(modes.contact_shapes @ covariance, rcond=1e-9, hermitian=True)
    eta_errors_m = modes.contact_shapes @ modal_displacements_m
    for error_m, contact in zip(eta_errors_m, residual.contacts, strict=True):
        fitted_eta_m = contact.motion.eta_m[: motion.sample_count - counted_start]
        counted_stop = counted_start + fitted_eta_m.size
        error_m[:counted_start], error_m[counted_stop:] = 0.0, 0.0
        error_m[counted_start:counted_stop] -= fitted_eta_m
    modal_displacements_m -= contact_to_modes @ eta_errors_m
    return MeasuredMotion(
        rig=rig,
        stations=motion.stations,
        sensor_names=tuple(sensor.name for sensor in motion.sensors),
        derivative_orders=tuple(sensor.measures.order for sensor in motion.sensors),
        sample_rate_hz=motion.sample_rate_hz,
        forces_n=motion.forces_n,
        displacement_m=displacement_m,
        velocity_m_per_s=velocity_m_per_s,
        modal_states=np.stack([modes.shapes @ modal_displacements_m, modes.shapes @ inverse_shapes @ velocity_m_per_s]),
        first_sample=first_sample,
        stop_sample=stop_sample,
    )


@dataclass(frozen=True)
class _StationModes:
    """Lowest modes of each body, as many as it has stations, with shapes at the stations and across the contacts.

    is_force_determined masks those whose slow displacement follows from forces; coordinates_by_force_m are the spectra
    of all modal displacements by forces.
    """

    natural_hz: Float[np.ndarray, " modes"]
    shapes: Float[np.ndarray, "stations modes"]
    contact_shapes: Float[np.ndarray, "contacts modes"]
    is_force_determined: Bool[np.ndarray, " modes"]
    displacement_spectra_by_force_m: np.ndarray

    def inverse_shapes(self) -> Float[np.ndarray, "modes stations"]:
        """Least-squares map from displacements at the stations to modal coordinates."""
        return np.asarray(np.linalg.pinv(self.shapes, rcond=1e-9))

    def slow_motion_shapes(self) -> Float[np.ndarray, "stations contacts"]:
        """Displacement of the stations per slow relative displacement of each contact, with least elastic energy."""
        compliant_shapes = self.contact_shapes.T / (self.natural_hz**2 + SOFTEST_HZ**2)[:, None]
        return np.asarray(
            self.shapes @ compliant_shapes @ np.linalg.pinv(self.contact_shapes @ compliant_shapes, rcond=1e-9)
        )


def _station_modes_of(rig: Rig, residual: Residual, stations: tuple[Station, ...]) -> _StationModes:
    """Modes of a rig, and their displacements by the forces of the fit, body by body."""
    record, contacts = residual.model.record, rig_with_joined_contacts(rig).contacts
    modal_motions = {
        response.body.name: (motion, response.dynamics.slowly_free_modes)
        for response, motion in zip(residual.model.responses, residual.model.modal_accelerations, strict=True)
    }
    at_stations, against_stations = [contact.at for contact in contacts], [contact.against for contact in contacts]
    modes_by_body = []
    for body in rig.bodies:
        modes = modes_of(rig, body)
        mode_count = min(sum(station.body == body.name for station in stations), body.max_modes)
        modal_acceleration, high_passed_indices = modal_motions[body.name]
        natural_hz = modes.frequencies_hz(mode_count)
        station_shapes, at_shapes, against_shapes = (
            _shapes_at_stations(body, modes, mode_count, places) for places in (stations, at_stations, against_stations)
        )
        is_high_passed = np.isin(np.arange(mode_count), high_passed_indices)
        is_force_determined = ~is_high_passed & (CROSSOVER_RATIO * natural_hz > 2 * CORNER_HZ)
        spectra_m = -modal_acceleration[:mode_count] / record.omega**2
        spectra_m[:, 0] = 0.0
        modes_by_body.append((natural_hz, station_shapes, at_shapes - against_shapes, is_force_determined, spectra_m))
    all_hz, all_shapes, all_contact_shapes, all_determined, all_spectra_m = zip(*modes_by_body, strict=True)
    return _StationModes(
        np.concatenate(all_hz),
        np.concatenate(all_shapes, axis=1),
        np.concatenate(all_contact_shapes, axis=1),
        np.concatenate(all_determined),
        np.concatenate(all_spectra_m),
    )


def _shapes_at_stations(
    body: Body, modes: Modes, mode_count: int, stations: Sequence[Station | None]
) -> Float[np.ndarray, "places modes"]:
    """Shapes of a body's lowest modes; zero at stations on other bodies and on the ground."""
    shapes = np.zeros((len(stations), mode_count))
    for row, station in zip(shapes, stations, strict=True):
        if station is not None and station.body == body.name:
            row[:] = modes.shapes(np.array([station.position_m]), mode_count)[0]
    return shapes


def _complete_displacements(
    sensed_m: Float[np.ndarray, "modes samples"], station_modes: _StationModes, record: Record
) -> Float[np.ndarray, "modes samples"]:
    """Modal displacements, with the slow part by forces for the modes that forces determine."""
    completed_m, by_force_m = sensed_m.copy(), station_modes.displacement_spectra_by_force_m
    lines_hz, line_count = np.fft.rfftfreq(record.transform_length, 1 / record.sample_rate_hz), by_force_m.shape[1]
    for mode_index in np.flatnonzero(station_modes.is_force_determined):
        crossover_hz = min(CROSSOVER_RATIO * station_modes.natural_hz[mode_index], record.highest_hz)
        high_pass_gain = np.sin(np.pi / 2 * np.clip(2 * lines_hz / crossover_hz - 1, 0, 1)) ** 2
        spectrum = high_pass_gain * rfft(sensed_m[mode_index], record.transform_length)
        spectrum[:line_count] += (1 - high_pass_gain[:line_count]) * by_force_m[mode_index]
        completed_m[mode_index] = irfft(spectrum, record.transform_length)[: sensed_m.shape[1]]
    return completed_m


def _slow_relative_motion(residual: Residual, sample_count: int) -> Float[np.ndarray, "2 contacts samples"]:
    """Slow relative displacement of each contact (m) and its rate (m/s) at all samples of a record."""
    record, sample_indices = residual.model.record, np.arange(sample_count)
    counted_samples = np.arange(record.counted_slice.start, record.counted_slice.stop) * record.decimation
    slow_motion = np.zeros((2, len(residual.contacts), sample_count))
    for contact_index, contact in enumerate(residual.contacts):
        spline = contact.observation.drift_spline
        for row, value_per_knot in zip(slow_motion[:, contact_index], (spline.value, spline.rate), strict=True):
            row[:] = np.interp(sample_indices, counted_samples, value_per_knot @ contact.unknowns[: spline.knot_count])
    return slow_motion


def _rms_by_row(signals: Float[np.ndarray, "rows samples"]) -> Float[np.ndarray, " rows"]:
    """Root mean square of each row."""
    return np.asarray(np.sqrt(np.mean(signals**2, axis=1)))
