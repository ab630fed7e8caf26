"""State of a rig at any sample of a record, estimated from its sensors and given at its stations.

The sensors determine as many of each body's lowest modes as it has stations. Velocities are as accurate as the
channels. Displacements are not: for a mode at 50 Hz that moves by 0.8 mm, errors of gains and positions leave 0.2 mm,
as the rigid and lowest modes move by centimetres. Two sources are therefore combined by frequency: above `CROSSOVER` of
a mode's natural frequency its displacement is that by the sensors, below it is the response to the measured force F and
the separated contact forces f with the accelerance A = -omega^2 / D,

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
from identify.linear.joined import joined
from identify.signals.kinematics import CORNER_HZ, kinematics
from rig.model.description import Body, Rig, Station
from rig.model.modes import Modes, modes_of
from rig.recording import Recording

CROSSOVER = 0.3
"""Crossover from the displacement by forces to that by sensors, as a share of a mode's natural frequency. 0.15 to 0.7
make no difference."""
FORCE_ERROR, SENSOR_ERROR = 1e-2, 3e-3
"""Relative errors of a mode's displacement by forces, and of a station's displacement by its sensor."""
SOFTEST_HZ = 0.05
"""Frequency at which free modes are taken to be held when slow motion is shared out among the modes."""
EDGE_SAMPLES = 16
"""Samples at either end of a record whose derivatives are inaccurate."""


@dataclass(frozen=True)
class MeasuredMotion:
    """Motion at a record's stations, measured with the sensors' gains and delays of one rig.

    displacement_m and velocity_m_per_s are those by the sensors with the slow motion, states the displacement and
    velocity by the rig's lowest modes. They are valid from first_sample to stop_sample. orders are the derivatives that
    the sensors measure.
    """

    rig: Rig
    stations: tuple[Station, ...]
    names: tuple[str, ...]
    orders: tuple[int, ...]
    sample_rate_hz: float
    forces_n: Float[np.ndarray, "forces samples"]
    displacement_m: Float[np.ndarray, "stations samples"]
    velocity_m_per_s: Float[np.ndarray, "stations samples"]
    states: Float[np.ndarray, "2 stations samples"]
    first_sample: int
    stop_sample: int

    @property
    def valid_samples(self) -> slice:
        return slice(self.first_sample, self.stop_sample)


def measured_motion(recording: Recording, rig: Rig, residual: Residual) -> MeasuredMotion:
    """Motion of a recording under a rig; `residual` is that of the fit, with slow motion and separated forces."""
    record = residual.model.record
    motion = kinematics(Recording(rig, recording.signals, recording.provenance), record.sensors[0].quantity)
    modes, slow_motion = _modes_of(rig, residual, motion.stations), _slow_relative_motion(residual, motion.samples)
    following = modes.slow_motion_shapes()
    displacement_m = motion.displacement_m + following @ slow_motion[0]
    velocity_m_per_s = motion.velocity_m_per_s + following @ slow_motion[1]
    counted_start = record.counted_samples.start * record.factor
    has_drift = any(drift is not None for drift in record.drifts)
    first = max(motion.excited_from, counted_start if has_drift else 0, EDGE_SAMPLES)
    stop = min(motion.samples, (record.counted_samples.stop - 1) * record.factor + 1) - EDGE_SAMPLES

    inverse_shapes = modes.inverse()
    sensed_m = inverse_shapes @ displacement_m
    coordinates_m = _complete_displacements(sensed_m, modes, record)
    mode_errors_m = np.sqrt(inverse_shapes**2 @ (SENSOR_ERROR * _rms(displacement_m[:, first:stop])) ** 2)
    mode_errors_m[modes.force_determined] = FORCE_ERROR * _rms(coordinates_m[modes.force_determined, first:stop])
    covariance = mode_errors_m[:, None] ** 2 * modes.contact_shapes.T
    contact_to_modes = covariance @ np.linalg.pinv(modes.contact_shapes @ covariance, rcond=1e-9, hermitian=True)
    eta_errors_m = modes.contact_shapes @ coordinates_m
    for row, contact in zip(eta_errors_m, residual.contacts, strict=True):
        fitted_eta_m = contact.eta_m[: motion.samples - counted_start]
        row[:counted_start], row[counted_start + fitted_eta_m.size :] = 0.0, 0.0
        row[counted_start : counted_start + fitted_eta_m.size] -= fitted_eta_m
    coordinates_m -= contact_to_modes @ eta_errors_m
    return MeasuredMotion(
        rig=rig,
        stations=motion.stations,
        names=tuple(s.name for s in motion.sensors),
        orders=tuple(s.measures.order for s in motion.sensors),
        sample_rate_hz=motion.sample_rate_hz,
        forces_n=motion.forces_n,
        displacement_m=displacement_m,
        velocity_m_per_s=velocity_m_per_s,
        states=np.stack([modes.shapes @ coordinates_m, modes.shapes @ inverse_shapes @ velocity_m_per_s]),
        first_sample=first,
        stop_sample=stop,
    )


@dataclass(frozen=True)
class _Modes:
    """Lowest modes of each body, as many as it has stations, with shapes at the stations and across the contacts.

    force_determined masks those whose slow displacement follows from forces; forced_m are the spectra of all modal
    displacements by forces.
    """

    natural_hz: Float[np.ndarray, " modes"]
    shapes: Float[np.ndarray, "stations modes"]
    contact_shapes: Float[np.ndarray, "contacts modes"]
    force_determined: Bool[np.ndarray, " modes"]
    forced_m: np.ndarray

    def inverse(self) -> Float[np.ndarray, "modes stations"]:
        """Least-squares map from displacements at the stations to modal coordinates."""
        return np.asarray(np.linalg.pinv(self.shapes, rcond=1e-9))

    def slow_motion_shapes(self) -> Float[np.ndarray, "stations contacts"]:
        """Displacement of the stations per slow relative displacement of each contact, with least elastic energy."""
        compliant = self.contact_shapes.T / (self.natural_hz**2 + SOFTEST_HZ**2)[:, None]
        return np.asarray(self.shapes @ compliant @ np.linalg.pinv(self.contact_shapes @ compliant, rcond=1e-9))


def _modes_of(rig: Rig, residual: Residual, stations: tuple[Station, ...]) -> _Modes:
    """Modes of a rig, and their displacements by the forces of the fit, body by body."""
    record, bodies = residual.model.record, []
    by_body = zip(residual.model.responses, residual.model.modal, strict=True)
    fitted = {response.body.name: (motion, response.dynamics.high_passed) for response, motion in by_body}
    contact_ends: list[list[Station | None]] = [
        [c.at for c in joined(rig).contacts],
        [c.against for c in joined(rig).contacts],
    ]
    for body in rig.bodies:
        modes = modes_of(rig, body)
        count = min(sum(s.body == body.name for s in stations), body.max_modes)
        acceleration, high_passed = fitted[body.name]
        natural_hz = modes.frequencies_hz(count)
        at_shapes, against_shapes = (_shapes(body, modes, count, places) for places in contact_ends)
        slow = np.isin(np.arange(count), high_passed)
        displaced = -acceleration[:count] / record.omega**2
        displaced[:, 0] = 0.0
        bodies.append(
            (
                natural_hz,
                _shapes(body, modes, count, stations),
                at_shapes - against_shapes,
                ~slow & (CROSSOVER * natural_hz > 2 * CORNER_HZ),
                displaced,
            )
        )
    hz, shapes, across, forced, displaced = zip(*bodies, strict=True)
    return _Modes(
        np.concatenate(hz),
        np.concatenate(shapes, axis=1),
        np.concatenate(across, axis=1),
        np.concatenate(forced),
        np.concatenate(displaced),
    )


def _shapes(
    body: Body, modes: Modes, count: int, stations: Sequence[Station | None]
) -> Float[np.ndarray, "places modes"]:
    """Shapes of a body's lowest modes; zero at stations on other bodies and on the ground."""
    rows = np.zeros((len(stations), count))
    for row, station in zip(rows, stations, strict=True):
        if station is not None and station.body == body.name:
            row[:] = modes.shapes(np.array([station.position_m]), count)[0]
    return rows


def _complete_displacements(
    sensed_m: Float[np.ndarray, "modes samples"], modes: _Modes, record: Record
) -> Float[np.ndarray, "modes samples"]:
    """Modal displacements, with the slow part by forces for the modes that forces determine."""
    completed_m = sensed_m.copy()
    hz = np.fft.rfftfreq(record.length, 1 / record.sample_rate_hz)
    for mode in np.flatnonzero(modes.force_determined):
        crossover_hz = min(CROSSOVER * modes.natural_hz[mode], record.highest_hz)
        high_pass = np.sin(np.pi / 2 * np.clip(2 * hz / crossover_hz - 1, 0, 1)) ** 2
        spectrum = high_pass * rfft(sensed_m[mode], record.length)
        line_count = modes.forced_m.shape[1]
        spectrum[:line_count] += (1 - high_pass[:line_count]) * modes.forced_m[mode]
        completed_m[mode] = irfft(spectrum, record.length)[: sensed_m.shape[1]]
    return completed_m


def _slow_relative_motion(residual: Residual, samples: int) -> Float[np.ndarray, "2 contacts samples"]:
    """Slow relative displacement of each contact (m) and its rate (m/s) at all samples of a record."""
    record, times = residual.model.record, np.arange(samples)
    counted = np.arange(record.counted_samples.start, record.counted_samples.stop) * record.factor
    motion = np.zeros((2, len(residual.contacts), samples))
    for j, contact in enumerate(residual.contacts):
        curve = contact.observation.curve
        for row, by_knot in zip(motion[:, j], (curve.value, curve.rate), strict=True):
            row[:] = np.interp(times, counted, by_knot @ contact.unknowns[: curve.knots])
    return motion


def _rms(rows: Float[np.ndarray, "rows samples"]) -> Float[np.ndarray, " rows"]:
    """Root mean square of each row."""
    return np.asarray(np.sqrt(np.mean(rows**2, axis=1)))
