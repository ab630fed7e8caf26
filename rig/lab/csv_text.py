"""Columns of a CSV file in two passes: the first counts lines and cells, the second converts the requested ones."""

import csv
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
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
LINES_AT_ONCE = 8192
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
class _Body:
    """Shape of the lines of samples: cells of the first one (width), and the number of lines.

    first_line_of maps every number of cells to the first line with that number; empty_at_end trailing cells, which are
    empty in all lines, do not count.
    """

    width: int
    samples: int
    first_line_of: Mapping[int, int]
    empty_at_end: int


def csv_blocks(path: Path, form: TextForm) -> Blocks:
    """Single block of all columns with names and values.

    Raises RigError if the file is not text in the encoding, or its lines do not have equally many cells.
    """
    head = next(islice(lines_of(path, form.encoding), form.lines_before_names, None), None)
    if head is None:
        raise RigError(f"{path}: has no line after the first {form.lines_before_names}; check lines_before_names")
    names = names_in(head, form.delimiter)
    named = not all(is_number(name, form.decimal) for name in names if name) if form.names is None else form.names
    skipped_lines = form.lines_before_names + (1 if named else 0) + form.lines_after_names
    body = _counted(path, form, skipped_lines)
    width = body.width
    used = _used_columns(path, names, width, body.empty_at_end) if named else width
    for cells, line in body.first_line_of.items():  # of last columns without a name there may be any number
        if cells != width and (cells < used or used == width) and not form.cut_incomplete_end:
            raise RigError(
                f"{path}: the number of columns changed from {width} to {cells} in line {line}; check delimiter"
            )
    column_names = tuple(names[:used]) if named else tuple(f"column {k}" for k in range(1, used + 1))
    yield ColumnBlock(
        column_names, body.samples, partial(_columns, path, form, skipped_lines, column_names, body.samples)
    )


def lines_of(path: Path, encoding: str) -> Iterator[str]:
    """Lines of a text; raises RigError if it is not in the encoding, or there is no such encoding."""
    unknown = RigError(f"{path}: there is no encoding {encoding!r}; give e.g. utf-8 or latin-1")
    if encoding.lower().replace("-", "_") in UNFIT_ENCODINGS:
        raise unknown
    number = 0
    try:
        with path.open(encoding=encoding) as stream:
            for line in stream:
                number += 1
                yield line
    except UnicodeError as error:
        raise RigError(
            f"{path}: is not text in {encoding} (after line {number}); name its encoding in the map, "
            'e.g. encoding = "latin-1" or "utf-16"'
        ) from error
    except (LookupError, ValueError) as error:
        raise unknown from error


def sample_lines(path: Path, form: TextForm, skipped_lines: int) -> Iterator[tuple[int, str]]:
    """Lines that are not blank, after the skipped ones, with their numbers from 1."""
    for number, line in enumerate(islice(lines_of(path, form.encoding), skipped_lines, None), start=skipped_lines + 1):
        if not line.isspace():
            yield number, line.rstrip("\n")


def _counted(path: Path, form: TextForm, skipped_lines: int) -> _Body:
    delimiter = form.delimiter
    lines = sample_lines(path, form, skipped_lines)
    number, first = next(lines, (0, ""))
    if not first:
        raise RigError(f"{path}: holds no samples; export it again")
    first_line_of, samples = {len(cells_of(first, delimiter)): number}, 1
    empty_count = _empty_at_end(first, delimiter)
    for number, line in lines:
        plain = '"' not in line and delimiter != " "
        count = line.count(delimiter) + 1 if plain else len(cells_of(line, delimiter))
        if count not in first_line_of:
            first_line_of[count] = number
        if empty_count:
            empty_count = min(empty_count, _empty_at_end(line, delimiter))
        samples += 1
    width = len(cells_of(first.rsplit(delimiter, empty_count)[0] if empty_count else first, delimiter))
    surplus = next(iter(first_line_of)) - width
    return _Body(width, samples, {count - surplus: number for count, number in first_line_of.items()}, empty_count)


def _columns(
    path: Path, form: TextForm, skipped_lines: int, names: Sequence[str], samples: int, column_indices: Sequence[int]
) -> list[Column]:
    values = np.empty((len(column_indices), samples))
    start = 0
    lines_left = sample_lines(path, form, skipped_lines)
    while lines := list(islice(lines_left, LINES_AT_ONCE)):
        if form.decimal != ".":
            _check_decimal(path, form, names, column_indices, lines)
        if form.cut_incomplete_end:
            lines = _complete_lines(path, form, column_indices, lines, lines_left)
        plain = [line if form.decimal == "." else line.replace(form.decimal, ".") for _, line in lines]
        if not plain:
            continue
        try:
            rows = np.loadtxt(
                plain,
                delimiter=None if form.delimiter == " " else form.delimiter,
                ndmin=2,
                comments=None,
                quotechar='"',
                usecols=column_indices,
            )
        except ValueError as error:
            raise _no_number(path, form, names, column_indices, lines) from error
        values[:, start : start + len(rows)] = rows.T
        start += len(rows)
    values = values[:, :start]
    if not start:
        raise RigError(f"{path}: has no line with numbers in all columns of the map; check its columns")
    return [Column(names[k], row, _unit_of(names[k])) for k, row in zip(column_indices, values, strict=True)]


def _unit_of(name: str) -> str | None:
    """Unit in a column's name, if it is one of the quantities'."""
    unit = name_and_unit(name)[1]
    return unit if quantity_of(unit) else None


def _complete_lines(
    path: Path,
    form: TextForm,
    chosen: Sequence[int],
    lines: Sequence[tuple[int, str]],
    lines_left: Iterator[tuple[int, str]],
) -> list[tuple[int, str]]:
    """Lines up to the first that lacks a number in a chosen column; raises RigError if a whole line follows it."""

    def is_whole(line: str) -> bool:
        cells = cells_of(line, form.delimiter)
        return len(cells) > max(chosen) and all(number_in(cells[k], form.decimal) is not None for k in chosen)

    count = next((k for k, (_, line) in enumerate(lines) if not is_whole(line)), len(lines))
    if count < len(lines):
        for number, line in chain(lines[count:], lines_left):
            if is_whole(line):
                raise RigError(
                    f"{path}: line {lines[count][0]} lacks a number, and line {number} has them all: not only "
                    "the end is incomplete; repair the record or cut it there"
                )
    return list(lines[:count])


def _check_decimal(
    path: Path, form: TextForm, names: Sequence[str], chosen: Sequence[int], lines: Sequence[tuple[int, str]]
) -> None:
    """Raise RigError at a point in a number if the decimal separator is a comma: 1.500 may be 1500 or 1.5."""
    for number, line in lines:
        if "." in line:
            cells = cells_of(line, form.delimiter)
            for k in chosen:
                if k < len(cells) and "." in cells[k]:
                    raise RigError(
                        f"{path}: line {number} has {cells[k].strip()!r} in column {names[k]!r}, and the decimal is "
                        f"{form.decimal!r}; export numbers without points, or correct decimal in the map"
                    )


def _no_number(
    path: Path, form: TextForm, names: Sequence[str], chosen: Sequence[int], lines: Sequence[tuple[int, str]]
) -> RigError:
    for number, line in lines:
        cells = cells_of(line, form.delimiter)
        for k in chosen:
            cell = cells[k].strip() if k < len(cells) else ""
            if not is_number(cell, form.decimal):
                return RigError(
                    f"{path}: line {number} has {cell[:50]!r} in column {names[k]!r}, which is no number; "
                    "check encoding, delimiter, decimal and the lines skipped"
                )
    return RigError(f"{path}: lines {lines[0][0]} to {lines[-1][0]} are not of numbers; check delimiter and decimal")


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


def _empty_at_end(line: str, delimiter: str) -> int:
    """Number of empty cells at the end of a line."""
    return 0 if delimiter == " " else line.count(delimiter, len(line.rstrip(" \t" + delimiter)))


def _used_columns(path: Path, names: list[str], column_count: int, empty_count: int) -> int:
    """Number of leading columns with a name and values; raises RigError if any but trailing columns lack either."""
    named = next((k for k in range(len(names), 0, -1) if names[k - 1]), 0)
    if column_count > len(names) or named > column_count + empty_count or not named:
        raise RigError(f"{path}: {named} names for {column_count} columns; check the line of names")
    return min(named, column_count)


def is_number(cell: str, decimal: str) -> bool:
    """True if a cell is a number, perhaps not finite."""
    return _float(cell, decimal) is not None


def number_in(cell: str, decimal: str) -> float | None:
    """Finite number in a cell; None if there is none, or it has the other decimal separator."""
    number = _float(cell, decimal)
    if number is None or not math.isfinite(number) or (decimal != "." and "." in cell):
        return None
    return number


def _float(cell: str, decimal: str) -> float | None:
    if "_" in cell or not cell:
        return None
    try:
        return float(cell if decimal == "." else cell.replace(decimal, "."))
    except ValueError:
        return None
