"""Unmeasured base motion: its band and level from the share of the linear residual that has its pattern.

At every line the pattern of the base over the sensors has the power 1 + S s, with its size s in noise. The best band
is the interval of lines of largest likelihood over all densities S (Kadane), its density the likeliest there, its
edges the means of their posterior; standard errors are Fisher's and the posterior's, for the lines that a Hann window
leaves independent.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float
from msgspec.structs import replace as changed
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal.windows import hann

from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.nuisance import line_to_time_residual_factor
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.residual.spectra import SMOOTHING_BANDWIDTH_HZ
from identify.gaps.search.candidates import Candidate
from rig.model.description import BaseMotion

WINDOW_BANDWIDTH_LINES, WINDOW_POWER_CORRELATION = 1.5, 35 / 18
"""Noise bandwidth of a Hann window in lines, and factor by which it lowers the number of independent powers. Derived:
mean of w^4 over (mean of w^2)^2."""
TRIAL_DENSITIES = 10.0 ** np.arange(-9, 3, 0.5)
"""Trial spectral densities, (m/s^2)^2/Hz. Derived: the best is within a factor 1.8, then refined."""
LEAST_PATTERN_SHARE, LEAST_SETTLED_SHARE = 0.5, 0.8
"""Share of a band's power beyond the sensors' noise that has the pattern of a base motion, below which something else
moves the machine there: near a resonance its errors have nearly that pattern. Set by hand: the greater part, and nearly
all beside a set that explains the rest."""
MAX_BANDS = 3
"""Bands that are looked at beside a set: something else in the best one may hide a base motion in another. Effort."""


@dataclass(frozen=True)
class _PatternSpectra:
    """Residual on a record's lines, as far as it has the pattern of a base motion.

    pattern_power is |p'y|^2/s in noise, unit_motion_power s, the pattern's power by a base motion of unit density;
    excess_of_pattern and excess_power are the power beyond the sensors' noise that has the pattern, and all of it.
    """

    lines_hz: Float[np.ndarray, " lines"]
    pattern_power: Float[np.ndarray, " lines"]
    unit_motion_power: Float[np.ndarray, " lines"]
    excess_of_pattern: Float[np.ndarray, " lines"]
    excess_power: Float[np.ndarray, " lines"]

    def in_band(self, low_hz: float, high_hz: float) -> Bool[np.ndarray, " lines"]:
        return (self.lines_hz >= low_hz) & (self.lines_hz <= high_hz)


def fit_base_spectrum(
    linearization: Linearization, residual: Residual, candidate: Candidate, min_gain: float, beside_set: bool = False
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """Most likely base motion (rms acceleration in m/s^2, lower and upper end of its band in Hz) and standard errors.

    None where the residual holds no base motion, -2 ln p falls by no more than `min_gain`, or other patterns have more
    of the band's power; `beside_set` beside a set that explains the rest, where a further band may hold it, and must
    hold little else. With y the residual and p
    the pattern of a base motion of unit density, both of unit noise, a density S lowers the cost of a line by
    2 (|p'y|^2/s (1 - 1/(1 + S s)) - log(1 + S s)), s = |p|^2; the best band is the interval of lines of largest sum.
    """
    if len(linearization.record.sensors) < len(linearization.observations) + 2:
        return None  # any residual has the pattern of a base motion
    spectra = _pattern_spectra(linearization, residual)
    least_share, max_bands = (LEAST_SETTLED_SHARE, MAX_BANDS) if beside_set else (LEAST_PATTERN_SHARE, 1)
    for _ in range(max_bands):
        estimate = _band_estimate(linearization, spectra, candidate, min_gain)
        if estimate is None:
            return None
        is_in_band = spectra.in_band(*estimate[0][1:])
        if np.sum(spectra.excess_of_pattern[is_in_band]) >= least_share * np.sum(spectra.excess_power[is_in_band]):
            return estimate
        spectra = replace(spectra, pattern_power=np.where(is_in_band, 0.0, spectra.pattern_power))
    return None


def _pattern_spectra(linearization: Linearization, residual: Residual) -> _PatternSpectra:
    """Residual by its pattern. Each sensor is scaled by the level of its residual around each line, so that a model
    error at some sensors does not hide the pattern at the others; the noise is then the power of the other patterns."""
    record = linearization.record
    lines_hz = record.omega / (2 * np.pi)
    low_hz, high_hz = float(lines_hz[1]), float(lines_hz[-1])
    unit_motion = BaseMotion(acceleration_rms_m_per_s2=float(np.sqrt(high_hz - low_hz)), low_hz=low_hz, high_hz=high_hz)
    shaken_rig, shares = changed(linearization.rig, base_motion=unit_motion), linearization.scales.unmodelled_shares
    signal_per_input = linear_model(record, shaken_rig, shares, linearization.cache.responses).signal_per_input
    contact_count = len(linearization.observations)
    pattern = signal_per_input[contact_count]
    contact_forces = linearization.model.projection.applied_to(pattern * linearization.model.error_deviation)[1]
    pattern = pattern - np.einsum("isl,il->sl", signal_per_input[:contact_count], contact_forces)
    spectra = _hann_windowed_residual_spectra(linearization, residual)
    smoothing_line_count = max(1, round(SMOOTHING_BANDWIDTH_HZ * record.transform_length / record.sample_rate_hz))
    sensor_rms = np.sqrt(np.maximum(uniform_filter1d(np.abs(spectra) ** 2, smoothing_line_count, axis=1), 1e-300))
    pattern_power, unit_motion_power = _pattern_power_and_squared_norm(spectra / sensor_rms, pattern / sensor_rms)
    remaining_power = np.sum(np.abs(spectra / sensor_rms) ** 2, axis=0) - pattern_power
    remaining_power = remaining_power / max(1, len(spectra) - contact_count - 1)
    noise_power = np.maximum(uniform_filter1d(remaining_power, smoothing_line_count), 1e-300)
    noise_by_pattern = np.mean(record.noise_variance / linearization.model.error_deviation**2, axis=0)
    return _PatternSpectra(
        lines_hz,
        pattern_power / noise_power,
        unit_motion_power / noise_power,
        _pattern_power_and_squared_norm(spectra, pattern)[0] - noise_by_pattern,
        np.sum(np.abs(spectra) ** 2, axis=0) - (len(spectra) - contact_count) * noise_by_pattern,
    )


def _band_estimate(
    linearization: Linearization, spectra: _PatternSpectra, candidate: Candidate, min_gain: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]] | None:
    """Values and standard errors of the band of largest gain, whatever else moves the machine there; None below
    `min_gain`."""
    record, ranges, lines_hz = linearization.record, candidate.parameters, spectra.lines_hz
    pattern_power, unit_motion_power = spectra.pattern_power, spectra.unit_motion_power
    is_in_range = (lines_hz >= ranges["low_hz"].low) & (lines_hz <= ranges["high_hz"].high)
    largest_gain, best_lines, best_density = 0.0, slice(0, 0), 0.0
    for trial_density in TRIAL_DENSITIES:
        gain_by_line = np.where(
            is_in_range, _log_likelihood_gains_by_line(trial_density, pattern_power, unit_motion_power), 0.0
        )
        interval_gain, interval_lines = _interval_of_largest_sum(gain_by_line)
        if interval_gain > largest_gain:
            largest_gain, best_lines, best_density = interval_gain, interval_lines, trial_density
    counted_sample_count = (record.counted_slice.stop - record.counted_slice.start) * record.decimation
    counted_share = counted_sample_count / record.transform_length
    if not 2 * largest_gain * counted_share / WINDOW_BANDWIDTH_LINES > min_gain:
        return None
    band_power_and_size = pattern_power[best_lines], unit_motion_power[best_lines]
    best_density, relative_error = _fitted_density(best_density, *band_power_and_size, counted_share)
    gain_by_line = np.where(
        is_in_range, _log_likelihood_gains_by_line(best_density, pattern_power, unit_motion_power), 0.0
    )
    gain_by_line = gain_by_line * counted_sample_count / record.transform_length / WINDOW_BANDWIDTH_LINES
    cumulative_gain = np.concatenate([[0.0], np.cumsum(gain_by_line)])
    resolution_hz = record.sample_rate_hz / counted_sample_count
    middle_line = (best_lines.start + best_lines.stop) // 2
    low_hz, low_error_hz = _band_edge(lines_hz[:middle_line], -cumulative_gain[:middle_line], resolution_hz)
    high_hz, high_error_hz = _band_edge(lines_hz[middle_line:], cumulative_gain[middle_line:-1], resolution_hz)
    rms_m_per_s2 = float(np.sqrt(best_density * record.sample_count / counted_sample_count * (high_hz - low_hz)))
    base_motion_values = np.array([np.clip(rms_m_per_s2, 0, ranges["acceleration_rms_m_per_s2"].high), low_hz, high_hz])
    rms_error = rms_m_per_s2 * np.hypot(relative_error, np.hypot(low_error_hz, high_error_hz) / (high_hz - low_hz)) / 2
    return base_motion_values, np.array([rms_error, low_error_hz, high_error_hz])


def _pattern_power_and_squared_norm(
    spectra: Complex[np.ndarray, "sensors lines"], pattern: Complex[np.ndarray, "sensors lines"]
) -> tuple[Float[np.ndarray, " lines"], Float[np.ndarray, " lines"]]:
    """Power |p'y|^2/|p|^2 of a pattern p in spectra y at every line, and its size |p|^2."""
    unit_motion_power = np.sum(np.abs(pattern) ** 2, axis=0)
    return np.abs(np.sum(pattern.conj() * spectra, axis=0)) ** 2 / np.maximum(
        unit_motion_power, 1e-300
    ), unit_motion_power


def _log_likelihood_gains_by_line(
    density: float, pattern_power: Float[np.ndarray, " lines"], unit_motion_power: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, " lines"]:
    """Gain of each line's log likelihood by a spectral density."""
    return np.asarray(
        pattern_power * (1 - 1 / (1 + density * unit_motion_power)) - np.log1p(density * unit_motion_power)
    )


def _fitted_density(
    start_density: float,
    pattern_power: Float[np.ndarray, " lines"],
    unit_motion_power: Float[np.ndarray, " lines"],
    counted_share: float,
) -> tuple[float, float]:
    """Likeliest density within a decade of a start, and its relative standard error by Fisher's information."""
    log_density_bounds = np.log(start_density) + np.array([-1.0, 1.0]) * np.log(10)
    optimum = minimize_scalar(
        lambda log_density: (
            -np.sum(_log_likelihood_gains_by_line(np.exp(log_density), pattern_power, unit_motion_power))
        ),
        bounds=log_density_bounds,
        method="bounded",
    )
    density = float(np.exp(optimum.x))
    signal_share = density * unit_motion_power / (1 + density * unit_motion_power)
    return density, float(1 / np.sqrt(max(np.sum(signal_share**2) * counted_share / WINDOW_POWER_CORRELATION, 1e-300)))


def _band_edge(
    lines_hz: Float[np.ndarray, " lines"], log_likelihoods: Float[np.ndarray, " lines"], resolution_hz: float
) -> tuple[float, float]:
    """Mean and standard deviation of a band's edge under a uniform prior, the latter with the window resolution."""
    probabilities = np.exp(log_likelihoods - np.max(log_likelihoods))
    probabilities /= probabilities.sum()
    mean_hz = float(probabilities @ lines_hz)
    return mean_hz, float(np.sqrt(probabilities @ (lines_hz - mean_hz) ** 2 + resolution_hz**2))


def _hann_windowed_residual_spectra(
    linearization: Linearization, residual: Residual
) -> Complex[np.ndarray, "sensors lines"]:
    """Spectra of the residual on the record's lines, under a Hann window so that no band leaks into another."""
    record = linearization.record
    sensor_residuals = residual.linear_residual[: len(record.sensors)]
    window = hann(sensor_residuals.shape[1]) * np.sqrt(8 / 3)
    spectrum = np.fft.rfft(sensor_residuals * window, record.transform_length // record.decimation)
    return np.asarray(spectrum * record.decimation / line_to_time_residual_factor(record))


def _interval_of_largest_sum(gain_by_line: Float[np.ndarray, " lines"]) -> tuple[float, slice]:
    """Largest sum of an interval, and the interval (Kadane)."""
    cumulative_gains = np.concatenate([[0.0], np.cumsum(gain_by_line)])
    lowest_before = np.minimum.accumulate(cumulative_gains)
    stop_line = int(np.argmax(cumulative_gains - lowest_before))
    start_line = int(np.argmin(cumulative_gains[: stop_line + 1]))
    return float(cumulative_gains[stop_line] - cumulative_gains[start_line]), slice(start_line, stop_line)
