"""Channels of a TDMS file, read one by one with npTDMS after a check of its segments."""

import logging
import math
import os
import struct
from collections.abc import Mapping
from functools import partial
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.extras import needs_extra
from rig.lab.column import Blocks, Column, ColumnBlock, Refused, UnreadableError
from rig.lab.recorded import stated_clock
from rig.lab.units import FACTORS, canonical_unit, stated_unit
from rig.limits import check_decoded_size

_HEAD_BYTES = 28
_METADATA, _NEW_LIST, _BIG_ENDIAN = 1 << 1, 1 << 2, 1 << 6
_UNKNOWN_LENGTH = (1 << 64) - 1
"""Length of the last segment of a file that was not closed."""
SEGMENT_BYTES, ENTRY_BYTES = 1000, 100
"""Memory that npTDMS keeps per segment, and per channel in a segment's own list."""
MAX_VISITS = 10_000_000
"""Largest number of channel visits, summed over segments, of npTDMS."""
UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription", "unit", "units", "Unit", "Units", "EU", "Engineering Units")
"""Properties of a channel that state its unit, the most specific first."""
READ_SCALES = {
    "Linear", "Polynomial", "Table", "Strain", "RTD", "Thermistor", "Thermocouple", "Add", "Subtract", "AdvancedAPI",
}  # fmt: skip
"""Types of scales that npTDMS applies; it passes over others, and the numbers would be in no unit."""


class _BoundedReadFile(BufferedReader):
    """File whose reads are limited to the bytes left: a false length would otherwise allocate its memory."""

    def read(self, size: int | None = -1) -> bytes:
        remaining = max(0, os.fstat(self.fileno()).st_size - self.tell())
        return super().read(remaining if size is None or size < 0 else min(size, remaining))


def tdms_blocks(path: Path) -> Blocks:
    """Block per channel of real numbers or time stamps, GROUP/CHANNEL, with the unit, rate and start it states.

    A channel with a scale that cannot be applied is a Refused. A file that was not closed is read to its last whole
    sample. Raises RigError if npTDMS is not installed, and RigError or UnreadableError if the file is cut off, or
    declares more than it has.
    """
    with needs_extra("lab", f"{path}: a TDMS file"):
        from nptdms import TdmsFile
        from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # what it finds is said by an error, or is no fault
    file_bytes = path.stat().st_size
    with _BoundedReadFile(path.open("rb", buffering=0)) as stream:
        is_closed = _check_segments(path, stream, file_bytes)
        stream.seek(0)
        with TdmsFile.open(stream, raw_timestamps=True) as file:
            channels = [channel for group in file.groups() for channel in group.channels()]
            if (declared_count := sum(map(len, channels))) > file_bytes:
                raise UnreadableError(f"it declares {declared_count} values, more than it has bytes")
            surplus_counts = {} if is_closed else _surplus_counts(file)
            surplus_text = f"{max(surplus_counts.values(), default=0)} samples that not all channels have are left out"
            crash_text = "the file was not closed, as after a crash; it is read to its last whole sample"
            notes = () if is_closed else (f"{crash_text}, {surplus_text}",)
            origin = _earliest_start(channels)
            for channel in channels:
                yield from _channel_blocks(channel, origin, len(channel) - surplus_counts.get(channel.path, 0), notes)


def _channel_blocks(channel: Any, origin: tuple[int, int], sample_count: int, notes: tuple[str, ...]) -> Blocks:
    """Block of the first samples of a channel; nothing if it holds texts, or no samples."""
    name = f"{channel.group_name}/{channel.name}"
    try:
        kind = channel.dtype.kind
        scale_types = _unread_scales(channel)
    except Exception:  # what npTDMS raises on a scale that lacks a property is not to be listed
        kind, scale_types = "", _scale_types(channel.properties)
    if scale_types:
        yield Refused(
            name,
            f"{name!r} has a scale of the type {', '.join(scale_types)}, which cannot be applied; export it as scaled "
            "numbers",
        )
    elif kind in "iufM" and sample_count > 0:
        read = partial(_read_column, channel, name, origin, sample_count)
        yield ColumnBlock((name,), sample_count, read, 8 * len(channel), notes)


def _read_column(channel: Any, channel_name: str, origin: tuple[int, int], count: int, _: object) -> list[Column]:
    properties = channel.properties
    unit = next(filter(None, (stated_unit(str(properties.get(key, ""))) for key in UNIT_PROPERTIES)), None)
    start = _start_time(properties)
    date_text = str(properties.get("wf_start_time", "")) if start is None else f"{start.as_datetime64('us')} UTC"
    rate_hz, start_s = _rate_and_offset(properties)
    if start is not None:
        start_s = (start_s or 0.0) + _seconds_between(origin, (start.seconds, start.second_fractions))
    raw_values = channel[:count]
    if channel.dtype.kind == "M":
        return [Column(channel_name, _seconds_of_stamps(raw_values), "s", date_text=date_text)]
    return [Column(channel_name, raw_values.astype(float, copy=False), unit, rate_hz, date_text, start_s)]


def _rate_and_offset(properties: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Rate (Hz) and start (s) of a waveform, whose abscissa may have another unit of time, or be none of time."""
    waveform_unit = stated_unit(str(properties.get("wf_xunit_string", ""))) or "s"
    unit_s = FACTORS["time"].get(canonical_unit(waveform_unit))
    interval, offset = (properties.get(f"wf_{key}") for key in ("increment", "start_offset"))
    if not isinstance(interval, int | float) or not 0 < interval < math.inf:
        return stated_clock({key: value for key, value in properties.items() if not key.startswith("wf_")})
    if unit_s is None:
        return None, None
    if not isinstance(offset, int | float) or not math.isfinite(offset):
        return 1 / (interval * unit_s), None
    return 1 / (interval * unit_s), offset * unit_s


def _start_time(properties: Mapping[str, Any]) -> Any:
    """Time stamp of the first sample; None if it is not stated, which is also written as the beginning of 1904."""
    from nptdms.timestamp import TdmsTimestamp

    start = properties.get("wf_start_time")
    return start if isinstance(start, TdmsTimestamp) and start.seconds > 0 else None


def _earliest_start(channels: list[Any]) -> tuple[int, int]:
    """Seconds, and 2^-64 seconds, of the earliest start; zeros if none is stated."""
    starts = [start for channel in channels if (start := _start_time(channel.properties)) is not None]
    return min(((start.seconds, start.second_fractions) for start in starts), default=(0, 0))


def _seconds_between(first: tuple[int, int], second: tuple[int, int]) -> float:
    """Seconds from one time to another: the large numbers are subtracted before anything is rounded."""
    return int(second[0]) - int(first[0]) + (int(second[1]) - int(first[1])) * 2.0**-64


def _seconds_of_stamps(stamps: Any) -> Float[np.ndarray, " samples"]:
    seconds = stamps["seconds"].astype(np.int64)
    fractions_s = stamps["second_fractions"].astype(float) * 2.0**-64
    return (seconds - seconds[0]).astype(float) + (fractions_s - fractions_s[0])


def _scale_types(properties: Mapping[str, Any]) -> list[str]:
    return [str(value)[:40] for key, value in properties.items() if key.endswith("_Scale_Type")] or ["unknown"]


def _unread_scales(channel: Any) -> list[str]:
    """Types of a channel's scales that npTDMS passes over, if it is not stored with its scales applied."""
    properties = channel.properties
    is_scaled = properties.get("NI_Scaling_Status") == "scaled" or properties.get("NI_Number_Of_Scales") == 0
    scale_types = {str(value)[:40] for key, value in properties.items() if key.endswith("_Scale_Type")}
    return [] if is_scaled else sorted(scale_types - READ_SCALES)


def _surplus_counts(file: Any) -> dict[str, int]:
    """Samples of each channel in the last chunk of a file that was not closed, beyond those that all channels have."""
    last_segment = file._reader._segments[-1]
    lengths = last_segment.final_chunk_lengths_override or {} if last_segment.segment_incomplete else {}
    paths = [item.path for item in last_segment.ordered_objects if item.has_data]
    common_count = min((lengths.get(path, 0) for path in paths), default=0)
    return {path: lengths[path] - common_count for path in paths if path in lengths}


def _check_segments(path: Path, stream: BufferedReader, file_bytes: int) -> bool:
    """True if the file was closed, False if its last segment has no length.

    Raises UnreadableError unless the file ends with its last segment, RigError if the channel lists are too long. A
    segment that only adds to the list of channels of the one before keeps a list of its own: 32 bytes can take
    megabytes.
    """
    offset, segment_count, listed_count, entry_count, visit_count = 0, 0, 0, 0, 0
    is_closed = True
    while offset < file_bytes:
        stream.seek(offset)
        segment_head = stream.read(_HEAD_BYTES + 4)
        if len(segment_head) < _HEAD_BYTES or segment_head[:4] != b"TDSm":
            raise UnreadableError(f"it has no whole segment at byte {offset}")
        (segment_flags,) = struct.unpack_from("<I", segment_head, 4)
        byte_order = ">" if segment_flags & _BIG_ENDIAN else "<"
        segment_length, head_length = struct.unpack_from(f"{byte_order}QQ", segment_head, 12)
        if segment_flags & _METADATA and len(segment_head) > _HEAD_BYTES:
            (list_length,) = struct.unpack_from(f"{byte_order}I", segment_head, _HEAD_BYTES)
            listed_count = list_length + (0 if segment_flags & _NEW_LIST else listed_count)
            entry_count += listed_count
        segment_count, visit_count = segment_count + 1, visit_count + listed_count
        is_closed = segment_length != _UNKNOWN_LENGTH
        if not is_closed and not offset and head_length > file_bytes - _HEAD_BYTES:
            raise UnreadableError("it was not closed, and ends before its first samples")
        offset = offset + _HEAD_BYTES + segment_length if is_closed else file_bytes
    if offset != file_bytes:
        raise UnreadableError("it is cut off")
    if visit_count > MAX_VISITS:
        raise RigError(
            f"{path}: has {segment_count} segments of up to {listed_count} channels; defragment it, or export it again"
        )
    check_decoded_size(
        SEGMENT_BYTES * segment_count + ENTRY_BYTES * entry_count, file_bytes, f"{path}: its {segment_count} segments"
    )
    return is_closed
