"""The scale of what no model explains, estimated from the record along with the fit (Kennedy and O'Hagan, J. R. Stat.
Soc. B 63, 2001: the discrepancy of the model as an unknown whose size the data tell)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.signal.windows import hann

from identify.gaps.residual.record import Record

BAND_HZ = 2.0
"""A discrepancy has one scale in each band of each sensor; some hundred independent values of 30 s tell it."""
SEGMENT_S = 1.0


@dataclass(frozen=True)
class Scales:
    """The share of each acceleration that no model explains, by sensor and line; and the variance of each contact
    residual, in units of what noise and the tolerated share of the force make of it."""

    discrepancy: Float[np.ndarray, "sensors lines"]
    contacts: tuple[float, ...]

    def distance(self, other: "Scales") -> float:
        """Mean difference of the logarithms of the shares."""
        return float(np.mean(np.abs(np.log(self.discrepancy / other.discrepancy))))


def prior_scales(record: Record) -> Scales:
    """Scales that the tolerances state."""
    return Scales(np.full(record.noise.shape, record.tolerances.unmodelled), (1.0,) * len(record.drifts))


def second_levels(
    record: Record, residual: Float[np.ndarray, "rows times"]
) -> Float[np.ndarray, "seconds bands sensors"]:
    """Mean square of a linear residual by second under a Hann window and in bands of 2 Hz: 1 where all is noise."""
    rows = residual[: len(record.sensors)]
    segment = min(round(SEGMENT_S * record.rate_hz), rows.shape[1])
    count = rows.shape[1] // segment
    parts = rows[:, : count * segment].reshape(rows.shape[0], count, segment)
    window = hann(segment, sym=False)
    power = np.abs(np.fft.rfft(parts * window, axis=2)) ** 2 / np.sum(window**2)
    per_band = max(1, round(BAND_HZ * segment / record.rate_hz))
    bands = power.shape[2] // per_band
    levels = power[:, :, : bands * per_band].reshape(rows.shape[0], count, bands, per_band).mean(axis=3)
    return np.asarray(levels.transpose(1, 2, 0))


def measured_levels(
    record: Record, residual: Float[np.ndarray, "rows times"], deviation: Float[np.ndarray, "sensors lines"], bands: int
) -> Float[np.ndarray, "bands sensors"]:
    """Mean by band of deviation^2 over the lines, in proportion to what the residual has on each.

    Times the residual's level that is its power in the sensors' unit. Where the deviation falls steeply, as below the
    first mode of a held body, its mean over the lines would make what stands on the lowest ones larger than it was.
    """
    rows = residual[: len(record.sensors)]
    power = np.abs(np.fft.rfft(rows * hann(rows.shape[1], sym=False))) ** 2
    hz = np.arange(power.shape[1]) * record.rate_hz / rows.shape[1]
    lines_hz = record.omega / (2 * np.pi)
    at = np.minimum(hz / BAND_HZ, bands - 1).astype(int)
    found = np.empty((bands, len(rows)))
    for k, (row, own) in enumerate(zip(power, deviation, strict=True)):
        variance = np.interp(hz, lines_hz, own**2)
        whole = np.bincount(at, row, bands)
        usual = np.bincount(at, variance, bands) / np.maximum(np.bincount(at, minlength=bands), 1)
        found[:, k] = np.divide(np.bincount(at, row * variance, bands), whole, out=usual, where=whole > 0)
    return found


def band_levels(record: Record, residual: Float[np.ndarray, "rows times"]) -> Float[np.ndarray, "bands sensors"]:
    """The same over the whole record."""
    return np.asarray(second_levels(record, residual).mean(axis=0))


def band_of_lines(record: Record, bands: int) -> Int[np.ndarray, " lines"]:
    """The band of each line, as a whole number."""
    return np.minimum(record.omega / (2 * np.pi * BAND_HZ), bands - 1).astype(int)


def by_band(
    record: Record, values: Float[np.ndarray, "sensors lines"], bands: int
) -> Float[np.ndarray, "bands sensors"]:
    """Means over the lines of each band."""
    at = band_of_lines(record, bands)
    counts = np.maximum(np.bincount(at, minlength=bands), 1)
    return np.array([np.bincount(at, row, bands) / counts for row in values]).T


def posterior_level(level: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any"]:
    """The variance believed after a mean square was seen: half-way between it and one, which was believed before.

    The mean of an inverse-gamma variance whose prior counts for as much as the band: one band tells its own scale, but
    none is ever taken to be less than half of what noise and the tolerated share make.
    """
    return np.asarray((1.0 + level) / 2)


def estimated_scales(
    record: Record,
    used: Scales,
    linear: Float[np.ndarray, "rows times"],
    contact_levels: tuple[float, ...],
) -> Scales:
    """Scales by the residuals that a fit under the scales `used` leaves.

    With n the noise and P the power of a band, its residual has the variance n + d^2 P; d is that for which it is what
    is seen. Not below the share that the tolerances state. In a free decay d stays: its power stands in sharp lines, so
    that what is left between them would make d as large as the motion.
    """
    contacts = tuple(
        float(factor * posterior_level(np.array(level)))
        for factor, level in zip(used.contacts, contact_levels, strict=True)
    )
    if not record.forced:
        return Scales(used.discrepancy, contacts)
    levels = band_levels(record, linear)
    bands = len(levels)
    variance = record.noise + used.discrepancy**2 * record.power
    noisy = by_band(record, record.noise / np.maximum(variance, 1e-300), bands)
    share = by_band(record, used.discrepancy, bands)
    explained = np.maximum(levels - noisy, 0.0) / np.maximum(1.0 - noisy, 1e-6)
    found = np.maximum(share * np.sqrt(explained), record.tolerances.unmodelled)
    return Scales(np.ascontiguousarray(found[band_of_lines(record, bands)].T), contacts)
