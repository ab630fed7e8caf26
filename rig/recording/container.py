"""Reading an MCAP file record by record, with every declared size and every checksum verified.

mcap's own readers allocate what a record declares, decompress whatever comes, and skip the checksum of attachments.
"""

import os
import struct
from collections.abc import Callable, Container, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from io import BufferedReader, BytesIO
from pathlib import Path, PurePosixPath
from typing import TypeVar

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, McapRecord, Message, Metadata, Schema, Statistics
from zlib_ng.zlib_ng import crc32

from rig.errors import RigError, TooLargeError
from rig.files import check_source
from rig.limits import MemoryCounter

MAX_RECORD_BYTES = 64 * 1024 * 1024
"""The largest record, and the largest content of a chunk, that is read."""
MAX_DESCRIPTION_BYTES = 4 * 1024 * 1024
"""The largest record that is no chunk, message or attachment."""
COPIES_PER_BYTE, MESSAGE_BYTES, ENTRY_BYTES = 4, 400, 200
"""Memory counted for what the chunks of a file hold: so many times its bytes, and what each message and each entry of a
map takes beside them where it is kept."""
_WINDOW_BYTES = 1024 * 1024  # a file is read in pieces of this size, which a processor's cache holds
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE_FIELDS = struct.Struct("<HIQQ")
_CHANNEL_ID = struct.Struct("<H")
_CHUNK_FIELDS = struct.Struct("<QQQII")  # times, size, checksum, length of the name of the compression
_RECORDS_LENGTH = struct.Struct("<Q")
_RECORD_TYPE_BY_OPCODE = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
    Opcode.STATISTICS: Statistics,
    Opcode.DATA_END: DataEnd,
}
ReadingStep = TypeVar("ReadingStep")
DAMAGE = (McapError, ValueError, OverflowError, struct.error, EOFError, OSError, RuntimeError, zstandard.ZstdError)
"""Exceptions that reading a bad record may raise."""


def open_recording(path: Path) -> BufferedReader:
    """MCAP file opened at its first record; raises RigError if it is no MCAP file.

    It is read record by record, not memory-mapped: truncating a mapped file while it is read would end the process.
    """
    check_source(path)
    try:
        with ExitStack() as exit_stack:
            recording_file = exit_stack.enter_context(path.open("rb"))
            first_bytes = recording_file.read(len(_MAGIC))
            if first_bytes == _MAGIC:
                exit_stack.pop_all()
                return recording_file
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror}); check the name") from error
    if not first_bytes:
        raise RigError(f"{path}: is empty; record it again")
    raise RigError(f"{path}: is no MCAP file; give a recording made by `rig record` or `rig import`")


def records_of_complete_file(
    file: BufferedReader, is_wanted: Callable[[Channel], bool] = lambda _: True
) -> Iterator[McapRecord]:
    """Every record of a complete, opened file; raises one of DAMAGE where it is truncated or damaged.

    The data of a message are valid until the next record is requested. Messages of channels for which is_wanted is
    false are only counted. A record with a forbidden size or name raises RigError, without the name of the file.
    """
    data_crc, message_count, skipped_ids, memory_counter = crc32(_MAGIC), 0, set[int](), memory_counter_of(file)
    for opcode, content in _top_level_records(file):
        for record in records(opcode, content[_HEAD.size :], memory_counter, skipped_ids):
            if isinstance(record, DataEnd) and record.data_section_crc not in (0, data_crc):
                raise ValueError("the checksum of its data is wrong")
            if isinstance(record, Statistics) and record.message_count != message_count:
                raise ValueError(f"{message_count} messages where its statistics count {record.message_count}")
            if isinstance(record, Channel) and not is_wanted(record):
                skipped_ids.add(record.id)
            message_count += record.message_count if isinstance(record, UnreadMessages) else isinstance(record, Message)
            yield record
        data_crc = crc32(content, data_crc)


def with_path_in_error(path: Path, reading_steps: Iterator[ReadingStep]) -> Iterator[ReadingStep]:
    """Pass on the steps of reading a file; turn every error into a RigError that names the file."""
    try:
        yield from reading_steps
    except RigError as error:
        raise RigError(f"{path}: {error}") from error
    except DAMAGE as error:
        damage_words = "damaged" if isinstance(error, ValueError) else "cut off or damaged"
        raise RigError(
            f"{path}: is {damage_words} ({reason_of(error)}); try `rig recover`, or restore a copy"
        ) from error


def reason_of(error: Exception) -> str:
    """Reason why a record could not be read: the system's or this module's, else "cannot be decoded"."""
    if isinstance(error, OSError):
        return error.strerror or "it cannot be read"
    return str(error) if type(error) in (ValueError, EOFError) else "a record cannot be decoded"


def undamaged_records(file: BufferedReader) -> Iterator[McapRecord]:
    """Every undamaged record of an opened file that may be truncated or damaged; data as in `records_of_complete_file`.

    A chunk without a checksum is skipped. Raises TooLargeError where the content exceeds the bound of the file.
    """
    memory_counter, top_level_records = memory_counter_of(file), _top_level_records(file)
    while True:
        try:
            opcode, content = next(top_level_records)
        except (StopIteration, *DAMAGE):
            return
        record_body = content[_HEAD.size :]
        try:
            if opcode != Opcode.CHUNK or _CHUNK_FIELDS.unpack_from(record_body)[3]:
                yield from records(opcode, record_body, memory_counter)
        except TooLargeError:
            raise
        except DAMAGE:
            continue


@dataclass(frozen=True)
class UnreadMessages:
    """Number of messages that were skipped."""

    message_count: int


def memory_counter_of(file: BufferedReader) -> MemoryCounter:
    """Counter of the memory kept of an open file, at zero."""
    return MemoryCounter(os.fstat(file.fileno()).st_size, "what its chunks hold")


def records(
    opcode: int, record_body: memoryview, memory_counter: MemoryCounter, skipped_ids: Container[int] = ()
) -> Iterator[McapRecord | UnreadMessages]:
    """Relevant records in one top-level record; a chunk is decompressed to at most MAX_RECORD_BYTES.

    Raises one of DAMAGE if the checksum is wrong or the content is no such record, RigError if it is refused.
    """
    if opcode == Opcode.CHUNK:
        yield from _chunk_records(_decompress(record_body, memory_counter), memory_counter, skipped_ids)
    elif opcode == Opcode.MESSAGE:
        yield _decoded_message(record_body, memory_counter)
    elif opcode in _RECORD_TYPE_BY_OPCODE:
        if opcode != Opcode.ATTACHMENT and len(record_body) > MAX_DESCRIPTION_BYTES:
            raise RigError(
                f"a description declares {len(record_body)} bytes; write at most {MAX_DESCRIPTION_BYTES} bytes"
            )
        record = _RECORD_TYPE_BY_OPCODE[Opcode(opcode)].read(ReadDataStream(BytesIO(record_body)))
        if isinstance(record, Attachment):
            _check_attachment_name_and_crc(record, record_body)
        if isinstance(record, Channel | Metadata):
            memory_counter.add(ENTRY_BYTES * (1 + len(record.metadata)))
        yield record


def _chunk_records(
    chunk_records: memoryview, memory_counter: MemoryCounter, skipped_ids: Container[int]
) -> Iterator[McapRecord | UnreadMessages]:
    offset = 0
    while offset < len(chunk_records):
        opcode, body_start, offset = _opcode_and_body_span(chunk_records, offset)
        if opcode == Opcode.MESSAGE and _CHANNEL_ID.unpack_from(chunk_records, body_start)[0] in skipped_ids:
            run_length = _count_like_records(chunk_records[body_start - _HEAD.size :], _HEAD.size + offset - body_start)
            offset += (run_length - 1) * (_HEAD.size + offset - body_start)
            yield UnreadMessages(run_length)
        elif opcode == Opcode.MESSAGE:
            yield _decoded_message(chunk_records[body_start:offset], memory_counter)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield from records(opcode, chunk_records[body_start:offset], memory_counter)


def _count_like_records(chunk_records: memoryview, record_bytes: int) -> int:
    """Number of consecutive records with the same opcode, length and channel (their first eleven bytes), at most 64."""
    record_count = min(len(chunk_records) // record_bytes, 64)
    first_eight_bytes, last_eight_bytes = (
        np.ndarray((record_count,), "<u8", chunk_records, offset=offset, strides=(record_bytes,)) for offset in (0, 3)
    )
    is_like_first = (first_eight_bytes == first_eight_bytes[0]) & (last_eight_bytes == last_eight_bytes[0])
    return record_count if is_like_first.all() else int(np.argmin(is_like_first))


def _decoded_message(record_body: memoryview, memory_counter: MemoryCounter) -> Message:
    memory_counter.add(MESSAGE_BYTES)
    channel_id, sequence, log_time, publish_time = _MESSAGE_FIELDS.unpack_from(record_body)
    return Message(channel_id, log_time, record_body[_MESSAGE_FIELDS.size :], publish_time, sequence)


def _top_level_records(file: BufferedReader) -> Iterator[tuple[int, memoryview]]:
    """Opcode and bytes (head and body) of every record, up to the footer and the magic behind it.

    The bytes are valid until the next record is requested.
    """
    window, opcode = _FileWindow(file), 0
    while opcode != Opcode.FOOTER:
        opcode, body_length = _opcode_and_body_length(window.peek(_HEAD.size), 0)
        yield opcode, window.peek(_HEAD.size + body_length)
        window.move(_HEAD.size + body_length)
    if window.peek(len(_MAGIC)) != _MAGIC or window.has_more_than(len(_MAGIC)):
        raise EOFError("its end is missing")


class _FileWindow:
    """Sliding window on a file in one reused buffer: allocation costs more than the reading."""

    def __init__(self, file: BufferedReader) -> None:
        self._file, self._buffer = file, memoryview(bytearray(_WINDOW_BYTES))
        self._position = self._end = 0

    def peek(self, byte_count: int) -> memoryview:
        """The next `byte_count` bytes, without moving; raises EOFError if the file ends before."""
        if self._end - self._position < byte_count:
            unread_bytes = self._buffer[self._position : self._end]
            larger_buffer = self._buffer if byte_count <= len(self._buffer) else memoryview(bytearray(byte_count))
            larger_buffer[: len(unread_bytes)] = unread_bytes
            self._buffer, self._position, self._end = (
                larger_buffer,
                0,
                len(unread_bytes) + self._file.readinto(larger_buffer[len(unread_bytes) :]),
            )
        if self._end < byte_count:
            raise EOFError(
                f"a record of {byte_count} bytes ends after {self._end}" if self._end else "its end is missing"
            )
        return self._buffer[self._position : self._position + byte_count]

    def move(self, byte_count: int) -> None:
        self._position += byte_count

    def has_more_than(self, byte_count: int) -> bool:
        """True if the file goes on behind the next `byte_count` bytes."""
        return self._end - self._position > byte_count or bool(self._file.read(1))


def _opcode_and_body_span(content: memoryview, offset: int) -> tuple[int, int, int]:
    """Opcode of the record at an offset, and the start and end of its body."""
    opcode, body_length = _opcode_and_body_length(content, offset)
    body_start = offset + _HEAD.size
    if body_start + body_length > len(content):
        raise EOFError(f"a record of {body_length} bytes ends after {len(content) - body_start}")
    return opcode, body_start, body_start + body_length


def _opcode_and_body_length(content: memoryview, offset: int) -> tuple[int, int]:
    """Opcode of the record at an offset and the length of its body, at most MAX_RECORD_BYTES (else RigError)."""
    opcode, body_length = _HEAD.unpack_from(content, offset)
    if opcode == 0:
        raise ValueError("a record without a kind")
    if body_length > MAX_RECORD_BYTES:
        raise RigError(f"a record declares {body_length} bytes; write records of at most {MAX_RECORD_BYTES} bytes")
    return opcode, body_length


def _decompress(record_body: memoryview, memory_counter: MemoryCounter) -> memoryview:
    """Decompressed records of a chunk; their memory is counted before the checksum is compared."""
    _, _, declared_bytes, declared_crc, name_length = _CHUNK_FIELDS.unpack_from(record_body)
    compression_name = bytes(record_body[_CHUNK_FIELDS.size : _CHUNK_FIELDS.size + name_length]).decode()
    (compressed_length,) = _RECORDS_LENGTH.unpack_from(record_body, _CHUNK_FIELDS.size + name_length)
    if declared_bytes > MAX_RECORD_BYTES:
        raise RigError(f"a chunk declares {declared_bytes} bytes when decompressed; write at most {MAX_RECORD_BYTES}")
    compressed = record_body[_CHUNK_FIELDS.size + name_length + _RECORDS_LENGTH.size :][:compressed_length]
    if len(compressed) < compressed_length:
        raise EOFError(f"a chunk of {compressed_length} bytes ends after {len(compressed)}")
    if compression_name == "lz4":
        chunk_records = memoryview(lz4.frame.LZ4FrameDecompressor().decompress(compressed, max_length=declared_bytes))
    elif compression_name == "zstd":
        chunk_records = memoryview(zstandard.ZstdDecompressor().stream_reader(compressed).read(declared_bytes))
    elif compression_name == "":
        chunk_records = compressed
    else:
        raise ValueError(f"unknown compression {compression_name!r}")
    memory_counter.add(COPIES_PER_BYTE * len(chunk_records))
    if len(chunk_records) != declared_bytes or declared_crc not in (0, crc32(chunk_records)):
        raise ValueError("the checksum of a chunk is wrong")
    return chunk_records


def _check_attachment_name_and_crc(record: Attachment, record_body: memoryview) -> None:
    attachment_path = PurePosixPath(record.name.replace("\\", "/"))
    if attachment_path.is_absolute() or ".." in attachment_path.parts:
        raise RigError(f"the attachment {record.name!r} is named like a path out of its folder; rename it")
    (declared_crc,) = struct.unpack("<I", record_body[-4:])
    if declared_crc not in (0, crc32(record_body[:-4])):
        raise ValueError(f"the checksum of the attachment {record.name!r} is wrong")
