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
LINES_ABOVE = 12
"""Lines above the samples among which the names and units are."""
MAX_CELLS = 100_000
STAMP = re.compile(
    r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})?[ T]*(\d\d?:\d\d(:\d\d([.,]\d{1,9})?)?)?(Z|[+-]\d\d:?\d\d)?"
)
"""A date, a time of day, or both."""
TIME_NAME = re.compile(
    r"^\W*(t|time|zeit|temps|tiempo|x_?value|x-?axis|x|second|sek|timestamp|elapsed|datetime|date)(?![a-z])|time|zeit",
    re.IGNORECASE,
)
_EXCEL_DELIMITER = re.compile(r"^sep=(?P<delimiter>.)$", re.IGNORECASE)


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
    width: int
    first_line: int


def dialect_of(path: Path) -> CsvDialect:
    """Dialect of a CSV file; raises RigError if no lines of numbers are found in it."""
    encoding = _encoding(path)
    lines = [line.rstrip("\r\n") for line in islice(lines_of(path, encoding), MAX_HEADER_LINES)]
    best: tuple[int, int, int, tuple[str, str]] | None = None
    for delimiter, decimal in DIALECTS:
        score, first, last = _samples_in(lines, delimiter, decimal)
        if best is None or score > best[0]:
            best = score, first, last, (delimiter, decimal)
    if best is None or best[0] <= 0:
        _check_no_quoted_commas(path, lines)
        raise RigError(
            f"{path}: no lines of numbers are found in its first {len(lines)}, as text in {encoding}, with tab, "
            "semicolon, comma or spaces between and point or comma as decimal; export the samples as text, a line for "
            "each time"
        )
    _, first, last, (delimiter, decimal) = best
    cells = [cells_of(line, delimiter) for line in lines[first : last + 1] if line.strip()]
    width = max(map(len, cells))
    if delimiter == ",":
        _check_no_quoted_commas(path, lines[first : last + 1])
    first = _first_sample(lines, first, delimiter, decimal)
    header = [names_in(line, delimiter) for line in lines[:first]]
    names_line, units_line = _names_and_units(header, cells, decimal)
    named = names_line is not None
    before = first if names_line is None else names_line
    numeric = all(is_number(cell, decimal) for cell in names_in(lines[first], delimiter) if cell)
    form = TextForm(
        encoding=encoding,
        delimiter=delimiter,
        decimal=decimal,
        lines_before_names=before,
        lines_after_names=first - before - 1 if named else 0,
        names=None if named or numeric else False,
    )
    return CsvDialect(
        form,
        tuple(header[names_line]) if names_line is not None else (),
        tuple(header[units_line]) if units_line is not None else (),
        tuple(map(tuple, [*header, names_in(lines[first], delimiter)])),
        width,
        first + 1,
    )


def is_stamp(cell: str) -> bool:
    """True if a cell is a date, a time of day, or both."""
    text = cell.strip()
    return any(mark in text for mark in ":-/.") and bool(text) and STAMP.fullmatch(text) is not None


def kinds_of(cells: Sequence[str], decimal: str) -> str:
    """Letter for each cell: n for a number, d for a date or time of day, e if it is empty, t for other text."""
    return "".join(
        "e" if not cell.strip() else "n" if is_number(cell, decimal) else "d" if is_stamp(cell) else "t"
        for cell in cells
    )


def _encoding(path: Path) -> str:
    """Encoding by the byte order mark, by zeros between the bytes, or by what can be decoded."""
    with path.open("rb") as stream:
        head = stream.read(1000)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if (zeros := head.count(0)) > len(head) / 4:
        return "utf-16-le" if head[1::2].count(0) > zeros / 2 else "utf-16-be"
    try:
        for _ in _decoded_pieces(path, "utf-8"):
            pass
    except UnicodeDecodeError:
        return _western(path)
    return "utf-8-sig"


def _western(path: Path) -> str:
    """Latin-1, or Windows' own (cp1252) where signs are used that only that has."""
    with path.open("rb") as stream:
        used = set().union(*(set(piece) for piece in iter(partial(stream.read, BYTES_AT_ONCE), b"")))
    if 0 in used:
        raise RigError(f"{path}: is not text; check what it is, and export the samples as text")
    if not used & set(range(0x80, 0xA0)):
        return "latin-1"
    try:
        bytes(used).decode("cp1252")
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
    texts: set[int] | None = None
    for number, line in enumerate(lines):
        if not line.strip():
            continue
        kinds = kinds_of(cells_of(line, delimiter)[:MAX_CELLS], decimal)
        numbers = kinds.count("n")
        here = {k for k, kind in enumerate(kinds) if kind == "t"}
        if not numbers or numbers + kinds.count("d") <= len(here):
            texts = None
            continue
        if here != texts:
            run, texts = (0, number, number), here
        run = (run[0] + numbers - len(here), run[1], number)
        best = max(best, run, key=lambda candidate: candidate[0])
    return best


def _check_no_quoted_commas(path: Path, lines: Sequence[str]) -> None:
    if any(re.search(r'"[+-]?\d+,\d+"', line) for line in lines[:100]):
        raise RigError(
            f"{path}: its numbers have commas in quotes between commas; export it with semicolons or tabs between"
        )


def _first_sample(lines: Sequence[str], first: int, delimiter: str, decimal: str) -> int:
    """First line that has numbers where the samples have them, perhaps with a header beside them."""
    numeric = [k for k, kind in enumerate(kinds_of(cells_of(lines[first], delimiter), decimal)) if kind == "n"]
    while first:
        kinds = kinds_of(cells_of(lines[first - 1], delimiter), decimal)
        if not all(k < len(kinds) and kinds[k] == "n" for k in numeric):
            break
        first -= 1
    return first


def _names_and_units(
    header: Sequence[Sequence[str]], samples: Sequence[Sequence[str]], decimal: str
) -> tuple[int | None, int | None]:
    """Line of names and line of units in a header; None if there is none.

    A line of names has a text for at least all but one of the columns; of several the one with the most different
    texts, and of those the lowest.
    """
    used = [k for k in range(max(map(len, samples))) if any(k < len(row) and row[k].strip() for row in samples)]
    needed = max(1, len(used) - 1)
    names_line, units_line, most = None, None, 0.0
    for number in range(len(header) - 1, max(-1, len(header) - 1 - LINES_ABOVE), -1):
        cells = header[number]
        kinds = kinds_of(cells, decimal)
        filled = [cell for cell in cells if cell]
        if not filled or len(cells) < used[-1] + 1 or kinds.count("t") < min(needed, max(1, len(filled) / 2)):
            continue
        units = [is_unit(cell.strip("[]()")) for cell in filled]
        if sum(units) >= len(filled) / 2 and len(cells) > 1 and not any(map(TIME_NAME.search, _longer(filled))):
            units_line = number if units_line is None else units_line
        elif len(filled) >= needed:
            score = len(set(filled)) + (0.5 if any(map(TIME_NAME.search, filled)) else 0.0)
            if score > most:
                names_line, most = number, score
    return names_line, units_line


def _longer(cells: Sequence[str]) -> list[str]:
    """Cells that are no unit alone: 's' is one, 'time' is none."""
    return [cell for cell in cells if not is_unit(cell.strip("[]()"))]
