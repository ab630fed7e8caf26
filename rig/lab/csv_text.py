"""Text of a CSV file: its form, lines, cells and numbers."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import msgspec

from rig.errors import RigError
from rig.lab.column import UnreadableError

TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".asc", ".lvm", ".dat")
MAX_LINE_LENGTH = 1_000_000
"""Longest line, characters."""
LINES_PER_BLOCK = 8192
"""Lines converted at once."""
_D_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]\d)")
"""Mark of an exponent as FORTRAN writes it."""
STAMP_PATTERN = re.compile(
    r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})?[ T]*"
    r"(\d\d?:\d\d(:\d\d([.,]\d{1,9})?)?)?( ?[AaPp]\.?[Mm]\.?)?(Z|[+-]\d\d:?\d\d)?"
)
"""A date, a time of day, or both."""
_COMMENT_MARK = re.compile(r"^\s*[#%]+\s*(?=[^\s,;|])")
UNFIT_ENCODINGS = {"idna", "punycode", "undefined", "unicode_escape", "raw_unicode_escape"}
"""Python codecs that no measured data uses; the first two take quadratic time."""


class TextForm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Format of a CSV file: a line of names between lines that are skipped.

    The delimiter " " stands for any white space. Without `names` the samples follow the lines before the names; None
    leaves it to the line, which is one of names unless it holds numbers alone. cut_incomplete_end leaves out last lines
    that lack a number in a requested column. Of several records one after another, sample_lines (None: all) is how many
    lines of samples are read.
    """

    encoding: str = "utf-8-sig"
    delimiter: str = ","
    decimal: str = "."
    lines_before_names: int = 0
    lines_after_names: int = 0
    names: bool | None = None
    cut_incomplete_end: bool = False
    sample_lines: int | None = None

    def __post_init__(self) -> None:
        description = f"delimiter is {self.delimiter!r} and decimal {self.decimal!r}"
        if len(self.delimiter) != 1 or len(self.decimal) != 1 or self.delimiter == self.decimal:
            raise RigError(f"{description}; give two different characters")
        if self.delimiter.isalnum() or self.delimiter in '+-"\r\n\0' or self.decimal not in ".,":
            raise RigError(f"{description}; give a delimiter that stands in no number, and the decimal . or ,")
        if min(self.lines_before_names, self.lines_after_names, self.sample_lines or 0) < 0:
            raise RigError("a number of lines in [csv] is negative; give zero or more")


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
    """Lines of samples, none of them blank, after the skipped ones, with their numbers from 1."""
    lines = enumerate(islice(lines_of(path, form.encoding), skipped_line_count, None), start=skipped_line_count + 1)
    filled_lines = ((line_number, line.rstrip("\n")) for line_number, line in lines if not line.isspace())
    return islice(filled_lines, form.sample_lines)


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


def is_number(cell: str, decimal: str) -> bool:
    """True if a cell is a number, perhaps not finite."""
    return _float_or_none(cell, decimal) is not None


def finite_number_or_none(cell: str, decimal: str) -> float | None:
    """Finite number in a cell; None if there is none, or it has the other decimal separator."""
    number = _float_or_none(cell, decimal)
    if number is None or not math.isfinite(number) or (decimal != "." and "." in cell):
        return None
    return number


def is_date_or_time(cell: str) -> bool:
    """True if a cell is a date, a time of day, or both."""
    text = cell.strip()
    return any(separator in text for separator in ":-/.") and bool(text) and STAMP_PATTERN.fullmatch(text) is not None


def cell_kind_letters(cells: Sequence[str], decimal: str) -> str:
    """Letter for each cell: n for a number, d for a date or time of day, e if it is empty, t for other text."""
    return "".join(
        "e" if not cell.strip() else "n" if is_number(cell, decimal) else "d" if is_date_or_time(cell) else "t"
        for cell in cells
    )


def _float_or_none(cell: str, decimal: str) -> float | None:
    if "_" in cell or not cell:
        return None
    number_text = cell if decimal == "." else cell.replace(decimal, ".")
    try:
        return float(number_text)
    except ValueError:
        pass
    try:
        return float(_D_EXPONENT.sub("e", number_text))
    except ValueError:
        return None
