"""Period of a force that repeats, as a multisine of several periods does."""

import numpy as np
import scipy
from jaxtyping import Float

REPEATS, LEAST_PERIOD = 0.999, 64
"""A force repeats if it correlates so well with itself a period later; a period is at least one 64th of the record."""


def period_of(force_n: Float[np.ndarray, " samples"]) -> int | None:
    """The samples after which a force repeats: the shortest lag of a peak of its correlation with itself.

    None if it does not, or the record is shorter than two periods.
    """
    samples, force_n = force_n.size, force_n - force_n.mean()
    length = scipy.fft.next_fast_len(2 * samples, real=True)
    products = scipy.fft.irfft(np.abs(scipy.fft.rfft(force_n, length)) ** 2, length)[: samples // 2 + 2]
    energy = np.concatenate([[0.0], np.cumsum(force_n**2)])
    lags = np.arange(products.size)
    both = np.sqrt(energy[samples - lags] * (energy[-1] - energy[lags]))
    correlation = np.divide(products, both, out=np.zeros_like(both), where=both > 0)
    peaks, _ = scipy.signal.find_peaks(correlation, height=REPEATS)
    long = peaks[peaks >= samples / LEAST_PERIOD]
    return int(long[0]) if long.size else None
