"""Columns of a CSV file in two passes: the first counts lines and cells, the second converts the requested ones."""

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import msgspec
import numpy as np

from rig.errors import RigError
from rig.lab.column import Blocks, Column, ColumnBlock, UnreadableError
from rig.lab.units import name_and_unit, quantity_of

TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".asc", ".lvm", ".dat")
MAX_LINE_LENGTH = 1_000_000
"""Longest line, characters."""
LINES_PER_BLOCK = 8192
"""Lines converted at once."""
_COMMENT_MARK = re.compile(r"^\s*[#%]+\s*(?=[^\s,;|])")
UNFIT_ENCODINGS = {"idna", "punycode", "undefined", "unicode_escape", "raw_unicode_escape"}
"""Python codecs that no measured data uses; the first two take quadratic time."""


class TextForm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Format of a CSV file: a line of names between lines that are skipped.

    The delimiter " " stands for any white space. Without `names` the samples follow the lines before the names; None
    leaves it to the line, which is one of names unless it holds numbers alone. cut_incomplete_end leaves out last lines
    that lack a number in a requested column.
    """

    encoding: str = "utf-8-sig"
    delimiter: str = ","
    decimal: str = "."
    lines_before_names: int = 0
    lines_after_names: int = 0
    names: bool | None = None
    cut_incomplete_end: bool = False

    def __post_init__(self) -> None:
        description = f"delimiter is {self.delimiter!r} and decimal {self.decimal!r}"
        if len(self.delimiter) != 1 or len(self.decimal) != 1 or self.delimiter == self.decimal:
            raise RigError(f"{description}; give two different characters")
        if self.delimiter.isalnum() or self.delimiter in '+-"\r\n\0' or self.decimal not in ".,":
            raise RigError(f"{description}; give a delimiter that stands in no number, and the decimal . or ,")
        if min(self.lines_before_names, self.lines_after_names) < 0:
            raise RigError("a number of lines in [csv] is negative; give zero or more")


@dataclass(frozen=True)
class _SampleLines:
    """Shape of the lines of samples: cells of the first one, and the number of lines.

    first_line_by_count maps every number of cells to the first line with that number; trailing_empty_count trailing
    cells, which are empty in all lines, do not count.
    """

    cell_count: int
    sample_count: int
    first_line_by_count: Mapping[int, int]
    trailing_empty_count: int


def csv_blocks(path: Path, form: TextForm) -> Blocks:
    """Single block of all columns with names and values.

    Raises RigError if the file is not text in the encoding, or its lines do not have equally many cells.
    """
    name_line = next(islice(lines_of(path, form.encoding), form.lines_before_names, None), None)
    if name_line is None:
        raise RigError(f"{path}: has no line after the first {form.lines_before_names}; check lines_before_names")
    header_names = names_in(name_line, form.delimiter)
    has_names = form.names
    if has_names is None:
        has_names = not all(is_number(name, form.decimal) for name in header_names if name)
    skipped_count = form.lines_before_names + has_names + form.lines_after_names
    line_shape = _count_sample_lines(path, form, skipped_count)
    cell_count = used_count = line_shape.cell_count
    if has_names:
        used_count = _used_column_count(path, header_names, cell_count, line_shape.trailing_empty_count)
    # of last columns without a name there may be any number
    for line_cell_count, line_number in line_shape.first_line_by_count.items():
        is_ragged = line_cell_count != cell_count and (line_cell_count < used_count or used_count == cell_count)
        if is_ragged and not form.cut_incomplete_end:
            raise RigError(
                f"{path}: the number of columns changed from {cell_count} to {line_cell_count} in line {line_number}; "
                "check delimiter"
            )
    used_names = tuple(header_names[:used_count] if has_names else (f"column {k}" for k in range(1, used_count + 1)))
    csv_columns = _CsvColumns(path, form, skipped_count, used_names, line_shape.sample_count)
    yield ColumnBlock(used_names, line_shape.sample_count, csv_columns.read)


def lines_of(path: Path, encoding: str) -> Iterator[str]:
    """Lines of a text; raises RigError if it is not in the encoding, or there is no such encoding."""
    encoding_error = RigError(f"{path}: there is no encoding {encoding!r}; give e.g. utf-8 or latin-1")
    if encoding.lower().replace("-", "_") in UNFIT_ENCODINGS:
        raise encoding_error
    line_number = 0
    try:
        with path.open(encoding=encoding) as stream:
            for line in stream:
                line_number += 1
                yield line
    except UnicodeError as error:
        raise RigError(
            f"{path}: is not text in {encoding} (after line {line_number}); name its encoding in the map, "
            'e.g. encoding = "latin-1" or "utf-16"'
        ) from error
    except (LookupError, ValueError) as error:
        raise encoding_error from error


def sample_lines(path: Path, form: TextForm, skipped_line_count: int) -> Iterator[tuple[int, str]]:
    """Lines that are not blank, after the skipped ones, with their numbers from 1."""
    lines = islice(lines_of(path, form.encoding), skipped_line_count, None)
    for line_number, line in enumerate(lines, start=skipped_line_count + 1):
        if not line.isspace():
            yield line_number, line.rstrip("\n")


def _count_sample_lines(path: Path, form: TextForm, skipped_line_count: int) -> _SampleLines:
    delimiter = form.delimiter
    numbered_lines = sample_lines(path, form, skipped_line_count)
    line_number, first_line = next(numbered_lines, (0, ""))
    if not first_line:
        raise RigError(f"{path}: holds no samples; export it again")
    first_cell_count = len(cells_of(first_line, delimiter))
    first_line_by_count, sample_count = {first_cell_count: line_number}, 1
    trailing_empty_count = _trailing_empty_count(first_line, delimiter)
    for line_number, line in numbered_lines:
        is_unquoted = '"' not in line and delimiter != " "
        count = line.count(delimiter) + 1 if is_unquoted else len(cells_of(line, delimiter))
        if count not in first_line_by_count:
            first_line_by_count[count] = line_number
        if trailing_empty_count:
            trailing_empty_count = min(trailing_empty_count, _trailing_empty_count(line, delimiter))
        sample_count += 1
    filled_line = first_line.rsplit(delimiter, trailing_empty_count)[0] if trailing_empty_count else first_line
    filled_count = len(cells_of(filled_line, delimiter))
    line_by_count = {count - first_cell_count + filled_count: number for count, number in first_line_by_count.items()}
    return _SampleLines(filled_count, sample_count, line_by_count, trailing_empty_count)


NumberedLines = list[tuple[int, str]]


@dataclass(frozen=True)
class _CsvColumns:
    """Columns of a file by index, with their names, and the number of lines of samples."""

    path: Path
    form: TextForm
    skipped_line_count: int
    names: Sequence[str]
    sample_count: int

    def read(self, indices: Sequence[int]) -> list[Column]:
        form, column_values, read_line_count = self.form, np.empty((len(indices), self.sample_count)), 0
        remaining_lines = sample_lines(self.path, form, self.skipped_line_count)
        while lines := list(islice(remaining_lines, LINES_PER_BLOCK)):
            if form.decimal != ".":
                self._check_decimal(indices, lines)
            if form.cut_incomplete_end:
                lines = self._lines_before_incomplete_end(indices, lines, remaining_lines)
            texts = [line if form.decimal == "." else line.replace(form.decimal, ".") for _, line in lines]
            if not texts:
                continue
            delimiter = None if form.delimiter == " " else form.delimiter
            try:
                numbers = np.loadtxt(texts, delimiter=delimiter, ndmin=2, comments=None, quotechar='"', usecols=indices)
            except ValueError as error:
                raise self._no_number_error(indices, lines) from error
            column_values[:, read_line_count : read_line_count + len(numbers)] = numbers.T
            read_line_count += len(numbers)
        if not read_line_count:
            raise RigError(f"{self.path}: has no line with numbers in all columns of the map; check its columns")
        column_names = [self.names[index] for index in indices]
        column_units = [name_and_unit(name)[1] for name in column_names]
        return [
            Column(name, samples, unit if quantity_of(unit) else None)
            for name, unit, samples in zip(column_names, column_units, column_values[:, :read_line_count], strict=True)
        ]

    def _lines_before_incomplete_end(
        self, indices: Sequence[int], lines: NumberedLines, remaining_lines: Iterator[tuple[int, str]]
    ) -> NumberedLines:
        """Lines up to the first that lacks a number in a chosen column; raises RigError if a whole line follows it."""

        def is_whole(line: str) -> bool:
            cells = cells_of(line, self.form.delimiter)
            return len(cells) > max(indices) and all(
                finite_number_or_none(cells[line_index], self.form.decimal) is not None for line_index in indices
            )

        whole_count = next((line_index for line_index, (_, line) in enumerate(lines) if not is_whole(line)), len(lines))
        if whole_count < len(lines):
            for line_number, line in chain(lines[whole_count:], remaining_lines):
                if is_whole(line):
                    raise RigError(
                        f"{self.path}: line {lines[whole_count][0]} lacks a number, and line {line_number} has them "
                        "all: not only the end is incomplete; repair the record or cut it there"
                    )
        return lines[:whole_count]

    def _check_decimal(self, indices: Sequence[int], lines: NumberedLines) -> None:
        """Raise RigError at a point in a number if the decimal separator is a comma: 1.500 may be 1500 or 1.5."""
        for line_number, line in lines:
            cells = cells_of(line, self.form.delimiter) if "." in line else []
            for index in indices:
                if index < len(cells) and "." in cells[index]:
                    raise RigError(
                        f"{self.path}: line {line_number} has {cells[index].strip()!r} in column "
                        f"{self.names[index]!r}, and the decimal is {self.form.decimal!r}; export numbers without "
                        "points, or correct decimal in the map"
                    )

    def _no_number_error(self, indices: Sequence[int], lines: NumberedLines) -> RigError:
        for line_number, line in lines:
            cells = cells_of(line, self.form.delimiter)
            for index in indices:
                cell = cells[index].strip() if index < len(cells) else ""
                if not is_number(cell, self.form.decimal):
                    return RigError(
                        f"{self.path}: line {line_number} has {cell[:50]!r} in column {self.names[index]!r}, which is "
                        "no number; check encoding, delimiter, decimal and the lines skipped"
                    )
        return RigError(
            f"{self.path}: lines {lines[0][0]} to {lines[-1][0]} are not of numbers; check delimiter and decimal"
        )


def cells_of(line: str, delimiter: str) -> list[str]:
    """Cells of a line, quotes taken off; raises UnreadableError if it is longer than MAX_LINE_LENGTH."""
    if len(line) > MAX_LINE_LENGTH:
        raise UnreadableError(f"a line has more than {MAX_LINE_LENGTH} characters")
    line = line.rstrip("\r\n")
    if '"' not in line:
        return line.split() if delimiter == " " else line.split(delimiter) if line else []
    if delimiter != " ":
        return next(csv.reader([line], delimiter=delimiter), [])
    return next(csv.reader([" ".join(line.split())], delimiter=" "), [])


def names_in(line: str, delimiter: str) -> list[str]:
    """Names in a line, without the # or % by which programs mark a comment."""
    return [cell.strip() for cell in cells_of(_COMMENT_MARK.sub("", line.strip("\r\n")), delimiter)]


def _trailing_empty_count(line: str, delimiter: str) -> int:
    """Number of empty cells at the end of a line."""
    return 0 if delimiter == " " else line.count(delimiter, len(line.rstrip(" \t" + delimiter)))


def _used_column_count(path: Path, column_names: list[str], column_count: int, trailing_empty_count: int) -> int:
    """Number of leading columns with a name and values; raises RigError if any but trailing columns lack either."""
    last_named = max((number for number, name in enumerate(column_names, start=1) if name), default=0)
    if column_count > len(column_names) or last_named > column_count + trailing_empty_count or not last_named:
        raise RigError(f"{path}: {last_named} names for {column_count} columns; check the line of names")
    return min(last_named, column_count)


def is_number(cell: str, decimal: str) -> bool:
    """True if a cell is a number, perhaps not finite."""
    return _float_or_none(cell, decimal) is not None


def finite_number_or_none(cell: str, decimal: str) -> float | None:
    """Finite number in a cell; None if there is none, or it has the other decimal separator."""
    number = _float_or_none(cell, decimal)
    if number is None or not math.isfinite(number) or (decimal != "." and "." in cell):
        return None
    return number


def _float_or_none(cell: str, decimal: str) -> float | None:
    if "_" in cell or not cell:
        return None
    try:
        return float(cell if decimal == "." else cell.replace(decimal, "."))
    except ValueError:
        return None
