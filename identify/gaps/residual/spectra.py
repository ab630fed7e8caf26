"""Computation of a `Record`: spectra of forces and motion, their noise and power, and the samples that count.

Notes for maintainers
1. Noise is that of the quiet start; without one that of the lowest cells of the spectrum over time, where the quietest
   segments are as loud at all frequencies, and else what rig.json states if that is less. No channel has less than
   that of 24 bits.
2. A measured displacement counts down to rest: of a free mass the residual is that of the windowed acceleration
   itself, w x'' = (w x)'' - 2 (w' x)' + w'' x, with no corner of integration.
"""

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import irfft
from scipy.ndimage import uniform_filter1d

from identify.contacts.separation import contact_drift_prior
from identify.gaps.residual.extent import (
    FORCE_BAND_RATIO,
    LEAST_COUNTED_S,
    RecordBeginning,
    beginning_of,
    check_length,
    diagnosis_sensors,
    end_of_motion_s,
    force_noise_n,
    highest_diagnosed_hz,
    integration_corner_hz,
    is_free_mass,
    sensor_noise_densities,
)
from identify.gaps.residual.gauges import gauge_sensors, gauge_zeros_and_deviations
from identify.gaps.residual.record import CountedBandAndEnd, Record
from identify.gaps.residual.ringing import MeasuredMode, measured_modes
from identify.gaps.residual.shaken_base import BaseSpectra, base_sensor
from identify.gaps.residual.transform import RecordTransform, transform_of
from identify.linear.joined import rig_with_joined_contacts
from identify.signals.drift import DriftPrior
from identify.signals.kinematics import CORNER_HZ, kinematics, omega_power
from identify.signals.noise import acceleration_noise_m_per_s2
from rig.model.description import ON_GROUND, Rig, Sensor
from rig.model.modes import modes_of
from rig.model.sensing import PASSBAND
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording
from rig.recording.period import force_period_samples

INITIAL_SAMPLE_COUNT = 10
"""Samples from which the first state of a decay is read. Set by hand."""
SMOOTHING_BANDWIDTH_HZ = 1.0
"""Bandwidth over which the power P of the acceleration is smoothed. Set by hand."""
UNSETTLED_FREQUENCY_SHARE = 1 / 3
"""Share of the first natural frequency below which an AC-coupled sensor shows nothing while its high-pass settles. Set
by hand: high-passes of some tenths of a hertz settle below 1 Hz, beams and frames vibrate above 3 Hz."""


def record_of(
    recording: Recording, tolerances: Tolerances | None = None, counted_part: CountedBandAndEnd | None = None
) -> Record:
    """Record of a recording, by the sensors of `extent.diagnosis_sensors` and the strain gauges of
    `gauges.gauge_sensors`.

    It counts up to the highest frequency that it shows and until its motion has decayed, or as `counted_part` says.
    Raises RigError if the recording is too short, has no sensors of motion or shows none.
    """
    rig, rate_hz, sample_count = recording.rig, recording.rig.sample_rate_hz, recording.samples
    joined_rig, tolerances = rig_with_joined_contacts(rig), tolerances or rig.tolerances or LABORATORY
    motion_sensors, gauges = diagnosis_sensors(recording), gauge_sensors(recording)
    sensors, motion_count = (*motion_sensors, *gauges), len(motion_sensors)
    beginning = beginning_of(recording, motion_sensors)
    check_length(recording, beginning)
    noise_densities = sensor_noise_densities(recording, sensors, beginning.quiet_sample_count)
    highest_hz = highest_diagnosed_hz(recording, motion_sensors, noise_densities[:motion_count], tolerances)
    modes: tuple[MeasuredMode, ...] = ()
    is_floating = rig.contacts and any(body.is_mass or body.rigid_modes for body in rig.bodies)
    if beginning.fits_initial_state and not is_floating:
        signals = np.stack([recording.values_of(sensor) for sensor in sensors])
        modes = measured_modes(signals, rate_hz, highest_hz, noise_densities)
        highest_hz = min(highest_hz, FORCE_BAND_RATIO * max((mode.frequency_hz for mode in modes), default=np.inf))
    decimation = counted_part.decimation if counted_part else max(1, int(rate_hz / (2 * highest_hz)))
    transform = transform_of(recording, beginning, decimation)
    omega = transform.omega
    sensor_spectra, eta_above_band = _sensor_spectra_and_eta_above(recording, transform, joined_rig, sensors)
    gauge_zeros, gauge_zero_errors = gauge_zeros_and_deviations(recording, gauges, beginning)
    sensor_spectra[motion_count:] -= np.outer(gauge_zeros, transform.spectrum(np.ones(sample_count))[: omega.size])
    noise_per_line, corner_hz = sample_count * noise_densities**2 * rate_hz / 2, CORNER_HZ
    if not (rig.contacts or beginning.zero_known):  # contacts have drifts for the slow motion
        motion_power = np.abs(sensor_spectra[:motion_count]) ** 2
        corner_hz = integration_corner_hz(rig, omega, motion_power, noise_per_line[:motion_count])
    acceleration_per_signal, displacement_per_signal = (
        np.stack([omega_power(omega, order - sensor.measures.order, corner_hz) for sensor in sensors])
        for order in (2, 0)
    )
    velocity_correction, accelerations = _window_corrections(recording, transform, sensors, omega, beginning.zero_known)
    accelerations += sensor_spectra * acceleration_per_signal
    noise_factor = np.stack([omega ** (2 - sensor.measures.order) for sensor in sensors])
    noise_variance = noise_per_line[:, None] * noise_factor**2
    signal_factors = _signal_factors(accelerations, noise_variance, motion_count)
    accelerations *= signal_factors[:, None]
    base, base_velocity_correction = _base_and_velocity_corrections(recording, transform, beginning, corner_hz)
    period_samples = _period_samples(recording.forces_n[:, beginning.excitation_start_sample :])
    unsettled_noise_factor = _unsettled_noise_factors(rig, sensors, omega) if beginning.fits_initial_state else 1.0
    static_ratio = np.stack([_quasi_static_acceleration_factor(rig, sensor, omega) for sensor in sensors])
    counted_end_s = counted_part.end_s if counted_part else None
    return Record(
        rig=rig,
        sensors=sensors,
        signal_factors=signal_factors,
        zero_errors=signal_factors * np.concatenate([np.zeros(motion_count), gauge_zero_errors]),
        zero_known=beginning.zero_known,
        sample_rate_hz=rate_hz,
        transform_length=transform.padded_length,
        sample_count=sample_count,
        decimation=transform.decimation,
        window=transform.window,
        omega=omega,
        force_spectra=transform.spectrum(recording.forces_n)[:, : omega.size],
        acceleration_signals=accelerations,
        displacement_signals=signal_factors[:, None] * sensor_spectra * displacement_per_signal,
        base=base,
        velocity_correction=velocity_correction - base_velocity_correction,
        force_noise_variance=sample_count * force_noise_n(recording, beginning.quiet_sample_count, tolerances) ** 2,
        noise_variance=signal_factors[:, None] ** 2 * noise_variance * unsettled_noise_factor,
        smoothed_power=_smoothed_power(accelerations, static_ratio, transform),
        corner_hz=corner_hz,
        eta_above_band=eta_above_band,
        drifts=_drift_priors(recording, joined_rig, motion_sensors, tolerances, beginning),
        excitation_start_s=beginning.excitation_start_sample / rate_hz,
        period_s=None if period_samples is None else period_samples / rate_hz,
        tolerances=tolerances,
        fits_initial_state=beginning.fits_initial_state,
        initial_sensor_states=np.array(
            [_initial_value_and_slope(recording.values_of(sensor), rate_hz) for sensor in sensors]
        ),
        measured_modes=modes,
        counted_slice=_counted_slice(sample_count, transform, beginning, accelerations[:motion_count], counted_end_s),
        responses_windowed=not rig.contacts,
    )


def _signal_factors(
    accelerations: Complex[np.ndarray, "sensors lines"],
    noise_variance: Float[np.ndarray, "sensors lines"],
    motion_count: int,
) -> Float[np.ndarray, " sensors"]:
    """Factors of `Record.signal_factors`, of the power beyond noise."""
    power = np.maximum(np.mean(np.abs(accelerations) ** 2 - noise_variance, axis=1), 0.0)
    signal_factors = np.ones(len(power))
    if np.any(power[:motion_count]) and np.any(power[motion_count:]):
        signal_factors[motion_count:] = np.sqrt(power[:motion_count].mean() / power[motion_count:].mean())
    return signal_factors


def _initial_value_and_slope(signal: Float[np.ndarray, " samples"], rate_hz: float) -> Float[np.ndarray, "2"]:
    """Value and slope of a signal at its first sample, by a cubic through its first samples."""
    time_s = np.arange(INITIAL_SAMPLE_COUNT) / rate_hz
    return np.polynomial.polynomial.polyfit(time_s, signal[:INITIAL_SAMPLE_COUNT], 3)[:2]


def _drift_priors(
    recording: Recording,
    joined_rig: Rig,
    sensors: tuple[Sensor, ...],
    tolerances: Tolerances,
    beginning: RecordBeginning,
) -> tuple[DriftPrior | None, ...]:
    """Drift of each relative displacement: what is known of the part that integration loses, and of motion across the
    axes of the accelerometers."""
    if not beginning.integrates:
        return (None,) * len(joined_rig.contacts)
    sensor_kinematics = kinematics(recording, sensors[0].quantity, least_order=2)
    noise_deviations = acceleration_noise_m_per_s2(sensor_kinematics, recording.rig)
    return tuple(
        contact_drift_prior(
            joined_rig, sensor_kinematics, contact_index, noise_deviations, tolerances, recording.samples
        )
        for contact_index in range(len(joined_rig.contacts))
    )


def _sensor_spectra_and_eta_above(
    recording: Recording, transform: RecordTransform, joined_rig: Rig, sensors: tuple[Sensor, ...]
) -> tuple[Complex[np.ndarray, "sensors lines"], Complex[np.ndarray, "contacts morelines"]]:
    """Spectrum of each sensor on the lines, and the measured relative displacements beyond them."""
    omega_above_band = transform.omega_above_band
    eta_above_band = np.zeros((len(joined_rig.contacts), omega_above_band.size), dtype=complex)
    sensor_spectra = np.empty((len(sensors), transform.line_count), dtype=complex)
    if recording.rig.base_sensors:
        sensor = base_sensor(recording.rig)
        spectrum = transform.spectrum(recording.values_of(sensor))[transform.line_count - 1 :]
        _add_eta_above_band(eta_above_band, joined_rig, sensor, spectrum, omega_above_band)
    for sensor_row, sensor in zip(sensor_spectra, sensors, strict=True):
        spectrum = transform.spectrum(recording.values_of(sensor))
        sensor_row[:] = spectrum[: transform.line_count]
        _add_eta_above_band(eta_above_band, joined_rig, sensor, spectrum[transform.line_count - 1 :], omega_above_band)
    return sensor_spectra, eta_above_band


def _quasi_static_acceleration_factor(
    rig: Rig, sensor: Sensor, omega: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, " lines"]:
    """Approximate acceleration per force of a body below its first mode, omega^2 / (omega^2 + omega_1^2); one for a
    free body, and for accelerometers, which show noise there.
    """
    body = rig.body(sensor.station.body)
    natural_hz = modes_of(rig, body).frequencies_hz(body.max_modes)
    if not sensor.measures.translates:  # rigid-body motion bends nothing
        natural_hz = natural_hz[natural_hz > 0]
    first_natural_omega = 2 * np.pi * float(np.min(natural_hz))
    return omega**2 / (omega**2 + first_natural_omega**2) if sensor.measures.order < 2 else np.ones_like(omega)


def _unsettled_noise_factors(
    rig: Rig, sensors: tuple[Sensor, ...], omega: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, "sensors lines"]:
    """Factor of the noise's variance for AC-coupled sensors whose high-passes have not settled where a record begins in
    motion: 1 + (share omega_1 / omega)^4, with the body's first natural frequency and `UNSETTLED_FREQUENCY_SHARE`."""
    factors = np.ones((len(sensors), omega.size))
    for k, sensor in enumerate(sensors):
        body = rig.body(sensor.station.body)
        natural_hz = modes_of(rig, body).frequencies_hz(body.max_modes)
        if sensor.measures.ac_coupled and np.any(natural_hz > 0):
            factors[k] += (2 * np.pi * UNSETTLED_FREQUENCY_SHARE * np.min(natural_hz[natural_hz > 0]) / omega) ** 4
    return factors


def _smoothed_power(
    acceleration_signals: Complex[np.ndarray, "sensors lines"],
    acceleration_ratio: Float[np.ndarray, "sensors lines"],
    transform: RecordTransform,
) -> Float[np.ndarray, "sensors lines"]:
    """Mean square of the accelerations per line, smoothed after division by their fall per force."""
    smoothing_line_count = max(1, round(SMOOTHING_BANDWIDTH_HZ * transform.padded_length / transform.sample_rate_hz))
    power = np.abs(acceleration_signals / acceleration_ratio) ** 2
    return np.asarray(uniform_filter1d(power, smoothing_line_count, axis=1) * acceleration_ratio**2)


def _window_corrections(
    recording: Recording,
    transform: RecordTransform,
    sensors: tuple[Sensor, ...],
    omega: Float[np.ndarray, " lines"],
    zero_known: bool,
) -> tuple[Complex[np.ndarray, "sensors lines"], Complex[np.ndarray, "sensors lines"]]:
    """Windowed velocity and acceleration less the derivatives of the windowed displacement x of free masses:
    w x' = (w x)' - w' x and w x'' = (w x)'' - 2 (w' x)' + w'' x. Zero for held bodies, whose response to a faded force
    is not the faded motion."""
    corrections = np.zeros((2, len(sensors), omega.size), dtype=complex)
    for k, sensor in enumerate(sensors):
        if zero_known and is_free_mass(recording.rig, sensor.station.body):
            corrections[:, k] = transform.window_correction(recording.values_of(sensor))
    return corrections[0], corrections[1]


def _base_and_velocity_corrections(
    recording: Recording, transform: RecordTransform, beginning: RecordBeginning, corner_hz: float
) -> tuple[BaseSpectra | None, Complex[np.ndarray, "sensors lines"] | float]:
    """Spectra of a measured base, and its part in the velocity corrections of the sensors; None, 0 without one."""
    if not recording.rig.base_sensors:
        return None, 0.0
    rig, omega, sensors = recording.rig, transform.omega, diagnosis_sensors(recording)
    sensor = base_sensor(rig)
    base_signal, base_order = recording.values_of(sensor), sensor.measures.order
    spectrum = transform.spectrum(base_signal)[: omega.size]
    velocity_correction, acceleration_correction = transform.window_correction(base_signal)
    sensed_acceleration = spectrum * omega_power(omega, 2 - base_order, corner_hz)
    (noise_density,) = sensor_noise_densities(recording, (sensor,), beginning.quiet_sample_count)
    noise_variance = recording.samples * noise_density**2 * rig.sample_rate_hz / 2 * omega ** (2 * (2 - base_order))
    is_corrected = np.array([beginning.zero_known and is_free_mass(rig, sensor.station.body) for sensor in sensors])
    base = BaseSpectra(
        sensor,
        sensed_acceleration + beginning.zero_known * acceleration_correction,
        sensed_acceleration + np.outer(is_corrected, acceleration_correction),
        spectrum * omega_power(omega, -base_order, corner_hz),
        noise_variance,
    )
    return base, np.outer(is_corrected, velocity_correction / sensor.gain)


def _counted_slice(
    sample_count: int,
    transform: RecordTransform,
    beginning: RecordBeginning,
    acceleration_signals: Complex[np.ndarray, "sensors lines"],
    counted_until_s: float | None,
) -> slice:
    """Slice of the times that count, at the lower rate: without the ends, and up to where the rig comes to rest."""
    rate_hz = transform.sample_rate_hz / transform.decimation
    duration_s = sample_count / transform.sample_rate_hz
    start_s, omitted_end_s = beginning.omitted_s
    if counted_until_s is None:
        accelerations = irfft(acceleration_signals, transform.padded_length // transform.decimation)
        counted_until_s = end_of_motion_s(accelerations[:, : int(duration_s * rate_hz)], rate_hz)
    end_s = min(duration_s - omitted_end_s, max(counted_until_s, start_s + LEAST_COUNTED_S))
    return slice(round(start_s * rate_hz), int(end_s * rate_hz))


def _period_samples(forces_n: Float[np.ndarray, "forces samples"]) -> int | None:
    """Common period of all forces in samples; None if there is none."""
    first_period, *further_periods = {force_period_samples(force_n) for force_n in forces_n if np.any(force_n)} or {
        None
    }
    return None if further_periods else first_period


def _add_eta_above_band(
    eta_above_band: Complex[np.ndarray, "contacts lines"],
    rig: Rig,
    sensor: Sensor,
    sensor_spectrum: Complex[np.ndarray, " lines"],
    omega_above_band: Float[np.ndarray, " lines"],
) -> None:
    """Add a sensor's contribution to the relative displacement of its contact above the band of the diagnosis."""
    is_in_passband = omega_above_band <= 2 * np.pi * PASSBAND * rig.sample_rate_hz
    displacement_per_signal = omega_power(omega_above_band, -sensor.measures.order, CORNER_HZ)
    for k, contact in enumerate(rig.contacts):
        for station, sign in ((contact.at, 1.0), (contact.against, -1.0)):
            if sensor.measures.translates and sensor.station == (station or ON_GROUND):
                eta_above_band[k] += sign * is_in_passband * sensor_spectrum * displacement_per_signal
