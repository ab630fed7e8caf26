"""Outstanding spectral lines of a residual, with far more power than their neighbours: no model error is as sharp."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.signal import find_peaks, zoom_fft
from scipy.signal.windows import hann

NEIGHBOUR_LINES, OUTSTANDING_RATIO = (3, 8), 100.0
"""Neighbours of a line, the third to the eighth on either side, and the multiple of their median power above which it
stands out: a Hann window separates them, and a resonance of 1 % damping at 8 Hz raises them all. Set by hand."""
REFINEMENT_STEPS = 32
"""Refinement of the frequency grid of a line: a tone off by half a step keeps 0.1 % of its power."""

FORCE_LINE_REACH = 2
"""Distance (lines) from a multiple of the force's repetition frequency within which a line belongs to the force.
Derived: a Hann window's reach."""

Rows = Float[np.ndarray, "rows times"]


def cost_of_lines(rows: Rows, direction_count: int, repeats_per_sample: float = 0.0) -> float:
    """Cost of outstanding lines, 2 R/rows sum ln(power / (OUTSTANDING_RATIO median power of the neighbours)).

    A line is two real values of an unknown variance; R, `direction_count`, counts the sensors' directions that contact
    forces cannot follow. `repeats_per_sample` is the frequency at which the measured force repeats (0: it does
    not): the response of any rig has lines at its multiples, which do not indicate tones.
    """
    ratios = np.maximum(_outstanding_ratio(rows, repeats_per_sample), 1.0)
    return float(2 * direction_count / len(rows) * np.sum(np.log(ratios)))


def outstanding_frequencies(rows: Rows, repeats_per_sample: float = 0.0) -> tuple[float, ...]:
    """Frequencies, per sample, of lines that stand out in any row, without those of a repeating force."""
    sample_count = rows.shape[1]
    frequencies: list[float] = []
    for line in np.flatnonzero(np.any(_outstanding_ratio(rows, repeats_per_sample) > 1, axis=0)):
        refined = _refined_frequency(rows, line / sample_count, 1 / sample_count)
        if all(abs(refined - frequency) > 1 / sample_count for frequency in frequencies):
            frequencies.append(refined)
    return tuple(frequencies)


def without_lines(rows: Rows, frequencies: tuple[float, ...]) -> Rows:
    """Rows less their least-squares harmonics at the given frequencies, where the rows are not all zero."""
    is_nonzero = np.any(rows, axis=0)
    for frequency in frequencies:
        phase_rad = 2 * np.pi * frequency * np.arange(rows.shape[1])
        harmonics = is_nonzero * np.stack([np.cos(phase_rad), np.sin(phase_rad)])
        rows = rows - rows @ np.linalg.pinv(harmonics) @ harmonics
    return rows


def sharpest_frequencies(
    rows: Rows, line_count: int, bandwidth: float, repeats_per_sample: float = 0.0
) -> Float[np.ndarray, " lines"]:
    """Frequencies, per sample, of the lines with most power relative to the median within `bandwidth`, in that order.

    The power is summed over the rows under a Hann window, on a grid four times finer than one over the duration; lines
    of a repeating force are left out.
    """
    sample_count, grid_count = rows.shape[1], 4 * rows.shape[1]
    power = np.sum(np.abs(np.fft.rfft(rows * hann(sample_count), grid_count)) ** 2, axis=0)
    median_power = median_filter(power, max(3, round(bandwidth * 4 * sample_count)))
    ratio = power / np.maximum(median_power, 1e-12 * power.max())
    ratio[_force_lines(np.arange(ratio.size) / 4, sample_count, repeats_per_sample)] = 0.0
    peaks, _ = find_peaks(ratio, distance=4)
    sharpest = peaks[np.argsort(-ratio[peaks])[:line_count]]
    return np.array([_refined_frequency(rows, peak / grid_count, 1 / grid_count) for peak in sharpest])


def _force_lines(
    line_numbers: Float[np.ndarray, " lines"], sample_count: int, repeats_per_sample: float
) -> Bool[np.ndarray, " lines"]:
    """Mask of lines within FORCE_LINE_REACH of multiples of the force's repetition frequency."""
    if not repeats_per_sample:
        return np.zeros(line_numbers.size, dtype=bool)
    spacing = repeats_per_sample * sample_count
    return np.abs(line_numbers - spacing * np.round(line_numbers / spacing)) <= FORCE_LINE_REACH


def _outstanding_ratio(rows: Rows, repeats_per_sample: float) -> Float[np.ndarray, "rows lines"]:
    """Power of each peak over OUTSTANDING_RATIO times its neighbours'; zero off peaks, at ends, on a force's lines."""
    nearest, farthest = NEIGHBOUR_LINES
    power = np.abs(np.fft.rfft(rows * hann(rows.shape[1]))) ** 2
    is_peak = power == maximum_filter1d(power, 2 * nearest - 1, axis=1)
    is_peak[:, :farthest] = is_peak[:, -farthest:] = False
    is_peak[:, _force_lines(np.arange(float(is_peak.shape[1])), rows.shape[1], repeats_per_sample)] = False
    peak_rows, peak_lines = np.nonzero(is_peak)
    offsets = np.arange(nearest, farthest + 1)
    neighbour_lines = peak_lines[:, None] + np.concatenate([-offsets, offsets])
    neighbour_power = np.median(power[peak_rows[:, None], neighbour_lines], axis=1)
    ratio = np.zeros_like(power)
    ratio[is_peak] = power[is_peak] / np.maximum(OUTSTANDING_RATIO * neighbour_power, 1e-300)
    return ratio


def _refined_frequency(rows: Rows, frequency: float, line_spacing: float) -> float:
    """Frequency of largest power of all rows within `line_spacing` of a frequency; per sample."""
    grid = frequency + line_spacing * np.linspace(-1, 1, 2 * REFINEMENT_STEPS + 1)
    spectra = zoom_fft(rows * hann(rows.shape[1]), grid[[0, -1]], grid.size, fs=1.0, endpoint=True)
    return float(grid[np.argmax(np.sum(np.abs(spectra) ** 2, axis=0))])
