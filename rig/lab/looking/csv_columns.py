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
from rig.lab.csv_text import LINES_PER_BLOCK, TextForm, cells_of, finite_number_or_none, sample_lines
from rig.lab.looking.columns import ColumnSummary, FileSummary, column_summary
from rig.lab.looking.csv_dialect import CsvDialect, cell_kind_letters, dialect_of
from rig.lab.recorded import stated_sampling_rate_hz
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
    line_numbers, values, last_digits, is_date = _line_numbers_values_digits_dates(path, dialect)
    form, line_count, is_finite = dialect.form, values.shape[1], np.isfinite(values)
    first_rows, counts = is_finite.argmax(axis=1), is_finite.sum(axis=1)
    end_rows = np.where(counts > 0, line_count - is_finite[:, ::-1].argmax(axis=1), 0)
    _check_one_block(path, line_numbers, values[:, : end_rows.max()])
    is_channel = (
        (counts / np.maximum(end_rows - first_rows, 1) >= LEAST_FILLED_SHARE)
        & (end_rows >= LEAST_LENGTH_SHARE * end_rows.max())
        & (first_rows <= MOST_SKIPPED_SHARE * line_count)
    )
    if not is_channel.any():
        raise RigError(
            f"{path}: none of its {len(values)} columns has numbers throughout; export the channels at one rate"
        )
    first_row, end = int(first_rows[is_channel].max()), int(end_rows[is_channel].min())
    facts = [_encoding_and_delimiter_sentence(dialect), _line_layout_sentence(dialect)]
    if first_row:
        form = _form_with_more_skipped_lines(dialect, line_numbers[first_row] - line_numbers[0])
        facts.append(f"lines {line_numbers[0]} to {line_numbers[first_row] - 1} lack numbers, and are skipped")
    if end < line_count:
        form = replace(form, cut_incomplete_end=True)
        facts.append(
            f"the last {line_count - end} lines, from line {line_numbers[end]} on, are incomplete and left out"
        )
    columns = []
    for k, column_samples in enumerate(values[:, first_row:end]):
        heading, unit = _name_and_unit(dialect, k)
        fault = ""
        if not is_channel[k]:
            fault = f"it has numbers in {counts[k]} of {line_count} lines" if counts[k] else "it has no numbers"
        elif not is_finite[k, first_row:end].all():
            fault = f"it has no number in line {line_numbers[first_row + int(np.argmin(is_finite[k, first_row:end]))]}"
        columns.append(column_summary(k + 1, Column(heading, column_samples, unit), last_digits[k], is_date[k], fault))
    rate_hz = stated_sampling_rate_hz(dialect.header, form.decimal)
    return FileSummary(path, tuple(_without_empty_trailing_columns(columns)), tuple(facts), form, rate_hz)


def _line_numbers_values_digits_dates(
    path: Path, dialect: CsvDialect
) -> tuple[list[int], Float[np.ndarray, "columns lines"], list[float], list[bool]]:
    """Line numbers, values (NaN where there is no number; dates as seconds), last digits, and which are dates."""
    count, form = dialect.column_count, dialect.form
    line_numbers: list[int] = []
    column_arrays = [array("d") for _ in range(count)]
    kinds = ""
    first_dates: dict[int, datetime] = {}
    last_lines: deque[str] = deque(maxlen=LINES_FOR_DIGITS)
    file_bytes = path.stat().st_size
    numbered_lines = sample_lines(path, form, dialect.first_line - 1)
    while numbered_batch := list(islice(numbered_lines, LINES_PER_BLOCK)):
        lines = [line for _, line in numbered_batch]
        kinds = kinds or cell_kind_letters(cells_of(lines[0], form.delimiter), form.decimal).ljust(count, "e")[:count]
        line_numbers += [line_number for line_number, _ in numbered_batch]
        needed_bytes = PROGRAM_BYTES + WORKING_BYTES_PER_CELL * count * len(line_numbers)
        check_decoded_size(needed_bytes, file_bytes, f"{path}: its {count} columns")
        last_lines.extend(lines[-LINES_FOR_DIGITS:])
        number_table = _number_table(lines, form, count) if set(kinds) == {"n"} else None
        if number_table is not None:
            for column, column_numbers in zip(column_arrays, number_table.T, strict=True):
                column.frombytes(column_numbers.tobytes())
            continue
        for line in lines:
            for column_index, cell in enumerate(_padded_cells(line, form, count)):
                if kinds[column_index] == "d":
                    column_arrays[column_index].append(_seconds_since_first(cell, column_index, first_dates))
                else:
                    number = finite_number_or_none(cell, form.decimal)
                    column_arrays[column_index].append(np.nan if number is None else number)
    is_date = [kind == "d" for kind in kinds]
    cells_by_column = zip(*(_padded_cells(line, form, count) for line in last_lines), strict=True)
    last_digits = [
        min(_last_digit_value(cell, form.decimal, is_column_of_dates) for cell in column_cells)
        for column_cells, is_column_of_dates in zip(cells_by_column, is_date, strict=True)
    ]
    return line_numbers, np.array([np.frombuffer(column) for column in column_arrays]), last_digits, is_date


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
        table = np.loadtxt(lines, delimiter=delimiter, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        return None
    return table if table.shape[1] == column_count and np.isfinite(table).all() else None


def _seconds_since_first(cell: str, column_index: int, first_date_by_column: dict[int, datetime]) -> float:
    """Seconds since the first date or time of day of its column; NaN if the cell holds none."""
    date_text = cell.strip().replace(",", ".").replace("/", "-")
    day_text, _, time_text = date_text.rpartition(" ")
    if day_text.count(".") == 2:
        day_text = "-".join(reversed(day_text.split(".")))
    elif day_text.count("-") == 2 and not day_text[:4].isdigit():
        day_text = "-".join(reversed(day_text.split("-")))
    try:
        if ":" not in date_text:
            return float("nan")
        if not day_text and "T" not in date_text:
            day_text = "1970-01-01"
            time_text = time_text if time_text.index(":") == 2 else f"0{time_text}"
        date = datetime.fromisoformat(f"{day_text}T{time_text}" if day_text else date_text)
    except ValueError:
        return float("nan")
    date = date.astimezone(UTC) if date.tzinfo else date.replace(tzinfo=UTC)
    return (date - first_date_by_column.setdefault(column_index, date)).total_seconds()


def _last_digit_value(cell: str, decimal: str, is_date: bool) -> float:
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


def _form_with_more_skipped_lines(dialect: CsvDialect, skipped_count: int) -> TextForm:
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


def _without_empty_trailing_columns(columns: list[ColumnSummary]) -> list[ColumnSummary]:
    """Columns without those at the end that have neither name nor numbers."""
    while columns and columns[-1].fault == "it has no numbers" and not columns[-1].name:
        columns = columns[:-1]
    return columns


def _encoding_and_delimiter_sentence(dialect: CsvDialect) -> str:
    form = dialect.form
    encoding = {"utf-8-sig": "UTF-8"}.get(form.encoding, form.encoding)
    delimiter = _DELIMITER_WORDS.get(form.delimiter, repr(form.delimiter))
    return f"text in {encoding}, {delimiter} between columns, decimal {'comma' if form.decimal == ',' else 'point'}"


def _line_layout_sentence(dialect: CsvDialect) -> str:
    units_line = next((k for k, row in enumerate(dialect.header, 1) if dialect.units and row == dialect.units), None)
    names_words = f"names in line {dialect.form.lines_before_names + 1}" if dialect.names else "no names"
    units_words = f"units in line {units_line}" if units_line else "no line of units"
    return f"{names_words}, {units_words}, samples from line {dialect.first_line}"
