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

from rig.lab.column import Blocks, Column, ColumnBlock, Refused, UnreadableError, column_names, utf8_or_latin1_text
from rig.lab.hdf5 import (
    attribute_text,
    check_written_and_decompressible,
    dataset_blocks,
    external_storage_refusal,
    is_first_visit,
    members,
    open_hdf5,
)
from rig.limits import MAX_DEPTH, MAX_ITEMS, MAX_NAME_LENGTH, PROGRAM_BYTES, check_decoded_size

_HEADER_BYTES = 128
_ARRAY_HEAD_BYTES = 8192
"""Bytes of a compressed array that hold its class, size and name."""
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT = 1, 2
_NUMPY_TYPE_BY_CODE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX_FLAG = 1 << 11

ReadArray = Callable[[], np.ndarray]


def matlab_blocks(path: Path, min_value_count: int = 2) -> Blocks:
    """Block per real numeric matrix, named as in MATLAB: `a`, `run.a`, `run(2).a`, `c{3}`; `a[1]` is a channel.

    Matrices of fewer than min_value_count are left out (of version 7.3, of fewer than two).
    Raises RigError if version 7.3 needs h5py and it is not installed, and RigError or UnreadableError if the file is
    cut, damaged or too large.
    """
    with path.open("rb") as stream:
        header = stream.read(_HEADER_BYTES)
    byte_order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
    if header.startswith(b"MATLAB 7.3"):
        yield from matlab_hdf5_blocks(path)
    elif byte_order is None or not header.startswith(b"MATLAB 5.0"):
        yield from _version_4_blocks(path.read_bytes(), min_value_count)
    else:
        yield from _Version5File(path, path.read_bytes(), byte_order, min_value_count).blocks()


def _matrix_block(
    matrix_name: str, shape: tuple[int, ...], read_array: ReadArray, min_value_count: int, working_bytes: int = 0
) -> Iterator[ColumnBlock]:
    """Channels of a matrix: its rows or columns, whichever are fewer."""
    if len(shape) != 2 or math.prod(shape) < min_value_count:
        return
    channel_count, sample_count = sorted(shape)
    if channel_count > MAX_ITEMS:
        raise UnreadableError(f"its array {matrix_name!r} has {channel_count} columns")
    channel_names = column_names(matrix_name, channel_count)
    yield ColumnBlock(channel_names, sample_count, partial(_read_columns, channel_names, read_array), working_bytes)


def _read_columns(names: Sequence[str], read_array: ReadArray, indices: Sequence[int]) -> list[Column]:
    matrix = read_array()
    channel_rows = matrix if matrix.shape[0] < matrix.shape[1] else matrix.T
    return [Column(names[index], channel_rows[index].astype(float)) for index in indices]


@dataclass(frozen=True)
class _Head:
    """Head of an array: class, flags, shape and name, and the offset of its content."""

    array_class: int
    flags: int
    shape: tuple[int, ...]
    name: str
    data_offset: int

    @property
    def is_real_numeric(self) -> bool:
        return self.array_class in _NUMERIC_CLASSES and not self.flags & _COMPLEX_FLAG


class _Version5File:
    """Traversal of a file of version 5 to 7, which counts the elements of structs and cells."""

    def __init__(self, path: Path, file_content: bytes, byte_order: str, min_value_count: int) -> None:
        self._path, self._content, self._byte_order = path, memoryview(file_content), byte_order
        self._min_value_count = min_value_count
        self._element_count = 0

    def blocks(self) -> Iterator[ColumnBlock]:
        offset = _HEADER_BYTES
        while offset < len(self._content):
            self._add_to_element_total("at its top", (1,))
            element_type, element_bytes, offset = self._element(self._content, offset)
            if element_type == _COMPRESSED:
                yield from self._compressed_blocks(element_bytes)
            elif element_type == _MATRIX:
                yield from self._array_blocks(element_bytes, "", 0)

    def _compressed_blocks(self, compressed: memoryview) -> Iterator[ColumnBlock]:
        """Blocks of a compressed array; only the head of a numeric one is decompressed, structs and cells wholly."""
        first_bytes = memoryview(zlib.decompressobj().decompress(compressed, _ARRAY_HEAD_BYTES))
        element_type, data_length, data_start, _ = self._tag(first_bytes, 0)
        if element_type != _MATRIX or not data_length:
            return
        element_size = data_start + data_length

        def unpacked_data() -> memoryview:
            return memoryview(_decompressed_element(compressed, element_size))[data_start:]

        head = self._head(first_bytes[data_start:])
        if head.is_real_numeric:
            yield from self._numeric_blocks(head, first_bytes[data_start:], head.name, unpacked_data, element_size)
        elif head.array_class in (_CELL, _STRUCT):
            memory_label = f"{self._path}: its variable {head.name!r}"
            check_decoded_size(PROGRAM_BYTES + len(self._content) + element_size, len(self._content), memory_label)
            yield from self._array_blocks(unpacked_data(), "", 0)

    def _array_blocks(self, content: memoryview, enclosing_name: str, nesting_depth: int) -> Iterator[ColumnBlock]:
        """Blocks of an array, or of those in a struct or cell array; none if it is not real and numeric."""
        if not content:
            return
        head = self._head(content)
        name = enclosing_name or head.name
        if nesting_depth > MAX_DEPTH or len(name) > MAX_NAME_LENGTH:
            raise UnreadableError(
                f"its structs are more than {MAX_DEPTH} deep, or have names of over {MAX_NAME_LENGTH} characters"
            )
        if head.array_class == _CELL:
            cell_names = (f"{name}{{{k}}}" for k in range(1, self._add_to_element_total(name, head.shape) + 1))
            yield from self._element_blocks(content, head.data_offset, cell_names, nesting_depth + 1)
        elif head.array_class == _STRUCT:
            yield from self._struct_blocks(content, head, name, nesting_depth + 1)
        elif head.is_real_numeric:
            yield from self._numeric_blocks(head, content, name, lambda: content, 0)

    def _struct_blocks(self, content: memoryview, head: _Head, name: str, nesting_depth: int) -> Iterator[ColumnBlock]:
        _, length_bytes, offset = self._element(content, head.data_offset)
        _, names_bytes, offset = self._element(content, offset)
        (name_length,) = struct.unpack(f"{self._byte_order}i", length_bytes)
        if name_length < 1:
            raise UnreadableError(f"the fields of its struct {name!r} have no names")
        name_starts = range(0, len(names_bytes), name_length)
        struct_fields = [
            utf8_or_latin1_text(bytes(names_bytes[k : k + name_length]).partition(b"\0")[0]) for k in name_starts
        ]
        struct_count = self._add_to_element_total(name, (*head.shape, len(struct_fields))) // max(1, len(struct_fields))
        struct_names = (name if struct_count == 1 else f"{name}({k})" for k in range(1, struct_count + 1))
        field_names = (f"{struct_name}.{field}" for struct_name in struct_names for field in struct_fields)
        yield from self._element_blocks(content, offset, field_names, nesting_depth)

    def _element_blocks(
        self, array_bytes: memoryview, offset: int, array_names: Iterator[str], nesting_depth: int
    ) -> Iterator[ColumnBlock]:
        """Blocks of consecutive arrays with these names."""
        for array_name in array_names:
            element_type, element_bytes, offset = self._element(array_bytes, offset)
            if element_type != _MATRIX:
                raise UnreadableError(f"its array {array_name!r} is of the unknown type {element_type}")
            yield from self._array_blocks(element_bytes, array_name, nesting_depth)

    def _numeric_blocks(
        self, head: _Head, first_bytes: memoryview, name: str, read_bytes: Callable[[], memoryview], working_bytes: int
    ) -> Iterator[ColumnBlock]:
        """Block of a numeric array from its first bytes; `read_bytes` returns all of it."""
        element_type, length, start, _ = self._tag(first_bytes, head.data_offset)
        if element_type not in _NUMPY_TYPE_BY_CODE:
            raise UnreadableError(f"its array {name!r} is of the unknown type {element_type}")
        number_type = np.dtype(self._byte_order + _NUMPY_TYPE_BY_CODE[element_type])
        if min(head.shape, default=0) < 0 or length != math.prod(head.shape) * number_type.itemsize:
            raise UnreadableError(f"its array {name!r} of {head.shape} holds {length // number_type.itemsize} values")

        def read_array() -> np.ndarray:
            return np.frombuffer(read_bytes()[start : start + length], number_type).reshape(head.shape, order="F")

        yield from _matrix_block(name, head.shape, read_array, self._min_value_count, working_bytes)

    def _head(self, array_bytes: memoryview) -> _Head:
        _, flag_bytes, offset = self._element(array_bytes, 0)
        (flags,) = struct.unpack_from(f"{self._byte_order}I", flag_bytes)
        _, shape_bytes, offset = self._element(array_bytes, offset)
        _, name_bytes, offset = self._element(array_bytes, offset)
        shape = tuple(np.frombuffer(shape_bytes, f"{self._byte_order}i4").tolist())
        return _Head(flags & 0xFF, flags, shape, utf8_or_latin1_text(bytes(name_bytes)), offset)

    def _tag(self, content: memoryview, offset: int) -> tuple[int, int, int, int]:
        """Tag of an element: type, length and offset of its data, and offset of the next element."""
        element_type, data_length = struct.unpack_from(f"{self._byte_order}II", content, offset)
        if element_type >> 16:  # up to four bytes, in the tag itself
            return element_type & 0xFFFF, element_type >> 16, offset + 4, offset + 8
        padding = -data_length % 8 if element_type != _COMPRESSED else 0
        return element_type, data_length, offset + 8, offset + 8 + data_length + padding

    def _element(self, content: memoryview, offset: int) -> tuple[int, memoryview, int]:
        """Type and data of an element, and offset of the next."""
        element_type, data_length, data_start, next_offset = self._tag(content, offset)
        if data_start + data_length > min(next_offset, len(content)):
            raise UnreadableError(f"an element of {data_length} bytes is cut off")
        return element_type, content[data_start : data_start + data_length], next_offset

    def _add_to_element_total(self, name: str, shape: tuple[int, ...]) -> int:
        """Number of elements of a struct or cell array, added to those of the file (at most MAX_ITEMS)."""
        element_count = math.prod(shape)
        self._element_count += element_count
        if min(shape, default=0) < 0 or self._element_count > MAX_ITEMS:
            raise UnreadableError(
                f"its array {name!r} has the size {shape}, and the file may hold {MAX_ITEMS} elements"
            )
        return element_count


def _decompressed_element(compressed: memoryview, element_size: int) -> bytes:
    """Decompressed element of exactly `element_size` bytes; raises UnreadableError if it has fewer or more."""
    decompressor = zlib.decompressobj()
    content = decompressor.decompress(compressed, element_size)
    surplus_bytes = b"" if decompressor.eof else decompressor.decompress(decompressor.unconsumed_tail, 1)
    if len(content) < element_size or surplus_bytes or not decompressor.eof:
        raise UnreadableError("its compressed data are cut off, or swell beyond what they declare")
    return content


def _version_4_blocks(file_content: bytes, min_value_count: int) -> Iterator[ColumnBlock]:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(BytesIO(file_content))[0] != 0:  # scipy would read what was not taken for version 5 to 7
        raise UnreadableError("its header is damaged")
    for array_name, array in loadmat(BytesIO(file_content)).items():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
            yield from _matrix_block(array_name, array.shape, partial(np.asarray, array), min_value_count)


def matlab_hdf5_blocks(path: Path) -> Blocks:
    """Block per real numeric array of a file of version 7.3, which is HDF5, named as in `matlab_blocks`.

    A group that several hard links or references reach is listed under the first of them. Raises RigError if h5py
    is not installed.
    """
    purpose = "a MATLAB file of version 7.3 (save(..., '-v7') stores it as an older one)"
    with open_hdf5(path, purpose) as file:
        arrays = _Version73File(path, file)
        for name, item in members(file, "", 0):
            if not name.startswith("#"):  # what references point to
                yield from arrays.array_blocks(name, item, 1)


class _Version73File:
    """Traversal of a file of version 7.3, which records visited objects and counts references."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._visited: set[int] = set()
        self._reference_count = 0

    def array_blocks(self, name: str, item: Any, nesting_depth: int) -> Iterator[ColumnBlock | Refused]:
        """Blocks of an array, of a struct (a group), or of the targets of a cell array's references."""
        import h5py

        if isinstance(item, Refused):
            yield item
        elif isinstance(item, h5py.Group):
            for field, member in (
                members(item, f"{name}.", nesting_depth) if is_first_visit(item, self._visited) else ()
            ):
                has_references = isinstance(member, h5py.Dataset) and _has_object_references(member)
                if has_references and not _has_class(member, "cell"):
                    yield from self._reference_blocks(member, f"{name}(", f").{field}", nesting_depth + 1)
                else:
                    yield from self.array_blocks(f"{name}.{field}", member, nesting_depth + 1)
        elif isinstance(item, h5py.Dataset) and _has_class(item, "cell"):
            yield from self._reference_blocks(item, f"{name}{{", "}", nesting_depth + 1)
        elif isinstance(item, h5py.Dataset) and not _has_class(item, "char") and not _is_empty(item):
            yield from dataset_blocks(self._path, item, name)

    def _reference_blocks(self, dataset: Any, prefix: str, suffix: str, depth: int) -> Iterator[ColumnBlock | Refused]:
        """Blocks of the targets of references, named prefix + number + suffix."""
        name = f"{prefix}1{suffix}"
        if not is_first_visit(dataset, self._visited):
            return
        if sentence := external_storage_refusal(dataset, name):
            yield Refused(name, sentence)
            return
        self._reference_count += dataset.size
        if depth > MAX_DEPTH or self._reference_count > MAX_ITEMS:
            raise UnreadableError(f"its cells are more than {MAX_DEPTH} deep, or more than {MAX_ITEMS}")
        check_written_and_decompressible(self._path, dataset, name)
        for reference_number, reference in enumerate(dataset[()].T.ravel(order="F"), start=1):
            yield from self.array_blocks(f"{prefix}{reference_number}{suffix}", self._file[reference], depth)


def _has_object_references(dataset: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference


def _has_class(item: Any, class_name: str) -> bool:
    return attribute_text(item, ("MATLAB_class",)) == class_name


def _is_empty(item: Any) -> bool:
    return attribute_text(item, ("MATLAB_empty",)) not in (None, "0")
