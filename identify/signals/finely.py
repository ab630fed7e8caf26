"""What a law without memory makes of band-limited signals, band-limited again: its kinks do not alias.

The law is evaluated at a multiple of the rate, block by block, so that memory does not grow with the multiple.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.signal import resample

from rig.model.contact_laws import penetration_m

OVERSAMPLING = 8
KEPT, MARGIN = 2048, 256
"""Samples of a block; on either side the signals, and further in what the law makes of them, rise from zero."""
FINE_AT_ONCE = 1 << 18
"""So many values of one signal at the finer rate."""


def finely(
    law: Callable[..., Float[np.ndarray, "*results blocks fine"]],
    signals: Float[np.ndarray, "rows samples"],
    times: int,
) -> Float[np.ndarray, "*results samples"]:
    """law(*signals), evaluated at `times` the rate of the signals and low-passed at half their rate.

    A law may give several results in front. Each block is resampled by the Fourier transform (scipy.signal.resample)
    under tapers that are one where it is kept, so that it need not be periodic.
    """
    samples = signals.shape[1]
    if times == 1:
        return law(*signals)
    length, count = KEPT + 4 * MARGIN, -(-samples // KEPT)
    padded = np.pad(signals, [(0, 0), (2 * MARGIN, count * KEPT + 2 * MARGIN - samples)], mode="edge")
    found = []
    whole, inner = _taper(length, 0, MARGIN), _taper(length * times, MARGIN * times, MARGIN * times)
    for first in range(0, count, batch := max(1, FINE_AT_ONCE // (length * times))):
        starts = np.arange(first, min(first + batch, count)) * KEPT
        cut = padded[:, starts[:, None] + np.arange(length)] * whole
        fine = law(*resample(cut, length * times, axis=-1)) * inner
        found.append(resample(fine, length, axis=-1)[..., 2 * MARGIN : 2 * MARGIN + KEPT])
    rows = np.concatenate(found, axis=-2)
    return rows.reshape(*rows.shape[:-2], -1)[..., :samples]


def penetration(eta_m: Float[np.ndarray, " samples"], lower_m: float, upper_m: float) -> Float[np.ndarray, " samples"]:
    """The dead zone of a band-limited relative displacement."""
    return finely(lambda fine_m: penetration_m(fine_m, lower_m, upper_m), eta_m[None], OVERSAMPLING)


def _taper(length: int, begin: int, rise: int) -> Float[np.ndarray, " length"]:
    """Zero, from `begin` on rising to one over so many samples, and back."""
    up = np.sin(np.pi / 2 * np.clip((np.arange(length) + 0.5 - begin) / rise, 0, 1)) ** 2
    return np.asarray(up * up[::-1])
