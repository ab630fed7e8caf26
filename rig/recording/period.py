"""Period of a force that repeats, such as a multisine over several periods."""

import numpy as np
import scipy
from jaxtyping import Float

MIN_CORRELATION, MAX_PERIOD_COUNT = 0.999, 64
"""Least autocorrelation at the period of a force that repeats; most periods in a record."""


def force_period_samples(force_n: Float[np.ndarray, " samples"]) -> int | None:
    """Samples after which a force repeats: the shortest lag at which its autocorrelation has a peak.

    None if it does not, or the record is shorter than two periods.
    """
    sample_count, force_n = force_n.size, force_n - force_n.mean()
    padded_length = scipy.fft.next_fast_len(2 * sample_count, real=True)
    lagged_products = scipy.fft.irfft(np.abs(scipy.fft.rfft(force_n, padded_length)) ** 2, padded_length)[
        : sample_count // 2 + 2
    ]
    energy_before = np.concatenate([[0.0], np.cumsum(force_n**2)])
    lags = np.arange(lagged_products.size)
    lag_energies = np.sqrt(energy_before[sample_count - lags] * (energy_before[-1] - energy_before[lags]))
    correlation = np.divide(lagged_products, lag_energies, out=np.zeros_like(lag_energies), where=lag_energies > 0)
    peak_lags, _ = scipy.signal.find_peaks(correlation, height=MIN_CORRELATION)
    period_lags = peak_lags[peak_lags >= sample_count / MAX_PERIOD_COUNT]
    return int(period_lags[0]) if period_lags.size else None
