"""Dialect of a CSV file found from its text: encoding, separators, and the lines of names, units and samples."""

import codecs
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path

from rig.errors import RigError
from rig.lab.csv_text import TextForm, cells_of, is_number, lines_of, names_in
from rig.lab.recorded import MAX_HEADER_LINES
from rig.lab.units import is_unit

DIALECTS = [(delimiter, decimal) for delimiter in "\t;,| " for decimal in ".," if delimiter != decimal]
"""Delimiters and decimal separators, of which the first of equally good ones is taken."""
BYTES_AT_ONCE = 1 << 20
HEADER_LINE_COUNT = 12
"""Lines above the samples among which the names and units are."""
MAX_CELLS = 100_000
STAMP_PATTERN = re.compile(
    r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})?[ T]*(\d\d?:\d\d(:\d\d([.,]\d{1,9})?)?)?(Z|[+-]\d\d:?\d\d)?"
)
"""A date, a time of day, or both."""
TIME_NAME_PATTERN = re.compile(
    r"^\W*(t|time|zeit|temps|tiempo|x_?value|x-?axis|x|second|sek|timestamp|elapsed|datetime|date)(?![a-z])|time|zeit",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class CsvDialect:
    """Form of a CSV file, the names and units above its columns, and the lines before the samples as cells.

    names is empty where the file has none; units has an entry (perhaps empty) for each column where there is a line of
    units. first_line and last_line are those of the samples, counted from 1.
    """

    form: TextForm
    names: tuple[str, ...]
    units: tuple[str, ...]
    header: tuple[tuple[str, ...], ...]
    column_count: int
    first_line: int


def dialect_of(path: Path) -> CsvDialect:
    """Dialect of a CSV file; raises RigError if no lines of numbers are found in it."""
    encoding = _text_encoding(path)
    lines = [line.rstrip("\r\n") for line in islice(lines_of(path, encoding), MAX_HEADER_LINES)]
    readings = [(*_samples_in(lines, *dialect), *dialect) for dialect in DIALECTS]
    score, first, last, delimiter, decimal = max(readings, key=lambda reading: reading[0])
    if score <= 0:
        _check_no_quoted_commas(path, lines)
        raise RigError(
            f"{path}: no lines of numbers are found in its first {len(lines)}, as text in {encoding}, with tab, "
            "semicolon, comma or spaces between and point or comma as decimal; export the samples as text, a line for "
            "each time"
        )
    sample_cells = [cells_of(line, delimiter) for line in lines[first : last + 1] if line.strip()]
    if delimiter == ",":
        _check_no_quoted_commas(path, lines[first : last + 1])
    first = _first_sample_line(lines, first, delimiter, decimal)
    header = [tuple(names_in(line, delimiter)) for line in lines[: first + 1]]
    names_line, units_line = _names_and_units_lines(header[:first], sample_cells, decimal)
    has_names = names_line is not None
    lines_before_names = first if names_line is None else names_line
    is_numeric = all(is_number(cell, decimal) for cell in header[first] if cell)
    form = TextForm(
        encoding=encoding,
        delimiter=delimiter,
        decimal=decimal,
        lines_before_names=lines_before_names,
        lines_after_names=first - lines_before_names - 1 if has_names else 0,
        names=None if has_names or is_numeric else False,
    )
    names = header[names_line] if names_line is not None else ()
    units = header[units_line] if units_line is not None else ()
    return CsvDialect(form, names, units, tuple(header), max(map(len, sample_cells)), first + 1)


def is_stamp(cell: str) -> bool:
    """True if a cell is a date, a time of day, or both."""
    text = cell.strip()
    return any(separator in text for separator in ":-/.") and bool(text) and STAMP_PATTERN.fullmatch(text) is not None


def cell_kinds_of(cells: Sequence[str], decimal: str) -> str:
    """Letter for each cell: n for a number, d for a date or time of day, e if it is empty, t for other text."""
    return "".join(
        "e" if not cell.strip() else "n" if is_number(cell, decimal) else "d" if is_stamp(cell) else "t"
        for cell in cells
    )


def _text_encoding(path: Path) -> str:
    """Encoding by the byte order mark, by zeros between the bytes, or by what can be decoded."""
    with path.open("rb") as stream:
        first_bytes = stream.read(1000)
    if first_bytes.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if (zero_count := first_bytes.count(0)) > len(first_bytes) / 4:
        return "utf-16-le" if first_bytes[1::2].count(0) > zero_count / 2 else "utf-16-be"
    try:
        for _ in _decoded_pieces(path, "utf-8"):
            pass
    except UnicodeDecodeError:
        return _western_encoding(path)
    return "utf-8-sig"


def _western_encoding(path: Path) -> str:
    """Latin-1, or Windows' own (cp1252) where signs are used that only that has."""
    with path.open("rb") as stream:
        used_bytes = set().union(*(set(piece) for piece in iter(partial(stream.read, BYTES_AT_ONCE), b"")))
    if 0 in used_bytes:
        raise RigError(f"{path}: is not text; check what it is, and export the samples as text")
    if not used_bytes & set(range(0x80, 0xA0)):
        return "latin-1"
    try:
        bytes(used_bytes).decode("cp1252")
    except UnicodeDecodeError:
        return "latin-1"
    return "cp1252"


def _decoded_pieces(path: Path, encoding: str) -> Iterator[str]:
    decoder = codecs.getincrementaldecoder(encoding)()
    with path.open("rb") as stream:
        for piece in chain(iter(partial(stream.read, BYTES_AT_ONCE), b""), [b""]):
            yield decoder.decode(piece, final=not piece)


def _samples_in(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[int, int, int]:
    """Numbers less texts of the longest run of lines of samples, and its first and last line.

    Lines of a run have their texts, if any, in the same columns, and more numbers and dates than texts.
    """
    best, run = (0, 0, 0), (0, 0, 0)
    text_columns: set[int] | None = None
    for index, line in enumerate(lines):
        if not line.strip():
            continue
        kinds = cell_kinds_of(cells_of(line, delimiter)[:MAX_CELLS], decimal)
        number_count = kinds.count("n")
        line_text_columns = {column for column, kind in enumerate(kinds) if kind == "t"}
        if not number_count or number_count + kinds.count("d") <= len(line_text_columns):
            text_columns = None
            continue
        if line_text_columns != text_columns:
            run, text_columns = (0, index, index), line_text_columns
        run = (run[0] + number_count - len(line_text_columns), run[1], index)
        best = max(best, run, key=lambda candidate: candidate[0])
    return best


def _check_no_quoted_commas(path: Path, lines: Sequence[str]) -> None:
    if any(re.search(r'"[+-]?\d+,\d+"', line) for line in lines[:100]):
        raise RigError(
            f"{path}: its numbers have commas in quotes between commas; export it with semicolons or tabs between"
        )


def _first_sample_line(lines: Sequence[str], first_line: int, delimiter: str, decimal: str) -> int:
    """First line that has numbers where the samples have them, perhaps with a header beside them."""

    def number_columns(line: str) -> set[int]:
        return {k for k, kind in enumerate(cell_kinds_of(cells_of(line, delimiter), decimal)) if kind == "n"}

    needed = number_columns(lines[first_line])
    while first_line and needed <= number_columns(lines[first_line - 1]):
        first_line -= 1
    return first_line


def _names_and_units_lines(
    header_cells: Sequence[Sequence[str]], sample_cells: Sequence[Sequence[str]], decimal: str
) -> tuple[int | None, int | None]:
    """Line of names and line of units in a header; None if there is none.

    A line of names has a text for at least all but one of the columns; of several the one with the most different
    texts, and of those the lowest.
    """
    used_columns = {k for row in sample_cells for k, cell in enumerate(row) if cell.strip()}
    needed_count = max(1, len(used_columns) - 1)
    names_line, units_line, best_score = None, None, 0.0
    for index in range(len(header_cells) - 1, max(-1, len(header_cells) - 1 - HEADER_LINE_COUNT), -1):
        cells = header_cells[index]
        filled = [cell for cell in cells if cell]
        text_count, half_count = cell_kinds_of(cells, decimal).count("t"), len(filled) / 2
        is_wide = len(cells) > max(used_columns)
        if not filled or not is_wide or text_count < min(needed_count, max(1, half_count)):
            continue
        words = [cell for cell in filled if not is_unit(cell.strip("[]()"))]  # "s" is a unit, "time" is none
        has_units = len(filled) - len(words) >= half_count and len(cells) > 1
        if has_units and not any(map(TIME_NAME_PATTERN.search, words)):
            units_line = index if units_line is None else units_line
        elif len(filled) >= needed_count:
            score = len(set(filled)) + (0.5 if any(map(TIME_NAME_PATTERN.search, filled)) else 0.0)
            if score > best_score:
                names_line, best_score = index, score
    return names_line, units_line
