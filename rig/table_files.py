"""What the libraries for measured data do not see to: a MATLAB file that swells, a TDMS file that is cut."""

import struct
import zlib
from pathlib import Path

from rig.errors import RigError

SMALL_BYTES = 256 * 1024 * 1024
MOST_TIMES = 20
"""A MATLAB file may swell to SMALL_BYTES, or to so many times its size."""
_MAT_HEADER = 128
_COMPRESSED = 15
_TDMS_HEAD_BYTES = 28
_BIG_ENDIAN = 1 << 6


def inflated(path: Path) -> bytes:
    """A MATLAB file of version 5 without its compression, and any other as it is.

    Raises RigError if it swells beyond measure or its compressed data is damaged.
    """
    content = path.read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or not content.startswith(b"MATLAB 5.0"):
        return content
    most = max(SMALL_BYTES, MOST_TIMES * len(content))
    pieces, size, at = [content[:_MAT_HEADER]], _MAT_HEADER, _MAT_HEADER
    while at < len(content):
        if at + 8 > len(content):
            raise RigError(f"{path}: is cut off; export it again")
        kind, length = struct.unpack_from(f"{order}II", content, at)
        end = at + 8 + length
        if end > len(content):
            raise RigError(f"{path}: is cut off; export it again")
        piece = content[at:end]
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            piece = unpacking.decompress(content[at + 8 : end], most - size + 1)
            if not unpacking.eof and size + len(piece) <= most:
                raise RigError(f"{path}: its compressed data is damaged; export it again")
        size += len(piece)
        if size > most:
            raise RigError(f"{path}: swells from {len(content)} to more than {most} bytes; store it uncompressed")
        pieces.append(piece)
        at = end
    return b"".join(pieces)


def check_segments(path: Path) -> None:
    """Raises RigError unless a TDMS file ends where its last segment does."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as file:
        while at < size:
            file.seek(at)
            head = file.read(_TDMS_HEAD_BYTES)
            if len(head) < _TDMS_HEAD_BYTES or head[:4] != b"TDSm":
                raise RigError(f"{path}: has no whole segment at byte {at}; export it again")
            (kind,) = struct.unpack_from("<I", head, 4)
            (length,) = struct.unpack_from(">Q" if kind & _BIG_ENDIAN else "<Q", head, 12)
            at += _TDMS_HEAD_BYTES + length
    if at != size:
        raise RigError(f"{path}: is cut off; export it again")
