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

BAND_HZ = 2.0
"""Width of the bands in which a sensor's discrepancy has one scale: some hundred independent values in 30 s. Derived:
30 s * 2 Hz * 2 = 120 real values tell a variance to 13 %."""
SEGMENT_S = 1.0
"""Length of the segments from which the level of a band follows, s. Derived: a Hann window of 1 s resolves 1.5 Hz, less
than a band."""


@dataclass(frozen=True)
class Scales:
    """Unmodelled share of each acceleration by sensor and line, and the variance of each contact residual relative to
    that by noise and the tolerated share of the force."""

    discrepancy: Float[np.ndarray, "sensors lines"]
    contacts: tuple[float, ...]

    def distance(self, compared: "Scales") -> float:
        """Mean absolute difference of the logarithms of the shares."""
        return float(np.mean(np.abs(np.log(self.discrepancy / compared.discrepancy))))


def prior_scales(record: Record) -> Scales:
    """Scales stated by the tolerances."""
    return Scales(np.full(record.noise.shape, record.tolerances.unmodelled), (1.0,) * len(record.drifts))


def second_levels(
    record: Record, residual: Float[np.ndarray, "rows times"]
) -> Float[np.ndarray, "seconds bands sensors"]:
    """Mean square of a linear residual by second and band, under a Hann window: 1 for noise alone."""
    rows = residual[: len(record.sensors)]
    segment = min(round(SEGMENT_S * record.rate_hz), rows.shape[1])
    count = rows.shape[1] // segment
    segments = rows[:, : count * segment].reshape(rows.shape[0], count, segment)
    window = hann(segment, sym=False)
    power = np.abs(np.fft.rfft(segments * window, axis=2)) ** 2 / np.sum(window**2)
    per_band = max(1, round(BAND_HZ * segment / record.rate_hz))
    band_count = power.shape[2] // per_band
    levels = power[:, :, : band_count * per_band].reshape(rows.shape[0], count, band_count, per_band).mean(axis=3)
    return np.asarray(levels.transpose(1, 2, 0))


def measured_levels(
    record: Record,
    residual: Float[np.ndarray, "rows times"],
    deviation: Float[np.ndarray, "sensors lines"],
    band_count: int,
) -> Float[np.ndarray, "bands sensors"]:
    """Mean of deviation^2 by band, weighted by the residual's power on each line.

    Times the residual's level, that is its power in the sensors' unit. Where the deviation falls steeply, as below the
    first mode of a held body, an unweighted mean would exaggerate a residual on the lowest lines.
    """
    rows = residual[: len(record.sensors)]
    power = np.abs(np.fft.rfft(rows * hann(rows.shape[1], sym=False))) ** 2
    hz = np.arange(power.shape[1]) * record.rate_hz / rows.shape[1]
    lines_hz = record.omega / (2 * np.pi)
    band_of_line = np.minimum(hz / BAND_HZ, band_count - 1).astype(int)
    variances = np.empty((band_count, len(rows)))
    for k, (row, sensor_deviation) in enumerate(zip(power, deviation, strict=True)):
        variance = np.interp(hz, lines_hz, sensor_deviation**2)
        band_power = np.bincount(band_of_line, row, band_count)
        mean_variance = np.bincount(band_of_line, variance, band_count) / np.maximum(
            np.bincount(band_of_line, minlength=band_count), 1
        )
        variances[:, k] = np.divide(
            np.bincount(band_of_line, row * variance, band_count), band_power, out=mean_variance, where=band_power > 0
        )
    return variances


def band_levels(record: Record, residual: Float[np.ndarray, "rows times"]) -> Float[np.ndarray, "bands sensors"]:
    """Mean square of a linear residual by band over the whole record."""
    return np.asarray(second_levels(record, residual).mean(axis=0))


def band_of_lines(record: Record, band_count: int) -> Int[np.ndarray, " lines"]:
    """Index of the band of each line."""
    return np.minimum(record.omega / (2 * np.pi * BAND_HZ), band_count - 1).astype(int)


def by_band(
    record: Record, values: Float[np.ndarray, "sensors lines"], band_count: int
) -> Float[np.ndarray, "bands sensors"]:
    """Mean over the lines of each band."""
    band_of_line = band_of_lines(record, band_count)
    counts = np.maximum(np.bincount(band_of_line, minlength=band_count), 1)
    return np.array([np.bincount(band_of_line, row, band_count) / counts for row in values]).T


def posterior_level(level: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """Posterior mean (1 + L) / 2 of a relative variance with prior mean 1, given a mean square L.

    The inverse-gamma prior weighs as much as the band, so that a band determines its own scale, which is never below
    half of that by noise and the tolerated share.
    """
    return np.asarray((1.0 + level) / 2)


def estimated_scales(
    record: Record,
    fit_scales: Scales,
    linear: Float[np.ndarray, "rows times"],
    contact_levels: tuple[float, ...],
) -> Scales:
    """Scales estimated from the residuals of a fit under `fit_scales`.

    With noise n and power P of a band, its residual has the variance n + d^2 P; d is that of the observed variance, not
    below the stated tolerance. In a free decay d is kept: the power is in sharp lines, and the residual between them
    would make d as large as the motion.
    """
    contacts = tuple(
        float(factor * posterior_level(np.array(level)))
        for factor, level in zip(fit_scales.contacts, contact_levels, strict=True)
    )
    if not record.forced:
        return Scales(fit_scales.discrepancy, contacts)
    levels = band_levels(record, linear)
    band_count = len(levels)
    variance = record.noise + fit_scales.discrepancy**2 * record.power
    noisy = by_band(record, record.noise / np.maximum(variance, 1e-300), band_count)
    share = by_band(record, fit_scales.discrepancy, band_count)
    explained = np.maximum(levels - noisy, 0.0) / np.maximum(1.0 - noisy, 1e-6)
    shares = np.maximum(share * np.sqrt(explained), record.tolerances.unmodelled)
    return Scales(np.ascontiguousarray(shares[band_of_lines(record, band_count)].T), contacts)
