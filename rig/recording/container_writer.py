"""Writing an MCAP file chunk by chunk: messages are put where the file will have them, without other copies.

mcap's own writer copies each message seven times.
"""

import struct
from collections import Counter
from collections.abc import Sequence
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
from zlib_ng.zlib_ng import crc32, crc32_combine

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQIIQ")  # times, size, checksum, no compression, size of the records
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_START = struct.Struct("<BQHI")  # up to its times
_INDEX = struct.Struct("<BQHI")
_PLACE = struct.Struct("<QQ")
_START = _HEAD.size + _CHUNK.size


class Chunk:
    """Messages of the next chunk in one buffer: a write to the file for each message would dominate the cost."""

    def __init__(self, start: bytes = b"") -> None:
        """Start with the records `start`; `counts` holds the messages of each channel over all chunks."""
        self._bytes = bytearray(_START)
        self._end = _START
        self._index: dict[int, list[bytes]] = {}
        self._times_ns: list[int] = []
        self.counts: Counter[int] = Counter()
        self._append(start)

    @property
    def size(self) -> int:
        return self._end - _START

    @property
    def filled(self) -> bool:
        return bool(self._index)

    @property
    def span_ns(self) -> int:
        """Time from the first message to the last, ns."""
        return self._times_ns[-1] - self._times_ns[0] if self._times_ns else 0

    def add(
        self,
        channel_id: int,
        time_ns: int,
        sequence: int,
        head: bytes,
        values: Float[np.ndarray, "channels samples"],
        published_ns: int | None = None,
    ) -> None:
        """Append a message: its head and the doubles, channel by channel; published_ns defaults to the log time."""
        published_at_ns = time_ns if published_ns is None else published_ns
        length = _MESSAGE.size - _HEAD.size + len(head) + 8 * values.size
        record_head = _MESSAGE.pack(Opcode.MESSAGE, length, channel_id, sequence, time_ns, published_at_ns) + head
        self._index.setdefault(channel_id, []).append(_PLACE.pack(time_ns, self.size))
        self._times_ns.append(time_ns)
        self.counts[channel_id] += 1
        self._append(record_head)
        offset = self._reserve(8 * values.size)
        np.ndarray(values.shape, "<f8", self._bytes, offset)[:] = values

    def add_many(
        self,
        channel_id: int,
        times_ns: UInt[np.ndarray, " messages"],
        head: bytes,
        values: Float[np.ndarray, "messages channels"],
    ) -> None:
        """Append messages with the same head and the same number of doubles."""
        record_type = _record_type(len(head), values.shape[1])
        places = np.empty((len(values), 2), "<u8")
        places[:, 0], places[:, 1] = times_ns, self.size + record_type.itemsize * np.arange(len(values))
        self._index.setdefault(channel_id, []).append(places.tobytes())
        self._times_ns += [int(times_ns[0]), int(times_ns[-1])]
        self.counts[channel_id] += len(values)
        offset = self._reserve(len(values) * record_type.itemsize)
        records = np.ndarray(len(values), record_type, self._bytes, offset)
        start = _MESSAGE_START.pack(Opcode.MESSAGE, record_type.itemsize - _HEAD.size, channel_id, 0)
        records["start"] = np.frombuffer(start, "u1")
        records["times"] = times_ns[:, None]  # logged and published
        records["head"] = np.frombuffer(head, "u1")
        records["values"] = values

    def sealed(self, file_offset: int) -> tuple[memoryview, int, ChunkIndex]:
        """Bytes of the chunk record and its message indexes at a file offset, their CRC-32, and the chunk index.

        The chunk is empty afterwards; the bytes are valid until the next message is added.
        """
        size, length = self.size, self._end
        first_ns, last_ns = min(self._times_ns), max(self._times_ns)
        crc = crc32(memoryview(self._bytes)[_START:length])
        record_head = _HEAD.pack(Opcode.CHUNK, length - _HEAD.size) + _CHUNK.pack(first_ns, last_ns, size, crc, 0, size)
        self._bytes[:_START] = record_head
        places = {}
        for channel, entries in self._index.items():
            places[channel], pairs = file_offset + self._end, b"".join(entries)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, _INDEX.size - _HEAD.size + len(pairs), channel, len(pairs))
            self._append(head + pairs)
        data = memoryview(self._bytes)[: self._end]
        crc = crc32(data[length:], crc32_combine(crc32(record_head), crc, size))
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=file_offset,
            compression="",
            compressed_size=size,
            message_end_time=last_ns,
            message_index_length=len(data) - length,
            message_index_offsets=places,
            message_start_time=first_ns,
            uncompressed_size=size,
        )
        self._end, self._index, self._times_ns = _START, {}, []
        return data, crc, index

    def _append(self, data: bytes) -> None:
        offset = self._reserve(len(data))
        self._bytes[offset : self._end] = data

    def _reserve(self, length: int) -> int:
        """Extend the buffer by `length` bytes and return the offset at which they start."""
        offset, self._end = self._end, self._end + length
        if self._end > len(self._bytes):
            self._bytes = self._bytes[:offset] + bytearray(2 * self._end - offset)
        return offset


@cache
def _record_type(head: int, doubles: int) -> np.dtype[np.void]:
    """NumPy record type of a message with `head` bytes before `doubles` doubles."""
    start = ("start", "u1", (_MESSAGE_START.size,))
    return np.dtype([start, ("times", "<u8", (2,)), ("head", "u1", (head,)), ("values", "<f8", (doubles,))])


MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQ")


class ContainerWriter:
    """Writer of an uncompressed MCAP file with checksums and indexes; doubles would hardly shrink."""

    def __init__(
        self,
        stream: IO[bytes],
        front: Sequence[Attachment | Metadata],
        schemas: Sequence[Schema],
        channels: Sequence[Channel],
    ) -> None:
        self._stream, self._offset, self._crc = stream, 0, 0
        self._repeated = [*schemas, *channels]
        self._indexes: list[Any] = []
        self._front = front
        self._write(MAGIC)
        self._write(_encoded(Header("", "rig")))
        for record in front:
            place, length = self._offset, self._write(_encoded(record))
            self._indexes.append(_index(record, place, length))
        repeated = b"".join(map(_encoded, self._repeated))
        self._write(repeated)
        # once more in the first chunk: in front of the chunks no checksum guards them, and what is saved of a file
        # without its end depends on them
        self.chunk = Chunk(repeated)

    def write_chunk(self) -> None:
        """Write the current chunk and start a new one."""
        data, crc, index = self.chunk.sealed(self._offset)
        self._write(data, crc)
        self._indexes.append(index)

    def finish(self) -> None:
        """Write the end of the data, the summary and the footer."""
        if self.chunk.filled:
            self.write_chunk()
        self._write(_encoded(DataEnd(self._crc)))
        chunks = [index for index in self._indexes if isinstance(index, ChunkIndex)]
        statistics = Statistics(
            attachment_count=sum(isinstance(record, Attachment) for record in self._front),
            channel_count=sum(isinstance(record, Channel) for record in self._repeated),
            channel_message_counts=dict(self.chunk.counts),
            chunk_count=len(chunks),
            message_count=self.chunk.counts.total(),
            message_end_time=max((index.message_end_time for index in chunks), default=0),
            message_start_time=min((index.message_start_time for index in chunks), default=0),
            metadata_count=sum(isinstance(record, Metadata) for record in self._front),
            schema_count=sum(isinstance(record, Schema) for record in self._repeated),
        )
        summary = b"".join(_encoded(record) for record in [*self._repeated, statistics, *self._indexes])
        summary_start = self._offset
        self._write(summary)
        footer = _FOOTER.pack(Opcode.FOOTER, 20, summary_start, 0)
        self._write(_encoded(Footer(summary_start, 0, crc32(footer, crc32(summary)))))
        self._write(MAGIC)

    def _write(self, data: bytes | memoryview, crc: int | None = None) -> int:
        """Write bytes and return their number; `crc` is their CRC-32 where it is known already."""
        self._stream.write(data)
        self._crc = crc32_combine(self._crc, crc32(data) if crc is None else crc, len(data))
        self._offset += len(data)
        return len(data)


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
