"""Period of a force that repeats, such as a multisine over several periods."""

import numpy as np
import scipy
from jaxtyping import Float

MIN_CORRELATION, MAX_PERIODS = 0.999, 64
"""Least autocorrelation at the period of a force that repeats; most periods in a record."""


def period_of(force_n: Float[np.ndarray, " samples"]) -> int | None:
    """Samples after which a force repeats: the shortest lag at which its autocorrelation has a peak.

    None if it does not, or the record is shorter than two periods.
    """
    samples, force_n = force_n.size, force_n - force_n.mean()
    length = scipy.fft.next_fast_len(2 * samples, real=True)
    products = scipy.fft.irfft(np.abs(scipy.fft.rfft(force_n, length)) ** 2, length)[: samples // 2 + 2]
    energy = np.concatenate([[0.0], np.cumsum(force_n**2)])
    lags = np.arange(products.size)
    energies = np.sqrt(energy[samples - lags] * (energy[-1] - energy[lags]))
    correlation = np.divide(products, energies, out=np.zeros_like(energies), where=energies > 0)
    peaks, _ = scipy.signal.find_peaks(correlation, height=MIN_CORRELATION)
    periods = peaks[peaks >= samples / MAX_PERIODS]
    return int(periods[0]) if periods.size else None
