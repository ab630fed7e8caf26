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
from typing import Any

import numpy as np

from rig.lab.column import Blocks, Column, ColumnBlock, Refused, UnreadableError, decoded
from rig.lab.hdf5 import attribute, blocks_of, check_stored, is_new, kept_elsewhere, members, open_hdf5
from rig.limits import MAX_DEPTH, MAX_ITEMS, MAX_NAME, PROGRAM_BYTES, check_decoded_size

_HEADER_BYTES = 128
_HEAD_BYTES = 8192
"""Bytes of a compressed array that hold its class, size and name."""
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT = 1, 2
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 1 << 11


def matlab_blocks(path: Path, least_values: int = 2) -> Blocks:
    """Block per real numeric matrix, named as in MATLAB: `a`, `run.a`, `run(2).a`, `c{3}`; `a[1]` is a channel.

    Matrices of fewer than least_values are left out (of version 7.3, of fewer than two).
    Raises RigError if version 7.3 needs h5py and it is not installed, and RigError or UnreadableError if the file is
    cut, damaged or too large.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEADER_BYTES)
    order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
    if head.startswith(b"MATLAB 7.3"):
        yield from matlab_hdf5_blocks(path)
    elif order is None or not head.startswith(b"MATLAB 5.0"):
        yield from _version_4(path.read_bytes(), least_values)
    else:
        yield from _Version5(path, path.read_bytes(), order, least_values).blocks()


def _block(
    name: str,
    shape: tuple[int, ...],
    array: Callable[[], np.ndarray],
    least_values: int,
    working_bytes: int = 0,
) -> Iterator[ColumnBlock]:
    """Channels of a matrix: its rows or columns, whichever are fewer."""
    if len(shape) != 2 or math.prod(shape) < least_values:
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
    """Head of an array: class, flags, shape and name, and the offset of its content."""

    kind: int
    flags: int
    shape: tuple[int, ...]
    name: str
    data_offset: int

    @property
    def is_real(self) -> bool:
        return self.kind in _NUMERIC_CLASSES and not self.flags & _COMPLEX


class _Version5:
    """Traversal of a file of version 5 to 7, which counts the elements of structs and cells."""

    def __init__(self, path: Path, content: bytes, order: str, least_values: int) -> None:
        self._path, self._content, self._order = path, memoryview(content), order
        self._least_values = least_values
        self._elements = 0

    def blocks(self) -> Iterator[ColumnBlock]:
        offset = _HEADER_BYTES
        while offset < len(self._content):
            self._count("at its top", (1,))
            kind, body, offset = self._element(self._content, offset)
            if kind == _COMPRESSED:
                yield from self._compressed_blocks(body)
            elif kind == _MATRIX:
                yield from self._array_blocks(body, "", 0)

    def _compressed_blocks(self, compressed: memoryview) -> Iterator[ColumnBlock]:
        """Blocks of a compressed array; only the head of a numeric one is decompressed, structs and cells wholly."""
        beginning = memoryview(zlib.decompressobj().decompress(compressed, _HEAD_BYTES))
        kind, length, first, _ = self._tag(beginning, 0)
        if kind != _MATRIX or not length:
            return
        size = first + length
        head = self._head(beginning[first:])
        if head.is_real:
            yield from self._numeric_blocks(
                head, beginning[first:], head.name, lambda: memoryview(_unpacked(compressed, size))[first:], size
            )
        elif head.kind in (_CELL, _STRUCT):
            label = f"{self._path}: its variable {head.name!r}"
            check_decoded_size(PROGRAM_BYTES + len(self._content) + size, len(self._content), label)
            yield from self._array_blocks(memoryview(_unpacked(compressed, size))[first:], "", 0)

    def _array_blocks(self, body: memoryview, enclosing_name: str, depth: int) -> Iterator[ColumnBlock]:
        """Blocks of an array, or of those in a struct or cell array; none if it is not real and numeric."""
        if not body:
            return
        head = self._head(body)
        name = enclosing_name or head.name
        if depth > MAX_DEPTH or len(name) > MAX_NAME:
            raise UnreadableError(
                f"its structs are more than {MAX_DEPTH} deep, or have names of over {MAX_NAME} characters"
            )
        if head.kind == _CELL:
            names = (f"{name}{{{k}}}" for k in range(1, self._count(name, head.shape) + 1))
            yield from self._element_blocks(body, head.data_offset, names, depth + 1)
        elif head.kind == _STRUCT:
            yield from self._struct_blocks(body, head, name, depth + 1)
        elif head.is_real:
            yield from self._numeric_blocks(head, body, name, lambda: body, 0)

    def _struct_blocks(self, body: memoryview, head: _Head, name: str, depth: int) -> Iterator[ColumnBlock]:
        _, length, offset = self._element(body, head.data_offset)
        _, text, offset = self._element(body, offset)
        (size,) = struct.unpack(f"{self._order}i", length)
        if size < 1:
            raise UnreadableError(f"the fields of its struct {name!r} have no names")
        fields = [decoded(bytes(text[k : k + size]).partition(b"\0")[0]) for k in range(0, len(text), size)]
        count = self._count(name, (*head.shape, len(fields))) // max(1, len(fields))
        elements = (name if count == 1 else f"{name}({k})" for k in range(1, count + 1))
        yield from self._element_blocks(body, offset, (f"{e}.{field}" for e in elements for field in fields), depth)

    def _element_blocks(self, body: memoryview, offset: int, names: Iterator[str], depth: int) -> Iterator[ColumnBlock]:
        """Blocks of consecutive arrays with these names."""
        for name in names:
            kind, element, offset = self._element(body, offset)
            if kind != _MATRIX:
                raise UnreadableError(f"its array {name!r} is of the unknown type {kind}")
            yield from self._array_blocks(element, name, depth)

    def _numeric_blocks(
        self, head: _Head, beginning: memoryview, name: str, body: Callable[[], memoryview], working_bytes: int
    ) -> Iterator[ColumnBlock]:
        """Block of a numeric array from its first bytes; `body` returns all of it."""
        kind, length, start, _ = self._tag(beginning, head.data_offset)
        if kind not in _TYPES:
            raise UnreadableError(f"its array {name!r} is of the unknown type {kind}")
        stored = np.dtype(self._order + _TYPES[kind])
        if min(head.shape, default=0) < 0 or length != math.prod(head.shape) * stored.itemsize:
            raise UnreadableError(f"its array {name!r} of {head.shape} holds {length // stored.itemsize} values")

        def array() -> np.ndarray:
            return np.frombuffer(body()[start : start + length], stored).reshape(head.shape, order="F")

        yield from _block(name, head.shape, array, self._least_values, working_bytes)

    def _head(self, body: memoryview) -> _Head:
        _, flag_bytes, offset = self._element(body, 0)
        (flags,) = struct.unpack_from(f"{self._order}I", flag_bytes)
        _, sizes, offset = self._element(body, offset)
        _, name, offset = self._element(body, offset)
        shape = tuple(np.frombuffer(sizes, f"{self._order}i4").tolist())
        return _Head(flags & 0xFF, flags, shape, decoded(bytes(name)), offset)

    def _tag(self, content: memoryview, offset: int) -> tuple[int, int, int, int]:
        """Tag of an element: type, length and offset of its data, and offset of the next element."""
        kind, length = struct.unpack_from(f"{self._order}II", content, offset)
        if kind >> 16:  # up to four bytes, in the tag itself
            return kind & 0xFFFF, kind >> 16, offset + 4, offset + 8
        return kind, length, offset + 8, offset + 8 + length + (-length % 8 if kind != _COMPRESSED else 0)

    def _element(self, content: memoryview, offset: int) -> tuple[int, memoryview, int]:
        """Type and data of an element, and offset of the next."""
        kind, length, start, next_offset = self._tag(content, offset)
        if start + length > min(next_offset, len(content)):
            raise UnreadableError(f"an element of {length} bytes is cut off")
        return kind, content[start : start + length], next_offset

    def _count(self, name: str, shape: tuple[int, ...]) -> int:
        """Number of elements of a struct or cell array, added to those of the file (at most MAX_ITEMS)."""
        count = math.prod(shape)
        self._elements += count
        if min(shape, default=0) < 0 or self._elements > MAX_ITEMS:
            raise UnreadableError(
                f"its array {name!r} has the size {shape}, and the file may hold {MAX_ITEMS} elements"
            )
        return count


def _unpacked(compressed: memoryview, size: int) -> bytes:
    """Decompressed element of exactly `size` bytes; raises UnreadableError if it has fewer or more."""
    decompressor = zlib.decompressobj()
    content = decompressor.decompress(compressed, size)
    surplus = b"" if decompressor.eof else decompressor.decompress(decompressor.unconsumed_tail, 1)
    if len(content) < size or surplus or not decompressor.eof:
        raise UnreadableError("its compressed data are cut off, or swell beyond what they declare")
    return content


def _version_4(content: bytes, least_values: int) -> Iterator[ColumnBlock]:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(BytesIO(content))[0] != 0:  # scipy would read what was not taken for version 5 to 7
        raise UnreadableError("its header is damaged")
    for name, array in loadmat(BytesIO(content)).items():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
            yield from _block(name, array.shape, partial(np.asarray, array), least_values)


def matlab_hdf5_blocks(path: Path) -> Blocks:
    """Block per real numeric array of a file of version 7.3, which is HDF5, named as in `matlab_blocks`.

    A group that several hard links or references reach is listed under the first of them. Raises RigError if h5py
    is not installed.
    """
    purpose = "a MATLAB file of version 7.3 (save(..., '-v7') stores it as an older one)"
    with open_hdf5(path, purpose) as file:
        arrays = _Arrays(path, file)
        for name, item in members(file, "", 0):
            if not name.startswith("#"):  # what references point to
                yield from arrays.of(name, item, 1)


class _Arrays:
    """Traversal of a file of version 7.3, which records visited objects and counts references."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._visited: set[int] = set()
        self._references = 0

    def of(self, name: str, item: Any, depth: int) -> Iterator[ColumnBlock | Refused]:
        """Blocks of an array, of a struct (a group), or of the targets of a cell array's references."""
        import h5py

        if isinstance(item, Refused):
            yield item
        elif isinstance(item, h5py.Group):
            if is_new(item, self._visited):
                for field, member in members(item, f"{name}.", depth):
                    if (
                        isinstance(member, h5py.Dataset)
                        and _holds_references(member)
                        and not _has_class(member, "cell")
                    ):
                        yield from self._referenced(member, f"{name}(", f").{field}", depth + 1)
                    else:
                        yield from self.of(f"{name}.{field}", member, depth + 1)
        elif isinstance(item, h5py.Dataset) and _has_class(item, "cell"):
            yield from self._referenced(item, f"{name}{{", "}", depth + 1)
        elif isinstance(item, h5py.Dataset) and not _has_class(item, "char") and not _is_empty(item):
            yield from blocks_of(self._path, item, name)

    def _referenced(self, dataset: Any, prefix: str, suffix: str, depth: int) -> Iterator[ColumnBlock | Refused]:
        """Blocks of the targets of references, named prefix + number + suffix."""
        name = f"{prefix}1{suffix}"
        if not is_new(dataset, self._visited):
            return
        if sentence := kept_elsewhere(dataset, name):
            yield Refused(name, sentence)
            return
        self._references += dataset.size
        if depth > MAX_DEPTH or self._references > MAX_ITEMS:
            raise UnreadableError(f"its cells are more than {MAX_DEPTH} deep, or more than {MAX_ITEMS}")
        check_stored(self._path, dataset, name)
        for number, reference in enumerate(dataset[()].T.ravel(order="F"), start=1):
            yield from self.of(f"{prefix}{number}{suffix}", self._file[reference], depth)


def _holds_references(dataset: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference


def _has_class(item: Any, kind: str) -> bool:
    return attribute(item, ("MATLAB_class",)) == kind


def _is_empty(item: Any) -> bool:
    return attribute(item, ("MATLAB_empty",)) not in (None, "0")
