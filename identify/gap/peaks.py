"""Where a sharp frequency may lie: the lines that stand out of the spectrum of a residual."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter
from scipy.signal import find_peaks
from scipy.signal.windows import hann

from identify.gap.residual import Base, Residual

AROUND_HZ = 2.0
"""A line stands out of the median of the spectrum within this band."""


def peaks_hz(base: Base, at: Residual, count: int) -> Float[np.ndarray, " peaks"]:
    """The frequencies of the `count` lines that stand out most, the first most, from the residuals over time.

    The squares of the linear and the contact residuals' spectra add up, under a Hann window, four times finer than one
    over the duration.
    """
    times = at.linear.shape[1]
    rows = np.concatenate([at.linear, *(c.residual[None, :times] for c in at.contacts)])
    power = np.sum(np.abs(np.fft.rfft(rows * hann(times), 4 * times)) ** 2, axis=0)
    hz = np.fft.rfftfreq(4 * times, 1 / base.record.rate_hz)
    level = median_filter(power, max(3, round(AROUND_HZ / hz[1])))
    ratio = power / np.maximum(level, 1e-12 * power.max())
    found, _ = find_peaks(ratio, distance=4)
    return np.asarray(hz[found[np.argsort(ratio[found])[::-1][:count]]])
