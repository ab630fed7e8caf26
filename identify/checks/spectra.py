"""Spectra of the sensors and forces of a record, on the lines that are compared with the linear model."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from identify.signals.beginning import QUIET_S, force_onset
from identify.signals.kinematics import TAPER_S, taper
from identify.signals.spectra import force_band_hz
from rig.errors import RigError
from rig.model.description import Sensor, force_names
from rig.model.sensing import PASSBAND
from rig.recording import Recording

LOWEST_HZ = 2.0
"""Accelerometers show drift and AC coupling below."""
LINES_TO_FORCE_RATIO = 2.0
"""Highest frequency of the lines, over the force's."""
PADDING_S, UNCOMPARED_END_S = 4.0, 2.5
"""Silence after the record; part of its end that is not compared over time, as the ringing is cut off there."""
MIN_COMPARED_S = 0.25
"""Least time that is compared with the linear model."""
MAX_LINES = 1600
SMOOTHED_LINE_COUNT = 41
"""Lines over which levels are averaged."""


@dataclass(frozen=True)
class Spectra:
    """Spectra of the forces, and of the sensors as accelerations: gain, delay and derivative of each chain divided out.

    across holds those of the sensors in the other direction at the same places, zero where there are none. line_noise
    is the standard deviation per line of each sensor's noise, in the same unit. line_numbers are those in the transform
    of padded_length samples; compared_span_s goes from the start of the force to where the ringing is cut off.
    """

    sensors: tuple[Sensor, ...]
    omega: Float[np.ndarray, " line_numbers"]
    acceleration: Complex[np.ndarray, "sensors lines"]
    across: Complex[np.ndarray, "sensors lines"]
    forces: Complex[np.ndarray, "forces lines"]
    line_noise: Float[np.ndarray, "sensors lines"]
    line_numbers: Int[np.ndarray, " line_numbers"]
    padded_length: int
    compared_span_s: tuple[float, float]
    sample_rate_hz: float
    record_s: float

    @cached_property
    def smoothed_line_level(self) -> Float[np.ndarray, "sensors lines"]:
        """Each sensor's root mean square over neighbouring lines."""
        return np.sqrt(uniform_filter1d(np.abs(self.acceleration) ** 2, SMOOTHED_LINE_COUNT, axis=1))

    @property
    def compared_rate_hz(self) -> float:
        """Samples a second of compared_signals."""
        return 2 * (int(self.line_numbers[-1]) + 1) * self.sample_rate_hz / self.padded_length

    def compared_signals(self, line_values: Complex[np.ndarray, "*some lines"]) -> Float[np.ndarray, "*some times"]:
        """Signals from consecutive lines over the compared time; their mean squares are those of the lines."""
        line_end = int(self.line_numbers[-1]) + 1
        full_spectra = np.zeros((*line_values.shape[:-1], line_end + 1), np.complex64)
        full_spectra[..., self.line_numbers] = line_values
        time_signals = irfft(full_spectra, 2 * line_end) * np.sqrt(2 * line_end**2 / self.line_numbers.size)
        start_sample, stop_sample = (round(time_s * self.compared_rate_hz) for time_s in self.compared_span_s)
        return np.asarray(time_signals[..., start_sample:stop_sample])

    @property
    def force_names(self) -> tuple[str, ...]:
        return force_names(len(self.forces))

    def with_acceleration(self, acceleration: Complex[np.ndarray, "sensors lines"]) -> "Spectra":
        return replace(self, acceleration=acceleration)


def spectra_of(
    recording: Recording,
    sensors: tuple[Sensor, ...],
    max_line_count: int | None = MAX_LINES,
    across: Recording | None = None,
) -> Spectra:
    """Spectra on at most this many lines (None: all) from 2 Hz to twice the force's highest frequency.

    across is the record of the other direction.

    Raises RigError if the force is zero, its band too low or too narrow, or the record too short.
    """
    rate_hz = recording.rig.sample_rate_hz
    forces_n, sample_count = recording.forces_n, recording.samples
    end_taper = taper(sample_count, min(round(TAPER_S * rate_hz), sample_count // 4))
    padded_length = next_fast_len(sample_count + round(PADDING_S * rate_hz), real=True)
    high_hz = min(LINES_TO_FORCE_RATIO * force_band_hz(forces_n, rate_hz)[1], PASSBAND * rate_hz)
    first_line, last_line = int(np.ceil(LOWEST_HZ * padded_length / rate_hz)), int(high_hz * padded_length / rate_hz)
    if last_line - first_line < SMOOTHED_LINE_COUNT:
        raise RigError("the force's band is too low or too narrow")
    line_step = 1 if max_line_count is None else max(1, (last_line - first_line) // max_line_count)
    line_numbers = np.arange(first_line, last_line, line_step)
    omega = 2 * np.pi * line_numbers * rate_hz / padded_length
    sensor_signals = np.stack([recording.values_of(sensor) for sensor in sensors])
    acceleration_per_signal = np.stack([acceleration_per_signal_unit(sensor, omega) for sensor in sensors])
    acceleration = rfft(sensor_signals * end_taper, padded_length)[:, line_numbers] * acceleration_per_signal
    across_acceleration = np.zeros_like(acceleration)
    for i, sensor in enumerate(sensors):
        other = None if across is None else _sensor_across(across, sensor)
        if across is not None and other is not None:
            lines = rfft(across.values_of(other) * end_taper, padded_length)[line_numbers]
            across_acceleration[i] = lines * acceleration_per_signal_unit(other, omega)
    quiet_count = quiet_sample_count(forces_n, rate_hz)
    if quiet_count:
        noise_rms = sensor_signals[:, :quiet_count].std(axis=1)
    else:
        noise_rms = np.array([sensor.noise_density * np.sqrt(rate_hz / 2) for sensor in sensors])
    # at rest a coarse converter shows nothing of its rounding, which the motion has
    noise_rms = np.maximum(noise_rms, [converter_step(signal) / np.sqrt(12) for signal in sensor_signals])
    line_noise = np.sqrt(sample_count) * noise_rms[:, None] * np.abs(acceleration_per_signal)
    duration_s = sample_count / rate_hz
    span_s = (quiet_count / rate_hz, max(duration_s - UNCOMPARED_END_S, 0.5 * sample_count / rate_hz))
    if span_s[1] - span_s[0] < MIN_COMPARED_S:
        raise RigError(
            f"the record lasts {duration_s:.3g} s, of which less than {MIN_COMPARED_S:g} s can be compared with the "
            "linear model; record longer"
        )
    forces = rfft(forces_n * end_taper, padded_length)[:, line_numbers]
    return Spectra(
        sensors=sensors,
        omega=omega,
        acceleration=acceleration,
        across=across_acceleration,
        forces=forces,
        line_noise=line_noise,
        line_numbers=line_numbers,
        padded_length=padded_length,
        compared_span_s=span_s,
        sample_rate_hz=rate_hz,
        record_s=duration_s,
    )


def _sensor_across(across: Recording, sensor: Sensor) -> Sensor | None:
    """Sensor of the same quantity at the same place, of the record of the other direction."""
    return next((s for s in across.rig.sensors if s.station == sensor.station and s.quantity == sensor.quantity), None)


def acceleration_per_signal_unit(sensor: Sensor, omega: Float[np.ndarray, " lines"]) -> Complex[np.ndarray, " lines"]:
    """Acceleration per unit of a sensor's signal: (i omega)^(2 - order) over its response."""
    return np.asarray((1j * omega) ** (2 - sensor.measures.order) / sensor.response(omega))


def converter_step(samples: Float[np.ndarray, " samples"]) -> float:
    """Usual step between the values that a channel takes, which of a fine converter is next to nothing."""
    value_levels = np.unique(samples)
    return float(np.median(np.diff(value_levels))) if value_levels.size > 1 else 0.0


def quiet_sample_count(forces: Float[np.ndarray, "*forces samples"], rate_hz: float) -> int:
    """Number of samples before the force, at least a quarter second; otherwise zero."""
    quiet_count = force_onset(forces, rate_hz) - round(0.05 * rate_hz)
    return quiet_count if quiet_count > QUIET_S * rate_hz else 0
