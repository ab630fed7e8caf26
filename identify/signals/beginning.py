"""Beginning of a record: whether it is at rest, and when the excitation sets in."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

QUIET_S = 0.25
"""Shortest quiet start, s."""
STD_BY_MEDIAN = 1.4826
"""Standard deviation of normal samples, over the median of their sizes."""
ONSET_DEVIATIONS = 6.0
"""Smallest force that counts as begun, in standard deviations of its noise."""
MAX_REST_RMS_SHARE = 0.02
"""Largest standard deviation before the excitation of a channel at rest, over that of its whole record."""


def force_onset(force_n: Float[np.ndarray, "*forces samples"], sample_rate_hz: float) -> int:
    """First sample at which a force has begun; 0 without a quiet start, or without any force.

    A force has begun where it exceeds a thousandth of its peak and six standard deviations of its channel's first
    quarter second: 1.4826 times the median size, which a few samples of force do not move. The start is quiet if six
    such standard deviations are below the force's root mean square.
    """
    return min((_onset(row, sample_rate_hz) for row in np.atleast_2d(force_n) if np.any(row)), default=0)


def _onset(force_n: Float[np.ndarray, " samples"], sample_rate_hz: float) -> int:
    """Onset of one force."""
    force_size_n = np.abs(force_n)
    starting_sizes_n = force_size_n[: max(1, round(QUIET_S * sample_rate_hz))]
    threshold_n = ONSET_DEVIATIONS * STD_BY_MEDIAN * float(np.median(starting_sizes_n))
    if threshold_n >= np.sqrt(np.mean(force_size_n**2)):
        return 0
    return int(np.argmax(force_size_n > max(threshold_n, 1e-3 * float(force_size_n.max()))))


def excitation_start(
    force_n: Float[np.ndarray, "*forces samples"],
    signals: Iterable[Float[np.ndarray, " samples"]],
    sample_rate_hz: float,
) -> int:
    """First excited sample, as `force_onset`; 0 also if a signal moves before it by over 2 % of its record.

    White noise, whose variance is half that of its differences, is no motion.
    """
    onset = force_onset(force_n, sample_rate_hz)

    def moves_before(signal: Float[np.ndarray, " samples"]) -> bool:
        quiet_samples = signal[:onset]
        motion_variance = np.var(quiet_samples) - np.var(np.diff(quiet_samples)) / 2
        return bool(motion_variance > MAX_REST_RMS_SHARE**2 * np.var(signal))

    return 0 if onset and any(map(moves_before, signals)) else onset


def lead_in(signal: Float[np.ndarray, " samples"], lead_samples: int) -> Float[np.ndarray, " before"]:
    """Lead-in that keeps a signal's value and slope continuous at its start: its point reflection, faded in."""
    reflection = 2 * signal[0] - signal[lead_samples:0:-1]
    return np.asarray(reflection * np.sin(np.pi / 2 * (np.arange(lead_samples) + 0.5) / lead_samples) ** 2)
