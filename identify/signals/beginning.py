"""Beginning of a record: at rest or in motion, and when the excitation starts."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

QUIET_S = 0.25
BEGUN, NORMAL_BY_MEDIAN = 6.0, 1.4826
STILL = 0.02
"""A channel that scatters at the start by at most this share of its whole scatter shows a rig at rest."""


def force_begins(force_n: Float[np.ndarray, "*forces samples"], sample_rate_hz: float) -> int:
    """The first sample at which a force has begun; 0 of a record without a quiet start, or without any force.

    A force has begun where it exceeds six standard deviations of its channel's first quarter second (1.4826 times
    the median size, which a few samples of force do not move), and a thousandth of its peak. The start is quiet if
    six such standard deviations are less than the force's root mean square.
    """
    return min((_begins(row, sample_rate_hz) for row in np.atleast_2d(force_n) if np.any(row)), default=0)


def _begins(force_n: Float[np.ndarray, " samples"], sample_rate_hz: float) -> int:
    size = np.abs(force_n)
    first = size[: max(1, round(QUIET_S * sample_rate_hz))]
    noise_n = BEGUN * NORMAL_BY_MEDIAN * float(np.median(first))
    if noise_n >= np.sqrt(np.mean(size**2)):
        return 0
    return int(np.argmax(size > max(noise_n, 1e-3 * float(size.max()))))


def at_rest_until(
    force_n: Float[np.ndarray, "*forces samples"],
    channels: Iterable[Float[np.ndarray, " samples"]],
    sample_rate_hz: float,
) -> int:
    """First excited sample, as `force_begins`; 0 also where a channel scatters before it by over 2 % of its record."""
    begun = force_begins(force_n, sample_rate_hz)
    moving = begun and any(np.std(channel[:begun]) > STILL * np.std(channel) for channel in channels)
    return 0 if moving else begun


def led_in(signal: Float[np.ndarray, " samples"], before: int) -> Float[np.ndarray, " before"]:
    """Lead-in that keeps a signal's value and slope continuous at its start: its point reflection, faded in."""
    mirrored = 2 * signal[0] - signal[before:0:-1]
    return np.asarray(mirrored * np.sin(np.pi / 2 * (np.arange(before) + 0.5) / before) ** 2)
