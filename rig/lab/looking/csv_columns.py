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
from rig.lab.csv_text import LINES_PER_BLOCK, TextForm, cells_of, number_in, sample_lines
from rig.lab.looking.columns import ColumnSummary, FileSummary, column_summary
from rig.lab.looking.csv_dialect import CsvDialect, cell_kinds_of, dialect_of
from rig.lab.recorded import rate_in
from rig.lab.units import is_unit, name_and_unit
from rig.limits import PROGRAM_BYTES, check_decoded_size

LEAST_FILLED_SHARE = 0.9
"""Share of the lines, up to its last number, in which a channel has a number."""
LEAST_LENGTH_SHARE = 0.5
"""Share of the lines over which a channel reaches."""
MOST_SKIPPED_SHARE = 0.1
"""Share of the lines that may be skipped at the beginning until all channels have numbers."""
LINES_FOR_DIGITS = 200
"""Last lines by which it is known how finely numbers are written; at the end a time has its fewest places."""
WORKING_BYTES_PER_CELL = 16
"""A number is held as it is read and in the table."""
_DELIMITER_WORDS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "spaces"}


def summary_of_csv(path: Path) -> FileSummary:
    """Columns of a CSV file; raises RigError with a sentence if no map can import it."""
    dialect = dialect_of(path)
    line_numbers, values, last_digits, is_date = _column_values(path, dialect)
    form = dialect.form
    end_rows = [
        int(np.flatnonzero(np.isfinite(column_values))[-1]) + 1 if np.isfinite(column_values).any() else 0
        for column_values in values
    ]
    first_rows = [int(np.argmax(np.isfinite(column_values))) for column_values in values]
    filled_shares = [
        float(np.isfinite(column_values[first_row:last_row]).mean()) if last_row > first_row else 0.0
        for column_values, first_row, last_row in zip(values, first_rows, end_rows, strict=True)
    ]
    line_count = values.shape[1]
    _check_one_block(path, line_numbers, values[:, : max(end_rows)])
    is_whole = [
        filled_share >= LEAST_FILLED_SHARE
        and end_row >= LEAST_LENGTH_SHARE * max(end_rows)
        and start_row <= MOST_SKIPPED_SHARE * line_count
        for filled_share, start_row, end_row in zip(filled_shares, first_rows, end_rows, strict=True)
    ]
    if not any(is_whole):
        raise RigError(
            f"{path}: none of its {len(values)} columns has numbers throughout; export the channels at one rate"
        )
    start_row = max(row for row, is_column_finite in zip(first_rows, is_whole, strict=True) if is_column_finite)
    end_row = min(row for row, is_column_finite in zip(end_rows, is_whole, strict=True) if is_column_finite)
    facts = [_reading_sentence(dialect), *_placing_sentences(dialect)]
    if start_row:
        skipped_count = line_numbers[start_row] - line_numbers[0]
        form = _form_skipping(dialect, skipped_count)
        facts.append(f"lines {line_numbers[0]} to {line_numbers[start_row] - 1} lack numbers, and are skipped")
    if end_row < line_count:
        form = replace(form, cut_incomplete_end=True)
        facts.append(
            f"the last {line_count - end_row} lines, from line {line_numbers[end_row]} on, are incomplete and left out"
        )
    column_summaries = []
    for column_index, column_values in enumerate(values):
        name, unit = _name_and_unit(dialect, column_index)
        fault = ""
        if not is_whole[column_index]:
            filled_count = int(np.isfinite(column_values).sum())
            fault = f"it has numbers in {filled_count} of {line_count} lines" if filled_count else "it has no numbers"
        elif not (is_finite := np.isfinite(column_values[start_row:end_row])).all():
            fault = f"it has no number in line {line_numbers[start_row + int(np.argmin(is_finite))]}"
        column_summaries.append(
            column_summary(
                column_index + 1,
                Column(name, column_values[start_row:end_row], unit),
                last_digits[column_index],
                is_date[column_index],
                fault,
            )
        )
    return FileSummary(
        path, tuple(_without_unused_end(column_summaries)), tuple(facts), form, rate_in(dialect.header, form.decimal)
    )


def _column_values(
    path: Path, dialect: CsvDialect
) -> tuple[list[int], Float[np.ndarray, "columns lines"], list[float], list[bool]]:
    """Line numbers, values (NaN where there is no number; dates as seconds), last digits, and which are dates."""
    column_count, form = dialect.column_count, dialect.form
    line_numbers: list[int] = []
    columns = [array("d") for _ in range(column_count)]
    cell_kinds = ""
    first_date_by_column: dict[int, datetime] = {}
    last_lines: deque[str] = deque(maxlen=LINES_FOR_DIGITS)
    file_bytes = path.stat().st_size
    numbered_lines = sample_lines(path, form, dialect.first_line - 1)
    while line_batch := list(islice(numbered_lines, LINES_PER_BLOCK)):
        cell_kinds = (
            cell_kinds
            or cell_kinds_of(cells_of(line_batch[0][1], form.delimiter), form.decimal).ljust(column_count, "e")[
                :column_count
            ]
        )
        line_numbers += [line_number for line_number, _ in line_batch]
        needed_bytes = PROGRAM_BYTES + WORKING_BYTES_PER_CELL * column_count * len(line_numbers)
        check_decoded_size(needed_bytes, file_bytes, f"{path}: its {column_count} columns")
        lines = [line for _, line in line_batch]
        last_lines.extend(lines[-LINES_FOR_DIGITS:])
        number_table = _number_table(lines, form, column_count) if set(cell_kinds) == {"n"} else None
        if number_table is not None:
            for column, row in zip(columns, number_table.T, strict=True):
                column.frombytes(row.tobytes())
            continue
        for line in lines:
            for column_index, (column, cell) in enumerate(
                zip(columns, _padded_cells(line, form, column_count), strict=True)
            ):
                if cell_kinds[column_index] == "d":
                    column.append(_seconds_since_first(cell, column_index, first_date_by_column))
                else:
                    value = number_in(cell, form.decimal)
                    column.append(np.nan if value is None else value)
    is_date = [cell_kind == "d" for cell_kind in cell_kinds]
    last_rows = [_padded_cells(line, form, column_count) for line in last_lines]
    last_digits = [
        min(_last_digit(row[column_index], form.decimal, is_date[column_index]) for row in last_rows)
        for column_index in range(column_count)
    ]
    return line_numbers, np.array([np.frombuffer(column) for column in columns]), last_digits, is_date


def _padded_cells(line: str, form: TextForm, column_count: int) -> list[str]:
    cells = cells_of(line, form.delimiter)[:column_count]
    return cells + [""] * (column_count - len(cells))


def _number_table(lines: list[str], form: TextForm, column_count: int) -> Float[np.ndarray, "lines columns"] | None:
    """Table of lines that hold numbers alone, converted at once; None if any holds anything else."""
    if form.decimal != ".":
        if any("." in line for line in lines):
            return None
        lines = [line.replace(form.decimal, ".") for line in lines]
    try:
        delimiter = None if form.delimiter == " " else form.delimiter
        number_table = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        return None
    return number_table if number_table.shape[1] == column_count and np.isfinite(number_table).all() else None


def _seconds_since_first(cell: str, column_index: int, first_date_by_column: dict[int, datetime]) -> float:
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
        date = datetime.fromisoformat(f"{day}T{time}" if day else text)
    except ValueError:
        return float("nan")
    date = date.astimezone(UTC) if date.tzinfo else date.replace(tzinfo=UTC)
    return (date - first_date_by_column.setdefault(column_index, date)).total_seconds()


def _last_digit(cell: str, decimal: str, is_date: bool) -> float:
    """Value of the last digit written: 1e-3 of 0.125, 1e-6 of 1.25e-4; of dates, s, at least the microsecond held."""
    if is_date:
        _, decimal_point, decimals = cell.replace(",", ".").rpartition(":")[2].partition(".")
        return max(1e-6, 10.0 ** -len(decimals)) if decimal_point else 1.0
    mantissa, _, exponent = cell.strip().lower().partition("e")
    decimal_count = len(mantissa.partition(decimal)[2])
    try:
        return float(10.0 ** ((int(exponent) if exponent else 0) - decimal_count))
    except (ValueError, OverflowError):
        return 1.0


def _check_one_block(path: Path, line_numbers: list[int], values: Float[np.ndarray, "columns lines"]) -> None:
    """Raise RigError if lines without any numbers stand between lines of samples."""
    empty_rows = np.flatnonzero(~np.isfinite(values).any(axis=0))
    if empty_rows.size:
        raise RigError(
            f"{path}: line {line_numbers[empty_rows[0]]} is no line of samples, and samples follow in line "
            f"{line_numbers[int(empty_rows[-1]) + 1]}; export each block of samples to a file of its own"
        )


def _form_skipping(dialect: CsvDialect, skipped_count: int) -> TextForm:
    form = dialect.form
    if dialect.names:
        return replace(form, lines_after_names=form.lines_after_names + skipped_count)
    return replace(form, lines_before_names=form.lines_before_names + skipped_count)


def _name_and_unit(dialect: CsvDialect, column_index: int) -> tuple[str, str | None]:
    """Header of a column, and its unit from the line of units or from the header."""
    name = dialect.names[column_index] if column_index < len(dialect.names) else ""
    unit = dialect.units[column_index].strip("[]() ") if column_index < len(dialect.units) else ""
    if not column_index and not is_unit(unit):  # a label, such as "Unit"
        unit = ""
    return name, unit or name_and_unit(name, guess=True)[1]


def _without_unused_end(columns: list[ColumnSummary]) -> list[ColumnSummary]:
    """Columns without those at the end that have neither name nor numbers."""
    while columns and columns[-1].fault == "it has no numbers" and not columns[-1].name:
        columns = columns[:-1]
    return columns


def _reading_sentence(dialect: CsvDialect) -> str:
    form = dialect.form
    encoding_name = {"utf-8-sig": "UTF-8"}.get(form.encoding, form.encoding)
    delimiter_words = _DELIMITER_WORDS.get(form.delimiter, repr(form.delimiter))
    return (
        f"text in {encoding_name}, {delimiter_words} between columns, decimal "
        f"{'comma' if form.decimal == ',' else 'point'}"
    )


def _placing_sentences(dialect: CsvDialect) -> list[str]:
    form = dialect.form
    units_line = next((k for k, row in enumerate(dialect.header, 1) if dialect.units and row == dialect.units), None)
    names_words = f"names in line {form.lines_before_names + 1}" if dialect.names else "no names"
    return [
        f"{names_words}, {f'units in line {units_line}' if units_line else 'no line of units'}, samples from line "
        f"{dialect.first_line}"
    ]
