"""Clocks of the channels of a file: the column of time or the rate of each, and what is wrong with them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.errors import RigError
from rig.lab.clock import LEAST_RATE_SHARE, MAX_DECIMATION, RATE_TOLERANCE, FewDigitsError, SampleTimes, unit_doubt
from rig.lab.csv_layout import TIME_NAME_PATTERN
from rig.lab.looking.columns import ColumnSummary, FileSummary
from rig.lab.units import FACTORS, canonical_unit, name_and_unit, quantity_of

MIN_RATE_IN_SECONDS_HZ = 5.0
"""Rate below which a time without unit is not taken for seconds."""
DAY_NUMBERS = ((20_000.0, 80_000.0, "as spreadsheets count them"), (700_000.0, 800_000.0, "as MATLAB counts them"))
"""Days since 1899-12-30 of the years 1954 to 2119, and since the year 0 of 1916 to 2190."""
EPOCH_SECONDS = (5e8, 4.5e9)
"""Seconds since 1970 (or 1904) of the years since 1985."""


@dataclass(frozen=True)
class ClockProposal:
    """Times of a channel: by a column and its unit (None: unknown), else by a rate; times is None if they are unknown.

    is_by_file is true if the channel states its rate itself; note says in words where the rate is from.
    """

    column: ColumnSummary | None
    unit: str | None
    times: SampleTimes | None
    note: str
    is_by_file: bool = False

    @property
    def rate_hz(self) -> float | None:
        return None if self.times is None else self.times.rate_hz


def clocks_of(
    file_summary: FileSummary, channels: Sequence[ColumnSummary], rig_rate_hz: float | None
) -> dict[int, ClockProposal]:
    """Clock of each channel, by its number: by the column of time that it is paired with, else by a stated rate.

    Raises RigError, without the name of the file, if the stamps of a column of time cannot be repaired.
    """
    starts_s = {channel.start_s for channel in channels}
    are_starts_stated = len(starts_s) > 1 and None not in starts_s
    clocks: dict[int, ClockProposal] = {}
    proposal_by_key: dict[tuple[int, int], ClockProposal] = {}
    for channel in channels:
        time_column = paired_time_column(channel, file_summary.columns)
        is_by_file = channel.rate_hz is not None and (channel.start_s is not None or time_column is None)
        if not is_by_file and time_column is None:
            _check_no_time_begins_again(channel, file_summary)
        if is_by_file or time_column is None:
            clock = _clock_by_rate(channel, file_summary)
        else:
            key = time_column.number, channel.step if time_column.step == 1 else 1
            if key not in proposal_by_key:
                proposal_by_key[key] = _clock_by_column(time_column, key[1], file_summary, rig_rate_hz)
            clock = proposal_by_key[key]
        if clock.times is not None and are_starts_stated and channel.start_s is not None:
            clock = replace(clock, times=replace(clock.times, start_s=channel.start_s))
        clocks[channel.number] = clock
    return clocks


def is_time_column(column: ColumnSummary) -> bool:
    """True if the unit of a column is one of time, or it has none and the name is one."""
    if column.unit is not None:
        return quantity_of(column.unit) == "time"
    name, _ = name_and_unit(column.name.removeprefix(column.group).lstrip("/."), guess=True)
    return TIME_NAME_PATTERN.search(name) is not None


def paired_time_column(channel: ColumnSummary, columns: Sequence[ColumnSummary]) -> ColumnSummary | None:
    """Column of time of a channel: the nearest before it in its group, else after it, else in the group around it.

    Without any that says by name or unit that it is one, it is the first that increases evenly.
    """
    fitting = [c for c in columns if c.stamps is not None and not c.fault and c.line_count == channel.line_count]
    fitting = [c for c in fitting if not (c.is_counter and quantity_of(c.unit) != "time")]
    time_columns = [column for column in fitting if column.is_date or is_time_column(column)]
    group = channel.group
    while True:
        members = [column for column in time_columns if column.group == group]
        before = [column for column in members if column.number < channel.number]
        if members:
            return _best_of_run(before or members, columns)
        if not group:
            break
        group = group[: max(group.rfind("/"), group.rfind("."), 0)]
    if len(time_columns) == 1:
        return time_columns[0]
    if time_columns:
        return None
    return next((column for column in fitting if column.unit is None and _increases_evenly(column)), None)


def _best_of_run(time_columns: Sequence[ColumnSummary], columns: Sequence[ColumnSummary]) -> ColumnSummary:
    """Of the last times that stand side by side, the one that is no date and has a unit of time."""
    numbers = {column.number for column in time_columns}
    run = [time_columns[-1]]
    for column in reversed(time_columns[:-1]):
        between = columns[column.number : run[-1].number - 1]
        if all(c.number in numbers or c.is_date or c.fault or c.is_counter or is_time_column(c) for c in between):
            run.append(column)
        else:
            break
    return min(reversed(run), key=lambda column: (column.is_date, quantity_of(column.unit) != "time"))


def _check_no_time_begins_again(channel: ColumnSummary, file_summary: FileSummary) -> None:
    for column in file_summary.columns:
        if column.restart_sentence and column.line_count == channel.line_count and is_time_column(column):
            raise RigError(column.restart_sentence)


def _clock_by_rate(channel: ColumnSummary, file_summary: FileSummary) -> ClockProposal:
    rate_hz, note = channel.rate_hz, f"{channel.rate_hz or 0:.9g} Hz by the file itself"
    if rate_hz is None:
        rate_hz, note = file_summary.rate_hz, "the file states neither time nor sampling rate"
        if rate_hz is not None:
            note = f"{rate_hz:.9g} Hz by {file_summary.rate_origin}"
    if rate_hz is None or not 0 < rate_hz < np.inf:
        return ClockProposal(None, None, None, note)
    times = SampleTimes.of_rate(rate_hz / channel.step, max(channel.sample_count, 2), channel.start_s or 0.0)
    return ClockProposal(None, None, times, note, is_by_file=channel.rate_hz is not None)


def _clock_by_column(
    column: ColumnSummary, step: int, file_summary: FileSummary, rig_rate_hz: float | None
) -> ClockProposal:
    stated_rate_hz = file_summary.rate_hz
    expected_hz = [rate_hz for rate_hz in (stated_rate_hz, rig_rate_hz) if rate_hz]
    unit, unit_note = _unit_of_time(column, expected_hz)
    label = f"column {column.name or column.number!r}"
    if column.stamps is None:
        raise RigError(f"{label} does not increase")
    stamps = column.stamps[::step]
    if unit is None:
        times = SampleTimes.of_stamps(stamps, 1.0, column.last_digit)
        note = f"{times.rate_hz:.6g} Hz by {label}, if that is in seconds{unit_note}"
        return ClockProposal(column, None, None, note)
    try:
        times = SampleTimes.of_stamps(stamps, FACTORS["time"][unit], column.last_digit, expected_hz)
    except FewDigitsError as error:
        return ClockProposal(None, None, None, f"{label}: {error}")
    note = f"{times.rate_hz:.9g} Hz by {label}{', dates' if column.is_date else ''}{unit_note}"
    note += f"; {times.note}" if times.note else ""
    if stated_rate_hz and abs(times.rate_hz / stated_rate_hz - 1) > 10 * RATE_TOLERANCE:
        note += f"; {file_summary.rate_origin} states {stated_rate_hz:g} Hz"
    return ClockProposal(column, unit, times, note)


def _increases_evenly(column: ColumnSummary) -> bool:
    stamp_steps = np.diff(column.stamps) if column.stamps is not None else np.zeros(1)
    return bool(stamp_steps.min() > 0 and np.ptp(stamp_steps) <= 1e-2 * stamp_steps.mean() + 2 * column.last_digit)


def _unit_of_time(column: ColumnSummary, expected_hz: Sequence[float]) -> tuple[str | None, str]:
    """Unit of a column of time, and where it is from in words: the file's; else that which its numbers suggest.

    None if it is not told by the file, or if by the file's a rate is far from the expected one.
    """
    stamps = np.arange(2.0) if column.stamps is None else column.stamps
    samples_per_unit = (len(stamps) - 1) / float(stamps[-1] - stamps[0])
    rate_by_unit = {unit: samples_per_unit / unit_s for unit, unit_s in FACTORS["time"].items()}
    if column.is_date or quantity_of(column.unit) == "time":
        unit = "s" if column.is_date else canonical_unit(column.unit or "")
        if expected_hz and is_far(rate_by_unit[unit], expected_hz[-1]):
            return (
                None,
                f", and in {unit} {rate_by_unit[unit]:.6g} Hz; {unit_doubt(rate_by_unit['s'], expected_hz[-1])}",
            )
        return unit, ""
    taken = "; the file states no unit of it, and {} is taken"
    if samples_per_unit > 0 and (epoch := _unit_of_epoch(float(stamps[0]), rate_by_unit)):
        unit, origin_words = epoch
        return unit, f"; its numbers are {origin_words}"
    fitting_units = [u for hz in expected_hz for u, unit_hz in rate_by_unit.items() if abs(unit_hz / hz - 1) < 1e-2]
    if fitting_units or (samples_per_unit >= MIN_RATE_IN_SECONDS_HZ and not expected_hz):
        unit = next(iter(fitting_units), "s")
        return unit, taken.format(unit)
    if expected_hz and is_far(rate_by_unit["s"], expected_hz[-1]):
        return None, f"; {unit_doubt(rate_by_unit['s'], expected_hz[-1])}"
    return ("s", taken.format("s")) if samples_per_unit >= MIN_RATE_IN_SECONDS_HZ else (None, "")


def is_far(rate_hz: float, rig_rate_hz: float) -> bool:
    """True if a rate is so far from that of the rig that its unit is doubted first."""
    return rate_hz < LEAST_RATE_SHARE * rig_rate_hz or rate_hz > MAX_DECIMATION * rig_rate_hz


def _unit_of_epoch(first_stamp: float, rate_by_unit: Mapping[str, float]) -> tuple[str, str] | None:
    """Unit of numbers that count from a date on, and their origin in words; None if they do not."""
    for lowest, highest, origin_words in DAY_NUMBERS:
        if lowest <= first_stamp <= highest and rate_by_unit["s"] > 1e5:
            return "d", f"days {origin_words}"
    for unit in ("s", "ms", "us", "ns"):
        factor = FACTORS["time"][unit]
        if EPOCH_SECONDS[0] <= first_stamp * factor <= EPOCH_SECONDS[1]:
            return unit, f"{unit} of the time of day and date"
    return None
