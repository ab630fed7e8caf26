"""Columns of a CSV file in two passes: the first counts lines and cells, the second converts what is asked for."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np

from rig.errors import RigError
from rig.lab.column import Blocks, Column, ColumnBlock, UnreadableError

MAX_LINE = 1_000_000
"""Characters of a line that is taken apart here."""
LINES = 8192
"""So many are converted at once."""
UNFIT_ENCODINGS = {"idna", "punycode", "undefined", "unicode_escape", "raw_unicode_escape"}
"""What Python calls encodings and no measured data is in; time of the first two grows with the square of the size."""


class TextForm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Form of a CSV file: one line of names stands between the lines that are skipped."""

    encoding: str = "utf-8-sig"
    delimiter: str = ","
    decimal: str = "."
    lines_before_names: int = 0
    lines_after_names: int = 0

    def __post_init__(self) -> None:
        given = f"delimiter is {self.delimiter!r} and decimal {self.decimal!r}"
        if len(self.delimiter) != 1 or len(self.decimal) != 1 or self.delimiter == self.decimal:
            raise RigError(f"{given}; give two different characters")
        if self.delimiter.isalnum() or self.delimiter in '+-"\r\n\0' or self.decimal not in ".,":
            raise RigError(f"{given}; give a delimiter that stands in no number, and the decimal . or ,")
        if min(self.lines_before_names, self.lines_after_names) < 0:
            raise RigError("a number of lines in [csv] is negative; give zero or more")


@dataclass(frozen=True)
class _Body:
    """The lines of samples: cells of the first one, and how many lines there are.

    first_line_of has every number of cells and the line that has it first; empty_at_end last cells, which are empty in
    all lines, do not count.
    """

    width: int
    samples: int
    first_line_of: Mapping[int, int]
    empty_at_end: int


def csv_blocks(path: Path, form: TextForm) -> Blocks:
    """One block of all columns that have names and values.

    Raises RigError if the file is not text in the encoding, or its lines do not have equally many cells.
    """
    head = next(islice(_lines(path, form.encoding), form.lines_before_names, None), None)
    if head is None:
        raise RigError(f"{path}: has no line after the first {form.lines_before_names}; check lines_before_names")
    names = [cell.strip() for cell in _cells(head, form.delimiter)]
    named = not all(_is_number(name, form.decimal) for name in names if name)
    skipped = form.lines_before_names + (1 if named else 0) + form.lines_after_names
    body = _counted(path, form, skipped)
    width = body.width
    used = _used_columns(path, names, width, body.empty_at_end) if named else width
    for cells, line in body.first_line_of.items():  # of last columns without a name there may be any number
        if cells != width and (cells < used or used == width):
            raise RigError(
                f"{path}: the number of columns changed from {width} to {cells} in line {line}; check delimiter"
            )
    shown = tuple(names[:used]) if named else tuple(f"column {k}" for k in range(1, used + 1))
    yield ColumnBlock(shown, body.samples, partial(_columns, path, form, skipped, shown, body.samples))


def _lines(path: Path, encoding: str) -> Iterator[str]:
    """Raises RigError where the text is in another encoding, or there is none of that name."""
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


def _samples(path: Path, form: TextForm, skipped: int) -> Iterator[tuple[int, str]]:
    """The lines that hold anything, behind those that are skipped, with their numbers from 1."""
    for number, line in enumerate(islice(_lines(path, form.encoding), skipped, None), start=skipped + 1):
        if not line.isspace():
            yield number, line.rstrip("\n")


def _counted(path: Path, form: TextForm, skipped: int) -> _Body:
    delimiter = form.delimiter
    lines = _samples(path, form, skipped)
    number, first = next(lines, (0, ""))
    if not first:
        raise RigError(f"{path}: holds no samples; export it again")
    first_line_of, samples = {len(_cells(first, delimiter)): number}, 1
    empty = _empty_at_end(first, delimiter)
    for number, line in lines:
        count = line.count(delimiter) + 1 if '"' not in line else len(_cells(line, delimiter))
        if count not in first_line_of:
            first_line_of[count] = number
        if empty:
            empty = min(empty, _empty_at_end(line, delimiter))
        samples += 1
    width = len(_cells(first.rsplit(delimiter, empty)[0] if empty else first, delimiter))
    surplus = next(iter(first_line_of)) - width
    return _Body(width, samples, {count - surplus: number for count, number in first_line_of.items()}, empty)


def _columns(
    path: Path, form: TextForm, skipped: int, names: Sequence[str], samples: int, chosen: Sequence[int]
) -> list[Column]:
    values = np.empty((len(chosen), samples))
    begin = 0
    body = _samples(path, form, skipped)
    while lines := list(islice(body, LINES)):
        if form.decimal != ".":
            _check_decimal(path, form, names, chosen, lines)
        plain = [line if form.decimal == "." else line.replace(form.decimal, ".") for _, line in lines]
        try:
            rows = np.loadtxt(plain, delimiter=form.delimiter, ndmin=2, comments=None, quotechar='"', usecols=chosen)
        except ValueError as error:
            raise _no_number(path, form, names, chosen, lines) from error
        values[:, begin : begin + len(rows)] = rows.T
        begin += len(rows)
    return [Column(names[k], row) for k, row in zip(chosen, values, strict=True)]


def _check_decimal(
    path: Path, form: TextForm, names: Sequence[str], chosen: Sequence[int], lines: Sequence[tuple[int, str]]
) -> None:
    """Raise RigError at a point in a number whose decimal is another: 1.500 is 1500 to some and 1.5 to others."""
    for number, line in lines:
        if "." in line:
            cells = _cells(line, form.delimiter)
            for k in chosen:
                if "." in cells[k]:
                    raise RigError(
                        f"{path}: line {number} has {cells[k].strip()!r} in column {names[k]!r}, and the decimal is "
                        f"{form.decimal!r}; export numbers without points, or correct decimal in the map"
                    )


def _no_number(
    path: Path, form: TextForm, names: Sequence[str], chosen: Sequence[int], lines: Sequence[tuple[int, str]]
) -> RigError:
    for number, line in lines:
        cells = _cells(line, form.delimiter)
        for k in chosen:
            if not _is_number(cells[k], form.decimal):
                return RigError(
                    f"{path}: line {number} has {cells[k].strip()[:50]!r} in column {names[k]!r}, which is no number; "
                    "check encoding, delimiter, decimal and the lines skipped"
                )
    return RigError(f"{path}: lines {lines[0][0]} to {lines[-1][0]} are not of numbers; check delimiter and decimal")


def _cells(line: str, delimiter: str) -> list[str]:
    if len(line) > MAX_LINE:
        raise UnreadableError(f"a line has more than {MAX_LINE} characters")
    return next(csv.reader([line], delimiter=delimiter))


def _empty_at_end(line: str, delimiter: str) -> int:
    """The number of last cells that are empty."""
    return line.count(delimiter, len(line.rstrip(" \t" + delimiter)))


def _used_columns(path: Path, names: list[str], width: int, empty: int) -> int:
    """Count of columns with a name and values; only last ones may lack either."""
    named = next((k for k in range(len(names), 0, -1) if names[k - 1]), 0)
    if width > len(names) or named > width + empty or not named:
        raise RigError(f"{path}: {named} names for {width} columns; check the line of names")
    return min(named, width)


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return "_" not in cell
