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


class _WholeFile(BufferedReader):
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
    with _WholeFile(path.open("rb", buffering=0)) as stream:
        _check_segments(path, stream, file_bytes)
        stream.seek(0)
        with TdmsFile.open(stream) as file:
            channels = [channel for group in file.groups() for channel in group.channels()]
            if (declared := sum(map(len, channels))) > file_bytes:
                raise UnreadableError(f"it declares {declared} values, more than it has bytes")
            for channel in channels:
                if channel.dtype.kind in "iuf":
                    name = f"{channel.group_name}/{channel.name}"
                    yield ColumnBlock((name,), len(channel), partial(_columns, channel, name), 8 * len(channel))


def _columns(channel: Any, name: str, _: object) -> list[Column]:
    unit = channel.properties.get("unit_string")
    interval_s = channel.properties.get("wf_increment")
    rate = 1 / interval_s if isinstance(interval_s, int | float) and interval_s > 0 else None
    recorded = f"{start} UTC" if (start := channel.properties.get("wf_start_time")) is not None else ""
    return [Column(name, channel[:].astype(float, copy=False), str(unit) if unit else None, rate, recorded)]


def _check_segments(path: Path, stream: BufferedReader, file_bytes: int) -> None:
    """Raise UnreadableError unless the file ends with its last segment, RigError if the channel lists are too long.

    A segment that only adds to the list of channels of the one before keeps a list of its own: 32 bytes can take
    megabytes.
    """
    offset, segments, channels_listed, entries, visits = 0, 0, 0, 0, 0
    while offset < file_bytes:
        stream.seek(offset)
        head = stream.read(_HEAD_BYTES + 4)
        if len(head) < _HEAD_BYTES or head[:4] != b"TDSm":
            raise UnreadableError(f"it has no whole segment at byte {offset}")
        (kind,) = struct.unpack_from("<I", head, 4)
        order = ">" if kind & _BIG_ENDIAN else "<"
        (length,) = struct.unpack_from(f"{order}Q", head, 12)
        if kind & _METADATA and len(head) > _HEAD_BYTES:
            (list_length,) = struct.unpack_from(f"{order}I", head, _HEAD_BYTES)
            channels_listed = list_length + (0 if kind & _NEW_LIST else channels_listed)
            entries += channels_listed
        segments, visits = segments + 1, visits + channels_listed
        offset += _HEAD_BYTES + length
    if offset != file_bytes:
        raise UnreadableError("it is cut off")
    if visits > MAX_VISITS:
        raise RigError(
            f"{path}: has {segments} segments of up to {channels_listed} channels; defragment it, or export it again"
        )
    check_decoded_size(SEGMENT_BYTES * segments + ENTRY_BYTES * entries, file_bytes, f"{path}: its {segments} segments")
