"""Clock of the samples of a file: its column of time, its rate, and what is wrong with either."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.errors import RigError
from rig.lab.clock import MAX_JITTER, RATE_TOLERANCE, SampleTimes
from rig.lab.looking.columns import SeenColumn, SeenFile
from rig.lab.looking.csv_dialect import TIME_NAME
from rig.lab.units import FACTORS, name_and_unit, plainly, quantity_of

SLOWEST_HZ = 5.0
"""Rate below which a time without unit is not taken for seconds."""


@dataclass(frozen=True)
class SeenClock:
    """Time of the samples: by a column and its unit (None: unknown), else by a rate (None: unknown).

    fault is an irregularity that resampling repairs; note says in words where the rate is from.
    """

    column: SeenColumn | None
    unit: str | None
    rate_hz: float | None
    note: str
    fault: str = ""


def clock_in(file: SeenFile, channels: Sequence[SeenColumn], rig_rate_hz: float | None) -> SeenClock:
    """Clock of a file: a column that increases evenly, or else the rate that its channels or header state."""
    samples = channels[0].samples if channels else 0
    rate_hz = next((c.rate_hz for c in channels if c.rate_hz), None)
    if rate_hz is not None:
        return SeenClock(None, None, rate_hz, f"{rate_hz:.9g} Hz by the file itself")
    stated_hz = file.rate_hz
    column = _time_column([c for c in file.columns if c.samples == samples])
    if column is None:
        note = (
            f"{stated_hz:.9g} Hz by {file.rate_origin}"
            if stated_hz
            else "the file states neither time nor sampling rate"
        )
        return SeenClock(None, None, stated_hz, note)
    unit = "s" if column.is_date else _unit_of_time(column, stated_hz or rig_rate_hz)
    unit_s = FACTORS["time"][unit or "s"]
    stamps_s = unit_s * (np.zeros(0) if column.stamps is None else column.stamps)
    label = f"column {column.name or column.number!r}"
    interval_s = float(stamps_s[-1] - stamps_s[0]) / (len(stamps_s) - 1)
    last_digit_s = column.resolution * unit_s
    deviation_s = float(np.abs(stamps_s - stamps_s[0] - interval_s * np.arange(len(stamps_s))).max())
    rounded = last_digit_s > 0 and deviation_s <= 1.01 * last_digit_s
    if column.is_date or (rounded and deviation_s > MAX_JITTER * interval_s):
        if not rounded:
            return SeenClock(None, None, None, f"{label} has dates that are not even; export the time in seconds")
        doubt = last_digit_s / (interval_s * (len(stamps_s) - 1))
        rate_hz = _rounded_rate(1 / interval_s, doubt, [r for r in (stated_hz, rig_rate_hz) if r])
        reason = "dates" if column.is_date else f"stamps written to {last_digit_s:g} s"
        return SeenClock(None, None, rate_hz, f"{rate_hz:.9g} Hz by {label}, {reason}")
    try:
        times = SampleTimes.of_stamps(stamps_s)
    except RigError as error:
        return SeenClock(column, unit, None, str(error), "its stamps cannot be repaired")
    note = f"{times.rate_hz:.6g} Hz by {label}" + ("" if unit else ", if that is in seconds")
    if column.unit is None and unit and not column.is_date:
        note += f"; the file states no unit of it, and {unit} is taken"
    if stated_hz and unit and abs(times.rate_hz / stated_hz - 1) > 10 * RATE_TOLERANCE:
        note += f"; {file.rate_origin} states {stated_hz:g} Hz"
    return SeenClock(column, unit, times.rate_hz if unit else None, note, times.fault)


def is_time(column: SeenColumn) -> bool:
    """True if the name or unit of a column is one of time."""
    return quantity_of(column.unit) == "time" or bool(TIME_NAME.search(name_and_unit(column.name, guess=True)[0]))


def _time_column(columns: Sequence[SeenColumn]) -> SeenColumn | None:
    """Column that says by name or unit that it is the time and increases; else the first that increases evenly."""
    rising = [c for c in columns if c.stamps is not None]
    named = [c for c in rising if (c.is_date or is_time(c)) and not (c.is_counter and quantity_of(c.unit) != "time")]
    if named:
        return min(named, key=lambda c: (c.is_date, quantity_of(c.unit) != "time"))
    return next((c for c in rising if c.unit is None and not c.is_counter and _is_even(c)), None)


def _is_even(column: SeenColumn) -> bool:
    steps = np.diff(column.stamps) if column.stamps is not None else np.zeros(1)
    return bool(steps.min() > 0 and np.ptp(steps) <= 1e-2 * steps.mean() + 2 * column.resolution)


def _unit_of_time(column: SeenColumn, rate_hz: float | None) -> str | None:
    """Unit of a column of time: the file's; else that by which its rate is the expected one, or is no snail's."""
    if quantity_of(column.unit) == "time":
        return plainly(column.unit or "")
    stamps = column.stamps
    if stamps is None:
        return None
    counted = (len(stamps) - 1) / float(stamps[-1] - stamps[0])
    if rate_hz:
        fitting = [u for u, factor in FACTORS["time"].items() if abs(counted / factor / rate_hz - 1) < 1e-2]
        if fitting:
            return fitting[0]
    return "s" if counted >= SLOWEST_HZ else None


def _rounded_rate(rate_hz: float, doubt: float, expected: Sequence[float]) -> float:
    """Rate within a relative doubt: an expected one, or the one of fewest digits."""
    for candidate in (*expected, *(float(f"{rate_hz:.{digits}g}") for digits in range(1, 10))):
        if abs(candidate / rate_hz - 1) <= doubt:
            return candidate
    return rate_hz
