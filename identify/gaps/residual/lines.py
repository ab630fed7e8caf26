"""Lines that stand out of a residual: no error of a model is as sharp as one line."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.signal import find_peaks, zoom_fft
from scipy.signal.windows import hann

BESIDE, OUTSTANDING = (3, 8), 100.0
"""A sensor's line is compared with those from the third to the eighth on either side: a Hann window keeps them apart,
and a resonance of 1 % damping at 8 Hz lifts them all. Above so many times their median power it stands out."""
FINER = 32
"""A line's frequency is found on a grid so many times finer: a tone off by half a step keeps 0.1 % of its power."""

NEAR = 2
"""A line so near (in lines) to a multiple of the frequency at which a force repeats is one of that force."""

Rows = Float[np.ndarray, "rows times"]


def cost_of_lines(rows: Rows, directions: int, repeats: float = 0.0) -> float:
    """2 R/rows ln(power over `OUTSTANDING` times that of the lines beside), over sensors and lines that stand out.

    A line is two real values of an unknown variance; R directions of the sensors are not free to follow the contacts.
    `repeats` is the frequency, per sample, at which the measured force repeats (0: it does not): whatever the rig, its
    response has lines at all multiples, which tell of no tone.
    """
    return float(2 * directions / len(rows) * np.sum(np.log(np.maximum(_outstanding(rows, repeats), 1.0))))


def standing_out(rows: Rows, repeats: float = 0.0) -> tuple[float, ...]:
    """The frequencies, per sample, of the lines that stand out in any of the rows; without those of the force."""
    times = rows.shape[1]
    found: list[float] = []
    for line in np.flatnonzero(np.any(_outstanding(rows, repeats) > 1, axis=0)):
        refined = _refined(rows, line / times, 1 / times)
        if all(abs(refined - other) > 1 / times for other in found):
            found.append(refined)
    return tuple(found)


def without_lines(rows: Rows, frequencies: tuple[float, ...]) -> Rows:
    """The rows, where they are not zero, less the harmonic waves of these frequencies, of any amplitude and phase."""
    there = np.any(rows, axis=0)
    for frequency in frequencies:
        turned = 2 * np.pi * frequency * np.arange(rows.shape[1])
        wave = there * np.stack([np.cos(turned), np.sin(turned)])
        rows = rows - rows @ np.linalg.pinv(wave) @ wave
    return rows


def sharpest(rows: Rows, count: int, around: float, repeats: float = 0.0) -> Float[np.ndarray, " lines"]:
    """The frequencies (per sample) of the lines that stand out most of the spectrum `around` them, the first most.

    Without those of a force that repeats, unless there are no others.

    The squares of the rows' spectra add up, under a Hann window, four times finer than one over the duration.
    """
    times = rows.shape[1]
    power = np.sum(np.abs(np.fft.rfft(rows * hann(times), 4 * times)) ** 2, axis=0)
    level = median_filter(power, max(3, round(around * 4 * times)))
    ratio = power / np.maximum(level, 1e-12 * power.max())
    ratio[_of_force(np.arange(ratio.size) / 4, times, repeats)] = 0.0
    found, _ = find_peaks(ratio, distance=4)
    most = found[np.argsort(-ratio[found])[:count]]
    return np.array([_refined(rows, line / (4 * times), 1 / (4 * times)) for line in most])


def _of_force(lines: Float[np.ndarray, " lines"], times: int, repeats: float) -> Bool[np.ndarray, " lines"]:
    """Mask of lines at multiples of the frequency at which the force repeats, per sample."""
    if not repeats:
        return np.zeros(lines.size, dtype=bool)
    apart = repeats * times
    return np.abs(lines - apart * np.round(lines / apart)) <= NEAR


def _outstanding(rows: Rows, repeats: float) -> Float[np.ndarray, "rows lines"]:
    """The power of a peak over `OUTSTANDING` times that beside; zero elsewhere, at the ends, at the force's lines."""
    power = np.abs(np.fft.rfft(rows * hann(rows.shape[1]))) ** 2
    peaks = power == maximum_filter1d(power, 2 * BESIDE[0] - 1, axis=1)
    peaks[:, : BESIDE[1]] = peaks[:, -BESIDE[1] :] = False
    peaks[:, _of_force(np.arange(float(peaks.shape[1])), rows.shape[1], repeats)] = False
    row, line = np.nonzero(peaks)
    apart = np.arange(BESIDE[0], BESIDE[1] + 1)
    beside = np.median(power[row[:, None], line[:, None] + np.concatenate([-apart, apart])], axis=1)
    ratio = np.zeros_like(power)
    ratio[peaks] = power[peaks] / np.maximum(OUTSTANDING * beside, 1e-300)
    return ratio


def _refined(rows: Rows, frequency: float, spacing: float) -> float:
    """The frequency, up to so far from another, at which the power of all rows is largest; per sample."""
    grid = frequency + spacing * np.linspace(-1, 1, 2 * FINER + 1)
    spectra = zoom_fft(rows * hann(rows.shape[1]), grid[[0, -1]], grid.size, fs=1.0, endpoint=True)
    return float(grid[np.argmax(np.sum(np.abs(spectra) ** 2, axis=0))])
