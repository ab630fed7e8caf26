"""Channels of a TDMS file, read one by one with npTDMS after a check of its segments."""

import logging
import os
import struct
from functools import partial
from io import BufferedReader
from pathlib import Path
from typing import Any

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import Blocks, Column, ColumnBlock, UnreadableError
from rig.limits import check_decoded_size

_HEAD_BYTES = 28
_METADATA, _NEW_LIST, _BIG_ENDIAN = 1 << 1, 1 << 2, 1 << 6
SEGMENT_BYTES, ENTRY_BYTES = 1000, 100
"""Memory that npTDMS keeps per segment, and per channel in a segment's own list."""
MAX_VISITS = 10_000_000
"""Largest number of channel visits, summed over segments, of npTDMS."""


class _BoundedReadFile(BufferedReader):
    """File whose reads are limited to the bytes left: a false length would otherwise allocate its memory."""

    def read(self, size: int | None = -1) -> bytes:
        remaining = max(0, os.fstat(self.fileno()).st_size - self.tell())
        return super().read(remaining if size is None or size < 0 else min(size, remaining))


def tdms_blocks(path: Path) -> Blocks:
    """Block per channel of real numbers, GROUP/CHANNEL, with the unit and rate of its properties.

    Raises RigError if npTDMS is not installed, and RigError or UnreadableError if the file is cut off, or declares more
    than it has.
    """
    with needs_extra("lab", f"{path}: a TDMS file"):
        from nptdms import TdmsFile
        from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # what it finds is said by an error, or is no fault
    file_bytes = path.stat().st_size
    with _BoundedReadFile(path.open("rb", buffering=0)) as stream:
        _check_segments(path, stream, file_bytes)
        stream.seek(0)
        with TdmsFile.open(stream) as file:
            channels = [channel for group in file.groups() for channel in group.channels()]
            if (declared_count := sum(map(len, channels))) > file_bytes:
                raise UnreadableError(f"it declares {declared_count} values, more than it has bytes")
            for channel in channels:
                if channel.dtype.kind in "iuf":
                    name = f"{channel.group_name}/{channel.name}"
                    yield ColumnBlock((name,), len(channel), partial(_read_column, channel, name), 8 * len(channel))


def _read_column(channel: Any, channel_name: str, _: object) -> list[Column]:
    unit = channel.properties.get("unit_string")
    interval_s = channel.properties.get("wf_increment")
    rate_hz = 1 / interval_s if isinstance(interval_s, int | float) and interval_s > 0 else None
    date_text = f"{start_utc} UTC" if (start_utc := channel.properties.get("wf_start_time")) is not None else ""
    return [Column(channel_name, channel[:].astype(float, copy=False), str(unit) if unit else None, rate_hz, date_text)]


def _check_segments(path: Path, stream: BufferedReader, file_bytes: int) -> None:
    """Raise UnreadableError unless the file ends with its last segment, RigError if the channel lists are too long.

    A segment that only adds to the list of channels of the one before keeps a list of its own: 32 bytes can take
    megabytes.
    """
    offset, segment_count, listed_count, entry_count, visit_count = 0, 0, 0, 0, 0
    while offset < file_bytes:
        stream.seek(offset)
        segment_head = stream.read(_HEAD_BYTES + 4)
        if len(segment_head) < _HEAD_BYTES or segment_head[:4] != b"TDSm":
            raise UnreadableError(f"it has no whole segment at byte {offset}")
        (segment_flags,) = struct.unpack_from("<I", segment_head, 4)
        byte_order = ">" if segment_flags & _BIG_ENDIAN else "<"
        (segment_length,) = struct.unpack_from(f"{byte_order}Q", segment_head, 12)
        if segment_flags & _METADATA and len(segment_head) > _HEAD_BYTES:
            (list_length,) = struct.unpack_from(f"{byte_order}I", segment_head, _HEAD_BYTES)
            listed_count = list_length + (0 if segment_flags & _NEW_LIST else listed_count)
            entry_count += listed_count
        segment_count, visit_count = segment_count + 1, visit_count + listed_count
        offset += _HEAD_BYTES + segment_length
    if offset != file_bytes:
        raise UnreadableError("it is cut off")
    if visit_count > MAX_VISITS:
        raise RigError(
            f"{path}: has {segment_count} segments of up to {listed_count} channels; defragment it, or export it again"
        )
    check_decoded_size(
        SEGMENT_BYTES * segment_count + ENTRY_BYTES * entry_count, file_bytes, f"{path}: its {segment_count} segments"
    )
