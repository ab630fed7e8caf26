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

DIALECTS = (
    ("\t", "."),
    ("\t", ","),
    (";", "."),
    (";", ","),
    (",", "."),
    ("|", "."),
    ("|", ","),
    (" ", "."),
    (" ", ","),
)
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
    best_reading: tuple[int, int, int, tuple[str, str]] | None = None
    for delimiter, decimal in DIALECTS:
        reading_score, first_sample, last_sample = _samples_in(lines, delimiter, decimal)
        if best_reading is None or reading_score > best_reading[0]:
            best_reading = reading_score, first_sample, last_sample, (delimiter, decimal)
    if best_reading is None or best_reading[0] <= 0:
        _check_no_quoted_commas(path, lines)
        raise RigError(
            f"{path}: no lines of numbers are found in its first {len(lines)}, as text in {encoding}, with tab, "
            "semicolon, comma or spaces between and point or comma as decimal; export the samples as text, a line for "
            "each time"
        )
    _, first_sample, last_sample, (delimiter, decimal) = best_reading
    sample_cells = [cells_of(line, delimiter) for line in lines[first_sample : last_sample + 1] if line.strip()]
    column_count = max(map(len, sample_cells))
    if delimiter == ",":
        _check_no_quoted_commas(path, lines[first_sample : last_sample + 1])
    first_sample = _first_sample_line(lines, first_sample, delimiter, decimal)
    header = [names_in(line, delimiter) for line in lines[:first_sample]]
    names_line, units_line = _names_and_units_lines(header, sample_cells, decimal)
    has_names = names_line is not None
    lines_before_names = first_sample if names_line is None else names_line
    is_numeric = all(is_number(cell, decimal) for cell in names_in(lines[first_sample], delimiter) if cell)
    form = TextForm(
        encoding=encoding,
        delimiter=delimiter,
        decimal=decimal,
        lines_before_names=lines_before_names,
        lines_after_names=first_sample - lines_before_names - 1 if has_names else 0,
        names=None if has_names or is_numeric else False,
    )
    return CsvDialect(
        form,
        tuple(header[names_line]) if names_line is not None else (),
        tuple(header[units_line]) if units_line is not None else (),
        tuple(map(tuple, [*header, names_in(lines[first_sample], delimiter)])),
        column_count,
        first_sample + 1,
    )


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
    best_run, current_run = (0, 0, 0), (0, 0, 0)
    text_columns: set[int] | None = None
    for line_index, line in enumerate(lines):
        if not line.strip():
            continue
        cell_kinds = cell_kinds_of(cells_of(line, delimiter)[:MAX_CELLS], decimal)
        number_count = cell_kinds.count("n")
        line_text_columns = {column_index for column_index, cell_kind in enumerate(cell_kinds) if cell_kind == "t"}
        if not number_count or number_count + cell_kinds.count("d") <= len(line_text_columns):
            text_columns = None
            continue
        if line_text_columns != text_columns:
            current_run, text_columns = (0, line_index, line_index), line_text_columns
        current_run = (current_run[0] + number_count - len(line_text_columns), current_run[1], line_index)
        best_run = max(best_run, current_run, key=lambda candidate: candidate[0])
    return best_run


def _check_no_quoted_commas(path: Path, lines: Sequence[str]) -> None:
    if any(re.search(r'"[+-]?\d+,\d+"', line) for line in lines[:100]):
        raise RigError(
            f"{path}: its numbers have commas in quotes between commas; export it with semicolons or tabs between"
        )


def _first_sample_line(lines: Sequence[str], first_line: int, delimiter: str, decimal: str) -> int:
    """First line that has numbers where the samples have them, perhaps with a header beside them."""
    number_columns = [
        k
        for k, cell_kind in enumerate(cell_kinds_of(cells_of(lines[first_line], delimiter), decimal))
        if cell_kind == "n"
    ]
    while first_line:
        cell_kinds = cell_kinds_of(cells_of(lines[first_line - 1], delimiter), decimal)
        if not all(column < len(cell_kinds) and cell_kinds[column] == "n" for column in number_columns):
            break
        first_line -= 1
    return first_line


def _names_and_units_lines(
    header_cells: Sequence[Sequence[str]], sample_cells: Sequence[Sequence[str]], decimal: str
) -> tuple[int | None, int | None]:
    """Line of names and line of units in a header; None if there is none.

    A line of names has a text for at least all but one of the columns; of several the one with the most different
    texts, and of those the lowest.
    """
    used_columns = [
        k for k in range(max(map(len, sample_cells))) if any(k < len(row) and row[k].strip() for row in sample_cells)
    ]
    needed_count = max(1, len(used_columns) - 1)
    names_line, units_line, best_score = None, None, 0.0
    for line_index in range(len(header_cells) - 1, max(-1, len(header_cells) - 1 - HEADER_LINE_COUNT), -1):
        cells = header_cells[line_index]
        cell_kinds = cell_kinds_of(cells, decimal)
        filled_cells = [cell for cell in cells if cell]
        if (
            not filled_cells
            or len(cells) < used_columns[-1] + 1
            or cell_kinds.count("t") < min(needed_count, max(1, len(filled_cells) / 2))
        ):
            continue
        are_units = [is_unit(cell.strip("[]()")) for cell in filled_cells]
        if (
            sum(are_units) >= len(filled_cells) / 2
            and len(cells) > 1
            and not any(map(TIME_NAME_PATTERN.search, _non_unit_cells(filled_cells)))
        ):
            units_line = line_index if units_line is None else units_line
        elif len(filled_cells) >= needed_count:
            line_score = len(set(filled_cells)) + (0.5 if any(map(TIME_NAME_PATTERN.search, filled_cells)) else 0.0)
            if line_score > best_score:
                names_line, best_score = line_index, line_score
    return names_line, units_line


def _non_unit_cells(cells: Sequence[str]) -> list[str]:
    """Cells that are no unit alone: 's' is one, 'time' is none."""
    return [cell for cell in cells if not is_unit(cell.strip("[]()"))]
