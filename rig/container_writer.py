"""Writing an MCAP file chunk by chunk, without copies of its messages: mcap's own writer copies each seven times."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import IO, Any

import numpy as np
from jaxtyping import Float, UInt
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from zlib_ng.zlib_ng import crc32

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIIQ")  # times, size, checksum, no compression, size of the records
_MESSAGE = struct.Struct("<BQHIQQ")


@dataclass
class Gathered:
    """Messages that will be a chunk: their bytes in pieces, and for each channel their times and places."""

    pieces: list[Any] = field(default_factory=list)
    size: int = 0
    times_ns: dict[int, list[UInt[np.ndarray, " messages"]]] = field(default_factory=dict)
    offsets: dict[int, list[UInt[np.ndarray, " messages"]]] = field(default_factory=dict)

    def add(self, channel: int, time_ns: int, sequence: int, *data: Any) -> None:
        """One message; its data may come in several pieces of bytes or contiguous arrays, which are not copied."""
        length = sum(memoryview(piece).nbytes for piece in data)
        head = _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE.size - _HEAD.size + length, channel, sequence, time_ns, time_ns)
        self._place(channel, np.array([time_ns], dtype="<u8"), np.zeros(1, dtype="<u8"))
        self.pieces += [head, *data]
        self.size += len(head) + length

    def add_many(
        self,
        channel: int,
        times_ns: UInt[np.ndarray, " messages"],
        head: bytes,
        values: Float[np.ndarray, "messages channels"],
    ) -> None:
        """Messages of the same head and as many doubles."""
        records = np.empty(len(values), dtype=_alike(len(head), values.shape[1]))
        records["opcode"], records["sequence"], records["channel"] = Opcode.MESSAGE, 0, channel
        records["length"] = records.itemsize - _HEAD.size
        records["log"] = records["publish"] = times_ns
        records["head"] = np.frombuffer(head, "u1")
        records["values"] = values
        self._place(channel, times_ns, np.arange(len(values), dtype="<u8") * np.uint64(records.itemsize))
        self.pieces.append(records.view("u1"))
        self.size += records.nbytes

    def _place(
        self, channel: int, times_ns: UInt[np.ndarray, " messages"], offsets: UInt[np.ndarray, " messages"]
    ) -> None:
        self.times_ns.setdefault(channel, []).append(times_ns)
        self.offsets.setdefault(channel, []).append(offsets + np.uint64(self.size))


class ContainerWriter:
    """An MCAP file with checksums and indexes, schemas and channels in front; uncompressed: doubles hardly shrink."""

    def __init__(
        self,
        stream: IO[bytes],
        front: Sequence[Attachment | Metadata],
        schemas: Sequence[Schema],
        channels: Sequence[Channel],
    ) -> None:
        self._stream, self._at, self._crc = stream, 0, 0
        self._repeated = [*schemas, *channels]
        self._indexes: list[Any] = []
        self._counts: dict[int, int] = {}
        self._times_ns: list[int] = []
        self._chunks = 0
        self._front = front
        self._write(MAGIC)
        self._write(_encoded(Header("", "rig")))
        for record in front:
            place, length = self._at, self._write(_encoded(record))
            self._indexes.append(_index(record, place, length))
        for record in self._repeated:
            self._write(_encoded(record))

    def first_chunk(self) -> Gathered:
        """A chunk that begins with the schemas and channels once more: in front of the chunks no checksum guards them.

        What is saved of a file without its end depends on them.
        """
        piece = b"".join(map(_encoded, self._repeated))
        return Gathered([piece], len(piece))

    def write_chunk(self, messages: Gathered) -> None:
        """Writes the messages as a chunk with its index."""
        times = {channel: np.concatenate(found) for channel, found in messages.times_ns.items()}
        begin, end = min(int(t.min()) for t in times.values()), max(int(t.max()) for t in times.values())
        crc = 0
        for piece in messages.pieces:
            crc = crc32(piece, crc)
        place = self._at
        self._write(_HEAD.pack(Opcode.CHUNK, _CHUNK.size + messages.size))
        self._write(_CHUNK.pack(begin, end, messages.size, crc, 0, messages.size))
        for piece in messages.pieces:
            self._write(piece)
        length, places = self._at - place, {}
        for channel, when in times.items():
            places[channel] = self._at
            pairs = np.stack([when, np.concatenate(messages.offsets[channel])], axis=1).tobytes()
            self._write(
                _HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(pairs)) + struct.pack("<HI", channel, len(pairs)) + pairs
            )
            self._counts[channel] = self._counts.get(channel, 0) + when.size
        self._indexes.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=place,
                compression="",
                compressed_size=messages.size,
                message_end_time=end,
                message_index_length=self._at - place - length,
                message_index_offsets=places,
                message_start_time=begin,
                uncompressed_size=messages.size,
            )
        )
        self._times_ns += [begin, end]
        self._chunks += 1

    def finish(self) -> None:
        """Writes the end of the data, the summary and the end of the file."""
        self._write(_encoded(DataEnd(self._crc)))
        statistics = Statistics(
            attachment_count=sum(isinstance(record, Attachment) for record in self._front),
            channel_count=sum(isinstance(record, Channel) for record in self._repeated),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=max(self._times_ns, default=0),
            message_start_time=min(self._times_ns, default=0),
            metadata_count=sum(isinstance(record, Metadata) for record in self._front),
            schema_count=sum(isinstance(record, Schema) for record in self._repeated),
        )
        summary = b"".join(_encoded(record) for record in [*self._repeated, statistics, *self._indexes])
        begin = self._at
        self._write(summary)
        footer = _HEAD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", begin, 0)
        self._write(_encoded(Footer(begin, 0, crc32(footer, crc32(summary)))))
        self._write(MAGIC)

    def _write(self, data: Any) -> int:
        """Returns the number of bytes."""
        self._stream.write(data)
        self._crc = crc32(data, self._crc)
        length = memoryview(data).nbytes
        self._at += length
        return length


@cache
def _alike(head: int, doubles: int) -> np.dtype[np.void]:
    """Of a message with so many bytes before so many doubles."""
    before = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8")]
    return np.dtype([*before, ("publish", "<u8"), ("head", "u1", (head,)), ("values", "<f8", (doubles,))])


def _encoded(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _index(record: Attachment | Metadata, place: int, length: int) -> AttachmentIndex | MetadataIndex:
    if isinstance(record, Metadata):
        return MetadataIndex(offset=place, length=length, name=record.name)
    return AttachmentIndex(
        offset=place,
        length=length,
        create_time=record.create_time,
        log_time=record.log_time,
        data_size=len(record.data),
        name=record.name,
        media_type=record.media_type,
    )
