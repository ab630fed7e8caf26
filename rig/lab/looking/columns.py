"""Columns of a file as a look shows them: name, unit, range, and what keeps one from being a measured channel."""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.lab.clock import restart_sentence
from rig.lab.column import Blocks, Column, Refused, UnreadableError, missing_row, repetition_count
from rig.lab.csv_text import TextForm
from rig.limits import MAX_ITEMS, MAX_NUMBER


@dataclass(frozen=True)
class ColumnSummary:
    """A column: its number from 1, and its name, unit, rate, start, date and label as the file has them.

    group is the path of the struct or group that it is in. Its sample_count numbers stand in every step-th of
    line_count lines. stamps are its values if they never decrease, in its unit, or in seconds if they are dates;
    last_digit is the last digit written of them. repeat_count is how many times each value is repeated. fault says in
    words why no channel can be made of it; empty if one can.
    """

    number: int
    name: str
    unit: str | None
    sample_count: int
    line_count: int
    lowest: float
    highest: float
    distinct_count: int
    """Different values, counted to three."""
    rate_hz: float | None = None
    start_s: float | None = None
    date_text: str = ""
    label: str = ""
    group: str = ""
    step: int = 1
    repeat_count: int = 1
    restart_sentence: str = ""
    """That it is a time which begins again, if it is a time; empty if it does not."""
    stamps: Float[np.ndarray, " samples"] | None = None
    last_digit: float = 0.0
    is_date: bool = False
    fault: str = ""

    @property
    def is_counter(self) -> bool:
        """True if the values are 0, 1, 2, ... or 1, 2, 3, ..."""
        stamps = self.stamps
        return stamps is not None and stamps[0] in (0, 1) and bool((np.diff(stamps) == 1).all())


@dataclass(frozen=True)
class FileSummary:
    """A file: its columns, its form if it is text, what was seen in words, and the rate that its header states."""

    path: Path
    columns: tuple[ColumnSummary, ...]
    facts: tuple[str, ...] = ()
    form: TextForm = field(default_factory=TextForm)
    rate_hz: float | None = None
    rate_origin: str = "the header"


def column_summary(
    column_number: int, column: Column, is_date: bool = False, fault: str = "", group: str = ""
) -> ColumnSummary:
    """Column with its range and, if they never decrease, its values."""
    values, step = column.values, 1
    if values.size and missing_row(values) is None:
        filled_rows = np.flatnonzero(np.isfinite(values))
        step = int(filled_rows[1] - filled_rows[0]) if filled_rows.size > 1 else 1
        values = values[filled_rows] if step > 1 else values
    numbers = values[np.isfinite(values)]
    if not fault and numbers.size and np.abs(numbers).max() > MAX_NUMBER:
        overload = numbers[np.argmax(np.abs(numbers))]
        fault = f"it is {overload:g} at sample {int(np.argmax(np.abs(values) > MAX_NUMBER))}, which nothing measures"
    if not fault and not numbers.size and values.size:
        fault = "it has no numbers"
    elif not fault and numbers.size < values.size:
        fault = f"it has no finite number at sample {int(np.argmin(np.isfinite(values)))}"
    is_increasing = not fault and values.size > 1 and values[-1] > values[0] and bool((np.diff(values) >= 0).all())
    lowest, highest = (float(numbers.min()), float(numbers.max())) if numbers.size else (np.nan, np.nan)
    distinct_count = 1 + (highest > lowest) + bool(((numbers > lowest) & (numbers < highest)).any())
    return ColumnSummary(
        number=column_number,
        name=column.name,
        unit=column.unit,
        sample_count=values.size,
        line_count=column.values.size,
        lowest=lowest,
        highest=highest,
        distinct_count=distinct_count,
        rate_hz=column.sample_rate_hz,
        start_s=column.start_s,
        date_text=column.date_text,
        label=column.label,
        group=group,
        step=step,
        repeat_count=1 if fault else repetition_count(values),
        restart_sentence="" if fault or is_increasing else restart_sentence(values, 0.0),
        stamps=values if is_increasing else None,
        last_digit=column.last_digit,
        is_date=is_date,
        fault=fault,
    )


def summary_of_blocks(path: Path, blocks: Blocks) -> FileSummary:
    """Columns of any format but CSV, decoded one by one."""
    columns: list[ColumnSummary] = []
    facts: list[str] = []
    for block in blocks:
        if isinstance(block, Refused):
            facts.append(f"left out: {block.sentence}")
            continue
        facts += [note for note in block.notes if note not in facts]
        for column_index in range(len(block.names)):
            (column,) = block.read([column_index])
            columns.append(column_summary(len(columns) + 1, column, group=_group_of(block.names[column_index])))
            if len(columns) > MAX_ITEMS:
                raise UnreadableError(f"it has more than {MAX_ITEMS} columns")
    return FileSummary(path, tuple(columns), tuple(facts))


def _group_of(name: str) -> str:
    """Path of the group or struct that a column is in, by its name: run of run/acc and run.acc, of run[2] too."""
    return re.sub(r"(^|[/.])[^/.]*$", "", name) or name.partition("[")[0] * ("[" in name)
