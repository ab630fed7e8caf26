"""Computation of a `Record`: spectra of forces and motion, their noise and power, and the samples that count.

Notes for maintainers
1. Noise is that of the quiet start; without one that of the lowest cells of the spectrum over time, where the quietest
   segments are as loud at all frequencies, and else what rig.json states if that is less. No channel has less than
   that of 24 bits.
2. A measured displacement counts down to rest: of a free mass the residual is that of the windowed acceleration
   itself, w x'' = (w x)'' - 2 (w' x)' + w'' x, with no corner of integration.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from identify.contacts.separation import drift_of
from identify.gaps.residual.extent import (
    LEAST_COUNTED_S,
    REACH,
    Beginning,
    beginning_of,
    check_length,
    end_of_motion_s,
    force_noise_n,
    high_hz_of,
    is_free,
    noise_corner_hz,
    read_sensors,
    sensor_densities,
)
from identify.gaps.residual.record import CountedPart, Record
from identify.gaps.residual.ringing import MeasuredMode, measured_modes
from identify.linear.joined import group_rig_of
from identify.signals.drift import Drift
from identify.signals.kinematics import CORNER_HZ, integrated, kinematics, taper
from identify.signals.noise import acceleration_noise
from rig.model.description import Rig, Sensor
from rig.model.modes import modes_of
from rig.model.sensing import PASSBAND
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording
from rig.recording.period import period_of

RING_S, LONGEST_RING_S, DECAY_TIMES = 12.0, 60.0, 20.0
"""Padding in which beams ring down before the transform wraps around, s; without contacts DECAY_TIMES of the slowest
mode, within both bounds, so that with two fifths of its damping it falls to 3e-4."""
FIRST_SAMPLES = 10
"""Samples from which the first state of a decay is read. Set by hand."""
SMOOTHED_HZ = 1.0
"""Bandwidth over which the power P of the acceleration is smoothed. Set by hand."""


SETTLED_SHARE = 1 / 3
"""Share of the first natural frequency below which an AC-coupled sensor shows nothing while its high-pass settles. Set
by hand: high-passes of some tenths of a hertz settle below 1 Hz, beams and frames vibrate above 3 Hz."""


@dataclass(frozen=True)
class _Transform:
    """Transform of windowed samples, padded to `padded_length`, and the lines for a rate lower by `decimation`."""

    sample_rate_hz: float
    padded_length: int
    decimation: int
    window: Float[np.ndarray, " samples"]

    @property
    def line_count(self) -> int:
        """Number of lines from zero to the highest frequency."""
        return self.padded_length // self.decimation // 2 + 1

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        """Circular frequencies of the lines, rad/s."""
        omega = 2 * np.pi * np.arange(self.line_count) * self.sample_rate_hz / self.padded_length
        omega[0] = 0.01 * omega[1]  # stands for the mean, which powers of omega would lose
        return omega

    @property
    def omega_above_band(self) -> Float[np.ndarray, " morelines"]:
        """Circular frequencies from the last of the lines to half the sample rate, rad/s."""
        return (
            2
            * np.pi
            * self.sample_rate_hz
            / self.padded_length
            * np.arange(self.line_count - 1, self.padded_length // 2 + 1)
        )

    def spectrum(self, signal: Float[np.ndarray, "*rows samples"]) -> Complex[np.ndarray, "*rows all"]:
        """Spectrum of a signal under the window, up to half the sample rate."""
        return np.asarray(rfft(signal * self.window, self.padded_length))


def record_of(
    recording: Recording,
    tolerances: Tolerances | None = None,
    counted_part: CountedPart | None = None,
) -> Record:
    """Record of a recording, by the sensors of `extent.read_sensors`.

    It counts up to the highest frequency that it shows and until its motion has decayed, or as `counted_part` says.
    Raises RigError if the recording is too short, has no sensors of motion or shows none.
    """
    rig, rate_hz, sample_count = recording.rig, recording.rig.sample_rate_hz, recording.samples
    joined_rig, tolerances = group_rig_of(rig), tolerances or rig.tolerances or LABORATORY
    sensors = read_sensors(recording)
    beginning = beginning_of(recording, sensors)
    check_length(recording, beginning)
    noise_densities = sensor_densities(recording, sensors, beginning.quiet_samples)
    high_hz = high_hz_of(recording, sensors, noise_densities, tolerances)
    decay_modes: tuple[MeasuredMode, ...] = ()
    if beginning.counts_from_blow and not (rig.contacts and any(b.is_mass or b.rigid_modes for b in rig.bodies)):
        decay_modes = measured_modes(
            np.stack([recording.values_of(s) for s in sensors]), rate_hz, high_hz, noise_densities
        )
        high_hz = min(high_hz, REACH * max((m.frequency_hz for m in decay_modes), default=np.inf))
    decimation = counted_part.decimation if counted_part else max(1, int(rate_hz / (2 * high_hz)))
    transform = _transform(recording, beginning, decimation)
    omega = transform.omega
    sensor_spectra, eta_above_band = _spectra(recording, transform, joined_rig, sensors)
    noise_per_line = sample_count * noise_densities**2 * rate_hz / 2
    integrates_alone = not (rig.contacts or beginning.zero_known)  # contacts have drifts for the slow motion
    corner_hz = (
        noise_corner_hz(rig, omega, np.abs(sensor_spectra) ** 2, noise_per_line) if integrates_alone else CORNER_HZ
    )
    to_acceleration, to_displacement = (
        np.stack([integrated(omega, target_order - s.measures.order, corner_hz) for s in sensors])
        for target_order in (2, 0)
    )
    velocity_correction, acceleration_signals = _window_corrections(
        recording, transform, sensors, omega, beginning.zero_known
    )
    acceleration_signals += sensor_spectra * to_acceleration
    period_samples = _period_of(recording.forces_n[:, beginning.excitation_start_sample :])
    acceleration_factor = np.stack([omega ** (2 - s.measures.order) for s in sensors])
    return Record(
        rig=rig,
        sensors=sensors,
        zero_known=beginning.zero_known,
        sample_rate_hz=rate_hz,
        transform_length=transform.padded_length,
        sample_count=sample_count,
        decimation=transform.decimation,
        window=transform.window,
        omega=omega,
        force_spectra=transform.spectrum(recording.forces_n)[:, : omega.size],
        acceleration_signals=acceleration_signals,
        displacement_signals=sensor_spectra * to_displacement,
        velocity_correction=velocity_correction,
        force_noise_variance=sample_count * force_noise_n(recording, beginning.quiet_samples, tolerances) ** 2,
        noise_variance=noise_per_line[:, None]
        * acceleration_factor**2
        * (_unsettled_noise_factors(rig, sensors, omega) if beginning.counts_from_blow else 1.0),
        smoothed_power=_smoothed_power(
            acceleration_signals, np.stack([_static_acceleration_ratio(rig, s, omega) for s in sensors]), transform
        ),
        corner_hz=corner_hz,
        eta_above_band=eta_above_band,
        drifts=_drifts(recording, joined_rig, sensors, tolerances, beginning),
        excitation_start_s=beginning.excitation_start_sample / rate_hz,
        period_s=None if period_samples is None else period_samples / rate_hz,
        tolerances=tolerances,
        counts_from_blow=beginning.counts_from_blow,
        first_states=np.array([_first_state(recording.values_of(s), rate_hz) for s in sensors]),
        measured_modes=decay_modes,
        counted_slice=_counted_samples(
            sample_count, transform, beginning, acceleration_signals, counted_part.end_s if counted_part else None
        ),
        responses_windowed=not rig.contacts,
    )


def _transform(recording: Recording, beginning: Beginning, decimation: int) -> _Transform:
    """Transform of the lowest lines; the record fades out, and in unless it starts quiet or with a blow."""
    rate_hz, sample_count = recording.rig.sample_rate_hz, recording.samples
    padded_length = decimation * next_fast_len(
        -(-(sample_count + round(_ring_down_s(recording.rig) * rate_hz)) // decimation), real=True
    )
    window = taper(sample_count, max(2, round(beginning.fade_length_s * rate_hz)))
    if beginning.zero_known and not beginning.counts_from_blow:  # differentiated twice, a kink in w'' would ring
        window = np.sin(np.pi / 2 * window) ** 2
    if beginning.counts_from_blow:
        window[0] = 0.5  # half a sample: the signal starts there
    elif not beginning.starts_quiet:
        window = window * window[::-1]
    return _Transform(rate_hz, padded_length, decimation, window)


def _first_state(signal: Float[np.ndarray, " samples"], rate_hz: float) -> Float[np.ndarray, "2"]:
    """Value and slope of a signal at its first sample, by a cubic through its first samples."""
    first_value, first_slope = np.polynomial.polynomial.polyfit(
        np.arange(FIRST_SAMPLES) / rate_hz, signal[:FIRST_SAMPLES], 3
    )[:2]
    return np.array([first_value, first_slope])


def _ring_down_s(rig: Rig) -> float:
    """Padding in which a rig rings down, s: without contacts until its slowest mode has decayed."""
    if rig.contacts:
        return RING_S
    decay_rates_per_s = []
    for body in rig.bodies:
        modes, mode_count = modes_of(rig, body), body.max_modes
        decay_rates_per_s += (2 * np.pi * modes.frequencies_hz(mode_count) * modes.damping_ratios(mode_count)).tolist()
    slowest_rate_per_s = min((rate_per_s for rate_per_s in decay_rates_per_s if rate_per_s > 0), default=np.inf)
    return float(np.clip(DECAY_TIMES / slowest_rate_per_s, RING_S, LONGEST_RING_S))


def _drifts(
    recording: Recording, joined_rig: Rig, sensors: tuple[Sensor, ...], tolerances: Tolerances, beginning: Beginning
) -> tuple[Drift | None, ...]:
    """Drift of each relative displacement: what is known of the slow part that integration loses."""
    if not beginning.integrates:
        return (None,) * len(joined_rig.contacts)
    motion = kinematics(recording, sensors[0].quantity, least_order=2)
    noise_deviations = acceleration_noise(motion, recording.rig)
    return tuple(
        drift_of(joined_rig, motion, contact_index, noise_deviations, tolerances, recording.samples)
        for contact_index in range(len(joined_rig.contacts))
    )


def _spectra(
    recording: Recording, transform: _Transform, joined_rig: Rig, sensors: tuple[Sensor, ...]
) -> tuple[Complex[np.ndarray, "sensors lines"], Complex[np.ndarray, "contacts morelines"]]:
    """Spectrum of each sensor on the lines, and the measured relative displacements beyond them."""
    omega_above_band = transform.omega_above_band
    eta_above_band = np.zeros((len(joined_rig.contacts), omega_above_band.size), dtype=complex)
    sensor_spectra = np.empty((len(sensors), transform.line_count), dtype=complex)
    for sensor_row, sensor in zip(sensor_spectra, sensors, strict=True):
        spectrum = transform.spectrum(recording.values_of(sensor))
        sensor_row[:] = spectrum[: transform.line_count]
        _add_eta_above_band(eta_above_band, joined_rig, sensor, spectrum[transform.line_count - 1 :], omega_above_band)
    return sensor_spectra, eta_above_band


def _static_acceleration_ratio(
    rig: Rig, sensor: Sensor, omega: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, " lines"]:
    """Approximate acceleration per force of a body below its first mode, omega^2 / (omega^2 + omega_1^2); one for a
    free body, and for accelerometers, which show noise there.
    """
    body = rig.body(sensor.station.body)
    first_omega = 2 * np.pi * float(np.min(modes_of(rig, body).frequencies_hz(body.max_modes)))
    return omega**2 / (omega**2 + first_omega**2) if sensor.measures.order < 2 else np.ones_like(omega)


def _unsettled_noise_factors(
    rig: Rig, sensors: tuple[Sensor, ...], omega: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, "sensors lines"]:
    """Factor of the noise's variance for AC-coupled sensors whose high-passes have not settled where a record begins in
    motion: 1 + (share omega_1 / omega)^4, with the body's first natural frequency and `SETTLED_SHARE`."""
    noise_factors = np.ones((len(sensors), omega.size))
    for sensor_index, sensor in enumerate(sensors):
        body = rig.body(sensor.station.body)
        natural_hz = modes_of(rig, body).frequencies_hz(body.max_modes)
        if sensor.measures.ac_coupled and np.any(natural_hz > 0):
            noise_factors[sensor_index] += (2 * np.pi * SETTLED_SHARE * np.min(natural_hz[natural_hz > 0]) / omega) ** 4
    return noise_factors


def _smoothed_power(
    acceleration_signals: Complex[np.ndarray, "sensors lines"],
    acceleration_ratio: Float[np.ndarray, "sensors lines"],
    transform: _Transform,
) -> Float[np.ndarray, "sensors lines"]:
    """Mean square of the accelerations per line, smoothed after division by their fall per force."""
    smoothing_lines = max(1, round(SMOOTHED_HZ * transform.padded_length / transform.sample_rate_hz))
    return np.asarray(
        uniform_filter1d(np.abs(acceleration_signals / acceleration_ratio) ** 2, smoothing_lines, axis=1)
        * acceleration_ratio**2
    )


def _window_corrections(
    recording: Recording,
    transform: _Transform,
    sensors: tuple[Sensor, ...],
    omega: Float[np.ndarray, " lines"],
    zero_known: bool,
) -> tuple[Complex[np.ndarray, "sensors lines"], Complex[np.ndarray, "sensors lines"]]:
    """Windowed velocity and acceleration less the derivatives of the windowed displacement x of free masses:
    w x' = (w x)' - w' x and w x'' = (w x)'' - 2 (w' x)' + w'' x. Zero for held bodies, whose response to a faded force
    is not the faded motion."""
    velocity_correction, acceleration_correction = np.zeros((2, len(sensors), omega.size), dtype=complex)
    window_slope = np.gradient(transform.window) * transform.sample_rate_hz
    window_curvature = np.gradient(window_slope) * transform.sample_rate_hz
    for sensor_index, sensor in enumerate(sensors):
        if zero_known and is_free(recording.rig, sensor.station.body):
            slope_spectrum, curvature_spectrum = rfft(
                np.stack([window_slope, window_curvature]) * recording.values_of(sensor), transform.padded_length
            )[:, : omega.size]
            velocity_correction[sensor_index] = -slope_spectrum
            acceleration_correction[sensor_index] = curvature_spectrum - 2j * omega * slope_spectrum
    return velocity_correction, acceleration_correction


def _counted_samples(
    sample_count: int,
    transform: _Transform,
    beginning: Beginning,
    acceleration_signals: Complex[np.ndarray, "sensors lines"],
    counted_until_s: float | None,
) -> slice:
    """Slice of the times that count, at the lower rate: without the ends, and up to where the rig comes to rest."""
    rate_hz = transform.sample_rate_hz / transform.decimation
    duration_s = sample_count / transform.sample_rate_hz
    start_s, omitted_end_s = beginning.omitted_s
    if counted_until_s is None:
        accelerations = irfft(acceleration_signals, transform.padded_length // transform.decimation)[
            :, : int(duration_s * rate_hz)
        ]
        counted_until_s = end_of_motion_s(accelerations, rate_hz)
    end_s = min(duration_s - omitted_end_s, max(counted_until_s, start_s + LEAST_COUNTED_S))
    return slice(round(start_s * rate_hz), int(end_s * rate_hz))


def _period_of(forces_n: Float[np.ndarray, "forces samples"]) -> int | None:
    """Common period of all forces in samples; None if there is none."""
    first_period, *further_periods = {period_of(force_n) for force_n in forces_n if np.any(force_n)} or {None}
    return None if further_periods else first_period


def _add_eta_above_band(
    eta_above: Complex[np.ndarray, "contacts lines"],
    rig: Rig,
    sensor: Sensor,
    sensor_spectrum: Complex[np.ndarray, " lines"],
    omega_above_band: Float[np.ndarray, " lines"],
) -> None:
    """Add a sensor's contribution to the relative displacement of its contact above the band of the diagnosis."""
    for j, contact in enumerate(rig.contacts):
        for station, sign in ((contact.at, 1.0), (contact.against, -1.0)):
            if sensor.station == station:
                in_passband = omega_above_band <= 2 * np.pi * PASSBAND * rig.sample_rate_hz
                eta_above[j] += (
                    sign
                    * in_passband
                    * sensor_spectrum
                    * integrated(omega_above_band, -sensor.measures.order, CORNER_HZ)
                )
