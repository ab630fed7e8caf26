"""Sampling times of a measured record: uneven or differing rates are refused, or resampled on request."""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError

MAX_JITTER_INTERVALS = 0.01
"""Largest deviation of a time stamp from an even grid, in sampling intervals."""
MIN_GAP_INTERVALS = 1.5
"""Least gap between two time stamps, in intervals."""
MAX_BRIDGED_INTERVALS = 4.5
"""Longest gap that is interpolated, in intervals."""
RATE_TOLERANCE = 1e-4
MAX_DECIMATION = 1000
"""Largest ratio of the record's rate to the rig's; beyond, its time is probably in another unit."""
PIECE_SAMPLES, OVERLAP_SAMPLES = 2**18, 64
"""Samples of all channels per spline, and extra knots at its ends, whose influence decays as 0.27^64."""


@dataclass(frozen=True)
class SampleTimes:
    """Times of a record's samples; stamps_s is None if they are known to be even.

    fault describes an irregularity of the stamps in words; empty if there is none.
    """

    sample_count: int
    rate_hz: float
    stamps_s: Float[np.ndarray, " samples"] | None = None
    fault: str = ""

    @classmethod
    def of_rate(cls, rate_hz: float, sample_count: int) -> "SampleTimes":
        if sample_count < 2:
            raise RigError("it holds fewer than two samples; export more")
        return cls(sample_count, rate_hz)

    @classmethod
    def of_stamps(cls, stamps_s: Float[np.ndarray, " samples"]) -> "SampleTimes":
        """Times by stamps; raises RigError if they do not increase or have a long gap."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            rate_hz, stamp_fault = _rate_and_fault(stamps_s)
        return cls(stamps_s.size, rate_hz, stamps_s, stamp_fault)

    def stamps(self, first_sample: int, end_sample: int) -> Float[np.ndarray, " some"]:
        """Time stamps of the samples first_sample to end_sample - 1, s."""
        if self.stamps_s is None:
            return np.arange(first_sample, end_sample) / self.rate_hz
        return self.stamps_s[first_sample:end_sample]


def even_samples_and_steps(
    values: Float[np.ndarray, "channels samples"], sample_times: SampleTimes, rate_hz: float, resample: bool
) -> tuple[Float[np.ndarray, "channels evenly"], tuple[str, ...]]:
    """Samples at the times k / rate_hz after the first, and the processing steps in words.

    Uneven time stamps are interpolated by a cubic spline to an even grid of nearly their own rate (its error is at most
    5/384 (omega interval)^4 of the amplitude at the frequency omega); another rate is then reached by a linear-phase
    filter, flat within 1e-3 to 0.37 of the new rate and down by 80 dB at 0.63 of it. Both only if `resample` is true.
    Raises RigError, without the name of the file, if the stamps are uneven or at another rate and it is not, and
    always for a rate below rate_hz or over MAX_DECIMATION times as high.
    """
    record_rate_hz, stamp_fault = sample_times.rate_hz, sample_times.fault
    if stamp_fault and not resample:
        raise RigError(f"{stamp_fault}; mend the record, or set resample = true in the map")
    is_other_rate = abs(record_rate_hz / rate_hz - 1) > RATE_TOLERANCE
    if is_other_rate and record_rate_hz < rate_hz:
        raise RigError(
            f"it is sampled at {record_rate_hz:.6g} Hz, below sample_rate_hz {rate_hz:g} of the rig; correct rig.json"
        )
    if record_rate_hz > MAX_DECIMATION * rate_hz:
        raise RigError(
            f"it is sampled at {record_rate_hz:.6g} Hz, over {MAX_DECIMATION} times sample_rate_hz {rate_hz:g} of the "
            "rig; correct the unit or scale of its time, or rig.json"
        )
    if is_other_rate and not resample:
        raise RigError(
            f"it is sampled at {record_rate_hz:.6g} Hz, sample_rate_hz of the rig is {rate_hz:g}; correct rig.json, or "
            "set resample = true in the map"
        )
    rate_ratio = Fraction(rate_hz / record_rate_hz).limit_denominator(MAX_DECIMATION) if is_other_rate else Fraction(1)
    grid_rate_hz = rate_hz / float(rate_ratio)
    processing_steps = []
    if stamp_fault or abs(grid_rate_hz / record_rate_hz - 1) > RATE_TOLERANCE:
        values = _resample_to_grid(values, sample_times, grid_rate_hz)
        grid_reason = stamp_fault or "the rate is uneven"
        processing_steps.append(f"resampled to an even {grid_rate_hz:.9g} Hz by a cubic spline, since {grid_reason}")
    if rate_ratio != 1:
        values = np.stack([_filter_to_rate(channel_values, rate_ratio) for channel_values in values])
        processing_steps.append(f"resampled from {grid_rate_hz:.9g} to {rate_hz:.9g} Hz by a linear-phase filter")
    return values, tuple(processing_steps)


def _resample_to_grid(
    values: Float[np.ndarray, "channels samples"], sample_times: SampleTimes, grid_hz: float
) -> Float[np.ndarray, "channels evenly"]:
    """Resample to an even grid by cubic splines, piece by piece with overlapping knots."""
    sample_count = sample_times.sample_count
    (start_s,), (end_s,) = sample_times.stamps(0, 1), sample_times.stamps(sample_count - 1, sample_count)
    grid_values = np.empty((len(values), int((end_s - start_s) * grid_hz * (1 + 1e-12)) + 1))
    piece_length = max(PIECE_SAMPLES // len(values), OVERLAP_SAMPLES)
    grid_start = 0
    for first_knot in range(0, sample_count - 1, piece_length):
        last_knot = min(first_knot + piece_length, sample_count - 1)
        knot_span = slice(max(first_knot - OVERLAP_SAMPLES, 0), min(last_knot + OVERLAP_SAMPLES, sample_count))
        knots_s = sample_times.stamps(knot_span.start, knot_span.stop)
        grid_end = grid_values.shape[1]
        if last_knot < sample_count - 1:
            grid_end = math.ceil((knots_s[last_knot - knot_span.start] - start_s) * grid_hz)
        spline = scipy.interpolate.CubicSpline(knots_s, values[:, knot_span], axis=1)
        grid_values[:, grid_start:grid_end] = spline(start_s + np.arange(grid_start, grid_end) / grid_hz)
        grid_start = grid_end
    return grid_values


def _filter_to_rate(samples: Float[np.ndarray, " samples"], rate_ratio: Fraction) -> Float[np.ndarray, " fewer"]:
    upsampling, downsampling = rate_ratio.numerator, rate_ratio.denominator
    filtered = scipy.signal.resample_poly(samples, upsampling, downsampling, window=("kaiser", 8.0), padtype="line")
    return np.asarray(filtered, dtype=float)


def _rate_and_fault(time_s: Float[np.ndarray, " samples"]) -> tuple[float, str]:
    """Sampling rate of time stamps (Hz), and their irregularity in words; empty if they are even."""
    if time_s.size < 2:
        raise RigError("it holds fewer than two samples; export more")
    intervals_s = np.diff(time_s)
    if not (intervals_s > 0).all():
        fault_index = int(np.argmin(intervals_s > 0))
        raise RigError(
            f"its time does not increase after {time_s[fault_index]:.6f} s (sample {fault_index}); sort or mend it"
        )
    interval_s = float(np.median(intervals_s))
    duration_s = float(time_s[-1] - time_s[0])
    gap_indices = np.flatnonzero(intervals_s > MIN_GAP_INTERVALS * interval_s)
    if gap_indices.size:
        widest = int(np.argmax(intervals_s))
        if intervals_s[widest] > MAX_BRIDGED_INTERVALS * interval_s:
            raise RigError(
                f"its time stamps have a gap of {intervals_s[widest]:.6g} s after {time_s[widest]:.6f} s; cut the "
                "record there and import the longer part"
            )
        rate_hz = float(np.divide(float(np.round(intervals_s / interval_s).sum()), duration_s))
        return rate_hz, f"its time stamps have {gap_indices.size} gaps, the first after {time_s[gap_indices[0]]:.6f} s"
    del intervals_s
    rate_hz = float(np.divide(time_s.size - 1, duration_s))
    stamp_errors = time_s - time_s[0]  # in intervals, in place: records are long
    stamp_errors *= rate_hz
    stamp_errors -= np.arange(time_s.size)
    np.abs(stamp_errors, out=stamp_errors)
    worst = int(np.argmax(stamp_errors))
    if stamp_errors[worst] > MAX_JITTER_INTERVALS:
        return rate_hz, (
            f"its time stamps are uneven, by {stamp_errors[worst]:.2g} of a sampling interval at {time_s[worst]:.6f} s"
        )
    return rate_hz, ""
