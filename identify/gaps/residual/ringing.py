"""Modes of a free decay: the highest ringing frequency, and frequency and damping ratio of each mode with errors.

The frequency and the decay rate alpha of a mode of amplitude A in white noise of one-sided density s have the least
standard error sqrt(4 alpha^3 s^2 / A^2) rad/s each (Cramer and Rao), which subspaces reach to a factor of two.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d
from scipy.signal import spectrogram
from scipy.signal.windows import tukey

from identify.signals.ringing import modes_of_decay

POWER_SHARE = 1 - 1e-6
"""Share of the velocities' power beyond noise that lies below the highest ringing frequency. Set by hand."""
TAPER_SHARE = 0.1
"""Tapered share of a record, both ends together, for that spectrum. Set by hand."""
SIGNAL_TO_NOISE_RATIO, SMOOTHED_LINES = 8.0, 9
"""Ratio of smoothed power to noise from which a line counts, and the lines that are smoothed over. Set by hand."""
PART_S, PART_SIGNAL_RATIO = 0.5, 25.0
"""Length of these parts, s, and the ratio of power to noise. Set by hand: by chance exceeded once in 7e10 lines."""
LEAST_FREQUENCY_ERROR, LEAST_DAMPING_ERROR = 3e-4, 0.03
"""Least relative errors of a mode's frequency and damping ratio: those by subspaces, fade and stations. Set by hand."""
SUBSPACE_ERROR_FACTOR = 2.0
"""Standard error by subspaces over the Cramer-Rao bound. Set by hand."""
MAX_MODE_COUNT = 12
"""Number of modes sought. Set by hand."""


@dataclass(frozen=True)
class MeasuredMode:
    """Frequency and damping ratio of a mode of a free decay, with their relative standard errors."""

    frequency_hz: float
    damping_ratio: float
    frequency_error: float
    damping_error: float


def highest_ringing_hz(
    signals: Float[np.ndarray, "sensors samples"],
    rate_hz: float,
    derivative_order: int,
    noise_densities: Float[np.ndarray, " sensors"],
) -> float:
    """Highest frequency (Hz) with power beyond noise, by velocities; `derivative_order` is that of the signals."""
    window = tukey(signals.shape[1], TAPER_SHARE)
    power = np.abs(np.fft.rfft((signals - signals.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    noise_power = (noise_densities**2 * rate_hz / 2 * np.sum(window**2))[:, None]
    lines_hz = np.fft.rfftfreq(signals.shape[1], 1 / rate_hz)
    is_signal = uniform_filter1d(power, SMOOTHED_LINES, axis=1) > SIGNAL_TO_NOISE_RATIO * noise_power
    velocity_power = ((power - noise_power) * is_signal)[:, 1:] * lines_hz[1:] ** (2.0 * (1 - derivative_order))
    cumulative = np.cumsum(np.maximum(velocity_power, 0.0).sum(axis=0))
    return float(lines_hz[1 + np.searchsorted(cumulative, POWER_SHARE * cumulative[-1])]) if cumulative[-1] > 0 else 0.0


def highest_hz_of_any_segment(
    signals: Float[np.ndarray, "sensors samples"], rate_hz: float, noise_densities: Float[np.ndarray, " sensors"]
) -> float:
    """Highest frequency (Hz) that some part of a record of length `PART_S` shows beyond noise: hits are soon over."""
    part_sample_count = min(signals.shape[1], round(PART_S * rate_hz))
    lines_hz, _, power_density = spectrogram(
        signals, rate_hz, "hann", part_sample_count, part_sample_count * 3 // 4, detrend="constant"
    )
    is_signal = np.any(power_density > PART_SIGNAL_RATIO * noise_densities[:, None, None] ** 2, axis=(0, 2))
    return float(lines_hz[is_signal].max(initial=0.0))


def measured_modes(
    signals: Float[np.ndarray, "sensors samples"],
    rate_hz: float,
    highest_hz: float,
    noise_densities: Float[np.ndarray, " sensors"],
) -> tuple[MeasuredMode, ...]:
    """Modes that exceed the noise, with their errors."""
    modes = []
    duration_s, noise_density = signals.shape[1] / rate_hz, float(np.sqrt(np.mean(noise_densities**2)))
    mean_square = float(np.sum(signals**2)) / len(signals)
    for mode in modes_of_decay(signals, rate_hz, highest_hz, MAX_MODE_COUNT):
        natural_omega = 2 * np.pi * mode.frequency_hz
        decay_per_s = mode.damping_ratio * natural_omega
        resolved_decay_per_s = max(decay_per_s, 1 / duration_s)
        # the integral of its square is A^2 / 4 alpha
        amplitude = np.sqrt(4 * resolved_decay_per_s * mode.energy_share * mean_square / rate_hz)
        decay_error_per_s = SUBSPACE_ERROR_FACTOR * np.sqrt(4 * resolved_decay_per_s**3) * noise_density / amplitude
        frequency_error = float(np.hypot(LEAST_FREQUENCY_ERROR, decay_error_per_s / natural_omega))
        damping_error = float(np.hypot(LEAST_DAMPING_ERROR, decay_error_per_s / decay_per_s))
        if damping_error < 1:
            modes.append(MeasuredMode(mode.frequency_hz, mode.damping_ratio, frequency_error, damping_error))
    return tuple(modes)
