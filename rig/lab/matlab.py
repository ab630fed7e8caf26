"""The numeric arrays of a MATLAB file, also in structs and cells.

Version 5 to 7 is read here: where a type is damaged, scipy's reader ends the process, or it swells. Version 7.3 is
HDF5, and version 4 is read by scipy.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np

from rig.lab.column import Blocks, Column, ColumnBlock, UnreadableError, decoded
from rig.lab.matlab_hdf5 import matlab_hdf5_blocks
from rig.limits import MAX_DEPTH, MAX_ITEMS, MAX_NAME, PROGRAM_BYTES, check_decoded_size

_HEADER_BYTES = 128
_HEAD_BYTES = 8192
"""Of a compressed array, so much tells its class, size and name."""
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT = 1, 2
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 1 << 11


def matlab_blocks(path: Path) -> Blocks:
    """A block a real numeric matrix, named as MATLAB does: `a`, `run.a`, `run(2).a`, `c{3}`; `a[1]` is a channel of it.

    Raises RigError if version 7.3 needs h5py and it is not installed, and RigError or UnreadableError if the file is
    cut, damaged or too large.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEADER_BYTES)
    order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
    if head.startswith(b"MATLAB 7.3"):
        yield from matlab_hdf5_blocks(path)
    elif order is None or not head.startswith(b"MATLAB 5.0"):
        yield from _version_4(path.read_bytes())
    else:
        yield from _Version5(path, path.read_bytes(), order).blocks()


def _block(
    name: str, shape: tuple[int, ...], array: Callable[[], np.ndarray], working_bytes: int = 0
) -> Iterator[ColumnBlock]:
    """The channels of a matrix of that shape; a record is longer than it has channels."""
    if len(shape) != 2 or math.prod(shape) < 2:
        return
    count, samples = sorted(shape)
    if count > MAX_ITEMS:
        raise UnreadableError(f"its array {name!r} has {count} columns")
    names = (name,) if count == 1 else tuple(f"{name}[{number}]" for number in range(1, count + 1))
    yield ColumnBlock(names, samples, partial(_columns, names, array), working_bytes)


def _columns(names: Sequence[str], array: Callable[[], np.ndarray], chosen: Sequence[int]) -> list[Column]:
    values = array()
    rows = values if values.shape[0] < values.shape[1] else values.T
    return [Column(names[k], rows[k].astype(float)) for k in chosen]


@dataclass(frozen=True)
class _Head:
    """Head of an array: its class, flags, shape and name, and where its content begins."""

    kind: int
    flags: int
    shape: tuple[int, ...]
    name: str
    begin: int

    @property
    def is_real(self) -> bool:
        return self.kind in _NUMERIC_CLASSES and not self.flags & _COMPLEX


class _Version5:
    """The walk through a file, which counts the elements of structs and cells."""

    def __init__(self, path: Path, content: bytes, order: str) -> None:
        self._path, self._content, self._order = path, memoryview(content), order
        self._elements = 0

    def blocks(self) -> Iterator[ColumnBlock]:
        at = _HEADER_BYTES
        while at < len(self._content):
            self._count("at its top", (1,))
            kind, body, at = self._element(self._content, at)
            if kind == _COMPRESSED:
                yield from self._of_compressed(body)
            elif kind == _MATRIX:
                yield from self._of_array(body, "", 0)

    def _of_compressed(self, packed: memoryview) -> Iterator[ColumnBlock]:
        """An array of numbers is only looked into; the elements of structs and cells are known once it is unpacked."""
        begin = memoryview(zlib.decompressobj().decompress(packed, _HEAD_BYTES))
        kind, length, first, _ = self._tag(begin, 0)
        if kind != _MATRIX or not length:
            return
        size = first + length
        head = self._head(begin[first:])
        if head.is_real:
            yield from self._of_numbers(
                head, begin[first:], head.name, lambda: memoryview(_unpacked(packed, size))[first:], size
            )
        elif head.kind in (_CELL, _STRUCT):
            shown = f"{self._path}: its variable {head.name!r}"
            check_decoded_size(PROGRAM_BYTES + len(self._content) + size, len(self._content), shown)
            yield from self._of_array(memoryview(_unpacked(packed, size))[first:], "", 0)

    def _of_array(self, body: memoryview, outer: str, depth: int) -> Iterator[ColumnBlock]:
        """The blocks of an array, or of those in a struct or a cell array; none if it is not real and numeric."""
        if not body:
            return
        head = self._head(body)
        name = outer or head.name
        if depth > MAX_DEPTH or len(name) > MAX_NAME:
            raise UnreadableError(
                f"its structs are more than {MAX_DEPTH} deep, or have names of over {MAX_NAME} characters"
            )
        if head.kind == _CELL:
            names = (f"{name}{{{k}}}" for k in range(1, self._count(name, head.shape) + 1))
            yield from self._of_elements(body, head.begin, names, depth + 1)
        elif head.kind == _STRUCT:
            yield from self._of_struct(body, head, name, depth + 1)
        elif head.is_real:
            yield from self._of_numbers(head, body, name, lambda: body, 0)

    def _of_struct(self, body: memoryview, head: _Head, name: str, depth: int) -> Iterator[ColumnBlock]:
        _, length, at = self._element(body, head.begin)
        _, text, at = self._element(body, at)
        (size,) = struct.unpack(f"{self._order}i", length)
        if size < 1:
            raise UnreadableError(f"the fields of its struct {name!r} have no names")
        fields = [decoded(bytes(text[k : k + size]).partition(b"\0")[0]) for k in range(0, len(text), size)]
        count = self._count(name, (*head.shape, len(fields))) // max(1, len(fields))
        elements = (name if count == 1 else f"{name}({k})" for k in range(1, count + 1))
        yield from self._of_elements(body, at, (f"{e}.{field}" for e in elements for field in fields), depth)

    def _of_elements(self, body: memoryview, at: int, names: Iterator[str], depth: int) -> Iterator[ColumnBlock]:
        """The blocks of the arrays of these names, which follow each other."""
        for name in names:
            kind, inner, at = self._element(body, at)
            if kind != _MATRIX:
                raise UnreadableError(f"its array {name!r} is of the unknown type {kind}")
            yield from self._of_array(inner, name, depth)

    def _of_numbers(
        self, head: _Head, known: memoryview, name: str, body: Callable[[], memoryview], working_bytes: int
    ) -> Iterator[ColumnBlock]:
        """The block of an array whose beginning is known; `body` gives all of it."""
        kind, length, begin, _ = self._tag(known, head.begin)
        if kind not in _TYPES:
            raise UnreadableError(f"its array {name!r} is of the unknown type {kind}")
        stored = np.dtype(self._order + _TYPES[kind])
        if min(head.shape, default=0) < 0 or length != math.prod(head.shape) * stored.itemsize:
            raise UnreadableError(f"its array {name!r} of {head.shape} holds {length // stored.itemsize} values")

        def array() -> np.ndarray:
            return np.frombuffer(body()[begin : begin + length], stored).reshape(head.shape, order="F")

        yield from _block(name, head.shape, array, working_bytes)

    def _head(self, body: memoryview) -> _Head:
        _, about, at = self._element(body, 0)
        (flags,) = struct.unpack_from(f"{self._order}I", about)
        _, sizes, at = self._element(body, at)
        _, name, at = self._element(body, at)
        shape = tuple(np.frombuffer(sizes, f"{self._order}i4").tolist())
        return _Head(flags & 0xFF, flags, shape, decoded(bytes(name)), at)

    def _tag(self, content: memoryview, at: int) -> tuple[int, int, int, int]:
        """Tag of an element: its type, the length of its data, where they begin, and where the next element begins."""
        kind, length = struct.unpack_from(f"{self._order}II", content, at)
        if kind >> 16:  # up to four bytes, in the tag itself
            return kind & 0xFFFF, kind >> 16, at + 4, at + 8
        return kind, length, at + 8, at + 8 + length + (-length % 8 if kind != _COMPRESSED else 0)

    def _element(self, content: memoryview, at: int) -> tuple[int, memoryview, int]:
        """An element's type and data, and where the next begins."""
        kind, length, begin, after = self._tag(content, at)
        if begin + length > min(after, len(content)):
            raise UnreadableError(f"an element of {length} bytes is cut off")
        return kind, content[begin : begin + length], after

    def _count(self, name: str, shape: tuple[int, ...]) -> int:
        """Elements of a struct or cell array, which count to those of the file."""
        count = math.prod(shape)
        self._elements += count
        if min(shape, default=0) < 0 or self._elements > MAX_ITEMS:
            raise UnreadableError(
                f"its array {name!r} has the size {shape}, and the file may hold {MAX_ITEMS} elements"
            )
        return count


def _unpacked(packed: memoryview, size: int) -> bytes:
    """Bytes of a compressed element, this many; raises UnreadableError if it has fewer or more."""
    unpacking = zlib.decompressobj()
    content = unpacking.decompress(packed, size)
    more = b"" if unpacking.eof else unpacking.decompress(unpacking.unconsumed_tail, 1)
    if len(content) < size or more or not unpacking.eof:
        raise UnreadableError("its compressed data are cut off, or swell beyond what they declare")
    return content


def _version_4(content: bytes) -> Iterator[ColumnBlock]:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(BytesIO(content))[0] != 0:  # scipy would read what was not taken for version 5 to 7
        raise UnreadableError("its header is damaged")
    for name, array in loadmat(BytesIO(content)).items():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
            yield from _block(name, array.shape, partial(np.asarray, array))
