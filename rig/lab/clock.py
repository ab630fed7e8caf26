"""Sampling times of measured channels: unlike or uneven ones are refused, or brought to one grid on request."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import scipy
from jaxtyping import Float, Int

from rig.errors import RigError
from rig.lab.units import FACTORS

MAX_JITTER_INTERVALS = 0.01
"""Largest deviation of a time stamp from an even grid, in sampling intervals."""
MAX_OFFSET_INTERVALS = 0.05
"""Largest deviation of the starts of two channels from a whole number of samples, and drift of their rates."""
MIN_GAP_INTERVALS = 1.5
"""Least gap between two time stamps, in intervals."""
MAX_BRIDGED_INTERVALS = 4.5
"""Longest gap that is interpolated, in intervals."""
MAX_PRESENT_SHARE = 0.75
"""Share of the places of a grid beyond which missing ones are gaps, and not values that were left out."""
MAX_RATE_DOUBT = 0.02
"""Largest relative doubt of a rate by stamps of few digits that is taken without another statement."""
RATE_TOLERANCE = 1e-4
LEAST_RATE_SHARE = 0.499
"""Least share of the rig's rate at which a record's rate is believed, and not its unit of time doubted."""
MAX_DECIMATION = 1000
"""Largest ratio of the record's rate to the rig's; beyond, its time is probably in another unit."""
LEAST_RECORD_SAMPLES = 10
"""Fewest samples after which a time that falls back begins another record."""
PASSBAND_SHARE = 0.37
"""Band, as a share of the new rate, in which the resampling filter is flat within 1e-3."""
SHIFT_HALF_TAPS = 32
"""Samples on each side by which a channel is interpolated between its own."""
PIECE_SAMPLES, OVERLAP_SAMPLES = 2**18, 64
"""Samples of all channels per spline, and extra knots at its ends, whose influence decays as 0.27^64."""


class FewDigitsError(RigError):
    """Fault of time stamps that have too few digits to tell the sampling rate."""


@dataclass(frozen=True)
class SampleTimes:
    """Times of a channel's samples; stamps_s, s since the first one, is None if they are known to be even.

    start_s is the time of the first sample. fault describes an irregularity of the stamps in words, and note what was
    taken of stamps with too few digits; both are empty if there is none.
    """

    sample_count: int
    rate_hz: float
    stamps_s: Float[np.ndarray, " samples"] | None = None
    fault: str = ""
    start_s: float = 0.0
    note: str = ""

    @classmethod
    def of_rate(cls, rate_hz: float, sample_count: int, start_s: float = 0.0) -> "SampleTimes":
        if sample_count < 2:
            raise RigError("it holds fewer than two samples; export more")
        return cls(sample_count, rate_hz, start_s=start_s)

    @classmethod
    def of_stamps(
        cls,
        stamps: Float[np.ndarray, " samples"],
        unit_s: float = 1.0,
        last_digit: float = 0.0,
        expected_hz: Sequence[float] = (),
    ) -> "SampleTimes":
        """Times by stamps in units of unit_s, written to last_digit (0: binary numbers).

        Stamps that are even to their last digit are taken for even; of the rates that they leave possible, it is the
        first of expected_hz. Raises RigError if they do not increase, have a long gap, or too few digits.
        """
        if stamps.size < 2:
            raise RigError("it holds fewer than two samples; export more")
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            elapsed_s = (stamps - stamps[0]) * unit_s
            digits_s = (last_digit + _binary_digits(stamps, last_digit)) * abs(unit_s)
            times = _even_to_the_last_digit(elapsed_s, digits_s, expected_hz)
            if times is None:
                rate_hz, stamp_fault = _rate_and_fault(elapsed_s, stamps[0] * unit_s)
                times = cls(stamps.size, rate_hz, elapsed_s, stamp_fault)
        return replace(times, start_s=float(stamps[0] * unit_s) + times.start_s)

    @property
    def end_s(self) -> float:
        """Time of the last sample, s."""
        if self.stamps_s is not None:
            return self.start_s + float(self.stamps_s[-1])
        return self.start_s + (self.sample_count - 1) / self.rate_hz

    def stamps(self, first_sample: int, end_sample: int) -> Float[np.ndarray, " some"]:
        """Time stamps of the samples first_sample to end_sample - 1, s since the first one."""
        if self.stamps_s is None:
            return np.arange(first_sample, end_sample) / self.rate_hz
        return self.stamps_s[first_sample:end_sample]

    def is_same_as(self, other: "SampleTimes") -> bool:
        """True if both are the same times."""
        if (self.sample_count, self.rate_hz, self.start_s) != (other.sample_count, other.rate_hz, other.start_s):
            return False
        if self.stamps_s is None or other.stamps_s is None:
            return self.stamps_s is other.stamps_s
        return np.array_equal(self.stamps_s, other.stamps_s)


@dataclass(frozen=True)
class TimedChannels:
    """Channels sampled at the same times, and the label (their column) by which a sentence names them."""

    label: str
    names: tuple[str, ...]
    values: Float[np.ndarray, "channels samples"]
    times: SampleTimes


def samples_on_one_clock(
    groups: Sequence[TimedChannels], rate_hz: float, resample: bool
) -> tuple[dict[str, Float[np.ndarray, " evenly"]], tuple[str, ...]]:
    """Samples of all channels at the times k / rate_hz after the latest start, and the processing steps in words.

    Channels that begin a whole number of samples apart are cut to the time that they share; others are interpolated
    and resampled, as `even_samples_and_steps` does, if `resample` is true. Raises RigError, without the name of the
    file, if they are not on one grid and it is not, if they share no time, and for a channel below rate_hz.
    """
    if len(groups) == 1:
        values, steps = even_samples_and_steps(groups[0].values, groups[0].times, rate_hz, resample)
        return dict(zip(groups[0].names, values, strict=True)), steps
    start_s, end_s = max(group.times.start_s for group in groups), min(group.times.end_s for group in groups)
    if not end_s > start_s:
        raise RigError(f"its channels share no time: {_time_words(groups)}; export them over the same time")
    slowest = min(groups, key=lambda group: group.times.rate_hz)
    if slowest.times.rate_hz < rate_hz * (1 - RATE_TOLERANCE):
        slow_hz = slowest.times.rate_hz
        remedy = "leave that channel out"
        if slow_hz >= LEAST_RATE_SHARE * rate_hz:
            remedy += (
                f", or give rig.json sample_rate_hz {slow_hz:.9g} and the map resample = true, which brings all to it"
            )
        raise RigError(
            f"{_time_words(groups)}: nothing is known of {slowest.label} above {slow_hz / 2:.6g} Hz, and "
            f"sample_rate_hz of the rig is {rate_hz:g}; {remedy}"
        )
    if are_on_one_grid([group.times for group in groups]):
        return _cut_to_common_time(groups, start_s, rate_hz, resample)
    if not resample:
        raise RigError(
            f"its channels are not sampled at the same times: {_time_words(groups)}; set resample = true in the map to "
            "bring them to one grid, or export them over the same time"
        )
    rows_by_name: dict[str, Float[np.ndarray, " evenly"]] = {}
    resampling_steps: list[str] = []
    for group in groups:
        values, times, steps = _even_from(group, start_s)
        values, rate_steps = even_samples_and_steps(values, times, rate_hz, resample)
        rows_by_name |= zip(group.names, values, strict=True)
        resampling_steps += [f"{group.label}: {step}" for step in (*steps, *rate_steps)]
    sample_count = min(row.size for row in rows_by_name.values())
    return {name: row[:sample_count] for name, row in rows_by_name.items()}, (
        f"brought to one grid from {start_s:.9g} s, since {_time_words(groups)}",
        *resampling_steps,
        f"all channels are flat within 1e-3 up to {PASSBAND_SHARE * rate_hz:.6g} Hz, and differ above",
    )


def _time_words(groups: Sequence[TimedChannels]) -> str:
    return times_in_words([(group.label, group.times) for group in groups])


def times_in_words(labels_and_times: Sequence[tuple[str, SampleTimes]]) -> str:
    """Rates and times in words; times count from the first start where the clock is that of the day."""
    zero_s = min(times.start_s for _, times in labels_and_times)
    zero_s = zero_s if abs(zero_s) > 1e5 else 0.0
    spans_s = [(times.start_s - zero_s, times.end_s - zero_s) for _, times in labels_and_times]
    return " and ".join(
        f"{label} is sampled at {times.rate_hz:.9g} Hz from {first_s:.9g} to {last_s:.9g} s"
        for (label, times), (first_s, last_s) in zip(labels_and_times, spans_s, strict=True)
    )


def are_on_one_grid(sample_times: Sequence[SampleTimes]) -> bool:
    """True if all times are even, at one rate, and begin a whole number of samples apart."""
    first = sample_times[0]
    for times in sample_times:
        drift = abs(times.rate_hz / first.rate_hz - 1) * max(times.sample_count, first.sample_count)
        offset = (times.start_s - first.start_s) * first.rate_hz
        if times.fault or drift > MAX_OFFSET_INTERVALS or abs(offset - round(offset)) > MAX_OFFSET_INTERVALS:
            return False
    return True


def _cut_to_common_time(
    groups: Sequence[TimedChannels], start_s: float, rate_hz: float, resample: bool
) -> tuple[dict[str, Float[np.ndarray, " evenly"]], tuple[str, ...]]:
    record_rate_hz = groups[0].times.rate_hz
    first_samples = [round((start_s - group.times.start_s) * record_rate_hz) for group in groups]
    sample_count = min(g.times.sample_count - first for g, first in zip(groups, first_samples, strict=True))
    if sample_count < 2:
        raise RigError(f"its channels share fewer than two samples: {_time_words(groups)}; export more")
    rows = [g.values[:, first : first + sample_count] for g, first in zip(groups, first_samples, strict=True)]
    cuts = []
    for group, first in zip(groups, first_samples, strict=True):
        surplus_counts = {"beginning": first, "end": group.times.sample_count - first - sample_count}
        cuts += [f"{count} samples at the {place} of {group.label}" for place, count in surplus_counts.items() if count]
    times = SampleTimes.of_rate(record_rate_hz, sample_count, start_s)
    values, steps = even_samples_and_steps(np.concatenate(rows), times, rate_hz, resample)
    names = [name for group in groups for name in group.names]
    cut_step = (
        f"cut to the time that all share, {sample_count} samples: {_time_words(groups)}; left out: {', '.join(cuts)}"
    )
    return dict(zip(names, values, strict=True)), ((cut_step, *steps) if cuts else steps)


def _even_from(
    group: TimedChannels, start_s: float
) -> tuple[Float[np.ndarray, "channels samples"], SampleTimes, tuple[str, ...]]:
    """Samples of a group at its own rate from a time on, interpolated between its own samples."""
    values, times, steps = group.values, group.times, []
    if times.fault:
        values = _resample_to_grid(values, times, times.rate_hz)
        steps.append(f"resampled to an even {times.rate_hz:.9g} Hz by a cubic spline, since {times.fault}")
    offset = (start_s - times.start_s) * times.rate_hz
    first_sample = math.floor(offset + MAX_JITTER_INTERVALS)
    part = offset - first_sample
    if abs(part) > MAX_JITTER_INTERVALS:
        values = np.stack([_shifted(row, part) for row in values])
        band_hz = 0.45 * times.rate_hz
        steps.append(f"shifted by {part:.4g} of a sample by a windowed sinc, right within 1e-3 up to {band_hz:.6g} Hz")
    values = values[:, first_sample:]
    return values, SampleTimes.of_rate(times.rate_hz, values.shape[1], start_s), tuple(steps)


def _shifted(samples: Float[np.ndarray, " samples"], part: float) -> Float[np.ndarray, " fewer"]:
    """Values at a part of a sample behind each sample, without the last one."""
    offsets = np.arange(-SHIFT_HALF_TAPS, SHIFT_HALF_TAPS + 1) + part
    window = np.i0(8.0 * np.sqrt(np.maximum(0.0, 1 - (offsets / (SHIFT_HALF_TAPS + 1)) ** 2))) / np.i0(8.0)
    taps = np.sinc(offsets) * window
    padded = np.pad(samples, SHIFT_HALF_TAPS, mode="reflect" if samples.size > SHIFT_HALF_TAPS else "edge")
    return np.asarray(scipy.signal.oaconvolve(padded, taps, mode="valid"))[:-1]


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
        remedy = (
            "correct rig.json" if record_rate_hz >= LEAST_RATE_SHARE * rate_hz else unit_doubt(record_rate_hz, rate_hz)
        )
        raise RigError(
            f"it is sampled at {record_rate_hz:.6g} Hz, below sample_rate_hz {rate_hz:g} of the rig; {remedy}"
        )
    if record_rate_hz > MAX_DECIMATION * rate_hz:
        raise RigError(
            f"it is sampled at {record_rate_hz:.6g} Hz, over {MAX_DECIMATION} times sample_rate_hz {rate_hz:g} of the "
            "rig; correct the unit or scale of its time, or rig.json"
        )
    if is_other_rate and not resample:
        advice = "correct rig.json, or " if record_rate_hz <= 2 * rate_hz else ""
        raise RigError(
            f"it is sampled at {record_rate_hz:.6g} Hz, sample_rate_hz of the rig is {rate_hz:g}; {advice}"
            "set resample = true in the map"
        )
    rate_ratio = Fraction(rate_hz / record_rate_hz).limit_denominator(MAX_DECIMATION) if is_other_rate else Fraction(1)
    grid_rate_hz = rate_hz / float(rate_ratio)
    processing_steps = [sample_times.note] if sample_times.note else []
    if stamp_fault or abs(grid_rate_hz / record_rate_hz - 1) > RATE_TOLERANCE:
        values = _resample_to_grid(values, sample_times, grid_rate_hz)
        grid_reason = stamp_fault or "the rate is uneven"
        processing_steps.append(f"resampled to an even {grid_rate_hz:.9g} Hz by a cubic spline, since {grid_reason}")
    if rate_ratio != 1:
        values = np.stack([_filter_to_rate(channel_values, rate_ratio) for channel_values in values])
        processing_steps.append(f"resampled from {grid_rate_hz:.9g} to {rate_hz:.9g} Hz by a linear-phase filter")
    return values, tuple(processing_steps)


def unit_doubt(record_rate_hz: float, rate_hz: float) -> str:
    """Advice, in words, where a rate is far from that of the rig: the unit of time is doubted first."""
    for unit, unit_s in FACTORS["time"].items():
        if unit != "s" and abs(record_rate_hz / unit_s / rate_hz - 1) < 1e-2:
            return f"check the unit of its time: in {unit} it would be {record_rate_hz / unit_s:.6g} Hz"
    return "check the unit of its time, or the rate given in the map"


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


def restart_samples(stamps: Float[np.ndarray, " samples"]) -> Int[np.ndarray, " restarts"]:
    """Samples at which a time falls back by more than half of what has passed; none if it also decreases otherwise."""
    drops = np.flatnonzero(np.diff(stamps) < 0) + 1
    starts = np.concatenate([[0], drops[:-1]]).astype(int) if drops.size else drops
    passed = stamps[drops - 1] - stamps[starts]
    is_restart = (stamps[drops - 1] - stamps[drops] > 0.5 * passed) & (drops - starts >= LEAST_RECORD_SAMPLES)
    return drops if is_restart.all() else drops[:0]


def restart_sentence(elapsed: Float[np.ndarray, " samples"], start: float) -> str:
    """Sentence that a time begins again; empty if it does not."""
    restarts = restart_samples(elapsed)
    if not restarts.size:
        return ""
    return (
        f"its time begins again after {start + elapsed[restarts[0] - 1]:.6f} (sample {restarts[0] - 1}): "
        f"{restarts.size + 1} records follow one another; export each to a file of its own, or take the first of a "
        f"text by csv = {{ sample_lines = {restarts[0]} }} in the map"
    )


def _binary_digits(stamps: Float[np.ndarray, " samples"], last_digit: float) -> Float[np.ndarray, " samples"]:
    """Value of the last binary digit of each stamp: in single precision if all can be of it, else in double."""
    singles = stamps.astype(np.float32)
    is_single = bool(np.isfinite(singles).all() and (np.abs(stamps - singles) <= 0.51 * last_digit).all())
    return np.abs(np.spacing(singles if is_single else stamps)).astype(float)


def _even_to_the_last_digit(
    elapsed_s: Float[np.ndarray, " samples"], digits_s: Float[np.ndarray, " samples"], expected_hz: Sequence[float]
) -> SampleTimes | None:
    """Even times if stamps are those of an even grid but for their last digits, or of steps that are; else None.

    Raises RigError if too few digits are left to tell the rate.
    """
    interval_count, digit_s, duration_s = elapsed_s.size - 1, float(digits_s.max()), float(elapsed_s[-1])
    if not 0 < duration_s < np.inf:
        return None
    interval_s = duration_s / interval_count
    deviations_s = elapsed_s - interval_s * np.arange(elapsed_s.size)
    if np.abs(deviations_s).max() <= 1.01 * digit_s and not _has_lost_steps(elapsed_s, digit_s, interval_s):
        is_fine = bool(np.abs(deviations_s).max() <= MAX_JITTER_INTERVALS * interval_s)
        doubt_s = min(digit_s, MAX_JITTER_INTERVALS * interval_s) if is_fine else digit_s
        if _are_steps_added_up(elapsed_s, digit_s, interval_s, expected_hz):
            is_fine, doubt_s = False, min(digit_s, 0.3 * interval_s) * interval_count
        rates_hz = (interval_count / (duration_s + doubt_s), interval_count / max(duration_s - doubt_s, 1e-300))
        rate_hz, note = _rate_between(*rates_hz, 1 / interval_s, expected_hz)
        note = "" if is_fine else note
        start_s = float(np.mean(elapsed_s - np.arange(elapsed_s.size) / rate_hz))
        return SampleTimes(elapsed_s.size, rate_hz, note=note, start_s=start_s if note else 0.0)
    steps_s = np.diff(elapsed_s)
    step_digits_s = 1.01 * digits_s[1:]
    shortest_s, longest_s = float((steps_s - step_digits_s).max()), float((steps_s + step_digits_s).min())
    if digit_s > 0.3 * interval_s or not 0 < shortest_s <= longest_s:
        return None
    rate_hz, note = _rate_between(1 / longest_s, 1 / shortest_s, 2 / (shortest_s + longest_s), expected_hz)
    return SampleTimes(elapsed_s.size, rate_hz, note=f"{note}: each step of its stamps is the same to its last digit")


def _are_steps_added_up(
    elapsed_s: Float[np.ndarray, " samples"], digit_s: float, interval_s: float, expected_hz: Sequence[float]
) -> bool:
    """True if all steps are one number of last digits, of which each may be wrong by one.

    Raises FewDigitsError if the rate that they make is as plausible as another that is expected.
    """
    if digit_s <= RATE_TOLERANCE * interval_s or float(np.ptp(np.diff(elapsed_s))) > 0.1 * digit_s:
        return False
    rate_hz = 1 / interval_s
    if abs(float(f"{rate_hz:.5g}") / rate_hz - 1) > 2e-6:
        return True
    lowest_hz, highest_hz = 1 / (interval_s + digit_s), 1 / max(interval_s - digit_s, 0.5 * interval_s)
    if any(abs(hz / rate_hz - 1) > RATE_TOLERANCE and lowest_hz <= hz <= highest_hz for hz in expected_hz):
        raise _few_digits_error(lowest_hz, highest_hz)
    return False


def _has_lost_steps(elapsed_s: Float[np.ndarray, " samples"], digit_s: float, interval_s: float) -> bool:
    """True if a few steps among many equal ones are longer, as where samples are lost."""
    if digit_s < 0.3 * interval_s:
        return False
    steps_s = np.diff(elapsed_s)
    odd_share = float((np.abs(steps_s - np.median(steps_s)) > 0.5 * digit_s).mean())
    return 0 < odd_share < 0.01


def _rate_between(
    lowest_hz: float, highest_hz: float, rate_hz: float, expected_hz: Sequence[float]
) -> tuple[float, str]:
    """Rate between two: the first expected one, or the one of fewest digits; and what was taken, in words."""
    note = f"{{:.9g}} Hz taken of stamps with few digits, by which it is {lowest_hz:.9g} to {highest_hz:.9g} Hz"
    for candidate_hz in expected_hz:
        if lowest_hz <= candidate_hz <= highest_hz:
            return candidate_hz, note.format(candidate_hz)
    if highest_hz - lowest_hz > MAX_RATE_DOUBT * rate_hz:
        raise _few_digits_error(lowest_hz, highest_hz)
    for candidate_hz in (float(f"{rate_hz:.{digits}g}") for digits in range(1, 10)):
        if lowest_hz <= candidate_hz <= highest_hz:
            return candidate_hz, note.format(candidate_hz)
    return rate_hz, note.format(rate_hz)


def _few_digits_error(lowest_hz: float, highest_hz: float) -> FewDigitsError:
    return FewDigitsError(
        f"its time stamps have too few digits: by them it is sampled at {lowest_hz:.4g} to {highest_hz:.4g} Hz; give "
        "sample_rate_hz in the map in place of time"
    )


def _rate_and_fault(elapsed_s: Float[np.ndarray, " samples"], start_s: float) -> tuple[float, str]:
    """Sampling rate of time stamps (Hz), and their irregularity in words; empty if they are even."""
    intervals_s = np.diff(elapsed_s)
    if not (intervals_s > 0).all():
        fault_index = int(np.argmin(intervals_s > 0))
        if sentence := restart_sentence(elapsed_s, start_s):
            raise RigError(sentence)
        raise RigError(
            f"its time does not increase after {start_s + elapsed_s[fault_index]:.6f} s (sample {fault_index}); sort "
            "or mend it"
        )
    interval_s = float(np.median(intervals_s))
    duration_s = float(elapsed_s[-1])
    gap_indices = np.flatnonzero(intervals_s > MIN_GAP_INTERVALS * interval_s)
    if gap_indices.size:
        _check_unchanged_are_exported(intervals_s)
        widest = int(np.argmax(intervals_s))
        widest_s = start_s + elapsed_s[widest]
        if intervals_s[widest] > MAX_BRIDGED_INTERVALS * interval_s:
            raise RigError(
                f"its time stamps have a gap of {intervals_s[widest]:.6g} s after {widest_s:.6f} s; cut "
                "the record there and import the longer part"
            )
        rate_hz = float(np.divide(float(np.round(intervals_s / interval_s).sum()), duration_s))
        first_gap_s = start_s + elapsed_s[gap_indices[0]]
        return rate_hz, f"its time stamps have {gap_indices.size} gaps, the first after {first_gap_s:.6f} s"
    del intervals_s
    rate_hz = float(np.divide(elapsed_s.size - 1, duration_s))
    stamp_errors = elapsed_s * rate_hz  # in intervals, in place: records are long
    stamp_errors -= np.arange(elapsed_s.size)
    np.abs(stamp_errors, out=stamp_errors)
    worst = int(np.argmax(stamp_errors))
    if stamp_errors[worst] > MAX_JITTER_INTERVALS:
        worst_s = start_s + elapsed_s[worst]
        return rate_hz, (
            f"its time stamps are uneven, by {stamp_errors[worst]:.2g} of a sampling interval at {worst_s:.6f} s"
        )
    return rate_hz, ""


def _check_unchanged_are_exported(intervals_s: Float[np.ndarray, " steps"]) -> None:
    """Raise RigError if samples lack all over a grid on which the others lie."""
    step_s = float(intervals_s[intervals_s < MIN_GAP_INTERVALS * intervals_s.min()].mean())
    place_counts = np.round(intervals_s / step_s)
    step_s = float(intervals_s.sum() / place_counts.sum())
    place_counts = np.round(intervals_s / step_s)
    is_on_grid = np.abs(intervals_s / step_s - np.round(intervals_s / step_s)) < 0.2
    place_count = int(place_counts.sum()) + 1
    quarters = np.array_split(place_counts > 1, 4)
    is_all_over = min(float(quarter.mean()) if quarter.size else 0.0 for quarter in quarters) > 0.02
    if is_on_grid.mean() > 0.98 and is_all_over and intervals_s.size + 1 < MAX_PRESENT_SHARE * place_count:
        raise RigError(
            f"its time stamps are {intervals_s.size + 1} of {place_count} places of a grid of {step_s:.6g} s, with "
            "gaps all over the record: samples that did not change were probably not exported; export every sample"
        )
