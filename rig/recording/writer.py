"""Writing a recording as its samples come: blocks and previews in chunks, to FILE.part until it is complete.

A preview is a look at the recording for people: the least and largest sample of every fiftieth of a second.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float, Int
from mcap.records import Attachment, Metadata, Schema
from mcap.records import Channel as ChannelRecord

from rig.errors import CutOffError
from rig.files import locked_part_path, sync_and_rename
from rig.model.description import Rig, to_json
from rig.recording import messages
from rig.recording.channels import Channels, to_metadata
from rig.recording.container_writer import ContainerWriter
from rig.recording.file import recorded_at
from rig.recording.foreign import PROVENANCE, RIG_NAME, ForeignRecords, copy_foreign_message

SAMPLES_PER_BLOCK, SAMPLES_AT_ONCE = 1024, 2048
CHUNK_BYTES, CHUNK_S = 512 * 1024, 5.0
"""Bytes and duration at which a chunk is written: a kill loses a chunk and a block at most."""


class RecordingWriter:
    """Writer of a recording: samples are appended group by group and stored as blocks of 1024, with previews."""

    def __init__(
        self,
        stream: IO[bytes],
        rig: Rig,
        channels_by_group: Mapping[str, Channels],
        provenance: Mapping[str, str],
        foreign: ForeignRecords | None = None,
    ) -> None:
        self._stream = stream
        self._channels_by_group = dict(channels_by_group)
        self._start_date_ns = start_date_ns(provenance)
        id_counter = count(1)
        self._channel_ids = {
            name: (next(id_counter), [next(id_counter) for _ in group.names])
            for name, group in channels_by_group.items()
        }
        foreign_records = (foreign or ForeignRecords()).renumbered(schema_count=2, channel_count=next(id_counter) - 1)
        self._writer = ContainerWriter(
            stream,
            front_records=[
                Attachment(0, 0, RIG_NAME, "application/json", to_json(rig)),
                Metadata(name=PROVENANCE, metadata=dict(provenance)),
                *foreign_records.front_records,
            ],
            schemas=[
                Schema(id=1, name=messages.BLOCK_NAME, encoding="protobuf", data=messages.BLOCK_SCHEMA),
                Schema(id=2, name=messages.PREVIEW_NAME, encoding="ros2msg", data=messages.PREVIEW_SCHEMA),
                *foreign_records.schemas.values(),
            ],
            channels=[
                *(
                    record
                    for name, group in channels_by_group.items()
                    for record in _channel_records(name, group, *self._channel_ids[name])
                ),
                *foreign_records.channels.values(),
            ],
        )
        for message in foreign_records.messages:
            copy_foreign_message(message, self._writer.chunk)
            self._write_full_chunk()
        stream.flush()
        self._pending_values = {name: np.zeros((len(group.names), 0)) for name, group in channels_by_group.items()}
        self._written_counts = dict.fromkeys(channels_by_group, 0)

    def append(self, group: str, values: Float[np.ndarray, "channels samples"]) -> None:
        waiting_values = self._pending_values[group]
        pending_values = np.concatenate([waiting_values, values], axis=1) if waiting_values.size else values
        full_count = pending_values.shape[1] // SAMPLES_PER_BLOCK * SAMPLES_PER_BLOCK
        for first in range(0, full_count, SAMPLES_AT_ONCE):  # the previews of so many samples are in one chunk
            self._write(group, pending_values[:, first : min(first + SAMPLES_AT_ONCE, full_count)], SAMPLES_PER_BLOCK)
        self._pending_values[group] = pending_values[:, full_count:].copy()
        self._stream.flush()  # a kill loses nothing but the chunk in the making

    def append_all(self, values: Mapping[str, Float[np.ndarray, "_ samples"]]) -> None:
        """Append samples of every group, interleaved in the file, so that it can be read segment by segment."""
        for start_index in range(0, max(group_values.shape[1] for group_values in values.values()), SAMPLES_AT_ONCE):
            for group_name, group_values in values.items():
                self.append(group_name, group_values[:, start_index : start_index + SAMPLES_AT_ONCE])

    def finish(self) -> None:
        """Write the remaining samples and the index, which completes the file."""
        for group_name, remainder in self._pending_values.items():
            if remainder.shape[1]:
                self._write(group_name, remainder, remainder.shape[1])
        self._writer.finish()

    def _write(self, group_name: str, values: Float[np.ndarray, "channels samples"], samples_per_block: int) -> None:
        """Write blocks of `samples_per_block` and the previews of their channels."""
        rate_hz, first_sample = self._channels_by_group[group_name].sample_rate_hz, self._written_counts[group_name]
        block_id, preview_ids = self._channel_ids[group_name]
        channel_count, sample_count = values.shape
        for offset in range(0, sample_count, samples_per_block):
            first, block = first_sample + offset, values[:, offset : offset + samples_per_block]
            time_ns = round(first / rate_hz * 1e9)
            head = messages.block_head(time_ns, first, rate_hz, (channel_count, samples_per_block))
            self._writer.chunk.add(block_id, self._start_date_ns + time_ns, first // SAMPLES_PER_BLOCK, head, block)
            self._write_full_chunk()
        part_starts, part_extremes = previews(values, rate_hz, samples_per_block)
        times_ns = np.rint((first_sample + part_starts) / rate_hz * 1e9).astype("<u8") + np.uint64(self._start_date_ns)
        for preview_id, channel_extremes in zip(preview_ids, part_extremes, strict=True):
            self._writer.chunk.add_many(preview_id, times_ns, messages.preview_head(2), channel_extremes)
        self._written_counts[group_name] += sample_count

    def _write_full_chunk(self) -> None:
        if self._writer.chunk.size >= CHUNK_BYTES or self._writer.chunk.span_ns >= CHUNK_S * 1e9:
            self._writer.write_chunk()


def _channel_records(
    group_name: str, channels: Channels, block_id: int, preview_ids: Sequence[int]
) -> Iterator[ChannelRecord]:
    topic, metadata = f"/rig/{group_name}/block", to_metadata(channels)
    yield ChannelRecord(id=block_id, topic=topic, message_encoding="protobuf", schema_id=1, metadata=metadata)
    for preview_id, channel_name in zip(preview_ids, channels.names, strict=True):
        yield preview_channel_record(preview_id, group_name, channel_name, channels.unit)


def start_date_ns(provenance: Mapping[str, str]) -> int:
    """Date at which a record begins, ns since 1970; 0 where it is unknown."""
    start_date = recorded_at(provenance)
    return max(0, round(start_date.timestamp() * 1e9)) if start_date else 0


@contextmanager
def writing(
    path: Path,
    rig: Rig,
    channels_by_group: Mapping[str, Channels],
    provenance: Mapping[str, str],
    foreign: ForeignRecords | None = None,
) -> Iterator[RecordingWriter]:
    """Writer of a recording that appears at `path` only when it is complete; `foreign` content is stored too.

    An interruption (Ctrl-C) completes the file with what was written so far. A full disk leaves what was written under
    the name FILE.part, as a kill does, for rig.recovery. Any other error removes it.
    """
    interrupt_error = None
    with locked_part_path(path) as part_path:
        try:
            with part_path.open("wb") as stream:
                writer = RecordingWriter(stream, rig, channels_by_group, provenance, foreign)
                try:
                    yield writer
                except KeyboardInterrupt as error:
                    interrupt_error = error
                writer.finish()
            sync_and_rename(part_path, path)
        except (OSError, CutOffError) as error:  # CutOffError: the disk failed another file of the same recording
            reason = error.strerror or str(error)
            raise CutOffError(
                f"{path}: cannot be written to its end ({reason}); make room and save what there is: rig recover "
                f"{part_path}",
                reason,
            ) from error
        except BaseException:
            part_path.unlink(missing_ok=True)
            raise
        if interrupt_error is not None:
            raise interrupt_error


PREVIEW_HZ = 50.0


def preview_channel_record(channel_id: int, group_name: str, channel_name: str, unit: str) -> ChannelRecord:
    """MCAP channel of the previews of a sensor, contact or force, under its name, so that a viewer shows it."""
    channel_metadata = {"unit": unit, "shown": "least, largest"}
    topic = f"/rig/{group_name}/preview/{channel_name}"
    return ChannelRecord(id=channel_id, topic=topic, message_encoding="cdr", schema_id=2, metadata=channel_metadata)


def previews(
    values: Float[np.ndarray, "channels samples"], sample_rate_hz: float, samples_per_block: int
) -> tuple[Int[np.ndarray, " parts"], Float[np.ndarray, "channels parts 2"]]:
    """First samples of the parts (1/50 s) of blocks of `samples_per_block`, and the extremes of every part."""
    part_starts = _preview_interval_starts(
        values.shape[1], samples_per_block, max(1, round(sample_rate_hz / PREVIEW_HZ))
    )
    extremes = [extreme_function.reduceat(values, part_starts, axis=1) for extreme_function in (np.minimum, np.maximum)]
    return part_starts, np.stack(extremes, axis=2)


@lru_cache(maxsize=16)
def _preview_interval_starts(
    sample_count: int, samples_per_block: int, samples_per_part: int
) -> Int[np.ndarray, " parts"]:
    block_starts = range(0, sample_count, samples_per_block)
    return np.concatenate([np.arange(block, block + samples_per_block, samples_per_part) for block in block_starts])
