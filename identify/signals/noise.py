"""Noise of accelerations, of the sensors of displacements, and of single channels.

From the quiet start of a record, from the sensors' description, or from the quietest times of the highest frequencies.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfilt, spectrogram
from scipy.stats import chi2

from identify.signals.kinematics import Kinematics
from rig.model.description import Rig, Sensor
from rig.model.sensing import PASSBAND

NoiseSource = Literal[
    "the quiet start of the record", "noise_density in rig.json", "the highest frequencies of the record"
]
NOISE_BAND_RATE_SHARES = (0.3, 0.4)
"""Band that shows the noise of a record without a quiet start, as shares of the sampling rate."""
PART_S, QUIET_QUANTILE = 0.05, 0.05
"""The noise is this quantile of the power in parts of this length."""
SEGMENT_SAMPLES, CELL_LINES = 256, 16
"""Samples of a segment of the spectrogram, and lines of one of its cells."""
CELL_DEGREES_OF_FREEDOM = 2 * CELL_LINES * 18 / 35
LOWEST_FREQUENCY_SHARE = 0.1
"""Lowest frequency at which noise is estimated, over the sampling rate."""
FLAT_RATIO, MIN_SEGMENTS = 2.0, 5
"""White noise: in the quietest segments, at least so many, no cell exceeds another by a larger ratio."""
ROUNDING_SHARE = 1e-7
"""Smallest noise of a channel, over its largest value: that of 24 bits."""


def acceleration_noise_m_per_s2(motion: Kinematics, rig: Rig) -> Float[np.ndarray, " stations"]:
    """Standard deviation per sample of each station's acceleration noise, m/s^2, from `noise_source`."""
    source, rate_hz = noise_source(motion, rig), motion.sample_rate_hz
    if source == "the quiet start of the record":
        return motion.acceleration_m_per_s2[:, : motion.quiet_sample_count].std(axis=1)
    if source == "noise_density in rig.json":
        base_noise = _rms_from_noise_density(motion.base.sensor, rate_hz) if motion.base else 0.0
        return np.array([np.hypot(_rms_from_noise_density(sensor, rate_hz), base_noise) for sensor in motion.sensors])
    sensor_signals = zip(motion.sensors, motion.acceleration_m_per_s2, strict=True)
    return np.array([_noise_from_high_band(row, max(0, 2 - s.measures.order), rate_hz) for s, row in sensor_signals])


def displacement_noise(motion: Kinematics, rig: Rig) -> Float[np.ndarray, " stations"]:
    """Standard deviation per sample of the white noise of each station's displacement sensor, in the unit of its
    quantity (m or m/s; against a base with that of the base's sensor), from `noise_source`."""
    motion_derivatives = (motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2)
    sensor_signals = [
        motion_derivatives[sensor.measures.order][i] for i, sensor in enumerate(motion.displacement_sensors)
    ]
    source = noise_source(motion, rig)
    if source == "the quiet start of the record":
        return np.array([row[: motion.quiet_sample_count].std() for row in sensor_signals])
    if source == "noise_density in rig.json":
        base_noise_density = motion.base.displacement_sensor.noise_density if motion.base else 0.0
        noise_densities = [np.hypot(sensor.noise_density, base_noise_density) for sensor in motion.displacement_sensors]
        return np.sqrt(motion.sample_rate_hz / 2) * np.array(noise_densities)
    return np.array([_noise_from_high_band(row, 0, motion.sample_rate_hz) for row in sensor_signals])


def noise_source(motion: Kinematics, rig: Rig) -> NoiseSource:
    """Source of the noise: the quiet start; without one, the description if it states any noise."""
    if motion.quiet_sample_count:
        return "the quiet start of the record"
    if any(sensor.noise_density > 0 for sensor in rig.sensors):
        return "noise_density in rig.json"
    return "the highest frequencies of the record"


def _rms_from_noise_density(sensor: Sensor, rate_hz: float) -> float:
    """Rms of white noise s in the d-th derivative, differentiated n = 2 - d times: s (2 pi)^n sqrt(f^(2n+1)/(2n+1))."""
    differentiations = max(0, 2 - sensor.measures.order)
    exponent = 2 * differentiations + 1
    return float(sensor.noise_density * (2 * np.pi) ** differentiations * np.sqrt((rate_hz / 2) ** exponent / exponent))


def _noise_from_high_band(signal: Float[np.ndarray, " samples"], differentiations: int, rate_hz: float) -> float:
    """White noise, differentiated so often, as loud as the quietest parts of a high band: an upper bound of its rms."""
    low_share, high_share = (share * 2 for share in NOISE_BAND_RATE_SHARES)
    band_passed = sosfilt(butter(4, (low_share, high_share), "bandpass", output="sos"), signal)
    part_samples = max(1, round(PART_S * rate_hz))
    band_parts = band_passed[: signal.size // part_samples * part_samples].reshape(-1, part_samples)
    part_powers, exponent = (band_parts**2).mean(axis=1), 2 * differentiations + 1
    return float(np.sqrt(np.quantile(part_powers[1:], QUIET_QUANTILE) / (high_share**exponent - low_share**exponent)))


def noise_density_and_certainty(signal: Float[np.ndarray, " samples"], rate_hz: float) -> tuple[float, bool]:
    """One-sided noise density of a channel in its own unit per sqrt(Hz), and whether it is certainly noise.

    A low quantile of the power in the spectrogram's cells, at the upper frequencies, bounds the noise from above. It is
    certainly noise if the quietest segments are equally loud at all these frequencies, as motion never is. A cell of n
    lines is distributed as chi-square with 2 n degrees of freedom, of which a Hann window leaves 18 of 35; the quantile
    is divided by that of this distribution.
    """
    segment_samples = min(SEGMENT_SAMPLES, signal.size)
    line_hz, _, power = spectrogram(signal, rate_hz, "hann", segment_samples, segment_samples // 2, detrend="linear")
    line_power = power[(line_hz > LOWEST_FREQUENCY_SHARE * rate_hz) & (line_hz < PASSBAND * rate_hz)]
    cell_count = len(line_power) // CELL_LINES
    if not cell_count:
        return 0.0, False
    cell_power = line_power[: cell_count * CELL_LINES].reshape(cell_count, CELL_LINES, -1).mean(axis=1)
    quantile_ratio = chi2.ppf(QUIET_QUANTILE, CELL_DEGREES_OF_FREEDOM) / CELL_DEGREES_OF_FREEDOM
    power_density = float(np.quantile(cell_power, QUIET_QUANTILE)) / quantile_ratio
    segment_power = np.median(cell_power, axis=0)
    quiet_share = max(QUIET_QUANTILE, MIN_SEGMENTS / segment_power.size)
    quiet_power_by_cell = cell_power[:, segment_power <= np.quantile(segment_power, min(quiet_share, 1.0))].mean(axis=1)
    return float(np.sqrt(power_density)), bool(np.max(quiet_power_by_cell) < FLAT_RATIO * np.min(quiet_power_by_cell))


def rounding_noise_density(signal: Float[np.ndarray, " samples"], rate_hz: float) -> float:
    """Noise density of rounding: the least that a channel of 24 bits shows."""
    return float(ROUNDING_SHARE * np.max(np.abs(signal)) / np.sqrt(rate_hz / 2))
