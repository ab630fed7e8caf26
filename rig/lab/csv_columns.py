"""Columns of a CSV file of known layout: numbers, dates as seconds, and the first word that is neither."""

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from rig.errors import RigError
from rig.lab.column import Blocks, Column, ColumnBlock, missing_row
from rig.lab.csv_layout import Layout, layout_of
from rig.lab.csv_text import (
    LINES_PER_BLOCK,
    TextForm,
    cell_kind_letters,
    cells_of,
    finite_number_or_none,
    is_number,
    sample_lines,
)
from rig.lab.units import quantity_of
from rig.limits import MAX_NUMBER

LINES_FOR_DIGITS = 200
"""Last cells by which it is known how finely numbers are written; at the end a time has its fewest places."""
_HALF_OF_DAY = re.compile(r"\s*([AaPp])\.?[Mm]\.?$")
DAY_S = 86400.0
TIME_OF_DAY_YEAR = 1970
"""Year of a time of day without a date."""


@dataclass(frozen=True)
class Word:
    """Cell of a column that is no number that anything measures: its line, text and row among the samples."""

    row: int
    line_number: int
    text: str
    reason: str

    def sentence(self, name: str) -> str:
        return f"line {self.line_number} has {self.text[:50]!r} in column {name!r}, {self.reason}"


@dataclass(frozen=True)
class TextColumn:
    """Numbers of a column, NaN where a line has none; its unit is s and word None if it is one of dates."""

    values: Float[np.ndarray, " lines"]
    word: Word | None
    last_digit: float
    is_date: bool

    @property
    def end(self) -> int:
        """Row behind the last number."""
        is_filled = np.isfinite(self.values)
        return int(is_filled.size - is_filled[::-1].argmax()) if is_filled.any() else 0


def csv_blocks(path: Path, form: TextForm) -> Blocks:
    """Single block of all columns with names and values.

    Raises RigError if the file is not text in the encoding, its lines do not have equally many cells, or several
    records follow one another.
    """
    layout = layout_of(path, form)
    if layout.ragged_sentence and not form.cut_incomplete_end:
        raise RigError(f"{path}: {layout.ragged_sentence}; check delimiter")
    if layout.several_sentence:
        raise RigError(
            f"{path}: {layout.several_sentence}; csv = {{ sample_lines = {layout.record_lines} }} in the map takes the "
            f"first, sample_lines = {layout.line_count} all as one record"
        )

    def read(indices: Sequence[int]) -> list[Column]:
        line_numbers, text_columns = read_text_columns(layout, indices)
        for index, text_column in zip(indices, text_columns, strict=True):
            _check_column(layout, layout.names[index], text_column, line_numbers, text_columns)
        return [
            column_of(layout, index, text_column, text_column.values[: text_column.end])
            for index, text_column in zip(indices, text_columns, strict=True)
        ]

    yield ColumnBlock(layout.names, layout.line_count, read, notes=layout.notes)


def column_of(layout: Layout, column_index: int, text_column: TextColumn, values: Float[np.ndarray, " rows"]) -> Column:
    """Column with these values of it, its unit if that is one of a quantity, and its rate and start if stated."""
    unit = "s" if text_column.is_date else layout.unit(column_index)
    return Column(
        name=layout.names[column_index],
        values=values,
        unit=unit if quantity_of(unit) else None,
        sample_rate_hz=layout.rate_hz_by_column.get(column_index),
        start_s=layout.start_s_by_column.get(column_index),
        last_digit=text_column.last_digit,
    )


def read_text_columns(
    layout: Layout, indices: Sequence[int]
) -> tuple[Int[np.ndarray, " lines"], tuple[TextColumn, ...]]:
    """Numbers of all lines of samples, and the columns with these indices."""
    form = layout.form
    line_numbers = np.zeros(layout.line_count, dtype=np.int64)
    values = np.full((len(indices), layout.line_count), np.nan)
    words: dict[int, Word] = {}
    dates = _DateColumns(layout, indices)
    last_cells = [deque[str](maxlen=LINES_FOR_DIGITS) for _ in indices]
    numbered_lines = sample_lines(layout.path, form, layout.first_line - 1)
    first_row = 0
    while batch := list(islice(numbered_lines, LINES_PER_BLOCK)):
        rows = slice(first_row, first_row + len(batch))
        line_numbers[rows] = [line_number for line_number, _ in batch]
        table = None if dates.places else _number_table([line for _, line in batch], form, indices)
        if table is not None:
            values[:, rows] = table.T
            for cells in (cells_of(line, form.delimiter) for _, line in batch[-LINES_FOR_DIGITS:]):
                for place, index in enumerate(indices):
                    last_cells[place].append(cells[index].strip())
        else:
            for row, (line_number, line) in enumerate(batch, start=first_row):
                cells = cells_of(line, form.delimiter)
                for place, index in enumerate(indices):
                    cell = cells[index].strip() if index < len(cells) else ""
                    if cell:
                        last_cells[place].append(cell)
                    if place in dates.places:
                        values[place, row] = dates.seconds(place, cell)
                        continue
                    number = finite_number_or_none(cell, form.decimal)
                    if number is not None and abs(number) <= MAX_NUMBER:
                        values[place, row] = number
                    elif place not in words and cell and cell.lower() not in ("nan", "-nan"):
                        words[place] = Word(row, line_number, cell, _reason(cell, form.decimal))
        first_row = rows.stop
    digits = [
        min((_last_digit_value(cell, form.decimal, place in dates.places) for cell in cells), default=0.0)
        for place, cells in enumerate(last_cells)
    ]
    for place in dates.places:
        values[place] = dates.over_midnight(place, values[place])
    columns = (TextColumn(row, words.get(k), digits[k], k in dates.places) for k, row in enumerate(values))
    return line_numbers, tuple(columns)


def _check_column(
    layout: Layout,
    name: str,
    column: TextColumn,
    line_numbers: Int[np.ndarray, " lines"],
    columns: Sequence[TextColumn],
) -> None:
    """Raise RigError at a word, or a line without a number, unless the end is to be cut and it stands there."""
    is_end_cut = layout.form.cut_incomplete_end
    if column.word is not None and (not is_end_cut or column.word.row < column.end):
        raise RigError(
            f"{layout.path}: {column.word.sentence(name)}; repair the record or leave that channel out, and check "
            "encoding, delimiter, decimal and the lines skipped"
        )
    if not column.end and is_end_cut:
        raise RigError(f"{layout.path}: has no line with numbers in all columns of the map; check its columns")
    row = missing_row(column.values[: column.end]) if column.end else 0
    if row is None:
        return
    if is_end_cut:
        is_whole = np.logical_and.reduce([np.isfinite(other.values) for other in columns])
        following_rows = np.flatnonzero(is_whole[row:])
        whole_line = line_numbers[row + following_rows[0]] if following_rows.size else line_numbers[column.end - 1]
        raise RigError(
            f"{layout.path}: line {line_numbers[row]} lacks a number, and line {whole_line} has them all: not only the "
            "end is incomplete; repair the record or cut it there"
        )
    raise RigError(
        f"{layout.path}: {missing_sentence(layout, name, int(line_numbers[row]), row)}; check encoding, delimiter, "
        "decimal and the lines skipped"
    )


def missing_sentence(layout: Layout, name: str, line_number: int, row: int) -> str:
    """Which line has no number in a column, and what stands there."""
    _, line = next(islice(sample_lines(layout.path, layout.form, layout.first_line - 1), row, None))
    index = layout.names.index(name)
    cells = cells_of(line, layout.form.delimiter)
    cell = cells[index].strip() if index < len(cells) else ""
    return Word(row, line_number, cell, "which is no number").sentence(name)


def _reason(cell: str, decimal: str) -> str:
    number = finite_number_or_none(cell, decimal)
    if number is not None:
        return "which nothing measures: a mark of overload, perhaps"
    if decimal != "." and "." in cell and is_number(cell.replace(".", ""), decimal):
        return f"and the decimal is {decimal!r}; export numbers without points, or correct decimal in the map"
    return "which is no number"


def _number_table(
    lines: list[str], form: TextForm, indices: Sequence[int]
) -> Float[np.ndarray, "lines columns"] | None:
    """Table of lines that hold measured numbers in these columns, converted at once; None if any does not."""
    if form.decimal != ".":
        if any("." in line for line in lines):
            return None
        lines = [line.replace(form.decimal, ".") for line in lines]
    delimiter = None if form.delimiter == " " else form.delimiter
    try:
        table = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None, quotechar='"', usecols=indices)
    except ValueError:
        return None
    return table if len(table) == len(lines) and (np.abs(table) <= MAX_NUMBER).all() else None


class _DateColumns:
    """Columns whose first cell is a date or a time of day, by their places among those that are read."""

    def __init__(self, layout: Layout, indices: Sequence[int]) -> None:
        first_lines = sample_lines(layout.path, layout.form, layout.first_line - 1)
        _, line = next(first_lines, (0, ""))
        cells = cells_of(line, layout.form.delimiter)
        first_cells = [cells[index] if index < len(cells) else "" for index in indices]
        kinds = cell_kind_letters(first_cells, layout.form.decimal)
        self.places = {place for place, kind in enumerate(kinds) if kind == "d" and ":" in first_cells[place]}
        self._first_date_by_place: dict[int, datetime] = {}
        self._month_first_places: set[int] = set()

    def seconds(self, place: int, cell: str) -> float:
        """Seconds since the first date or time of day of a column; NaN if the cell holds none."""
        found_date = _date_in(cell, place in self._month_first_places)
        if found_date is None and place not in self._first_date_by_place:
            self._month_first_places.add(place)
            found_date = _date_in(cell, is_month_first=True)
        if found_date is None:
            return float("nan")
        return (found_date - self._first_date_by_place.setdefault(place, found_date)).total_seconds()

    def over_midnight(self, place: int, seconds: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " lines"]:
        """Seconds of a column that go on over midnight if it has no dates beside the times of day."""
        first_date = self._first_date_by_place.get(place)
        if first_date is None or first_date.year != TIME_OF_DAY_YEAR:
            return seconds
        return seconds + DAY_S * np.cumsum(np.diff(seconds, prepend=seconds[:1]) < -DAY_S / 2)


def _date_in(cell: str, is_month_first: bool) -> datetime | None:
    """Date, or time of day on the first of January 1970, in a cell; None if it holds none with a time.

    The day stands before the month, or behind it, where the year does not stand first.
    """
    text = cell.strip().replace(",", ".").replace("/", "-")
    half_of_day = _HALF_OF_DAY.search(text)
    if half_of_day:
        text = text[: half_of_day.start()]
    day_text, _, time_text = text.rpartition(" ")
    if day_text.count(".") == 2:
        day_text = "-".join(reversed(day_text.split(".")))
    elif day_text.count("-") == 2 and not day_text[:4].isdigit():
        first, second, year = day_text.split("-")
        day_text = f"{year}-{first}-{second}" if is_month_first else f"{year}-{second}-{first}"
    day_text = re.sub(r"-(\d)(?!\d)", r"-0\1", day_text)
    if ":" not in text:
        return None
    if not day_text and "T" not in text:
        day_text = f"{TIME_OF_DAY_YEAR}-01-01"
    if day_text and time_text.find(":") == 1:
        time_text = f"0{time_text}"
    try:
        found_date = datetime.fromisoformat(f"{day_text}T{time_text}" if day_text else text)
    except ValueError:
        return None
    if half_of_day:
        found_date = found_date.replace(hour=found_date.hour % 12 + (12 if half_of_day[1] in "pP" else 0))
    return found_date.astimezone(UTC) if found_date.tzinfo else found_date.replace(tzinfo=UTC)


def _last_digit_value(cell: str, decimal: str, is_date: bool) -> float:
    """Value of the last digit written; of dates, s, at least the microsecond held."""
    if is_date:
        _, decimal_point, decimals = cell.replace(",", ".").rpartition(":")[2].rstrip("aApPmM. ").partition(".")
        return max(1e-6, 10.0 ** -len(decimals)) if decimal_point else 1.0
    mantissa, _, exponent = cell.lower().replace("d", "e").partition("e")
    decimal_count = len(mantissa.partition(decimal)[2])
    try:
        return float(10.0 ** ((int(exponent) if exponent else 0) - decimal_count))
    except (ValueError, OverflowError):
        return 1.0
