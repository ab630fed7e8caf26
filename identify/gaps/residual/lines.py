"""Outstanding spectral lines of a residual, with far more power than their neighbours: no model error is as sharp."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.signal import find_peaks, zoom_fft
from scipy.signal.windows import hann

NEIGHBOURS, OUTSTANDING = (3, 8), 100.0
"""Neighbours of a line, the third to the eighth on either side, and the multiple of their median power above which it
stands out: a Hann window separates them, and a resonance of 1 % damping at 8 Hz raises them all. Set by hand."""
REFINEMENT = 32
"""Refinement of the frequency grid of a line: a tone off by half a step keeps 0.1 % of its power."""

FORCE_LINE_REACH = 2
"""Distance (lines) from a multiple of the force's repetition frequency within which a line belongs to the force.
Derived: a Hann window's reach."""

Rows = Float[np.ndarray, "rows times"]


def cost_of_lines(rows: Rows, direction_count: int, repeats: float = 0.0) -> float:
    """Cost of outstanding lines, 2 R/rows sum ln(power / (OUTSTANDING median power of the neighbours)).

    A line is two real values of an unknown variance; R, `direction_count`, counts the sensors' directions that contact
    forces cannot follow. `repeats` is the frequency, per sample, at which the measured force repeats (0: it does
    not): the response of any rig has lines at its multiples, which do not indicate tones.
    """
    return float(2 * direction_count / len(rows) * np.sum(np.log(np.maximum(_outstanding_ratio(rows, repeats), 1.0))))


def outstanding_frequencies(rows: Rows, repeats: float = 0.0) -> tuple[float, ...]:
    """Frequencies, per sample, of lines that stand out in any row, without those of a repeating force."""
    samples = rows.shape[1]
    frequencies: list[float] = []
    for line in np.flatnonzero(np.any(_outstanding_ratio(rows, repeats) > 1, axis=0)):
        refined = _refined(rows, line / samples, 1 / samples)
        if all(abs(refined - frequency) > 1 / samples for frequency in frequencies):
            frequencies.append(refined)
    return tuple(frequencies)


def without_lines(rows: Rows, frequencies: tuple[float, ...]) -> Rows:
    """Rows less their least-squares harmonics at the given frequencies, where the rows are not all zero."""
    is_nonzero = np.any(rows, axis=0)
    for frequency in frequencies:
        phase = 2 * np.pi * frequency * np.arange(rows.shape[1])
        wave = is_nonzero * np.stack([np.cos(phase), np.sin(phase)])
        rows = rows - rows @ np.linalg.pinv(wave) @ wave
    return rows


def sharpest_frequencies(rows: Rows, count: int, bandwidth: float, repeats: float = 0.0) -> Float[np.ndarray, " lines"]:
    """Frequencies, per sample, of the lines with most power relative to the median within `bandwidth`, in that order.

    The power is summed over the rows under a Hann window, on a grid four times finer than one over the duration; lines
    of a repeating force are left out.
    """
    samples = rows.shape[1]
    power = np.sum(np.abs(np.fft.rfft(rows * hann(samples), 4 * samples)) ** 2, axis=0)
    level = median_filter(power, max(3, round(bandwidth * 4 * samples)))
    ratio = power / np.maximum(level, 1e-12 * power.max())
    ratio[_force_lines(np.arange(ratio.size) / 4, samples, repeats)] = 0.0
    peaks, _ = find_peaks(ratio, distance=4)
    sharpest = peaks[np.argsort(-ratio[peaks])[:count]]
    return np.array([_refined(rows, line / (4 * samples), 1 / (4 * samples)) for line in sharpest])


def _force_lines(lines: Float[np.ndarray, " lines"], samples: int, repeats: float) -> Bool[np.ndarray, " lines"]:
    """Mask of lines within FORCE_LINE_REACH of multiples of the force's repetition frequency."""
    if not repeats:
        return np.zeros(lines.size, dtype=bool)
    spacing = repeats * samples
    return np.abs(lines - spacing * np.round(lines / spacing)) <= FORCE_LINE_REACH


def _outstanding_ratio(rows: Rows, repeats: float) -> Float[np.ndarray, "rows lines"]:
    """Power of each peak over OUTSTANDING times its neighbours'; zero off peaks, at the ends, on the force's lines."""
    power = np.abs(np.fft.rfft(rows * hann(rows.shape[1]))) ** 2
    peaks = power == maximum_filter1d(power, 2 * NEIGHBOURS[0] - 1, axis=1)
    peaks[:, : NEIGHBOURS[1]] = peaks[:, -NEIGHBOURS[1] :] = False
    peaks[:, _force_lines(np.arange(float(peaks.shape[1])), rows.shape[1], repeats)] = False
    row, line = np.nonzero(peaks)
    offsets = np.arange(NEIGHBOURS[0], NEIGHBOURS[1] + 1)
    neighbour_power = np.median(power[row[:, None], line[:, None] + np.concatenate([-offsets, offsets])], axis=1)
    ratio = np.zeros_like(power)
    ratio[peaks] = power[peaks] / np.maximum(OUTSTANDING * neighbour_power, 1e-300)
    return ratio


def _refined(rows: Rows, frequency: float, spacing: float) -> float:
    """Frequency of largest power of all rows within `spacing` of a frequency; per sample."""
    grid = frequency + spacing * np.linspace(-1, 1, 2 * REFINEMENT + 1)
    spectra = zoom_fft(rows * hann(rows.shape[1]), grid[[0, -1]], grid.size, fs=1.0, endpoint=True)
    return float(grid[np.argmax(np.sum(np.abs(spectra) ** 2, axis=0))])
