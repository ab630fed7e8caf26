"""The noise of accelerations: from the quiet start of a record, from the sensors' description, or from what is highest
in frequency and quietest in time."""

from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, sosfilt, spectrogram
from scipy.stats import chi2

from identify.signals.kinematics import Kinematics
from rig.model.description import Rig, Sensor
from rig.model.sensing import PASSBAND

Source = Literal["the quiet start of the record", "noise_density in rig.json", "the highest frequencies of the record"]
BAND = (0.3, 0.4)
"""Of the sampling rate: where noise is looked for in a record without a quiet start."""
PART_S, QUIETEST = 0.05, 0.05
"""The noise is the power in the quietest parts of this length: so large a share of them has less."""
SEGMENT, LINES = 256, 16
"""A spectrum over time has segments of so many samples, and cells of so many of their lines."""
FREEDOM = 2 * LINES * 18 / 35
HIGH = 0.1
"""Of the sampling rate: no noise is looked for below."""
FLAT, SEGMENTS = 2.0, 5
"""Noise is white: in the quietest segments, so many at least, no cell has more than this multiple of another."""
RESOLVED = 1e-7
"""Of its largest value: no channel shows less, as of 24 bits."""


def acceleration_noise(motion: Kinematics, rig: Rig) -> Float[np.ndarray, " stations"]:
    """Standard deviation per sample of each station's acceleration noise, m/s^2, from what `noise_source` says."""
    source = noise_source(motion, rig)
    if source == "the quiet start of the record":
        return motion.acceleration_m_per_s2[:, : motion.quiet_samples].std(axis=1)
    if source == "noise_density in rig.json":
        return np.array([_described(s, motion.sample_rate_hz) for s in motion.sensors])
    return np.array(
        [
            _noise_from_high_band(row, s, motion)
            for s, row in zip(motion.sensors, motion.acceleration_m_per_s2, strict=True)
        ]
    )


def noise_source(motion: Kinematics, rig: Rig) -> Source:
    """The quiet seconds before the force begins; where there are none the description, if it names any noise."""
    if motion.quiet_samples:
        return "the quiet start of the record"
    if any(s.noise_density > 0 for s in rig.sensors):
        return "noise_density in rig.json"
    return "the highest frequencies of the record"


def _described(sensor: Sensor, rate_hz: float) -> float:
    """Rms of white noise s in the d-th derivative, differentiated n = 2 - d times: s (2 pi)^n sqrt(f^(2n+1)/(2n+1))."""
    times = max(0, 2 - sensor.measures.order)
    return float(
        sensor.noise_density * (2 * np.pi) ** times * np.sqrt((rate_hz / 2) ** (2 * times + 1) / (2 * times + 1))
    )


def _noise_from_high_band(row: Float[np.ndarray, " samples"], sensor: Sensor, motion: Kinematics) -> float:
    """Density of white noise that makes the quietest parts of a high band as loud as they are: an upper bound."""
    rate, times = motion.sample_rate_hz, max(0, 2 - sensor.measures.order)
    low, high = (share * 2 for share in BAND)
    high_passed = sosfilt(butter(4, (low, high), "bandpass", output="sos"), row)
    size = max(1, round(PART_S * rate))
    power = (high_passed[: row.size // size * size].reshape(-1, size) ** 2).mean(axis=1)
    share = high ** (2 * times + 1) - low ** (2 * times + 1)
    return float(np.sqrt(np.quantile(power[1:], QUIETEST) / share))


def heard_density(signal: Float[np.ndarray, " samples"], rate_hz: float) -> tuple[float, bool]:
    """One-sided noise of a channel in its own unit per sqrt(Hz), and whether it is surely noise.

    The lowest of what stands in the cells of its spectrum over time, in the upper part of the frequencies: no more
    than that is noise. It is noise where the quietest segments are as loud at all these frequencies, as motion never
    is. A cell of n lines is distributed as chi-square with 2 n degrees of freedom, of which a Hann window leaves 18 of
    35, by whose quantile it is less.
    """
    segment = min(SEGMENT, signal.size)
    hz, _, power = spectrogram(signal, rate_hz, "hann", segment, segment // 2, detrend="linear")
    power = power[(hz > HIGH * rate_hz) & (hz < PASSBAND * rate_hz)]
    count = len(power) // LINES
    if not count:
        return 0.0, False
    cells = power[: count * LINES].reshape(count, LINES, -1).mean(axis=1)
    low = float(np.quantile(cells, QUIETEST)) / (chi2.ppf(QUIETEST, FREEDOM) / FREEDOM)
    loudness = np.median(cells, axis=0)
    share = max(QUIETEST, SEGMENTS / loudness.size)
    quiet = cells[:, loudness <= np.quantile(loudness, min(share, 1.0))].mean(axis=1)
    return float(np.sqrt(low)), bool(np.max(quiet) < FLAT * np.min(quiet))


def least_density(signal: Float[np.ndarray, " samples"], rate_hz: float) -> float:
    """The noise of rounding: what a channel of 24 bits cannot show."""
    return float(RESOLVED * np.max(np.abs(signal)) / np.sqrt(rate_hz / 2))
