"""The numeric arrays of a MATLAB file, also in structs and cells.

Version 5 to 7 is read here: where a type is damaged, scipy's reader ends the process, or it swells.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np

from rig.errors import RigError

SMALL_BYTES = 256 * 1024 * 1024
MOST_TIMES = 20
"""A file may swell to SMALL_BYTES, or to so many times its size."""
MOST_ELEMENTS = 100_000
"""Of a struct or cell array."""
_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT = 1, 2
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 1 << 11


def most_bytes(size: int) -> int:
    """What a file of that size may hold in all; more is no data."""
    return max(SMALL_BYTES, MOST_TIMES * size)


def arrays_of(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Name and values of every real numeric array, named as MATLAB does: `a`, `run.a`, `run(2).a`, `c{3}`.

    Files of version 4 are read by scipy, of 7.3 (HDF5) by h5py, an optional dependency. Raises RigError or ValueError
    if the file is cut or damaged.
    """
    content = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if content.startswith(b"MATLAB 7.3"):
        from rig.lab.matlab_hdf5 import arrays_of_hdf5

        yield from arrays_of_hdf5(path, most_bytes(len(content)))
        return
    if order is None or not content.startswith(b"MATLAB 5.0"):
        yield from _version_4(content)
        return
    left = most_bytes(len(content))
    at = _HEADER_BYTES
    while at < len(content):
        kind, body, at = _element(content, at, order)
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            inner = unpacking.decompress(body, left)
            if not unpacking.eof:
                what = "swells beyond measure; store it uncompressed" if len(inner) == left else "is damaged"
                raise RigError(f"{path}: its compressed data {what}")
            left -= len(inner)
            kind, body, _ = _element(inner, 0, order)
        if kind == _MATRIX:
            yield from _matrix(body, order)


def _element(content: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """An element's type and data, and where the next begins."""
    kind, length = struct.unpack_from(f"{order}II", content, at)
    if kind >> 16:  # up to four bytes, in the tag itself
        kind, length, begin, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
    else:
        begin = at + 8
        after = begin + length + (-length % 8 if kind != _COMPRESSED else 0)
    if begin + length > min(after, len(content)):
        raise ValueError(f"an element of {length} bytes is cut off")
    return kind, content[begin : begin + length], after


def _matrix(body: bytes, order: str, outer: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Name and values of an array, or of those in a struct or a cell array; nothing if it is not real and numeric."""
    if not body:
        return
    _, about, at = _element(body, 0, order)
    (flags,) = struct.unpack_from(f"{order}I", about)
    kind = flags & 0xFF
    _, sizes, at = _element(body, at, order)
    _, own, at = _element(body, at, order)
    name = outer or own.decode(errors="replace")
    shape = tuple(np.frombuffer(sizes, f"{order}i4").tolist())
    if kind == _CELL:
        yield from _inner(body, at, order, [f"{name}{{{k}}}" for k in range(1, _count(name, shape) + 1)])
    elif kind == _STRUCT:
        _, length, at = _element(body, at, order)
        _, text, at = _element(body, at, order)
        (size,) = struct.unpack(f"{order}i", length)
        if size < 1:
            raise ValueError(f"the fields of its struct {name!r} have no names")
        fields = [text[k : k + size].partition(b"\0")[0].decode(errors="replace") for k in range(0, len(text), size)]
        count = _count(name, shape)
        elements = [name] if count == 1 else [f"{name}({k})" for k in range(1, count + 1)]
        yield from _inner(body, at, order, [f"{element}.{field}" for element in elements for field in fields])
    elif kind in _NUMERIC_CLASSES and not flags & _COMPLEX:
        kind, data, _ = _element(body, at, order)
        if kind not in _TYPES:
            raise ValueError(f"its array {name!r} is of the unknown type {kind}")
        values = np.frombuffer(data, order + _TYPES[kind])
        if min(shape, default=0) < 0 or values.size != math.prod(shape):
            raise ValueError(f"its array {name!r} of {shape} holds {values.size} values")
        yield name, values.reshape(shape, order="F")


def _inner(body: bytes, at: int, order: str, names: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of these names, one after the other."""
    for name in names:
        kind, inner, at = _element(body, at, order)
        if kind != _MATRIX:
            raise ValueError(f"its array {name!r} is of the unknown type {kind}")
        yield from _matrix(inner, order, name)


def _count(name: str, shape: tuple[int, ...]) -> int:
    """Elements of a struct or cell array."""
    if min(shape, default=0) < 0 or math.prod(shape) > MOST_ELEMENTS:
        raise ValueError(f"its array {name!r} has the size {shape}")
    return math.prod(shape)


def _version_4(content: bytes) -> Iterator[tuple[str, np.ndarray]]:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(BytesIO(content))[0] != 0:  # scipy would read what `arrays_of` did not take for version 5 to 7
        raise ValueError("its header is damaged")
    for name, array in loadmat(BytesIO(content)).items():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
            yield name, array
