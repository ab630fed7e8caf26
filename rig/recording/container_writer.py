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
_INDEX_ENTRY = struct.Struct("<QQ")
_RECORDS_START = _HEAD.size + _CHUNK.size


class Chunk:
    """Messages of the next chunk in one buffer: a write to the file for each message would dominate the cost."""

    def __init__(self, first_records: bytes = b"") -> None:
        """Start with `first_records`; `message_counts` holds the messages of each channel over all chunks."""
        self._bytes = bytearray(_RECORDS_START)
        self._end_offset = _RECORDS_START
        self._index_entries: dict[int, list[bytes]] = {}
        self._times_ns: list[int] = []
        self.message_counts: Counter[int] = Counter()
        self._append(first_records)

    @property
    def size(self) -> int:
        return self._end_offset - _RECORDS_START

    @property
    def has_messages(self) -> bool:
        return bool(self._index_entries)

    @property
    def span_ns(self) -> int:
        """Time from the first message to the last, ns."""
        return self._times_ns[-1] - self._times_ns[0] if self._times_ns else 0

    def add(
        self,
        channel_id: int,
        time_ns: int,
        sequence: int,
        message_head: bytes,
        values: Float[np.ndarray, "channels samples"],
        published_ns: int | None = None,
    ) -> None:
        """Append a message: its head and the doubles, channel by channel; published_ns defaults to the log time."""
        publish_time_ns = time_ns if published_ns is None else published_ns
        body_length = _MESSAGE.size - _HEAD.size + len(message_head) + 8 * values.size
        record_head = (
            _MESSAGE.pack(Opcode.MESSAGE, body_length, channel_id, sequence, time_ns, publish_time_ns) + message_head
        )
        self._index_entries.setdefault(channel_id, []).append(_INDEX_ENTRY.pack(time_ns, self.size))
        self._times_ns.append(time_ns)
        self.message_counts[channel_id] += 1
        self._append(record_head)
        values_offset = self._reserve(8 * values.size)
        np.ndarray(values.shape, "<f8", self._bytes, values_offset)[:] = values

    def add_many(
        self,
        channel_id: int,
        times_ns: UInt[np.ndarray, " messages"],
        message_head: bytes,
        values: Float[np.ndarray, "messages channels"],
    ) -> None:
        """Append messages with the same head and the same number of doubles."""
        message_type = _message_type(len(message_head), values.shape[1])
        index_entries = np.empty((len(values), 2), "<u8")
        index_entries[:, 0], index_entries[:, 1] = times_ns, self.size + message_type.itemsize * np.arange(len(values))
        self._index_entries.setdefault(channel_id, []).append(index_entries.tobytes())
        self._times_ns += [int(times_ns[0]), int(times_ns[-1])]
        self.message_counts[channel_id] += len(values)
        messages_offset = self._reserve(len(values) * message_type.itemsize)
        message_rows = np.ndarray(len(values), message_type, self._bytes, messages_offset)
        message_start = _MESSAGE_START.pack(Opcode.MESSAGE, message_type.itemsize - _HEAD.size, channel_id, 0)
        message_rows["start"] = np.frombuffer(message_start, "u1")
        message_rows["times"] = times_ns[:, None]  # logged and published
        message_rows["head"] = np.frombuffer(message_head, "u1")
        message_rows["values"] = values

    def seal(self, file_offset: int) -> tuple[memoryview, int, ChunkIndex]:
        """Bytes of the chunk record and its message indexes at a file offset, their CRC-32, and the chunk index.

        The chunk is empty afterwards; the bytes are valid until the next message is added.
        """
        records_size, chunk_length = self.size, self._end_offset
        first_ns, last_ns = min(self._times_ns), max(self._times_ns)
        records_crc = crc32(memoryview(self._bytes)[_RECORDS_START:chunk_length])
        record_head = _HEAD.pack(Opcode.CHUNK, chunk_length - _HEAD.size) + _CHUNK.pack(
            first_ns, last_ns, records_size, records_crc, 0, records_size
        )
        self._bytes[:_RECORDS_START] = record_head
        index_offsets = {}
        for channel_id, index_entries in self._index_entries.items():
            index_offsets[channel_id], entry_bytes = file_offset + self._end_offset, b"".join(index_entries)
            index_head = _INDEX.pack(
                Opcode.MESSAGE_INDEX, _INDEX.size - _HEAD.size + len(entry_bytes), channel_id, len(entry_bytes)
            )
            self._append(index_head + entry_bytes)
        sealed_bytes = memoryview(self._bytes)[: self._end_offset]
        sealed_crc = crc32(sealed_bytes[chunk_length:], crc32_combine(crc32(record_head), records_crc, records_size))
        chunk_index = ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=file_offset,
            compression="",
            compressed_size=records_size,
            message_end_time=last_ns,
            message_index_length=len(sealed_bytes) - chunk_length,
            message_index_offsets=index_offsets,
            message_start_time=first_ns,
            uncompressed_size=records_size,
        )
        self._end_offset, self._index_entries, self._times_ns = _RECORDS_START, {}, []
        return sealed_bytes, sealed_crc, chunk_index

    def _append(self, appended_bytes: bytes) -> None:
        offset = self._reserve(len(appended_bytes))
        self._bytes[offset : self._end_offset] = appended_bytes

    def _reserve(self, byte_count: int) -> int:
        """Extend the buffer by `byte_count` bytes and return the offset at which they start."""
        offset, self._end_offset = self._end_offset, self._end_offset + byte_count
        if self._end_offset > len(self._bytes):
            self._bytes = self._bytes[:offset] + bytearray(2 * self._end_offset - offset)
        return offset


@cache
def _message_type(head_length: int, double_count: int) -> np.dtype[np.void]:
    """NumPy record type of a message with `head_length` bytes before `double_count` doubles."""
    start_field = ("start", "u1", (_MESSAGE_START.size,))
    return np.dtype(
        [start_field, ("times", "<u8", (2,)), ("head", "u1", (head_length,)), ("values", "<f8", (double_count,))]
    )


MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQ")


class ContainerWriter:
    """Writer of an uncompressed MCAP file with checksums and indexes; doubles would hardly shrink."""

    def __init__(
        self,
        stream: IO[bytes],
        front_records: Sequence[Attachment | Metadata],
        schemas: Sequence[Schema],
        channels: Sequence[Channel],
    ) -> None:
        self._stream, self._offset, self._crc = stream, 0, 0
        self._repeated_records = [*schemas, *channels]
        self._index_records: list[Any] = []
        self._front_records = front_records
        self._write(MAGIC)
        self._write(_record_bytes(Header("", "rig")))
        for record in front_records:
            record_offset, record_length = self._offset, self._write(_record_bytes(record))
            self._index_records.append(_index_record(record, record_offset, record_length))
        repeated_bytes = b"".join(map(_record_bytes, self._repeated_records))
        self._write(repeated_bytes)
        # once more in the first chunk: in front of the chunks no checksum guards them, and what is saved of a file
        # without its end depends on them
        self.chunk = Chunk(repeated_bytes)

    def write_chunk(self) -> None:
        """Write the current chunk and start a new one."""
        chunk_bytes, chunk_crc, chunk_index = self.chunk.seal(self._offset)
        self._write(chunk_bytes, chunk_crc)
        self._index_records.append(chunk_index)

    def finish(self) -> None:
        """Write the end of the data, the summary and the footer."""
        if self.chunk.has_messages:
            self.write_chunk()
        self._write(_record_bytes(DataEnd(self._crc)))
        chunk_indexes = [index for index in self._index_records if isinstance(index, ChunkIndex)]
        statistics = Statistics(
            attachment_count=sum(isinstance(record, Attachment) for record in self._front_records),
            channel_count=sum(isinstance(record, Channel) for record in self._repeated_records),
            channel_message_counts=dict(self.chunk.message_counts),
            chunk_count=len(chunk_indexes),
            message_count=self.chunk.message_counts.total(),
            message_end_time=max((index.message_end_time for index in chunk_indexes), default=0),
            message_start_time=min((index.message_start_time for index in chunk_indexes), default=0),
            metadata_count=sum(isinstance(record, Metadata) for record in self._front_records),
            schema_count=sum(isinstance(record, Schema) for record in self._repeated_records),
        )
        summary_bytes = b"".join(
            _record_bytes(record) for record in [*self._repeated_records, statistics, *self._index_records]
        )
        summary_start = self._offset
        self._write(summary_bytes)
        footer_bytes_before_crc = _FOOTER.pack(Opcode.FOOTER, 20, summary_start, 0)
        self._write(_record_bytes(Footer(summary_start, 0, crc32(footer_bytes_before_crc, crc32(summary_bytes)))))
        self._write(MAGIC)

    def _write(self, written_bytes: bytes | memoryview, data_crc: int | None = None) -> int:
        """Write bytes and return their number; `data_crc` is their CRC-32 where it is known already."""
        self._stream.write(written_bytes)
        self._crc = crc32_combine(self._crc, crc32(written_bytes) if data_crc is None else data_crc, len(written_bytes))
        self._offset += len(written_bytes)
        return len(written_bytes)


def _record_bytes(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _index_record(record: Attachment | Metadata, offset: int, record_length: int) -> AttachmentIndex | MetadataIndex:
    if isinstance(record, Metadata):
        return MetadataIndex(offset=offset, length=record_length, name=record.name)
    return AttachmentIndex(
        offset=offset,
        length=record_length,
        create_time=record.create_time,
        log_time=record.log_time,
        data_size=len(record.data),
        name=record.name,
        media_type=record.media_type,
    )
