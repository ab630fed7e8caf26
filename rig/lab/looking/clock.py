"""Clock of the samples of a file: its column of time, its rate, and what is wrong with either."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.errors import RigError
from rig.lab.clock import MAX_JITTER_INTERVALS, RATE_TOLERANCE, SampleTimes
from rig.lab.looking.columns import ColumnSummary, FileSummary
from rig.lab.looking.csv_dialect import TIME_NAME_PATTERN
from rig.lab.units import FACTORS, canonical_unit, name_and_unit, quantity_of

MIN_RATE_IN_SECONDS_HZ = 5.0
"""Rate below which a time without unit is not taken for seconds."""


@dataclass(frozen=True)
class ClockProposal:
    """Time of the samples: by a column and its unit (None: unknown), else by a rate (None: unknown).

    fault is an irregularity that resampling repairs; note says in words where the rate is from.
    """

    column: ColumnSummary | None
    unit: str | None
    rate_hz: float | None
    note: str
    fault: str = ""


def clock_in(file_summary: FileSummary, channels: Sequence[ColumnSummary], rig_rate_hz: float | None) -> ClockProposal:
    """Clock of a file: a column that increases evenly, or else the rate that its channels or header state."""
    sample_count = channels[0].sample_count if channels else 0
    rate_hz = next((channel.rate_hz for channel in channels if channel.rate_hz), None)
    if rate_hz is not None:
        return ClockProposal(None, None, rate_hz, f"{rate_hz:.9g} Hz by the file itself")
    stated_rate_hz = file_summary.rate_hz
    time_column = _time_column([column for column in file_summary.columns if column.sample_count == sample_count])
    if time_column is None:
        note = "the file states neither time nor sampling rate"
        if stated_rate_hz:
            note = f"{stated_rate_hz:.9g} Hz by {file_summary.rate_origin}"
        return ClockProposal(None, None, stated_rate_hz, note)
    unit = "s" if time_column.is_date else _unit_of_time(time_column, stated_rate_hz or rig_rate_hz)
    unit_s = FACTORS["time"][unit or "s"]
    stamps_s = unit_s * (np.zeros(0) if time_column.stamps is None else time_column.stamps)
    label = f"column {time_column.name or time_column.number!r}"
    interval_s = float(stamps_s[-1] - stamps_s[0]) / (len(stamps_s) - 1)
    last_digit_s = time_column.last_digit * unit_s
    deviation_s = float(np.abs(stamps_s - stamps_s[0] - interval_s * np.arange(len(stamps_s))).max())
    is_rounded = last_digit_s > 0 and deviation_s <= 1.01 * last_digit_s
    if time_column.is_date or (is_rounded and deviation_s > MAX_JITTER_INTERVALS * interval_s):
        if not is_rounded:
            return ClockProposal(None, None, None, f"{label} has dates that are not even; export the time in seconds")
        relative_doubt = last_digit_s / (interval_s * (len(stamps_s) - 1))
        rate_hz = _rounded_rate(1 / interval_s, relative_doubt, [hz for hz in (stated_rate_hz, rig_rate_hz) if hz])
        origin_words = "dates" if time_column.is_date else f"stamps written to {last_digit_s:g} s"
        return ClockProposal(None, None, rate_hz, f"{rate_hz:.9g} Hz by {label}, {origin_words}")
    try:
        sample_times = SampleTimes.of_stamps(stamps_s)
    except RigError as error:
        return ClockProposal(time_column, unit, None, str(error), "its stamps cannot be repaired")
    note = f"{sample_times.rate_hz:.6g} Hz by {label}" + ("" if unit else ", if that is in seconds")
    if time_column.unit is None and unit and not time_column.is_date:
        note += f"; the file states no unit of it, and {unit} is taken"
    if stated_rate_hz and unit and abs(sample_times.rate_hz / stated_rate_hz - 1) > 10 * RATE_TOLERANCE:
        note += f"; {file_summary.rate_origin} states {stated_rate_hz:g} Hz"
    return ClockProposal(time_column, unit, sample_times.rate_hz if unit else None, note, sample_times.fault)


def is_time_column(column: ColumnSummary) -> bool:
    """True if the name or unit of a column is one of time."""
    name, _ = name_and_unit(column.name, guess=True)
    return quantity_of(column.unit) == "time" or TIME_NAME_PATTERN.search(name) is not None


def _time_column(columns: Sequence[ColumnSummary]) -> ColumnSummary | None:
    """Column that says by name or unit that it is the time and increases; else the first that increases evenly."""
    ascending = [c for c in columns if c.stamps is not None and not (c.is_counter and quantity_of(c.unit) != "time")]
    time_columns = [column for column in ascending if column.is_date or is_time_column(column)]
    if time_columns:
        return min(time_columns, key=lambda column: (column.is_date, quantity_of(column.unit) != "time"))
    return next((column for column in ascending if column.unit is None and _increases_evenly(column)), None)


def _increases_evenly(column: ColumnSummary) -> bool:
    stamp_steps = np.diff(column.stamps) if column.stamps is not None else np.zeros(1)
    return bool(stamp_steps.min() > 0 and np.ptp(stamp_steps) <= 1e-2 * stamp_steps.mean() + 2 * column.last_digit)


def _unit_of_time(column: ColumnSummary, rate_hz: float | None) -> str | None:
    """Unit of a column of time: the file's; else that by which its rate is the expected one, or is no snail's."""
    if quantity_of(column.unit) == "time":
        return canonical_unit(column.unit or "")
    stamps = column.stamps
    if stamps is None:
        return None
    samples_per_unit = (len(stamps) - 1) / float(stamps[-1] - stamps[0])
    for unit, factor in FACTORS["time"].items():
        if rate_hz and abs(samples_per_unit / factor / rate_hz - 1) < 1e-2:
            return unit
    return "s" if samples_per_unit >= MIN_RATE_IN_SECONDS_HZ else None


def _rounded_rate(rate_hz: float, relative_doubt: float, expected_hz: Sequence[float]) -> float:
    """Rate within a relative doubt: an expected one, or the one of fewest digits."""
    for candidate_hz in (*expected_hz, *(float(f"{rate_hz:.{digits}g}") for digits in range(1, 10))):
        if abs(candidate_hz / rate_hz - 1) <= relative_doubt:
            return candidate_hz
    return rate_hz
