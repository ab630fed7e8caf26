"""The numeric arrays of a MATLAB file: where a type is damaged, scipy's reader ends the process, or it swells."""

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
_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 1 << 11


def arrays_of(path: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Name and values of every real numeric array; raises RigError or ValueError if the file is cut or damaged.

    Files of version 5 to 7 are read here, of version 4 by scipy; 7.3 is refused.
    """
    content = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if content.startswith(b"MATLAB 7.3"):
        raise RigError(f"{path}: is a MATLAB file of version 7.3; store it by save(..., '-v7')")
    if order is None or not content.startswith(b"MATLAB 5.0"):
        yield from _version_4(content)
        return
    left = max(SMALL_BYTES, MOST_TIMES * len(content))
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
        if kind == _MATRIX and (found := _matrix(body, order)) is not None:
            yield found


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


def _matrix(body: bytes, order: str) -> tuple[str, np.ndarray] | None:
    """Name and values; None if it is no real numeric array."""
    _, about, at = _element(body, 0, order)
    (flags,) = struct.unpack_from(f"{order}I", about)
    if flags & 0xFF not in _NUMERIC_CLASSES or flags & _COMPLEX:
        return None
    _, sizes, at = _element(body, at, order)
    _, name, at = _element(body, at, order)
    kind, data, _ = _element(body, at, order)
    shape = tuple(np.frombuffer(sizes, f"{order}i4").tolist())
    if kind not in _TYPES:
        raise ValueError(f"its array {name.decode(errors='replace')!r} is of the unknown type {kind}")
    values = np.frombuffer(data, order + _TYPES[kind])
    if min(shape, default=0) < 0 or values.size != math.prod(shape):
        raise ValueError(f"its array {name.decode(errors='replace')!r} of {shape} holds {values.size} values")
    return name.decode(errors="replace"), values.reshape(shape, order="F")


def _version_4(content: bytes) -> Iterator[tuple[str, np.ndarray]]:
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    if matfile_version(BytesIO(content))[0] != 0:  # scipy would read what `arrays_of` did not take for version 5 to 7
        raise ValueError("its header is damaged")
    for name, array in loadmat(BytesIO(content)).items():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
            yield name, array
