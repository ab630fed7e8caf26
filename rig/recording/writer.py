"""Writing a recording as its samples come: blocks and previews in chunks, and beside until the file is complete."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float
from mcap.records import Attachment, Metadata, Schema
from mcap.records import Channel as ChannelRecord

from rig.errors import CutOffError
from rig.files import reserved, settle
from rig.model.description import Rig, to_json
from rig.recording import messages
from rig.recording.channels import Channels, described
from rig.recording.container_writer import ContainerWriter
from rig.recording.file import recorded_at
from rig.recording.foreign import PROVENANCE, RIG_NAME, Foreign, put
from rig.recording.preview import preview_record, previews

BLOCK, AT_ONCE = 1024, 2048
CHUNK_BYTES, CHUNK_S = 512 * 1024, 5.0
"""A chunk is written when it has so many bytes, or so much of the record: a kill loses that and a block at most."""


class RecordingWriter:
    """Appends samples group by group and stores them as blocks of 1024 samples, with previews beside."""

    def __init__(
        self,
        stream: IO[bytes],
        rig: Rig,
        groups: Mapping[str, Channels],
        provenance: Mapping[str, str],
        foreign: Foreign | None = None,
    ) -> None:
        self._stream = stream
        self._groups = dict(groups)
        self._began_ns = began_ns(provenance)
        ids = count(1)
        self._ids = {name: (next(ids), [next(ids) for _ in group.names]) for name, group in groups.items()}
        others = (foreign or Foreign()).numbered(schemas=2, channels=next(ids) - 1)
        self._writer = ContainerWriter(
            stream,
            front=[
                Attachment(0, 0, RIG_NAME, "application/json", to_json(rig)),
                Metadata(name=PROVENANCE, metadata=dict(provenance)),
                *others.front,
            ],
            schemas=[
                Schema(id=1, name=messages.BLOCK_NAME, encoding="protobuf", data=messages.BLOCK_SCHEMA),
                Schema(id=2, name=messages.PREVIEW_NAME, encoding="ros2msg", data=messages.PREVIEW_SCHEMA),
                *others.schemas.values(),
            ],
            channels=[
                *(record for name, group in groups.items() for record in _records(name, group, *self._ids[name])),
                *others.channels.values(),
            ],
        )
        for message in others.messages:
            put(message, self._writer.chunk)
            self._write_full_chunk()
        stream.flush()
        self._pending = {name: np.zeros((len(group.names), 0)) for name, group in groups.items()}
        self._written = dict.fromkeys(groups, 0)

    def append(self, group: str, values: Float[np.ndarray, "channels samples"]) -> None:
        waiting = self._pending[group]
        pending = np.concatenate([waiting, values], axis=1) if waiting.size else values
        whole = pending.shape[1] // BLOCK * BLOCK
        for first in range(0, whole, AT_ONCE):  # the previews of so many samples are in one chunk
            self._write(group, pending[:, first : min(first + AT_ONCE, whole)], BLOCK)
        self._pending[group] = pending[:, whole:].copy()
        self._stream.flush()  # a kill loses nothing but the chunk in the making

    def append_all(self, values: Mapping[str, Float[np.ndarray, "_ samples"]]) -> None:
        """Samples of every group, put side by side in the file, so that it can be read segment by segment."""
        for first in range(0, max(rows.shape[1] for rows in values.values()), AT_ONCE):
            for group, rows in values.items():
                self.append(group, rows[:, first : first + AT_ONCE])

    def finish(self) -> None:
        """Writes what is left, and the index: from here on the file is complete."""
        for group, rest in self._pending.items():
            if rest.shape[1]:
                self._write(group, rest, rest.shape[1])
        self._writer.finish()

    def _write(self, group: str, values: Float[np.ndarray, "channels samples"], length: int) -> None:
        """Blocks of that length, and the previews of their channels."""
        rate, first = self._groups[group].sample_rate_hz, self._written[group]
        block_id, preview_ids = self._ids[group]
        channels, samples = values.shape
        for begin in range(0, samples, length):
            time_ns = round((first + begin) / rate * 1e9)
            head = messages.block_head(time_ns, first + begin, rate, (channels, length))
            at_ns = self._began_ns + time_ns
            self._writer.chunk.add(block_id, at_ns, (first + begin) // BLOCK, head, values[:, begin : begin + length])
            self._write_full_chunk()
        begins, rows = previews(values, rate, length)
        moments_ns = np.rint((first + begins) / rate * 1e9).astype("<u8") + np.uint64(self._began_ns)
        for preview_id, ends in zip(preview_ids, rows, strict=True):
            self._writer.chunk.add_many(preview_id, moments_ns, messages.preview_head(2), ends)
        self._written[group] += samples

    def _write_full_chunk(self) -> None:
        if self._writer.chunk.size >= CHUNK_BYTES or self._writer.chunk.span_ns >= CHUNK_S * 1e9:
            self._writer.write_chunk()


def _records(name: str, group: Channels, block_id: int, preview_ids: Sequence[int]) -> Iterator[ChannelRecord]:
    yield ChannelRecord(
        id=block_id, topic=f"/rig/{name}/block", message_encoding="protobuf", schema_id=1, metadata=described(group)
    )
    for preview_id, sensor in zip(preview_ids, group.names, strict=True):
        yield preview_record(preview_id, name, sensor, group.unit)


def began_ns(provenance: Mapping[str, str]) -> int:
    """The date at which a record begins, ns since 1970; 0 where it is not known."""
    began = recorded_at(provenance)
    return max(0, round(began.timestamp() * 1e9)) if began else 0


@contextmanager
def writing(
    path: Path,
    rig: Rig,
    groups: Mapping[str, Channels],
    provenance: Mapping[str, str],
    foreign: Foreign | None = None,
) -> Iterator[RecordingWriter]:
    """A writer for a recording at `path`, which appears there only when it is complete; `foreign` is stored beside.

    An interruption (Ctrl-C) completes the file with what was written so far. A full disk leaves what was written under
    the name FILE.part, as a kill does, for rig.recovery. Any other error removes it.
    """
    interruption = None
    with reserved(path) as part:
        try:
            with part.open("wb") as stream:
                writer = RecordingWriter(stream, rig, groups, provenance, foreign)
                try:
                    yield writer
                except KeyboardInterrupt as error:
                    interruption = error
                writer.finish()
            settle(part, path)
        except (OSError, CutOffError) as error:  # CutOffError: the disk failed another file of the same recording
            why = error.strerror or str(error)
            raise CutOffError(
                f"{path}: cannot be written to its end ({why}); make room and save what there is: rig recover {part}",
                why,
            ) from error
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        if interruption is not None:
            raise interruption
