"""Scale of the model discrepancy d, the unmodelled share of each acceleration, estimated from the record with the fit.

Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001: the discrepancy as an unknown whose size follows from the data.

With n the noise, sigma^2 the variance and L the mean square of the residual in a band of a sensor,

    d^2 <- d^2 max(L - n / sigma^2, 0) / (1 - n / sigma^2),   contact level <- level (1 + L_j) / 2

never below the tolerance `unmodelled`. Without it, physical parameters absorb the model error.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import hann

from identify.gaps.residual.record import Record

BAND_WIDTH_HZ = 2.0
"""Width of the bands in which a sensor's discrepancy has one scale: some hundred independent values in 30 s. Derived:
30 s * 2 Hz * 2 = 120 real values tell a variance to 13 %."""
SEGMENT_LENGTH_S = 1.0
"""Length of the segments from which the level of a band follows, s. Derived: a Hann window of 1 s resolves 1.5 Hz, less
than a band."""


@dataclass(frozen=True)
class Scales:
    """Unmodelled share of each acceleration by sensor and line, and the variance of each contact residual relative to
    that by noise and the tolerated share of the force."""

    unmodelled_shares: Float[np.ndarray, "sensors lines"]
    contact_variances: tuple[float, ...]

    def log_share_distance(self, compared_scales: "Scales") -> float:
        """Mean absolute difference of the logarithms of the shares."""
        return float(np.mean(np.abs(np.log(self.unmodelled_shares / compared_scales.unmodelled_shares))))


def prior_scales(record: Record) -> Scales:
    """Scales stated by the tolerances: their unmodelled share, and variances of one."""
    return Scales(np.full(record.noise_variance.shape, record.tolerances.unmodelled), (1.0,) * len(record.drifts))


def segment_and_band_counts(rate_hz: float, sample_count: int) -> tuple[int, int, int, int]:
    """Samples per segment, number of segments, lines per band and number of bands."""
    samples = min(round(SEGMENT_LENGTH_S * rate_hz), sample_count)
    lines_per_band = max(1, round(BAND_WIDTH_HZ * samples / rate_hz))
    return samples, sample_count // samples, lines_per_band, (samples // 2 + 1) // lines_per_band


def residual_mean_squares_by_second(
    record: Record, residual: Float[np.ndarray, "rows times"]
) -> Float[np.ndarray, "seconds bands sensors"]:
    """Mean square of a linear residual by second and band, under a Hann window: 1 for noise alone."""
    residuals = residual[: len(record.sensors)]
    segment_sample_count, count, band_lines, band_count = segment_and_band_counts(
        record.residual_rate_hz, residuals.shape[1]
    )
    segments = residuals[:, : count * segment_sample_count].reshape(len(residuals), count, segment_sample_count)
    window = hann(segment_sample_count, sym=False)
    power = np.abs(np.fft.rfft(segments * window, axis=2)) ** 2 / np.sum(window**2)
    power_by_line = power[:, :, : band_count * band_lines].reshape(len(residuals), count, band_count, band_lines)
    return np.asarray(power_by_line.mean(axis=3).transpose(1, 2, 0))


def power_weighted_band_variances(
    record: Record,
    residual: Float[np.ndarray, "rows times"],
    error_deviation: Float[np.ndarray, "sensors lines"],
    band_count: int,
) -> Float[np.ndarray, "bands sensors"]:
    """Mean of deviation^2 by band, weighted by the residual's power on each line.

    Times the residual's level, that is its power in the sensors' unit. Where the deviation falls steeply, as below the
    first mode of a held body, an unweighted mean would exaggerate a residual on the lowest lines.
    """
    residuals = residual[: len(record.sensors)]
    residual_power = np.abs(np.fft.rfft(residuals * hann(residuals.shape[1], sym=False))) ** 2
    lines_hz = np.arange(residual_power.shape[1]) * record.residual_rate_hz / residuals.shape[1]
    bands = np.minimum(lines_hz / BAND_WIDTH_HZ, band_count - 1).astype(int)
    line_counts = np.maximum(np.bincount(bands, minlength=band_count), 1)
    weighted_variances = np.empty((band_count, len(residuals)))
    for k, (sensor_power, deviation) in enumerate(zip(residual_power, error_deviation, strict=True)):
        variance = np.interp(lines_hz, record.omega / (2 * np.pi), deviation**2)
        band_power = np.bincount(bands, sensor_power, band_count)
        weighted_sum = np.bincount(bands, sensor_power * variance, band_count)
        unweighted = np.bincount(bands, variance, band_count) / line_counts
        weighted_variances[:, k] = np.divide(weighted_sum, band_power, out=unweighted, where=band_power > 0)
    return weighted_variances


def residual_mean_squares_by_band(
    record: Record, residual: Float[np.ndarray, "rows times"]
) -> Float[np.ndarray, "bands sensors"]:
    """Mean square of a linear residual by band over the whole record."""
    return np.asarray(residual_mean_squares_by_second(record, residual).mean(axis=0))


def band_index(record: Record, band_count: int) -> Int[np.ndarray, " lines"]:
    """Index of the band of each line."""
    return np.minimum(record.omega / (2 * np.pi * BAND_WIDTH_HZ), band_count - 1).astype(int)


def band_means(
    record: Record, line_values: Float[np.ndarray, "sensors lines"], band_count: int
) -> Float[np.ndarray, "bands sensors"]:
    """Mean over the lines of each band, for every sensor."""
    indices = band_index(record, band_count)
    line_counts = np.maximum(np.bincount(indices, minlength=band_count), 1)
    return np.array([np.bincount(indices, sensor_values, band_count) / line_counts for sensor_values in line_values]).T


def posterior_variance(mean_square: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Posterior mean (1 + L) / 2 of a relative variance with prior mean 1, given a mean square L.

    The inverse-gamma prior weighs as much as the band, so that a band determines its own scale, which is never below
    half of that by noise and the tolerated share.
    """
    return np.asarray((1.0 + mean_square) / 2)


def estimated_scales(
    record: Record,
    fit_scales: Scales,
    linear_residual: Float[np.ndarray, "rows times"],
    contact_mean_squares: tuple[float, ...],
) -> Scales:
    """Scales estimated from the residuals of a fit under `fit_scales`.

    With noise n and power P of a band, its residual has the variance n + d^2 P; d is that of the observed variance, not
    below the stated tolerance. In a free decay d is kept: the power is in sharp lines, and the residual between them
    would make d as large as the motion.
    """
    contact_variances = tuple(
        float(variance * posterior_variance(np.array(mean_square)))
        for variance, mean_square in zip(fit_scales.contact_variances, contact_mean_squares, strict=True)
    )
    if not record.has_force:
        return Scales(fit_scales.unmodelled_shares, contact_variances)
    mean_square_by_band = residual_mean_squares_by_band(record, linear_residual)
    band_count = len(mean_square_by_band)
    line_variance = record.noise_variance + fit_scales.unmodelled_shares**2 * record.smoothed_power
    noise_share = band_means(record, record.noise_variance / np.maximum(line_variance, 1e-300), band_count)
    fit_share = band_means(record, fit_scales.unmodelled_shares, band_count)
    variance_ratio = np.maximum(mean_square_by_band - noise_share, 0.0) / np.maximum(1.0 - noise_share, 1e-6)
    new_shares = np.maximum(fit_share * np.sqrt(variance_ratio), record.tolerances.unmodelled)
    return Scales(np.ascontiguousarray(new_shares[band_index(record, band_count)].T), contact_variances)
