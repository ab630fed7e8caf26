"""An MCAP file record by record, where no size is believed before it is checked and no byte before its checksum.

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
from rig.limits import Held

MAX_BYTES = 64 * 1024 * 1024
"""The largest record, and the largest content of a chunk, that is read."""
MAX_DESCRIPTION_BYTES = 4 * 1024 * 1024
"""The largest record that is no chunk, message or attachment."""
CONTENT_COPIES, MESSAGE_BYTES, ENTRY_BYTES = 4, 400, 200
"""Memory counted for what the chunks of a file hold: so many times its bytes, and what each message and each entry of a
map takes beside them where it is kept."""
_PIECE_BYTES = 1024 * 1024  # a file is read in pieces of this size, which a processor's cache holds
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHANNEL = struct.Struct("<H")
_CHUNK = struct.Struct("<QQQII")  # times, size, checksum, length of the name of the compression
_LENGTH = struct.Struct("<Q")
_KINDS = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
    Opcode.STATISTICS: Statistics,
    Opcode.DATA_END: DataEnd,
}
Step = TypeVar("Step")
DAMAGE = (McapError, ValueError, OverflowError, struct.error, EOFError, OSError, RuntimeError, zstandard.ZstdError)
"""What reading a bad record may raise."""


def opened(path: Path) -> BufferedReader:
    """The file, open behind its first eight bytes; raises RigError with a sentence if it is no MCAP file.

    It is read record by record and not mapped: a mapped file that is cut while it is read would end the process.
    """
    check_source(path)
    try:
        with ExitStack() as closing:
            file = closing.enter_context(path.open("rb"))
            start = file.read(len(_MAGIC))
            if start == _MAGIC:
                closing.pop_all()
                return file
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror}); check the name") from error
    if not start:
        raise RigError(f"{path}: is empty; record it again")
    raise RigError(f"{path}: is no MCAP file; give a recording made by `rig record` or `rig import`")


def whole(file: BufferedReader, wanted: Callable[[Channel], bool] = lambda _: True) -> Iterator[McapRecord]:
    """Every record of a complete file that `opened` gave; raises one of DAMAGE where it is cut or damaged.

    The data of a message are there until the next record is asked for. The messages of channels that are not wanted
    are counted, no more. A record that is refused for its size or name raises RigError, without the name of the file.
    """
    crc, messages, unwanted, held = crc32(_MAGIC), 0, set[int](), held_of(file)
    for opcode, content in _split(file):
        for record in records(opcode, content[_HEAD.size :], held, unwanted):
            if isinstance(record, DataEnd) and record.data_section_crc not in (0, crc):
                raise ValueError("the checksum of its data is wrong")
            if isinstance(record, Statistics) and record.message_count != messages:
                raise ValueError(f"{messages} messages where its statistics count {record.message_count}")
            if isinstance(record, Channel) and not wanted(record):
                unwanted.add(record.id)
            messages += record.messages if isinstance(record, Unread) else isinstance(record, Message)
            yield record
        crc = crc32(content, crc)


def with_path_in_error(path: Path, steps: Iterator[Step]) -> Iterator[Step]:
    """Result of reading a file; where it is refused or damaged, one sentence that names it (RigError)."""
    try:
        yield from steps
    except RigError as error:
        raise RigError(f"{path}: {error}") from error
    except DAMAGE as error:
        state = "damaged" if isinstance(error, ValueError) else "cut off or damaged"
        raise RigError(f"{path}: is {state} ({reason_of(error)}); try `rig recover`, or restore a copy") from error


def reason_of(error: Exception) -> str:
    """Why a record could not be read: in words of this module, or, where a library gave up, that it cannot be decoded.

    Those of the system (no disk, no right) are its own.
    """
    if isinstance(error, OSError):
        return error.strerror or "it cannot be read"
    return str(error) if type(error) in (ValueError, EOFError) else "a record cannot be decoded"


def complete(file: BufferedReader) -> Iterator[McapRecord]:
    """Every sound record of a file that `opened` gave, cut off or damaged as it may be; its data are as of `whole`.

    A chunk without a checksum is not taken for sound. Raises TooLargeError where the file holds more than it may.
    """
    held, top_level = held_of(file), _split(file)
    while True:
        try:
            opcode, content = next(top_level)
        except (StopIteration, *DAMAGE):
            return
        body = content[_HEAD.size :]
        try:
            if opcode != Opcode.CHUNK or _CHUNK.unpack_from(body)[3]:
                yield from records(opcode, body, held)
        except TooLargeError:
            raise
        except DAMAGE:
            continue


@dataclass(frozen=True)
class Unread:
    """Messages that nobody wants."""

    messages: int


def held_of(file: BufferedReader) -> Held:
    """Memory held of an open file: nothing so far."""
    return Held(os.fstat(file.fileno()).st_size, "what its chunks hold")


def records(opcode: int, body: memoryview, held: Held, unwanted: Container[int] = ()) -> Iterator[McapRecord | Unread]:
    """The records that matter here in one top-level record; a chunk is decompressed within MAX_BYTES.

    Raises one of DAMAGE if the checksum is wrong or the content is no such record, RigError if it is refused.
    """
    if opcode == Opcode.CHUNK:
        yield from _in_chunk(_decompressed(body, held), held, unwanted)
    elif opcode == Opcode.MESSAGE:
        yield _message(body, held)
    elif opcode in _KINDS:
        if opcode != Opcode.ATTACHMENT and len(body) > MAX_DESCRIPTION_BYTES:
            raise RigError(f"a description declares {len(body)} bytes; write at most {MAX_DESCRIPTION_BYTES} bytes")
        record = _KINDS[Opcode(opcode)].read(ReadDataStream(BytesIO(body)))
        if isinstance(record, Attachment):
            _check_attachment(record, body)
        if isinstance(record, Channel | Metadata):
            held.add(ENTRY_BYTES * (1 + len(record.metadata)))
        yield record


def _in_chunk(data: memoryview, held: Held, unwanted: Container[int]) -> Iterator[McapRecord | Unread]:
    after = 0
    while after < len(data):
        opcode, begin, after = _next(data, after)
        if opcode == Opcode.MESSAGE and _CHANNEL.unpack_from(data, begin)[0] in unwanted:
            alike = _alike(data[begin - _HEAD.size :], _HEAD.size + after - begin)
            after += (alike - 1) * (_HEAD.size + after - begin)
            yield Unread(alike)
        elif opcode == Opcode.MESSAGE:
            yield _message(data[begin:after], held)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield from records(opcode, data[begin:after], held)


def _alike(data: memoryview, length: int) -> int:
    """Count of records of that kind, length and channel, all in their first eleven bytes, one behind the other.

    No more than 64 are looked at.
    """
    rows = min(len(data) // length, 64)
    starts, ends = (np.ndarray((rows,), "<u8", data, offset=place, strides=(length,)) for place in (0, 3))
    same = (starts == starts[0]) & (ends == ends[0])
    return rows if same.all() else int(np.argmin(same))


def _message(body: memoryview, held: Held) -> Message:
    held.add(MESSAGE_BYTES)
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(channel, log_time, body[_MESSAGE.size :], publish_time, sequence)


def _split(file: BufferedReader) -> Iterator[tuple[int, memoryview]]:
    """Every record's opcode and its bytes, head and body, up to the footer and the magic behind it.

    The bytes are there until the next record is asked for.
    """
    window, opcode = _Window(file), 0
    while opcode != Opcode.FOOTER:
        opcode, length = _head(window.shown(_HEAD.size), 0)
        yield opcode, window.shown(_HEAD.size + length)
        window.move(_HEAD.size + length)
    if window.shown(len(_MAGIC)) != _MAGIC or window.beyond(len(_MAGIC)):
        raise EOFError("its end is missing")


class _Window:
    """A part of a file, in the same memory wherever it is moved: new memory costs more than the reading."""

    def __init__(self, file: BufferedReader) -> None:
        self._file, self._held = file, memoryview(bytearray(_PIECE_BYTES))
        self._at = self._end = 0

    def shown(self, count: int) -> memoryview:
        """Bytes from the current position, this many; raises EOFError if the file ends before."""
        if self._end - self._at < count:
            rest = self._held[self._at : self._end]
            held = self._held if count <= len(self._held) else memoryview(bytearray(count))
            held[: len(rest)] = rest
            self._held, self._at, self._end = held, 0, len(rest) + self._file.readinto(held[len(rest) :])
        if self._end < count:
            raise EOFError(f"a record of {count} bytes ends after {self._end}" if self._end else "its end is missing")
        return self._held[self._at : self._at + count]

    def move(self, count: int) -> None:
        self._at += count

    def beyond(self, count: int) -> bool:
        """True if there is anything behind this many bytes from the current position."""
        return self._end - self._at > count or bool(self._file.read(1))


def _next(content: memoryview, at: int) -> tuple[int, int, int]:
    """The opcode of the record there, and where its body begins and ends."""
    opcode, length = _head(content, at)
    begin = at + _HEAD.size
    if begin + length > len(content):
        raise EOFError(f"a record of {length} bytes ends after {len(content) - begin}")
    return opcode, begin, begin + length


def _head(content: memoryview, at: int) -> tuple[int, int]:
    """The opcode of the record there and the length of its body, which is no more than MAX_BYTES."""
    opcode, length = _HEAD.unpack_from(content, at)
    if opcode == 0:
        raise ValueError("a record without a kind")
    if length > MAX_BYTES:
        raise RigError(f"a record declares {length} bytes; write records of at most {MAX_BYTES} bytes")
    return opcode, length


def _decompressed(body: memoryview, held: Held) -> memoryview:
    """The records in a chunk, which are counted before their checksum is compared."""
    _, _, size, crc, name = _CHUNK.unpack_from(body)
    compression = bytes(body[_CHUNK.size : _CHUNK.size + name]).decode()
    (length,) = _LENGTH.unpack_from(body, _CHUNK.size + name)
    if size > MAX_BYTES:
        raise RigError(f"a chunk declares {size} bytes when decompressed; write at most {MAX_BYTES}")
    packed = body[_CHUNK.size + name + _LENGTH.size :][:length]
    if len(packed) < length:
        raise EOFError(f"a chunk of {length} bytes ends after {len(packed)}")
    if compression == "lz4":
        data = memoryview(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size))
    elif compression == "zstd":
        data = memoryview(zstandard.ZstdDecompressor().stream_reader(packed).read(size))
    elif compression == "":
        data = packed
    else:
        raise ValueError(f"unknown compression {compression!r}")
    held.add(CONTENT_COPIES * len(data))
    if len(data) != size or crc not in (0, crc32(data)):
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _check_attachment(record: Attachment, body: memoryview) -> None:
    name = PurePosixPath(record.name.replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts:
        raise RigError(f"the attachment {record.name!r} is named like a path out of its folder; rename it")
    (crc,) = struct.unpack("<I", body[-4:])
    if crc not in (0, crc32(body[:-4])):
        raise ValueError(f"the checksum of the attachment {record.name!r} is wrong")
