"""Contact laws evaluated on band-limited signals without aliasing: interpolate, evaluate, low-pass, decimate.

A law with a kink makes a force whose spectrum falls as 1/f^2, one with a damper that sets in at contact as 1/f. Sampled
at the rate of a recording it folds back into the band of the motion. The signals themselves are smooth: they are
interpolated band-limited to `LAW_RATE_HZ`, and what the law makes of them is low-passed before samples are left out.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft, rfft

from identify.signals.spectra import decimated, oversampled
from rig.model.contact_laws import penetration_m

LAW_RATE_HZ, FINEST = 16384.0, 8
"""Laws are evaluated at the multiple of a recording's rate that is nearest to this; at most at so many times its rate,
as slow recordings are of slow motion.

Against 131 kHz, on the reference rig of 4096 Hz with contact damping: clearance within 0.0003 %, stiffness within
0.0025 %; at 8192 Hz 0.0008 and 0.006 %, at 4096 Hz 0.0026 and 0.023 %. On that of 512 Hz 0.0001 and 0.0002 %."""
KEPT, MARGIN = 5120, 256
"""Samples of a block; on either side the signals, and further in what the law makes of them, rise from zero."""
LENGTH = KEPT + 4 * MARGIN
VALUES_AT_ONCE = 1 << 16
"""So many values of one signal at the finer rate."""

Law = Callable[..., Float[np.ndarray, "*results blocks fine"]]


def oversampling(sample_rate_hz: float) -> int:
    """Oversampling factor of a signal on which a law is evaluated."""
    return min(max(1, round(LAW_RATE_HZ / sample_rate_hz)), FINEST)


def evaluated(
    law: Law, signals: Float[np.ndarray, "rows samples"], sample_rate_hz: float, factor: int = 1
) -> Float[np.ndarray, "*results fewer"]:
    """law(*signals), of a law without memory, low-passed to every `factor`-th sample.

    A law may give several results in front. It is evaluated block by block, so that memory does not grow with the finer
    rate. Each block is resampled by the Fourier transform under tapers that are one where it is kept, so that it need
    not be periodic.
    """
    times, samples = oversampling(sample_rate_hz), signals.shape[1]
    if times == 1:
        return decimated(law(*signals), factor)
    count = -(-samples // KEPT)
    padded = np.pad(signals, [(0, 0), (2 * MARGIN, count * KEPT + 2 * MARGIN - samples)], mode="edge")
    blocks = sliding_window_view(padded, LENGTH, axis=1)[:, ::KEPT]
    whole, inner = _taper(LENGTH, 0, MARGIN), _taper(LENGTH * times, MARGIN * times, MARGIN * times)
    results = []
    for first in range(0, count, batch := max(1, VALUES_AT_ONCE // (LENGTH * times))):
        fine = law(*_finer(blocks[:, first : first + batch] * whole, times))
        results.append(_coarser(fine * inner, times)[..., 2 * MARGIN : 2 * MARGIN + KEPT])
    rows = np.concatenate(results, axis=-2)
    return decimated(rows.reshape(*rows.shape[:-2], -1)[..., :samples], factor)


def interpolated(signal: Float[np.ndarray, " samples"], sample_rate_hz: float) -> Float[np.ndarray, " fine"]:
    """A whole signal at the finer rate, for a law with a memory; `low_passed` takes what that makes of it."""
    return oversampled(signal, oversampling(sample_rate_hz))


def low_passed(fine: Float[np.ndarray, " fine"], sample_rate_hz: float, factor: int) -> Float[np.ndarray, " fewer"]:
    """Signals low-passed from the finer rate to every `factor`-th sample of the recording."""
    return decimated(fine, factor * oversampling(sample_rate_hz))


def penetration(
    eta_m: Float[np.ndarray, " samples"], lower_m: float, upper_m: float, sample_rate_hz: float
) -> Float[np.ndarray, " samples"]:
    """The dead zone of a band-limited relative displacement."""
    return evaluated(lambda fine_m: penetration_m(fine_m, lower_m, upper_m), eta_m[None], sample_rate_hz)


def _finer(blocks: Float[np.ndarray, "rows blocks length"], times: int) -> Float[np.ndarray, "rows blocks fine"]:
    lines = rfft(blocks) * times
    lines[..., -1] /= 2  # half the rate stands for both signs
    return np.asarray(irfft(lines, LENGTH * times))


def _coarser(fine: Float[np.ndarray, "*results fine"], times: int) -> Float[np.ndarray, "*results length"]:
    """Rows at 1 / times the rate."""
    lines = rfft(fine)[..., : LENGTH // 2 + 1] / times
    lines[..., -1] *= 2
    return np.asarray(irfft(lines, LENGTH))


def _taper(length: int, begin: int, rise: int) -> Float[np.ndarray, " length"]:
    """Zero, from `begin` on rising to one over so many samples, and back."""
    up = np.sin(np.pi / 2 * np.clip((np.arange(length) + 0.5 - begin) / rise, 0, 1)) ** 2
    return np.asarray(up * up[::-1])
