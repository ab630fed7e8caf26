"""Columns of a CSV file whose dialect is found from its text, with what is ragged about them."""

from array import array
from collections import deque
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from rig.errors import RigError
from rig.lab.column import Column
from rig.lab.csv_text import LINES_AT_ONCE, TextForm, cells_of, number_in, sample_lines
from rig.lab.looking.columns import SeenColumn, SeenFile, seen_column
from rig.lab.looking.csv_dialect import CsvDialect, dialect_of, kinds_of
from rig.lab.recorded import rate_in
from rig.lab.units import is_unit, name_and_unit
from rig.limits import PROGRAM_BYTES, check_decoded_size

LEAST_FILLED = 0.9
"""Share of the lines, up to its last number, in which a channel has a number."""
LEAST_LENGTH = 0.5
"""Share of the lines over which a channel reaches."""
MOST_BEFORE = 0.1
"""Share of the lines that may be skipped at the beginning until all channels have numbers."""
ROWS_FOR_DIGITS = 200
"""Last lines by which it is known how finely numbers are written; at the end a time has its fewest places."""
WORKING_BYTES_PER_CELL = 16
"""A number is held as it is read and in the table."""
_BETWEEN = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "spaces"}


def seen_csv(path: Path) -> SeenFile:
    """Columns of a CSV file; raises RigError with a sentence if no map can import it."""
    dialect = dialect_of(path)
    lines, values, digits, dated = _values(path, dialect)
    form = dialect.form
    last = [int(np.flatnonzero(np.isfinite(row))[-1]) + 1 if np.isfinite(row).any() else 0 for row in values]
    first = [int(np.argmax(np.isfinite(row))) for row in values]
    filled = [
        float(np.isfinite(row[a:b]).mean()) if b > a else 0.0 for row, a, b in zip(values, first, last, strict=True)
    ]
    count = values.shape[1]
    _check_one_block(path, lines, values[:, : max(last)])
    whole = [
        share >= LEAST_FILLED and end >= LEAST_LENGTH * max(last) and start <= MOST_BEFORE * count
        for share, start, end in zip(filled, first, last, strict=True)
    ]
    if not any(whole):
        raise RigError(
            f"{path}: none of its {len(values)} columns has numbers throughout; export the channels at one rate"
        )
    start = max(a for a, ok in zip(first, whole, strict=True) if ok)
    end = min(b for b, ok in zip(last, whole, strict=True) if ok)
    facts = [_reading(dialect), *_placing(dialect)]
    if start:
        skipped = lines[start] - lines[0]
        form = _skipping(dialect, skipped)
        facts.append(f"lines {lines[0]} to {lines[start] - 1} lack numbers, and are skipped")
    if end < count:
        form = replace(form, cut_incomplete_end=True)
        facts.append(f"the last {count - end} lines, from line {lines[end]} on, are incomplete and left out")
    columns = []
    for k, row in enumerate(values):
        name, unit = _name_and_unit(dialect, k)
        fault = ""
        if not whole[k]:
            in_lines = int(np.isfinite(row).sum())
            fault = f"it has numbers in {in_lines} of {count} lines" if in_lines else "it has no numbers"
        elif not (finite := np.isfinite(row[start:end])).all():
            fault = f"it has no number in line {lines[start + int(np.argmin(finite))]}"
        columns.append(seen_column(k + 1, Column(name, row[start:end], unit), digits[k], dated[k], fault))
    return SeenFile(
        path, tuple(_without_unused_end(columns)), tuple(facts), form, rate_in(dialect.header, form.decimal)
    )


def _values(
    path: Path, dialect: CsvDialect
) -> tuple[list[int], Float[np.ndarray, "columns lines"], list[float], list[bool]]:
    """Line numbers, values (NaN where there is no number; dates as seconds), last digits, and which are dates."""
    width, form = dialect.width, dialect.form
    numbers: list[int] = []
    columns = [array("d") for _ in range(width)]
    kinds = ""
    beginning: dict[int, datetime] = {}
    last_lines: deque[str] = deque(maxlen=ROWS_FOR_DIGITS)
    file_bytes = path.stat().st_size
    rows = sample_lines(path, form, dialect.first_line - 1)
    while batch := list(islice(rows, LINES_AT_ONCE)):
        kinds = kinds or kinds_of(cells_of(batch[0][1], form.delimiter), form.decimal).ljust(width, "e")[:width]
        numbers += [number for number, _ in batch]
        needed_bytes = PROGRAM_BYTES + WORKING_BYTES_PER_CELL * width * len(numbers)
        check_decoded_size(needed_bytes, file_bytes, f"{path}: its {width} columns")
        lines = [line for _, line in batch]
        last_lines.extend(lines[-ROWS_FOR_DIGITS:])
        table = _all_numbers(lines, form, width) if set(kinds) == {"n"} else None
        if table is not None:
            for column, row in zip(columns, table.T, strict=True):
                column.frombytes(row.tobytes())
            continue
        for line in lines:
            for k, (column, cell) in enumerate(zip(columns, _padded(line, form, width), strict=True)):
                if kinds[k] == "d":
                    column.append(_seconds(cell, k, beginning))
                else:
                    value = number_in(cell, form.decimal)
                    column.append(np.nan if value is None else value)
    dated = [kind == "d" for kind in kinds]
    last_rows = [_padded(line, form, width) for line in last_lines]
    digits = [min(_last_digit(row[k], form.decimal, dated[k]) for row in last_rows) for k in range(width)]
    return numbers, np.array([np.frombuffer(column) for column in columns]), digits, dated


def _padded(line: str, form: TextForm, width: int) -> list[str]:
    cells = cells_of(line, form.delimiter)[:width]
    return cells + [""] * (width - len(cells))


def _all_numbers(lines: list[str], form: TextForm, width: int) -> Float[np.ndarray, "lines columns"] | None:
    """Table of lines that hold numbers alone, converted at once; None if any holds anything else."""
    if form.decimal != ".":
        if any("." in line for line in lines):
            return None
        lines = [line.replace(form.decimal, ".") for line in lines]
    try:
        delimiter = None if form.delimiter == " " else form.delimiter
        table = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        return None
    return table if table.shape[1] == width and np.isfinite(table).all() else None


def _seconds(cell: str, column: int, beginning: dict[int, datetime]) -> float:
    """Seconds since the first date or time of day of its column; NaN if the cell holds none."""
    text = cell.strip().replace(",", ".").replace("/", "-")
    day, _, time = text.rpartition(" ")
    if day.count(".") == 2:
        day = "-".join(reversed(day.split(".")))
    elif day.count("-") == 2 and not day[:4].isdigit():
        day = "-".join(reversed(day.split("-")))
    try:
        if ":" not in text:
            return float("nan")
        if not day and "T" not in text:
            day = "1970-01-01"
            time = time if time.index(":") == 2 else f"0{time}"
        moment = datetime.fromisoformat(f"{day}T{time}" if day else text)
    except ValueError:
        return float("nan")
    moment = moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
    return (moment - beginning.setdefault(column, moment)).total_seconds()


def _last_digit(cell: str, decimal: str, is_date: bool) -> float:
    """Value of the last digit written: 1e-3 of 0.125, 1e-6 of 1.25e-4; of dates, s, at least the microsecond held."""
    if is_date:
        _, point, places = cell.replace(",", ".").rpartition(":")[2].partition(".")
        return max(1e-6, 10.0 ** -len(places)) if point else 1.0
    mantissa, _, exponent = cell.strip().lower().partition("e")
    places_count = len(mantissa.partition(decimal)[2])
    try:
        return float(10.0 ** ((int(exponent) if exponent else 0) - places_count))
    except (ValueError, OverflowError):
        return 1.0


def _check_one_block(path: Path, lines: list[int], values: Float[np.ndarray, "columns lines"]) -> None:
    """Raise RigError if lines without any numbers stand between lines of samples."""
    empty = np.flatnonzero(~np.isfinite(values).any(axis=0))
    if empty.size:
        raise RigError(
            f"{path}: line {lines[empty[0]]} is no line of samples, and samples follow in line "
            f"{lines[int(empty[-1]) + 1]}; export each block of samples to a file of its own"
        )


def _skipping(dialect: CsvDialect, lines: int) -> TextForm:
    form = dialect.form
    if dialect.names:
        return replace(form, lines_after_names=form.lines_after_names + lines)
    return replace(form, lines_before_names=form.lines_before_names + lines)


def _name_and_unit(dialect: CsvDialect, column: int) -> tuple[str, str | None]:
    """Header of a column, and its unit from the line of units or from the header."""
    name = dialect.names[column] if column < len(dialect.names) else ""
    unit = dialect.units[column].strip("[]() ") if column < len(dialect.units) else ""
    if not column and not is_unit(unit):  # a label, such as "Unit"
        unit = ""
    return name, unit or name_and_unit(name, guess=True)[1]


def _without_unused_end(columns: list[SeenColumn]) -> list[SeenColumn]:
    """Columns without those at the end that have neither name nor numbers."""
    while columns and columns[-1].fault == "it has no numbers" and not columns[-1].name:
        columns = columns[:-1]
    return columns


def _reading(dialect: CsvDialect) -> str:
    form = dialect.form
    encoding = {"utf-8-sig": "UTF-8"}.get(form.encoding, form.encoding)
    between = _BETWEEN.get(form.delimiter, repr(form.delimiter))
    return f"text in {encoding}, {between} between columns, decimal {'comma' if form.decimal == ',' else 'point'}"


def _placing(dialect: CsvDialect) -> list[str]:
    form = dialect.form
    units = next((k for k, row in enumerate(dialect.header, 1) if dialect.units and row == dialect.units), None)
    names = f"names in line {form.lines_before_names + 1}" if dialect.names else "no names"
    return [
        f"{names}, {f'units in line {units}' if units else 'no line of units'}, samples from line {dialect.first_line}"
    ]
