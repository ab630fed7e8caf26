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

ResidualRows = Float[np.ndarray, "rows times"]


def outstanding_line_cost(residual: ResidualRows, direction_count: int, repeats_per_sample: float = 0.0) -> float:
    """Cost of outstanding lines, 2 R/rows sum ln(power / (OUTSTANDING_RATIO median power of the neighbours)).

    A line is two real values of an unknown variance; R, `direction_count`, counts the sensors' directions that contact
    forces cannot follow. `repeats_per_sample` is the frequency at which the measured force repeats (0: it does
    not): the response of any rig has lines at its multiples, which do not indicate tones.
    """
    outstanding_ratios = np.maximum(_peak_to_neighbour_power_ratio(residual, repeats_per_sample), 1.0)
    return float(2 * direction_count / len(residual) * np.sum(np.log(outstanding_ratios)))


def outstanding_line_frequencies(residual: ResidualRows, repeats_per_sample: float = 0.0) -> tuple[float, ...]:
    """Frequencies, per sample, of lines that stand out in any row, without those of a repeating force."""
    sample_count = residual.shape[1]
    frequencies: list[float] = []
    for line in np.flatnonzero(np.any(_peak_to_neighbour_power_ratio(residual, repeats_per_sample) > 1, axis=0)):
        refined_frequency = _refined_frequency(residual, line / sample_count, 1 / sample_count)
        if all(abs(refined_frequency - frequency) > 1 / sample_count for frequency in frequencies):
            frequencies.append(refined_frequency)
    return tuple(frequencies)


def without_lines(residual: ResidualRows, frequencies: tuple[float, ...]) -> ResidualRows:
    """Rows of a residual less their least-squares harmonics at the given frequencies, where they are not all zero."""
    is_nonzero = np.any(residual, axis=0)
    for frequency in frequencies:
        phase_rad = 2 * np.pi * frequency * np.arange(residual.shape[1])
        harmonics = is_nonzero * np.stack([np.cos(phase_rad), np.sin(phase_rad)])
        residual = residual - residual @ np.linalg.pinv(harmonics) @ harmonics
    return residual


def sharpest_line_frequencies(
    residual: ResidualRows, line_count: int, bandwidth_per_sample: float, repeats_per_sample: float = 0.0
) -> Float[np.ndarray, " lines"]:
    """Frequencies, per sample, of the lines with most power relative to the median within `bandwidth`, in that order.

    The power is summed over the rows under a Hann window, on a grid four times finer than one over the duration; lines
    of a repeating force are left out.
    """
    sample_count, grid_count = residual.shape[1], 4 * residual.shape[1]
    line_power = np.sum(np.abs(np.fft.rfft(residual * hann(sample_count), grid_count)) ** 2, axis=0)
    median_power = median_filter(line_power, max(3, round(bandwidth_per_sample * 4 * sample_count)))
    power_ratio = line_power / np.maximum(median_power, 1e-12 * line_power.max())
    power_ratio[_is_force_line(np.arange(power_ratio.size) / 4, sample_count, repeats_per_sample)] = 0.0
    peak_indices, _ = find_peaks(power_ratio, distance=4)
    sharpest_indices = peak_indices[np.argsort(-power_ratio[peak_indices])[:line_count]]
    return np.array([_refined_frequency(residual, peak / grid_count, 1 / grid_count) for peak in sharpest_indices])


def _is_force_line(
    line_numbers: Float[np.ndarray, " lines"], sample_count: int, repeats_per_sample: float
) -> Bool[np.ndarray, " lines"]:
    """Mask of lines within FORCE_LINE_REACH of multiples of the force's repetition frequency."""
    if not repeats_per_sample:
        return np.zeros(line_numbers.size, dtype=bool)
    force_line_spacing = repeats_per_sample * sample_count
    return np.abs(line_numbers - force_line_spacing * np.round(line_numbers / force_line_spacing)) <= FORCE_LINE_REACH


def _peak_to_neighbour_power_ratio(
    residual: ResidualRows, repeats_per_sample: float
) -> Float[np.ndarray, "rows lines"]:
    """Power of each peak over OUTSTANDING_RATIO times its neighbours'; zero off peaks, at ends, on a force's lines."""
    nearest_neighbour, farthest_neighbour = NEIGHBOUR_LINES
    line_power = np.abs(np.fft.rfft(residual * hann(residual.shape[1]))) ** 2
    is_peak = line_power == maximum_filter1d(line_power, 2 * nearest_neighbour - 1, axis=1)
    is_peak[:, :farthest_neighbour] = is_peak[:, -farthest_neighbour:] = False
    is_peak[:, _is_force_line(np.arange(float(is_peak.shape[1])), residual.shape[1], repeats_per_sample)] = False
    peak_rows, peak_lines = np.nonzero(is_peak)
    neighbour_offsets = np.arange(nearest_neighbour, farthest_neighbour + 1)
    neighbour_lines = peak_lines[:, None] + np.concatenate([-neighbour_offsets, neighbour_offsets])
    neighbour_power = np.median(line_power[peak_rows[:, None], neighbour_lines], axis=1)
    outstanding_ratio = np.zeros_like(line_power)
    outstanding_ratio[is_peak] = line_power[is_peak] / np.maximum(OUTSTANDING_RATIO * neighbour_power, 1e-300)
    return outstanding_ratio


def _refined_frequency(residual: ResidualRows, frequency: float, line_spacing: float) -> float:
    """Frequency of largest power of all rows within `line_spacing` of a frequency; per sample."""
    grid = frequency + line_spacing * np.linspace(-1, 1, 2 * REFINEMENT_STEPS + 1)
    spectra = zoom_fft(residual * hann(residual.shape[1]), grid[[0, -1]], grid.size, fs=1.0, endpoint=True)
    return float(grid[np.argmax(np.sum(np.abs(spectra) ** 2, axis=0))])
