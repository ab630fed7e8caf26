"""The numeric arrays of a MATLAB file, also in structs and cells, with what texts and numbers beside them state.

Version 5 to 7 is read here: where a type is damaged, scipy's reader ends the process, or it swells. Version 7.3 is
HDF5, and version 4 is read by scipy. A file is gone through twice: first for what is stated, then for the numbers.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import RigError
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
from rig.lab.stated import MAX_FIELD_VALUES, Field, Stated, StatedFields, column_of
from rig.lab.units import stated_unit
from rig.limits import MAX_DEPTH, MAX_ITEMS, MAX_NAME_LENGTH, PROGRAM_BYTES, check_decoded_size

_HEADER_BYTES = 128
_ARRAY_HEAD_BYTES = 8192
"""Bytes of a compressed array that hold its class, size and name."""
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHARACTERS = 1, 2, 4
_UTF16_TYPES = (3, 4, 17)
"""Types of characters of two bytes."""
_LABCHART_BOUNDS = ("datastart", "dataend")
_LABCHART_TABLES = (
    "samplerate", "unittextmap", "firstsampleoffset", "tickrate", "blocktimes", "scaleunits", "scaleoffset",
    "rangemin", "rangemax",
)  # fmt: skip
"""Fields of LabChart with a number for each channel and block."""
_MAX_FIELD_BYTES = 1 << 20
"""Largest array, decompressed, that is read for what it states."""
_NUMPY_TYPE_BY_CODE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX_FLAG = 1 << 11

ReadArray = Callable[[], np.ndarray]


@dataclass(frozen=True)
class _Leaf:
    """An array of real numbers, or of characters: its name in MATLAB, its shape and what reads it.

    working_bytes is the memory that `read_array` needs besides the array.
    """

    name: str
    shape: tuple[int, ...]
    is_text: bool
    read_array: ReadArray
    working_bytes: int = 0

    @property
    def path(self) -> tuple[str, ...]:
        return tuple(self.name.split("."))


Leaves = Iterator[_Leaf]


def matlab_blocks(path: Path) -> Blocks:
    """Block per real numeric matrix, named as in MATLAB: `a`, `run.a`, `run(2).a`, `c{3}`; `a[1]` is a channel.

    Where LabChart stores channels one behind the other, `data(1:2048)` is one. Raises RigError if version 7.3 needs
    h5py and it is not installed, and RigError or UnreadableError if the file is cut, damaged or too large.
    """
    with path.open("rb") as stream:
        header = stream.read(_HEADER_BYTES)
    byte_order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
    if header.startswith(b"MATLAB 7.3"):
        yield from matlab_hdf5_blocks(path)
    elif byte_order is None or not header.startswith(b"MATLAB 5.0"):
        arrays = _version_4_arrays(path.read_bytes())
        yield from _blocks_of_leaves(lambda: iter(arrays))
    else:
        content = path.read_bytes()
        yield from _blocks_of_leaves(lambda: _Version5File(path, content, byte_order).leaves())


def _blocks_of_leaves(leaves: Callable[[], Leaves]) -> Iterator[ColumnBlock]:
    stated = StatedFields()
    for leaf in leaves():
        _add_to_stated(stated, leaf)
    for leaf in leaves():
        if not leaf.is_text and len(leaf.shape) == 2 and math.prod(leaf.shape) > 1:
            yield from _matrix_blocks(leaf, stated)


def _add_to_stated(stated: StatedFields, leaf: _Leaf) -> None:
    value_count = math.prod(leaf.shape)
    if not leaf.is_text and value_count > 1:
        stated.add_array(leaf.path, value_count)
    if len(leaf.shape) != 2 or not 0 < value_count <= MAX_FIELD_VALUES or leaf.working_bytes > _MAX_FIELD_BYTES:
        return
    if leaf.is_text:
        texts = tuple("".join(row).strip(" \0") for row in leaf.read_array())
        stated.add_field(leaf.path, texts[0] if len(texts) == 1 else texts)
    elif value_count == 1:
        stated.add_field(leaf.path, float(leaf.read_array().flat[0]))
    elif leaf.path[-1] in (*_LABCHART_BOUNDS, *_LABCHART_TABLES):
        stated.add_field(leaf.path, leaf.read_array().astype(float))


def _is_labchart(stated: StatedFields, path: tuple[str, ...]) -> bool:
    """True if an array is of LabChart, which keeps all channels in one row and tables of them beside it."""
    fields = stated.fields_beside(path)
    is_known = path[-1] in ("data", *_LABCHART_BOUNDS, *_LABCHART_TABLES)
    return is_known and all(isinstance(fields.get((name,)), np.ndarray | float) for name in _LABCHART_BOUNDS)


def _matrix_blocks(leaf: _Leaf, stated: StatedFields) -> Iterator[ColumnBlock]:
    """Channels of a matrix: its rows or columns, whichever are fewer, or those that LabChart puts in one row."""
    if _is_labchart(stated, leaf.path):
        if leaf.path[-1] == "data":
            yield from _labchart_blocks(leaf, stated.fields_beside(leaf.path))
        return
    channel_count, sample_count = sorted(leaf.shape)
    if channel_count > MAX_ITEMS:
        raise UnreadableError(f"its array {leaf.name!r} has {channel_count} columns")
    channel_names = column_names(leaf.name, channel_count)
    read = partial(_read_columns, channel_names, leaf.read_array, stated.of_array(leaf.path, channel_count))
    yield ColumnBlock(channel_names, sample_count, read, leaf.working_bytes)


def _read_columns(
    names: Sequence[str], read_array: ReadArray, stated: Sequence[Stated], indices: Sequence[int]
) -> list[Column]:
    matrix = read_array()
    channel_rows = matrix if matrix.shape[0] < matrix.shape[1] else matrix.T
    return [column_of(names[index], channel_rows[index].astype(float), stated[index]) for index in indices]


def _labchart_blocks(leaf: _Leaf, fields: Mapping[tuple[str, ...], Field]) -> Iterator[ColumnBlock]:
    """Channels that stand one behind the other in a row, as LabChart exports them, for each of its blocks."""
    firsts, lasts = (_channel_table(fields, name) for name in _LABCHART_BOUNDS)
    if firsts is None or lasts is None or firsts.shape != lasts.shape:
        raise UnreadableError("its datastart and dataend do not fit each other")
    read_array = lru_cache(leaf.read_array)  # for all channels once
    for channel, block in np.ndindex(firsts.shape):
        first, last = firsts[channel, block], lasts[channel, block]
        if not 1 <= first < last <= math.prod(leaf.shape):
            continue  # no samples of this channel in this block
        name, span = f"{leaf.name}({int(first)}:{int(last)})", slice(int(first) - 1, int(last))
        stated, scale, offset = _labchart_channel(fields, channel, block)
        read = partial(_read_piece, name, read_array, span, stated, scale, offset)
        yield ColumnBlock((name,), span.stop - span.start, read, leaf.working_bytes)


def _labchart_channel(fields: Mapping[tuple[str, ...], Field], channel: int, block: int) -> tuple[Stated, float, float]:
    """What is stated of a channel in a block, and its scale and offset, if its samples are integers."""
    values = {
        name: float(table[channel % table.shape[0], block % table.shape[1]])
        for name in _LABCHART_TABLES
        if (table := _channel_table(fields, name)) is not None
    }
    rate_hz, tick_hz = values.get("samplerate", math.nan), values.get("tickrate", math.nan)
    block_times = _channel_table(fields, "blocktimes")
    start_s = 0.0 if block_times is None else 86400 * (values["blocktimes"] - float(block_times.flat[0]))
    if tick_hz > 0 and "firstsampleoffset" in values:
        start_s += values["firstsampleoffset"] / tick_hz
    unit = _row_of(fields.get(("unittext",)), values.get("unittextmap", 0.0) - 1)
    label = _row_of(fields.get(("titles",)), float(channel))
    stated = Stated(
        stated_unit(unit),
        rate_hz if 0 < rate_hz < math.inf else None,
        start_s if math.isfinite(start_s) else None,
        label,
    )
    return stated, values.get("scaleunits", 1.0), values.get("scaleoffset", 0.0)


def _channel_table(fields: Mapping[tuple[str, ...], Field], name: str) -> np.ndarray | None:
    """Table of a LabChart field, channels by blocks; None if it is not there."""
    value = fields.get((name,))
    return np.atleast_2d(np.asarray(value, dtype=float)) if isinstance(value, float | np.ndarray) else None


def _row_of(texts: Field | None, row: float) -> str:
    rows = (texts,) if isinstance(texts, str) else texts if isinstance(texts, tuple) else ()
    return rows[int(row)].strip() if 0 <= row < len(rows) else ""


def _read_piece(
    name: str, read_array: ReadArray, span: slice, stated: Stated, scale: float, offset: float, _: object
) -> list[Column]:
    samples = read_array().ravel(order="F")[span]
    values = samples.astype(float)
    return [column_of(name, scale * (values + offset) if samples.dtype.kind in "iu" else values, stated)]


@dataclass(frozen=True)
class _Head:
    """Head of an array: class, flags, shape and name, and the offset of its content."""

    array_class: int
    flags: int
    shape: tuple[int, ...]
    name: str
    data_offset: int

    @property
    def is_leaf(self) -> bool:
        """True if it is of real numbers or characters."""
        return self.is_text or (self.array_class in _NUMERIC_CLASSES and not self.flags & _COMPLEX_FLAG)

    @property
    def is_text(self) -> bool:
        return self.array_class == _CHARACTERS


class _Version5File:
    """Traversal of a file of version 5 to 7, which counts the elements of structs and cells."""

    def __init__(self, path: Path, file_content: bytes, byte_order: str) -> None:
        self._path, self._content, self._byte_order = path, memoryview(file_content), byte_order
        self._element_count = 0

    def leaves(self) -> Leaves:
        offset = _HEADER_BYTES
        while offset < len(self._content):
            self._add_to_element_total("at its top", (1,))
            element_type, element_bytes, offset = self._element(self._content, offset)
            if element_type == _COMPRESSED:
                yield from self._compressed_leaves(element_bytes)
            elif element_type == _MATRIX:
                yield from self._array_leaves(element_bytes, "", 0)

    def _compressed_leaves(self, compressed: memoryview) -> Leaves:
        """Arrays in a compressed one; only the head of a numeric one is decompressed, structs and cells wholly."""
        first_bytes = memoryview(zlib.decompressobj().decompress(compressed, _ARRAY_HEAD_BYTES))
        element_type, data_length, data_start, _ = self._tag(first_bytes, 0)
        if element_type != _MATRIX or not data_length:
            return
        element_size = data_start + data_length

        def unpacked_data() -> memoryview:
            return memoryview(_decompressed_element(compressed, element_size))[data_start:]

        head = self._head(first_bytes[data_start:])
        if head.is_leaf:
            yield self._leaf(head, first_bytes[data_start:], head.name, unpacked_data, element_size)
        elif head.array_class in (_CELL, _STRUCT):
            memory_label = f"{self._path}: its variable {head.name!r}"
            check_decoded_size(PROGRAM_BYTES + len(self._content) + element_size, len(self._content), memory_label)
            yield from self._array_leaves(unpacked_data(), "", 0)

    def _array_leaves(self, content: memoryview, enclosing_name: str, nesting_depth: int) -> Leaves:
        """An array, or those in a struct or cell array; none if it is not of real numbers or characters."""
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
            yield from self._element_leaves(content, head.data_offset, cell_names, nesting_depth + 1)
        elif head.array_class == _STRUCT:
            yield from self._struct_leaves(content, head, name, nesting_depth + 1)
        elif head.is_leaf:
            yield self._leaf(head, content, name, lambda: content, 0)

    def _struct_leaves(self, content: memoryview, head: _Head, name: str, nesting_depth: int) -> Leaves:
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
        yield from self._element_leaves(content, offset, field_names, nesting_depth)

    def _element_leaves(
        self, array_bytes: memoryview, offset: int, array_names: Iterator[str], nesting_depth: int
    ) -> Leaves:
        """Consecutive arrays with these names."""
        for array_name in array_names:
            element_type, element_bytes, offset = self._element(array_bytes, offset)
            if element_type != _MATRIX:
                raise UnreadableError(f"its array {array_name!r} is of the unknown type {element_type}")
            yield from self._array_leaves(element_bytes, array_name, nesting_depth)

    def _leaf(
        self, head: _Head, first_bytes: memoryview, name: str, read_bytes: Callable[[], memoryview], working_bytes: int
    ) -> _Leaf:
        """Array of numbers or characters from its first bytes; `read_bytes` returns all of it."""
        element_type, length, start, _ = self._tag(first_bytes, head.data_offset)
        if head.is_text:

            def read_characters() -> np.ndarray:
                text = _decoded(bytes(read_bytes()[start : start + length]), element_type, self._byte_order)
                characters = list(text.ljust(math.prod(head.shape))[: math.prod(head.shape)])
                return np.array(characters, dtype="U1").reshape(head.shape, order="F")

            return _Leaf(name, head.shape, True, read_characters, working_bytes)
        if element_type not in _NUMPY_TYPE_BY_CODE:
            raise UnreadableError(f"its array {name!r} is of the unknown type {element_type}")
        number_type = np.dtype(self._byte_order + _NUMPY_TYPE_BY_CODE[element_type])
        if min(head.shape, default=0) < 0 or length != math.prod(head.shape) * number_type.itemsize:
            raise UnreadableError(f"its array {name!r} of {head.shape} holds {length // number_type.itemsize} values")

        def read_array() -> np.ndarray:
            return np.frombuffer(read_bytes()[start : start + length], number_type).reshape(head.shape, order="F")

        return _Leaf(name, head.shape, False, read_array, working_bytes)

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


def _decoded(content: bytes, element_type: int, byte_order: str) -> str:
    """Characters of an array of type char."""
    if element_type in _UTF16_TYPES:
        return content.decode("utf-16-le" if byte_order == "<" else "utf-16-be", "replace")
    return utf8_or_latin1_text(content)


def _version_4_arrays(file_content: bytes) -> list[_Leaf]:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(BytesIO(file_content))[0] != 0:  # scipy would read what was not taken for version 5 to 7
        raise UnreadableError("its header is damaged")
    arrays = {
        name: np.array([[*text] for text in array.ravel()]) if array.dtype.kind == "U" else array
        for name, array in loadmat(BytesIO(file_content), chars_as_strings=False).items()
        if isinstance(array, np.ndarray) and array.dtype.kind in "iufU"
    }
    return [
        _Leaf(name, array.shape, array.dtype.kind == "U", partial(np.asarray, array)) for name, array in arrays.items()
    ]


def matlab_hdf5_blocks(path: Path) -> Blocks:
    """Block per real numeric array of a file of version 7.3, which is HDF5, named as in `matlab_blocks`.

    A group that several hard links or references reach is listed under the first of them. Raises RigError if h5py
    is not installed.
    """
    purpose = "a MATLAB file of version 7.3 (save(..., '-v7') stores it as an older one)"
    with open_hdf5(path, purpose) as file:
        stated = StatedFields()
        for name, item in _Version73File(path, file).datasets():
            if not isinstance(item, Refused):
                _add_dataset_to_stated(path, stated, name, item)
        for name, item in _Version73File(path, file).datasets():
            if isinstance(item, Refused):
                yield item
            elif not _has_class(item, "char"):
                yield from _dataset_blocks(path, item, name, stated)


def _dataset_blocks(path: Path, dataset: Any, name: str, stated: StatedFields) -> Iterator[ColumnBlock | Refused]:
    """Block of a dataset; of one in which LabChart stores all channels, a block of each."""
    leaf_path = tuple(name.split("."))
    for block in dataset_blocks(path, dataset, name, stated, leaf_path):
        if isinstance(block, Refused) or not _is_labchart(stated, leaf_path):
            yield block
        else:
            read_array = partial(_written_array, path, dataset, name)
            yield from _matrix_blocks(_Leaf(name, dataset.shape, False, read_array, dataset.nbytes), stated)


def _written_array(path: Path, dataset: Any, name: str) -> np.ndarray:
    check_written_and_decompressible(path, dataset, name)
    return np.asarray(dataset[()])


def _add_dataset_to_stated(path: Path, stated: StatedFields, name: str, dataset: Any) -> None:
    """Add a dataset of version 7.3, whose arrays are transposed, and what it states if it is small."""
    try:
        shape, kind = dataset.shape[::-1], dataset.dtype.kind
    except TypeError:  # a type that NumPy does not have
        return
    is_text = _has_class(dataset, "char")
    if kind not in "iuf" or external_storage_refusal(dataset, name) or dataset.nbytes > _MAX_FIELD_BYTES:
        if kind in "iuf" and not is_text:
            stated.add_array(tuple(name.split(".")), math.prod(shape))
        return

    def read_array() -> np.ndarray:
        array = dataset[()].T
        return np.vectorize(chr, otypes=["U1"])(array) if is_text else array

    try:
        check_written_and_decompressible(path, dataset, name)
    except RigError:  # said where its numbers are asked for
        stated.add_array(tuple(name.split(".")), math.prod(shape))
        return
    _add_to_stated(stated, _Leaf(name, shape, is_text, read_array))


class _Version73File:
    """Traversal of a file of version 7.3, which records visited objects and counts references."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self._visited: set[int] = set()
        self._reference_count = 0

    def datasets(self) -> Iterator[tuple[str, Any]]:
        """Name and dataset, or Refused, of every array."""
        for name, item in members(self._file, "", 0):
            if not name.startswith("#"):  # what references point to
                yield from self._arrays_in(name, item, 1)

    def _arrays_in(self, name: str, item: Any, nesting_depth: int) -> Iterator[tuple[str, Any]]:
        """An array, those of a struct (a group), or the targets of a cell array's references."""
        import h5py

        if isinstance(item, Refused):
            yield name, item
        elif isinstance(item, h5py.Group):
            for field, member in (
                members(item, f"{name}.", nesting_depth) if is_first_visit(item, self._visited) else ()
            ):
                has_references = isinstance(member, h5py.Dataset) and _has_object_references(member)
                if has_references and not _has_class(member, "cell"):
                    yield from self._targets(member, f"{name}(", f").{field}", nesting_depth + 1)
                else:
                    yield from self._arrays_in(f"{name}.{field}", member, nesting_depth + 1)
        elif isinstance(item, h5py.Dataset) and _has_class(item, "cell"):
            yield from self._targets(item, f"{name}{{", "}", nesting_depth + 1)
        elif isinstance(item, h5py.Dataset) and not _is_empty(item):
            yield name, item

    def _targets(self, dataset: Any, prefix: str, suffix: str, depth: int) -> Iterator[tuple[str, Any]]:
        """Arrays that references point to, named prefix + number + suffix."""
        name = f"{prefix}1{suffix}"
        if not is_first_visit(dataset, self._visited):
            return
        if sentence := external_storage_refusal(dataset, name):
            yield name, Refused(name, sentence)
            return
        self._reference_count += dataset.size
        if depth > MAX_DEPTH or self._reference_count > MAX_ITEMS:
            raise UnreadableError(f"its cells are more than {MAX_DEPTH} deep, or more than {MAX_ITEMS}")
        check_written_and_decompressible(self._path, dataset, name)
        for reference_number, reference in enumerate(dataset[()].T.ravel(order="F"), start=1):
            yield from self._arrays_in(f"{prefix}{reference_number}{suffix}", self._file[reference], depth)


def _has_object_references(dataset: Any) -> bool:
    import h5py

    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference


def _has_class(item: Any, class_name: str) -> bool:
    return attribute_text(item, ("MATLAB_class",)) == class_name


def _is_empty(item: Any) -> bool:
    return attribute_text(item, ("MATLAB_empty",)) not in (None, "0")
