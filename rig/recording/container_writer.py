"""Writing an MCAP file chunk by chunk; mcap's own writer copies each message seven times."""

import struct
from collections.abc import Sequence
from typing import IO, Any

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

from rig.recording.chunk import Chunk

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.Struct("<BQQQ")


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
        self._front = front
        self._write(MAGIC)
        self._write(_encoded(Header("", "rig")))
        for record in front:
            place, length = self._at, self._write(_encoded(record))
            self._indexes.append(_index(record, place, length))
        repeated = b"".join(map(_encoded, self._repeated))
        self._write(repeated)
        # once more in the first chunk: in front of the chunks no checksum guards them, and what is saved of a file
        # without its end depends on them
        self.chunk = Chunk(repeated)

    def write_chunk(self) -> None:
        """Writes the chunk in the making, which is empty then."""
        data, crc, index = self.chunk.sealed(self._at)
        self._write(data, crc)
        self._indexes.append(index)

    def finish(self) -> None:
        """Writes the end of the data, the summary and the end of the file."""
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
        begin = self._at
        self._write(summary)
        footer = _FOOTER.pack(Opcode.FOOTER, 20, begin, 0)
        self._write(_encoded(Footer(begin, 0, crc32(footer, crc32(summary)))))
        self._write(MAGIC)

    def _write(self, data: bytes | memoryview, crc: int | None = None) -> int:
        """Returns the number of bytes; `crc` is their checksum where it is known."""
        self._stream.write(data)
        self._crc = crc32_combine(self._crc, crc32(data) if crc is None else crc, len(data))
        self._at += len(data)
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
