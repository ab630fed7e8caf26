"""Time histories of a UFF file (dataset 58), text or binary, each decoded in place.

TextLayout: "Universal Dataset Number: 58" and "58b", SDRC; widths of columns are those of its FORTRAN formats.
"""

import mmap
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, islice, pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.lab.column import Blocks, Column, ColumnBlock, Refused, UnreadableError, utf8_or_latin1_text

MARK_PATTERN = re.compile(rb" {4}-1[ ]*(?:[\r\n]+|\Z)")
"""Line that opens or closes a dataset; it directly follows the numbers of a binary one."""
MARK_LINE_PATTERN = re.compile(rb"(?:\A|(?<=[\r\n]))" + MARK_PATTERN.pattern)
LINE_PATTERN = re.compile(rb"([^\r\n]*)(?:\r\n|\r|\n|\Z)")
TIME_RESPONSE_CODE, EVEN_CODE = 1, 1
SINGLE_CODE, DOUBLE_CODE = 2, 4
"""Codes of real number types; those of complex ones are 5 and 6."""
NUMBER_WIDTHS = {
    (SINGLE_CODE, True): (13,) * 6,
    (SINGLE_CODE, False): (13,) * 6,
    (DOUBLE_CODE, True): (20,) * 4,
    (DOUBLE_CODE, False): (13, 20) * 2,
}
"""Widths (characters) of the numbers of a text line, by type and by whether the abscissas are even and left out."""
LINES_PER_BLOCK = 4096
"""Lines of text converted at once."""


@dataclass(frozen=True)
class Dataset:
    """A dataset: its type, whether it is binary, and its offsets, behind the opening mark and at the closing one."""

    type_code: int
    is_binary: bool
    start_offset: int
    stop_offset: int


@dataclass(frozen=True)
class _History:
    """Header of a dataset 58, and the offsets of its numbers."""

    name: str
    unit: str | None
    type_code: int
    point_count: int
    is_even: bool
    interval_s: float
    byte_order: str
    """Byte order of a binary dataset, < or >; empty for text."""
    start_offset: int
    stop_offset: int
    date_text: str
    """ID lines two to five, of which one states the date."""

    @property
    def value_count(self) -> int:
        return self.point_count if self.is_even else 2 * self.point_count


def uff_blocks(path: Path) -> Blocks:
    """Block per time history; one with uneven abscissas has the column NAME time before it.

    Raises UnreadableError if the file is cut off.
    """
    with path.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        for dataset in datasets_of(content):
            if dataset.type_code == 58:
                yield _history_block(content, dataset)


def check_uff_is_complete(path: Path) -> None:
    """Raise UnreadableError if the last dataset is incomplete, or there is none."""
    with path.open("rb") as stream:
        for _ in datasets_of(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)):
            pass


def datasets_of(content: mmap.mmap) -> Iterator[Dataset]:
    """Datasets in order; raises UnreadableError if the last one is incomplete, or there is none."""
    opening_mark = MARK_LINE_PATTERN.search(content)
    if opening_mark is None:
        raise UnreadableError("it has no dataset")
    while opening_mark is not None:
        start_offset = opening_mark.end()
        type_line = _line(content, start_offset)[0]
        type_text, is_binary = type_line[:6].strip(), type_line[6:7].lower() == b"b"
        if not type_text.isdigit():
            raise UnreadableError(f"its dataset at byte {start_offset} has no number, or is cut off")
        closing_mark = _closing_mark(content, start_offset, type_line if is_binary else b"")
        if closing_mark is None:
            raise UnreadableError(f"its dataset at byte {start_offset} is cut off")
        yield Dataset(int(type_text), is_binary, start_offset, closing_mark.start())
        offset = closing_mark.end()
        opening_mark = MARK_LINE_PATTERN.search(content, offset)
    if re.compile(rb"\S| \Z").search(content, offset):
        raise UnreadableError(f"it is cut off at byte {offset}, behind its last whole dataset")


def _closing_mark(content: mmap.mmap, start_offset: int, binary_head: bytes) -> re.Match[bytes] | None:
    """Mark that closes a dataset; the head of a binary one states how many bytes precede it."""
    if binary_head:
        _, _, offset = _header(content, start_offset)
        byte_count = _integer(binary_head, 31, 43)
        for gap_bytes in range(3):  # some programs end the numbers by a line end
            if byte_count > 0 and (closing_mark := MARK_PATTERN.match(content, offset + byte_count + gap_bytes)):
                return closing_mark
        return MARK_PATTERN.search(content, offset)
    return MARK_LINE_PATTERN.search(content, start_offset)


def _line(content: mmap.mmap, offset: int) -> tuple[bytes, int]:
    """Line at an offset, and the offset of the next."""
    line_match = LINE_PATTERN.match(content, offset)
    if line_match is None:
        raise UnreadableError("a dataset has no header")
    return line_match[1], line_match.end()


def _header(content: mmap.mmap, offset: int) -> tuple[bytes, list[str], int]:
    """Line of the type, the eleven lines below it, and the offset of the numbers."""
    type_line, offset = _line(content, offset)
    header_lines = []
    for _ in range(11):
        line, offset = _line(content, offset)
        header_lines.append(utf8_or_latin1_text(line[:200]))
    return type_line, header_lines, offset


def _integer(line: bytes | str, first_character: int, end_character: int) -> int:
    try:
        return int(line[first_character:end_character])
    except ValueError:
        raise UnreadableError(f"its header has {line[first_character:end_character]!r} in place of a number") from None


def _history_block(content: mmap.mmap, dataset: Dataset) -> ColumnBlock | Refused:
    type_line, header_lines, numbers_offset = _header(content, dataset.start_offset)
    name = header_lines[0][:80].strip()
    unit = header_lines[8][46:67].strip()
    type_code = _integer(header_lines[6], 0, 10)
    if _integer(header_lines[5], 0, 5) != TIME_RESPONSE_CODE or type_code not in (SINGLE_CODE, DOUBLE_CODE):
        return Refused(name, f"dataset {name!r} is no time history; export time histories alone")
    try:
        interval_s = float(header_lines[6][43:56])
    except ValueError:
        interval_s = 0.0
    history = _History(
        name=name,
        unit=unit if unit and unit != "NONE" else None,
        type_code=type_code,
        point_count=_integer(header_lines[6], 10, 20),
        is_even=_integer(header_lines[6], 20, 30) == EVEN_CODE,
        interval_s=interval_s,
        byte_order=("<" if _integer(type_line, 7, 13) == 1 else ">") if dataset.is_binary else "",
        start_offset=numbers_offset,
        stop_offset=dataset.stop_offset,
        date_text=" ".join(line[:80].strip() for line in (header_lines[2], header_lines[1], *header_lines[3:5])),
    )
    number_bytes = min(NUMBER_WIDTHS[type_code, history.is_even])
    if dataset.is_binary:
        number_bytes = 4 if type_code == SINGLE_CODE else 8
    number_count = (dataset.stop_offset - numbers_offset) // number_bytes
    has_wrong_length = number_count != history.value_count if dataset.is_binary else number_count < history.value_count
    if history.point_count < 0 or has_wrong_length:
        raise _wrong_length_error(name, number_count, history.is_even, history.point_count)
    read_columns = partial(_read_columns, content, history)
    if history.is_even:
        return ColumnBlock((name,), history.point_count, read_columns)
    return ColumnBlock((f"{name} time", name), history.point_count, read_columns, 16 * history.point_count)


def _read_columns(content: mmap.mmap, history: _History, column_indices: Sequence[int]) -> list[Column]:
    values = _binary_numbers(content, history) if history.byte_order else _text_numbers(content, history)
    if history.is_even:
        rate_hz = 1 / history.interval_s if history.interval_s > 0 and history.point_count > 1 else None
        return [Column(history.name, values, history.unit, rate_hz, history.date_text)]
    columns = (
        Column(f"{history.name} time", values[::2].copy(), "s"),
        Column(history.name, values[1::2].copy(), history.unit, None, history.date_text),
    )
    return [columns[k] for k in column_indices]


def _binary_numbers(content: mmap.mmap, history: _History) -> Float[np.ndarray, " numbers"]:
    numpy_type = f"{history.byte_order}f{4 if history.type_code == SINGLE_CODE else 8}"
    return np.frombuffer(content, numpy_type, history.value_count, history.start_offset).astype(float)


def _text_numbers(content: mmap.mmap, history: _History) -> Float[np.ndarray, " numbers"]:
    spans = list(pairwise(accumulate(NUMBER_WIDTHS[history.type_code, history.is_even], initial=0)))
    history_numbers, number_count = np.empty(history.value_count), 0
    lines = (match[1] for match in LINE_PATTERN.finditer(content, history.start_offset, history.stop_offset))
    while line_batch := list(islice(lines, LINES_PER_BLOCK)):
        numbers = [float(cell) for line in line_batch for first, last in spans if (cell := line[first:last].strip())]
        if number_count + len(numbers) <= history_numbers.size:
            history_numbers[number_count : number_count + len(numbers)] = numbers
        number_count += len(numbers)
    if number_count != history_numbers.size:
        raise _wrong_length_error(history.name, number_count, history.is_even, history.point_count)
    return history_numbers


def _wrong_length_error(name: str, value_count: int, is_even: bool, point_count: int) -> UnreadableError:
    return UnreadableError(
        f"its dataset {name!r} holds {value_count if is_even else value_count // 2} of {point_count} samples"
    )
