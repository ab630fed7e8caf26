"""Form of a CSV file found from its text: encoding, separators, and the lines of names and samples."""

import codecs
import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, islice
from pathlib import Path

from rig.errors import RigError
from rig.lab.csv_layout import HEADER_LINE_COUNT, TIME_NAME_PATTERN, is_units_row
from rig.lab.csv_text import TextForm, cell_kind_letters, cells_of, is_number, lines_of, names_in
from rig.lab.recorded import MAX_HEADER_LINES

DELIMITERS_AND_DECIMALS = [(delimiter, decimal) for delimiter in "\t;,| " for decimal in ".," if delimiter != decimal]
"""Delimiters and decimal separators, of which the first of equally good ones is taken."""
BYTES_PER_READ = 1 << 20
MAX_CELL_COUNT = 100_000


def text_form_of(path: Path) -> TextForm:
    """Form of a CSV file; raises RigError if no lines of numbers are found in it."""
    encoding = _text_encoding(path)
    lines = [line.rstrip("\r\n") for line in islice(lines_of(path, encoding), MAX_HEADER_LINES)]
    scored_runs = [(*_longest_numeric_run(lines, *separators), *separators) for separators in DELIMITERS_AND_DECIMALS]
    best_score, first_line, last_line, delimiter, decimal = max(scored_runs, key=lambda scored_run: scored_run[0])
    if best_score <= 0:
        _check_no_quoted_commas(path, lines)
        raise RigError(
            f"{path}: no lines of numbers are found in its first {len(lines)}, as text in {encoding}, with tab, "
            "semicolon, comma or spaces between and point or comma as decimal; export the samples as text, a line for "
            "each time"
        )
    sample_cells = [cells_of(line, delimiter) for line in lines[first_line : last_line + 1] if line.strip()]
    if delimiter == ",":
        _check_no_quoted_commas(path, lines[first_line : last_line + 1])
    first_line = _first_sample_line(lines, first_line, delimiter, decimal)
    header_cells = [names_in(line, delimiter) for line in lines[: first_line + 1]]
    names_line = _names_line(header_cells[:first_line], sample_cells, decimal)
    has_names = names_line is not None
    lines_before_names = first_line if names_line is None else names_line
    is_numeric = all(is_number(cell, decimal) for cell in header_cells[first_line] if cell)
    return TextForm(
        encoding=encoding,
        delimiter=delimiter,
        decimal=decimal,
        lines_before_names=lines_before_names,
        lines_after_names=first_line - lines_before_names - 1 if has_names else 0,
        names=None if has_names or is_numeric else False,
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
        byte_values = set().union(*(set(piece) for piece in iter(partial(stream.read, BYTES_PER_READ), b"")))
    if 0 in byte_values:
        raise RigError(f"{path}: is not text; check what it is, and export the samples as text")
    if not byte_values & set(range(0x80, 0xA0)):
        return "latin-1"
    try:
        bytes(byte_values).decode("cp1252")
    except UnicodeDecodeError:
        return "latin-1"
    return "cp1252"


def _decoded_pieces(path: Path, encoding: str) -> Iterator[str]:
    decoder = codecs.getincrementaldecoder(encoding)()
    with path.open("rb") as stream:
        for piece in chain(iter(partial(stream.read, BYTES_PER_READ), b""), [b""]):
            yield decoder.decode(piece, final=not piece)


def _longest_numeric_run(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[int, int, int]:
    """Numbers less texts of the longest run of lines of samples, and its first and last line.

    Lines of a run have their texts, if any, in the same columns, and more numbers and dates than texts.
    """
    best_run, current_run = (0, 0, 0), (0, 0, 0)
    text_columns: set[int] | None = None
    for line_index, line in enumerate(lines):
        if not line.strip():
            continue
        cell_kinds = cell_kind_letters(cells_of(line, delimiter)[:MAX_CELL_COUNT], decimal)
        number_count = cell_kinds.count("n")
        line_text_columns = {column_index for column_index, kind in enumerate(cell_kinds) if kind == "t"}
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
    """First line that has numbers where the samples have them, perhaps with a header beside them.

    Lines that have a word in place of one of several numbers are passed over.
    """

    def number_columns(cells: Sequence[str]) -> set[int]:
        return {k for k, kind in enumerate(cell_kind_letters(cells, decimal)) if kind == "n"}

    first_cells = cells_of(lines[first_line], delimiter)
    needed_columns = number_columns(first_cells)
    for line_index in range(first_line - 1, -1, -1):
        cells = cells_of(lines[line_index], delimiter)
        present_columns = needed_columns & number_columns(cells)
        if present_columns == needed_columns:
            first_line = line_index
        elif lines[line_index].strip() and (not present_columns or len(cells) != len(first_cells)):
            break
    return first_line


def _names_line(
    header_cells: Sequence[Sequence[str]], sample_cells: Sequence[Sequence[str]], decimal: str
) -> int | None:
    """Line of names in a header; None if there is none.

    It has a text for at least all but one of the columns and is no line of units; of several the one with the most
    different texts, and of those the lowest.
    """
    used_columns = {column_index for row in sample_cells for column_index, cell in enumerate(row) if cell.strip()}
    needed_count = max(1, len(used_columns) - 1)
    names_line, best_score = None, 0.0
    for line_index in range(len(header_cells) - 1, max(-1, len(header_cells) - 1 - HEADER_LINE_COUNT), -1):
        cells = header_cells[line_index]
        filled_cells = [cell for cell in cells if cell]
        text_count, half_count = cell_kind_letters(cells, decimal).count("t"), len(filled_cells) / 2
        is_wide = len(cells) > max(used_columns)
        if not filled_cells or not is_wide or text_count < min(needed_count, max(1, half_count)):
            continue
        if not is_units_row(cells) and len(filled_cells) >= needed_count:
            name_score = len(set(filled_cells)) + (0.5 if any(map(TIME_NAME_PATTERN.search, filled_cells)) else 0.0)
            if name_score > best_score:
                names_line, best_score = line_index, name_score
    return names_line
