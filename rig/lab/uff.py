"""Time histories of a UFF file (dataset 58), text or binary, each decoded in place.

Layout: "Universal Dataset Number: 58" and "58b", SDRC; widths of columns are those of its FORTRAN formats.
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

from rig.lab.column import Blocks, Column, ColumnBlock, Refused, UnreadableError, decode_text

MARK = re.compile(rb" {4}-1[ ]*(?:[\r\n]+|\Z)")
"""Line that opens or closes a dataset; it directly follows the numbers of a binary one."""
LINE_OF_MARK = re.compile(rb"(?:\A|(?<=[\r\n]))" + MARK.pattern)
LINE = re.compile(rb"([^\r\n]*)(?:\r\n|\r|\n|\Z)")
TIME_RESPONSE, EVEN = 1, 1
SINGLE, DOUBLE = 2, 4
"""Codes of real number types; those of complex ones are 5 and 6."""
WIDTHS = {
    (SINGLE, True): (13,) * 6,
    (SINGLE, False): (13,) * 6,
    (DOUBLE, True): (20,) * 4,
    (DOUBLE, False): (13, 20) * 2,
}
"""Widths (characters) of the numbers of a text line, by type and by whether the abscissas are even and left out."""
LINES_AT_ONCE = 4096
"""Lines of text converted at once."""


@dataclass(frozen=True)
class Dataset:
    """A dataset: its type, whether it is binary, and its offsets, behind the opening mark and at the closing one."""

    kind: int
    binary: bool
    start: int
    stop: int


@dataclass(frozen=True)
class _History:
    """Header of a dataset 58, and the offsets of its numbers."""

    name: str
    unit: str | None
    kind: int
    point_count: int
    even: bool
    interval_s: float
    order: str
    """Byte order of a binary dataset, < or >; empty for text."""
    start: int
    stop: int
    recorded: str
    """ID lines two to five, of which one states the date."""

    @property
    def value_count(self) -> int:
        return self.point_count if self.even else 2 * self.point_count


def uff_blocks(path: Path) -> Blocks:
    """Block per time history; one with uneven abscissas has the column NAME time before it.

    Raises UnreadableError if the file is cut off.
    """
    with path.open("rb") as stream:
        content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        for dataset in datasets_of(content):
            if dataset.kind == 58:
                yield _block(content, dataset)


def check_whole(path: Path) -> None:
    """Raise UnreadableError if the last dataset is incomplete, or there is none."""
    with path.open("rb") as stream:
        for _ in datasets_of(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)):
            pass


def datasets_of(content: mmap.mmap) -> Iterator[Dataset]:
    """Datasets in order; raises UnreadableError if the last one is incomplete, or there is none."""
    mark = LINE_OF_MARK.search(content)
    if mark is None:
        raise UnreadableError("it has no dataset")
    while mark is not None:
        start = mark.end()
        head = _line(content, start)[0]
        kind, binary = head[:6].strip(), head[6:7].lower() == b"b"
        if not kind.isdigit():
            raise UnreadableError(f"its dataset at byte {start} has no number, or is cut off")
        closing = _closing(content, start, head if binary else b"")
        if closing is None:
            raise UnreadableError(f"its dataset at byte {start} is cut off")
        yield Dataset(int(kind), binary, start, closing.start())
        offset = closing.end()
        mark = LINE_OF_MARK.search(content, offset)
    if re.compile(rb"\S| \Z").search(content, offset):
        raise UnreadableError(f"it is cut off at byte {offset}, behind its last whole dataset")


def _closing(content: mmap.mmap, start: int, binary_head: bytes) -> re.Match[bytes] | None:
    """Mark that closes a dataset; the head of a binary one states how many bytes precede it."""
    if binary_head:
        _, _, offset = _header(content, start)
        size = _integer(binary_head, 31, 43)
        for between in range(3):  # some programs end the numbers by a line end
            if size > 0 and (closing := MARK.match(content, offset + size + between)):
                return closing
        return MARK.search(content, offset)
    return LINE_OF_MARK.search(content, start)


def _line(content: mmap.mmap, offset: int) -> tuple[bytes, int]:
    """Line at an offset, and the offset of the next."""
    match = LINE.match(content, offset)
    if match is None:
        raise UnreadableError("a dataset has no header")
    return match[1], match.end()


def _header(content: mmap.mmap, offset: int) -> tuple[bytes, list[str], int]:
    """Line of the type, the eleven lines below it, and the offset of the numbers."""
    head, offset = _line(content, offset)
    lines = []
    for _ in range(11):
        line, offset = _line(content, offset)
        lines.append(decode_text(line[:200]))
    return head, lines, offset


def _integer(line: bytes | str, first: int, last: int) -> int:
    try:
        return int(line[first:last])
    except ValueError:
        raise UnreadableError(f"its header has {line[first:last]!r} in place of a number") from None


def _block(content: mmap.mmap, dataset: Dataset) -> ColumnBlock | Refused:
    head, lines, start = _header(content, dataset.start)
    name, unit, kind = lines[0][:80].strip(), lines[8][46:67].strip(), _integer(lines[6], 0, 10)
    if _integer(lines[5], 0, 5) != TIME_RESPONSE or kind not in (SINGLE, DOUBLE):
        return Refused(name, f"dataset {name!r} is no time history; export time histories alone")
    try:
        interval_s = float(lines[6][43:56])
    except ValueError:
        interval_s = 0.0
    history = _History(
        name=name,
        unit=unit if unit and unit != "NONE" else None,
        kind=kind,
        point_count=_integer(lines[6], 10, 20),
        even=_integer(lines[6], 20, 30) == EVEN,
        interval_s=interval_s,
        order=("<" if _integer(head, 7, 13) == 1 else ">") if dataset.binary else "",
        start=start,
        stop=dataset.stop,
        recorded=" ".join(line[:80].strip() for line in (lines[2], lines[1], *lines[3:5])),
    )
    size = (4 if kind == SINGLE else 8) if dataset.binary else min(WIDTHS[kind, history.even])
    room = (dataset.stop - start) // size
    if history.point_count < 0 or (room != history.value_count if dataset.binary else room < history.value_count):
        raise _wrong_length(name, room, history.even, history.point_count)
    names = (name,) if history.even else (f"{name} time", name)
    return ColumnBlock(
        names, history.point_count, partial(_columns, content, history), 0 if history.even else 16 * history.point_count
    )


def _columns(content: mmap.mmap, history: _History, chosen: Sequence[int]) -> list[Column]:
    values = _binary(content, history) if history.order else _text(content, history)
    if history.even:
        rate = 1 / history.interval_s if history.interval_s > 0 and history.point_count > 1 else None
        return [Column(history.name, values, history.unit, rate, history.recorded)]
    columns = (
        Column(f"{history.name} time", values[::2].copy(), "s"),
        Column(history.name, values[1::2].copy(), history.unit, None, history.recorded),
    )
    return [columns[k] for k in chosen]


def _binary(content: mmap.mmap, history: _History) -> Float[np.ndarray, " numbers"]:
    kind = f"{history.order}f{4 if history.kind == SINGLE else 8}"
    return np.frombuffer(content, kind, history.value_count, history.start).astype(float)


def _text(content: mmap.mmap, history: _History) -> Float[np.ndarray, " numbers"]:
    cuts = list(pairwise(accumulate(WIDTHS[history.kind, history.even], initial=0)))
    values, count = np.empty(history.value_count), 0
    lines = (match[1] for match in LINE.finditer(content, history.start, history.stop))
    while batch := list(islice(lines, LINES_AT_ONCE)):
        numbers = [float(cell) for line in batch for first, last in cuts if (cell := line[first:last].strip())]
        if count + len(numbers) <= values.size:
            values[count : count + len(numbers)] = numbers
        count += len(numbers)
    if count != values.size:
        raise _wrong_length(history.name, count, history.even, history.point_count)
    return values


def _wrong_length(name: str, value_count: int, even: bool, point_count: int) -> UnreadableError:
    return UnreadableError(
        f"its dataset {name!r} holds {value_count if even else value_count // 2} of {point_count} samples"
    )
