"""Measured data as columns, from the files in which laboratories keep them: CSV, UFF, MATLAB, TDMS and HDF5."""

import csv
import logging
import struct
from collections.abc import Callable, Iterable
from io import BytesIO
from pathlib import Path

import msgspec
import numpy as np

from rig.errors import RigError
from rig.extras import needs_extra
from rig.files import check_source
from rig.lab.column import Column
from rig.lab.containers import read_hdf5
from rig.lab.matlab import arrays_of, most_bytes

_SEGMENT_HEAD_BYTES = 28  # of TDMS
_BIG_ENDIAN = 1 << 6


class TextForm(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a CSV file is written: one line of names stands between the lines that are skipped."""

    encoding: str = "utf-8-sig"
    delimiter: str = ","
    decimal: str = "."
    lines_before_names: int = 0
    lines_after_names: int = 0

    def __post_init__(self) -> None:
        if len(self.delimiter) != 1 or len(self.decimal) != 1 or self.delimiter == self.decimal:
            raise RigError(
                f"delimiter is {self.delimiter!r} and decimal {self.decimal!r}; give two different characters"
            )
        if min(self.lines_before_names, self.lines_after_names) < 0:
            raise RigError("a number of lines in [csv] is negative; give zero or more")


def columns_of(path: Path, text: TextForm) -> tuple[Column, ...]:
    """Every column of numbers in a file, whose format is told by its suffix.

    Raises RigError with a sentence if the file cannot be opened, is empty, is not of its format or holds no numbers.
    """
    if (suffix := path.suffix.lower()) not in READERS:
        raise RigError(f"{path}: the suffix {suffix!r} is none of {', '.join(READERS)}; rename the file or convert it")
    check_source(path)
    try:
        if not path.stat().st_size:
            raise RigError(f"{path}: is empty; export it again")
        columns = tuple(READERS[suffix](path, text))
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror or error}); check the name") from error
    except RigError:
        raise
    except MemoryError as error:
        raise RigError(f"{path}: needs more memory than there is; export it again, or a shorter record") from error
    except Exception as error:  # what the formats' libraries raise on a bad file is not to be listed
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise RigError(f"{path}: cannot be read as {suffix} ({reason}); export it again") from error
    if not columns:
        raise RigError(f"{path}: holds no column of numbers over time; check what was exported")
    return columns


def _csv(path: Path, text: TextForm) -> Iterable[Column]:
    try:
        content = path.read_bytes().decode(text.encoding)
    except UnicodeDecodeError as error:
        raise RigError(
            f"{path}: is not text in {text.encoding} (byte {error.start}); name its encoding in the map, "
            'e.g. encoding = "latin-1" or "utf-16"'
        ) from error
    except LookupError as error:
        raise RigError(f"{path}: there is no encoding {text.encoding!r}; give e.g. utf-8 or latin-1") from error
    lines = content.splitlines()[text.lines_before_names :]
    if not lines:
        raise RigError(f"{path}: has no line after the first {text.lines_before_names}; check lines_before_names")
    names = [cell.strip() for cell in next(csv.reader(lines[:1], delimiter=text.delimiter))]
    named = not all(_is_number(name, text.decimal) for name in names if name)
    skipped = (1 if named else 0) + text.lines_after_names
    body = [line for line in lines[skipped:] if line.strip()]
    if not body:
        raise RigError(f"{path}: holds no samples; export it again")
    body, emptied = _without_empty_columns(body, text.delimiter)
    width = len(next(csv.reader(body[:1], delimiter=text.delimiter)))
    used = _used_columns(path, names, width, emptied) if named else width
    if text.decimal != ".":
        body = [line.replace(text.decimal, ".") for line in body]
    only = range(used) if used < width else None  # None: every row must have the same number of columns
    try:
        values = np.loadtxt(body, delimiter=text.delimiter, ndmin=2, comments=None, quotechar='"', usecols=only)
    except ValueError as error:
        reason = _first_fault(body, text.delimiter, used, all_alike=only is None) or str(error)
        raise RigError(
            f"{path}: {reason} (rows counted from the first sample); check delimiter, decimal and the lines skipped"
        ) from error
    for number, column in enumerate(values.T, start=1):
        yield Column(names[number - 1] if named else f"column {number}", np.ascontiguousarray(column))


def _first_fault(body: list[str], delimiter: str, used: int, *, all_alike: bool) -> str:
    """Why the rows are no table of numbers; empty where these rules find nothing."""
    rows = csv.reader(body, delimiter=delimiter)
    for number, cells in enumerate(rows, start=1):
        if len(cells) < used or (all_alike and len(cells) != used):
            return f"row {number} has {len(cells)} columns instead of {used}"
        for column, cell in enumerate(cells[:used], start=1):
            if not _is_number(cell, "."):
                return f"row {number}, column {column} is no number: {cell!r}"
    return ""


def _without_empty_columns(body: list[str], delimiter: str) -> tuple[list[str], int]:
    """The lines without the last columns that are empty in all of them, and how many those are."""
    emptied = 0
    blanks = " \t".replace(delimiter, "")
    while all(line.rstrip(blanks).endswith(delimiter) for line in body):
        body, emptied = [line.rstrip(blanks).removesuffix(delimiter) for line in body], emptied + 1
    return body, emptied


def _used_columns(path: Path, names: list[str], width: int, emptied: int) -> int:
    """How many columns have a name and values; only last ones may lack either."""
    named = next((k for k in range(len(names), 0, -1) if names[k - 1]), 0)
    if width > len(names) or named > width + emptied or not named:
        raise RigError(f"{path}: {named} names for {width} columns; check the line of names")
    return min(named, width)


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _uff(path: Path, _: TextForm) -> Iterable[Column]:
    with needs_extra("lab", f"{path}: a UFF file"):
        import pyuff

    file = pyuff.UFF(str(path))
    for place, kind in enumerate(file.get_set_types()):
        if kind != 58:
            continue
        dataset = file.read_sets(place)
        name = str(dataset["id1"]).strip()
        if dataset["func_type"] != 1 or np.iscomplexobj(dataset["data"]):
            raise RigError(f"{path}: dataset {name!r} is no time history; export time histories alone")
        if len(dataset["data"]) != dataset["num_pts"]:
            raise RigError(f"{path}: dataset {name!r} holds {len(dataset['data'])} of {dataset['num_pts']} samples")
        unit = str(dataset["ordinate_axis_units_lab"]).strip()
        interval = np.diff(dataset["x"]).mean() if len(dataset["x"]) > 1 else 0.0
        if dataset["abscissa_spacing"] == 0:
            yield Column(f"{name} time", dataset["x"], "s")
            interval = 0.0
        yield Column(name, dataset["data"], unit if unit and unit != "NONE" else None, _rate(interval))


def _mat(path: Path, _: TextForm) -> Iterable[Column]:
    for name, array in arrays_of(path):
        if array.ndim != 2 or array.size < 2:
            continue
        rows = array if array.shape[0] < array.shape[1] else array.T  # a record is longer than it has channels
        for number, row in enumerate(rows, start=1):
            yield Column(name if len(rows) == 1 else f"{name}[{number}]", row.astype(float))


def _tdms(path: Path, _: TextForm) -> Iterable[Column]:
    with needs_extra("lab", f"{path}: a TDMS file"):
        from nptdms import TdmsFile
        from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # what it finds is said by an error, or is no fault
    content = BytesIO(path.read_bytes())  # a read from it takes no more memory than there is to read
    _check_segments(path, content.getbuffer())
    declared = sum(len(c) for group in TdmsFile.read_metadata(content).groups() for c in group.channels())
    if declared > len(content.getbuffer()):
        raise RigError(f"{path}: declares {declared} values, more than it has bytes; export it again")
    content.seek(0)
    for group in TdmsFile.read(content).groups():
        for channel in group.channels():
            values = channel[:]
            if values.dtype.kind in "iuf":
                unit = channel.properties.get("unit_string")
                rate = _rate(float(channel.properties.get("wf_increment", 0.0)))
                yield Column(f"{group.name}/{channel.name}", values.astype(float), str(unit) if unit else None, rate)


def _check_segments(path: Path, content: memoryview) -> None:
    """Raises RigError unless a TDMS file ends where its last segment does."""
    at = 0
    while at < len(content):
        head = content[at : at + _SEGMENT_HEAD_BYTES]
        if len(head) < _SEGMENT_HEAD_BYTES or bytes(head[:4]) != b"TDSm":
            raise RigError(f"{path}: has no whole segment at byte {at}; export it again")
        (kind,) = struct.unpack_from("<I", head, 4)
        (length,) = struct.unpack_from(">Q" if kind & _BIG_ENDIAN else "<Q", head, 12)
        at += _SEGMENT_HEAD_BYTES + length
    if at != len(content):
        raise RigError(f"{path}: is cut off; export it again")


def _hdf5(path: Path, _: TextForm) -> Iterable[Column]:
    return read_hdf5(path, most_bytes(path.stat().st_size))


def _rate(interval_s: float) -> float | None:
    return 1 / interval_s if interval_s > 0 else None


READERS: dict[str, Callable[[Path, TextForm], Iterable[Column]]] = {
    ".csv": _csv,
    ".txt": _csv,
    ".uff": _uff,
    ".unv": _uff,
    ".mat": _mat,
    ".tdms": _tdms,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
}
