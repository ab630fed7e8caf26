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
from rig.lab.units import FACTORS, canonical_unit, name_and_unit, stated_unit
from rig.model.quantities import QUANTITIES

MARK_PATTERN = re.compile(rb" {4}-1[ ]*(?:[\r\n]+|\Z)")
"""Line that opens or closes a dataset; it directly follows the numbers of a binary one."""
MARK_LINE_PATTERN = re.compile(rb"(?:\A|(?<=[\r\n]))" + MARK_PATTERN.pattern)
LINE_PATTERN = re.compile(rb"([^\r\n]*)(?:\r\n|\r|\n|\Z)")
TIME_RESPONSE_CODE, EVEN_CODE = 1, 1
SINGLE_CODE, DOUBLE_CODE = 2, 4
"""Codes of real number types; those of complex ones are 5 and 6."""
COLUMN_WIDTHS = {
    (SINGLE_CODE, True): (13,) * 6,
    (SINGLE_CODE, False): (13,) * 6,
    (DOUBLE_CODE, True): (20,) * 4,
    (DOUBLE_CODE, False): (13, 20) * 2,
}
"""Widths (characters) of numbers that touch each other in a line, by type and by whether abscissas are left out."""
MIN_NUMBER_BYTES = 2
"""Fewest bytes of a number in a text, with the space behind it."""
QUANTITY_BY_CODE = {
    **{quantity.uff_kind: quantity.name for quantity in QUANTITIES.values() if quantity.uff_kind},
    9: "force",
    13: "force",
}
"""Quantity by the data type of an ordinate."""
HEADER_DIGITS_DOUBT = 5e-6
"""Largest relative error of a number that the header gives in six digits."""
MAX_LINE_BYTES = 1000
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
class UffUnits:
    """Units of the lengths and forces of a file, per m and per N (dataset 164)."""

    length: float
    force: float


@dataclass(frozen=True)
class _History:
    """Header of a dataset 58, and the offsets of its numbers."""

    name: str
    unit: str | None
    time_unit: str
    type_code: int
    point_count: int
    is_even: bool
    rate_hz: float | None
    start_s: float | None
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
        units = units_in(content)
        for dataset in datasets_of(content):
            if dataset.type_code == 58:
                yield _history_block(content, dataset, units)


def uff_units(path: Path) -> UffUnits | None:
    """Units of a file; None if it states none. Raises UnreadableError if it is cut off or has no dataset."""
    with path.open("rb") as stream:
        return units_in(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))


def units_in(content: mmap.mmap) -> UffUnits | None:
    """Units by the last dataset 164, NaN where it has no number, SI where it has 0 or nothing; None without one."""
    units = None
    for dataset in datasets_of(content):
        if dataset.type_code == 164:
            _, offset = _line(content, dataset.start_offset)
            _, offset = _line(content, offset)
            factors = [_real(cell) or 1.0 for cell in _line(content, offset)[0].split()[:2]]
            units = UffUnits(*factors, *(2 - len(factors)) * [1.0])
    return units


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


def _real(text: bytes | str) -> float:
    """Number in a header, also with the exponent D; NaN if there is none."""
    try:
        return float(text.strip().upper().replace("D", "E") if isinstance(text, str) else _number(text))
    except ValueError:
        return float("nan")


def _number(cell: bytes) -> float:
    """Number in a cell, as FORTRAN writes it; raises ValueError if there is none."""
    return float(cell.upper().replace(b"D", b"E"))


def _history_block(content: mmap.mmap, dataset: Dataset, units: UffUnits | None) -> ColumnBlock | Refused:
    type_line, header_lines, numbers_offset = _header(content, dataset.start_offset)
    name = header_lines[0][:80].strip()
    type_code = _integer(header_lines[6], 0, 10)
    if _integer(header_lines[5], 0, 5) != TIME_RESPONSE_CODE or type_code not in (SINGLE_CODE, DOUBLE_CODE):
        return Refused(name, f"dataset {name!r} is no time history; export time histories alone")
    time_unit = _time_unit(header_lines[7])
    unit_s = FACTORS["time"].get(time_unit)
    start, interval = _real(header_lines[6][30:43]), _real(header_lines[6][43:56])
    is_even = _integer(header_lines[6], 20, 30) == EVEN_CODE
    history = _History(
        name=name,
        unit=_ordinate_unit(header_lines[8], units),
        time_unit=time_unit,
        type_code=type_code,
        point_count=_integer(header_lines[6], 10, 20),
        is_even=is_even,
        rate_hz=_rate_of_interval(interval * unit_s) if unit_s and 0 < interval < np.inf else None,
        start_s=start * unit_s if unit_s and is_even and np.isfinite(start) else None,
        byte_order=("<" if _integer(type_line, 7, 13) == 1 else ">") if dataset.is_binary else "",
        start_offset=numbers_offset,
        stop_offset=dataset.stop_offset,
        date_text=" ".join(line[:80].strip() for line in (header_lines[2], header_lines[1], *header_lines[3:5])),
    )
    number_bytes = (4 if type_code == SINGLE_CODE else 8) if dataset.is_binary else MIN_NUMBER_BYTES
    number_count = (dataset.stop_offset - numbers_offset + (not dataset.is_binary)) // number_bytes
    has_wrong_length = number_count != history.value_count if dataset.is_binary else number_count < history.value_count
    if history.point_count < 0 or has_wrong_length:
        raise _wrong_length_error(name, number_count, history.is_even, history.point_count)
    read_columns = partial(_read_columns, content, history)
    column_names = (name,) if history.is_even else (f"{name} time", name)
    notes = tuple(_notes_on(content, history))
    return ColumnBlock(column_names, history.point_count, read_columns, 16 * history.point_count, notes)


def _time_unit(axis_line: str) -> str:
    """Canonical unit of the abscissa, by its own label or that of the axis (Time [ms]); s if none is stated."""
    unit = stated_unit(axis_line[46:67]) or name_and_unit(axis_line[26:46].strip())[1]
    return canonical_unit(unit) if unit else "s"


def _ordinate_unit(axis_line: str, units: UffUnits | None) -> str | None:
    """Unit of the ordinate by its label, else that of the file's units and the ordinate's quantity."""
    if unit := stated_unit(axis_line[46:67]):
        return unit
    quantity = QUANTITY_BY_CODE.get(_integer(axis_line, 0, 10)) if units and axis_line[:10].strip() else None
    if units is None or quantity is None:
        return None
    per_si_unit = units.force if quantity == "force" else units.length
    return next((unit for unit, si in FACTORS[quantity].items() if abs(si * per_si_unit - 1) < 1e-4), None)


def _rate_of_interval(interval_s: float) -> float:
    """Rate of an interval that is known to six digits: the one of fewest digits within its doubt."""
    rate_hz = 1 / interval_s
    candidates_hz = (float(f"{rate_hz:.{digits}g}") for digits in range(1, 10))
    return next((hz for hz in candidates_hz if abs(hz / rate_hz - 1) <= HEADER_DIGITS_DOUBT), rate_hz)


def _notes_on(content: mmap.mmap, history: _History) -> Iterator[str]:
    if history.time_unit not in FACTORS["time"]:
        yield f"the abscissa of {history.name!r} is in {history.time_unit!r}, which is no known unit of time"
    if history.byte_order or not history.value_count:
        return
    text_end = history.stop_offset
    while text_end > history.start_offset and content[text_end - 1 : text_end].isspace():
        text_end -= 1
    line_start = max(content.rfind(end, history.start_offset, text_end) for end in (b"\n", b"\r"))
    first_line = _line(content, history.start_offset)[0]
    last_cells, cells_per_line = content[line_start + 1 : text_end].split(), len(first_line.split())
    fill_count = len(last_cells) - ((history.value_count - 1) % max(cells_per_line, 1) + 1)
    if line_start > history.start_offset and fill_count > 0:
        yield f"{fill_count} numbers that only fill the last line of {history.name!r} are left out"


def _read_columns(content: mmap.mmap, history: _History, column_indices: Sequence[int]) -> list[Column]:
    values = _binary_numbers(content, history) if history.byte_order else _text_numbers(content, history)
    if history.is_even:
        rate_hz = history.rate_hz if history.point_count > 1 else None
        return [Column(history.name, values, history.unit, rate_hz, history.date_text, history.start_s)]
    columns = (
        Column(f"{history.name} time", values[::2].copy(), history.time_unit),
        Column(history.name, values[1::2].copy(), history.unit, None, history.date_text),
    )
    return [columns[k] for k in column_indices]


def _binary_numbers(content: mmap.mmap, history: _History) -> Float[np.ndarray, " numbers"]:
    numpy_type = f"{history.byte_order}f{4 if history.type_code == SINGLE_CODE else 8}"
    return np.frombuffer(content, numpy_type, history.value_count, history.start_offset).astype(float)


def _text_numbers(content: mmap.mmap, history: _History) -> Float[np.ndarray, " numbers"]:
    """Numbers of a text; zeros that fill the last line are left out."""
    history_numbers = np.empty(history.value_count)
    number_count, surplus_count = 0, 0
    is_filled_by_zeros = True
    lines = (match[1] for match in LINE_PATTERN.finditer(content, history.start_offset, history.stop_offset))
    while line_batch := list(islice(lines, LINES_PER_BLOCK)):
        numbers = _numbers_in(line_batch, history)
        kept_numbers = numbers[: history_numbers.size - number_count]
        surplus_numbers = numbers[len(kept_numbers) :]
        history_numbers[number_count : number_count + len(kept_numbers)] = kept_numbers
        number_count += len(kept_numbers)
        surplus_count += len(surplus_numbers)
        is_filled_by_zeros &= not any(surplus_numbers)
    numbers_per_line = len(_line(content, history.start_offset)[0].split())
    is_whole = number_count == history_numbers.size and is_filled_by_zeros and surplus_count < max(numbers_per_line, 1)
    if not is_whole:
        total_count = number_count + surplus_count
        raise _wrong_length_error(history.name, total_count, history.is_even, history.point_count)
    return history_numbers


def _numbers_in(lines: Sequence[bytes], history: _History) -> list[float]:
    """Numbers in lines: apart by spaces, whatever their widths, or else in the columns of the format."""
    if max(map(len, lines)) > MAX_LINE_BYTES:
        raise UnreadableError(f"its dataset {history.name!r} has a line of more than {MAX_LINE_BYTES} characters")
    try:
        return [*map(float, b" ".join(lines).split())]
    except ValueError:  # exponents D, or numbers that touch
        return [number for line in lines for number in _numbers_of_line(line, history)]


def _numbers_of_line(line: bytes, history: _History) -> list[float]:
    widths = COLUMN_WIDTHS[history.type_code, history.is_even]
    try:
        return [*map(_number, line.split())]
    except ValueError:
        spans = pairwise(accumulate(widths, initial=0))
        cells = [cell for first, last in spans if (cell := line[first:last].strip())]
    try:
        if line[sum(widths) :].strip():
            raise ValueError
        return [*map(_number, cells)]
    except ValueError:
        raise UnreadableError(
            f"its dataset {history.name!r} has the line {utf8_or_latin1_text(line[:60])!r}, whose numbers are neither "
            f"apart by spaces nor in columns of {' and '.join(map(str, dict.fromkeys(widths)))} characters"
        ) from None


def _wrong_length_error(name: str, value_count: int, is_even: bool, point_count: int) -> UnreadableError:
    return UnreadableError(
        f"its dataset {name!r} holds {value_count if is_even else value_count // 2} of {point_count} samples"
    )
