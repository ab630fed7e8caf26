"""An MCAP file record by record, where no size is believed before it is checked and no byte before its checksum.

mcap's own readers allocate what a record declares, decompress whatever comes, and skip the checksum of attachments.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BufferedIOBase, BytesIO
from pathlib import Path, PurePosixPath

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema, Statistics

from rig.errors import RigError

MAX_BYTES = 64 * 1024 * 1024
"""The largest record, and the largest content of a chunk, that is read."""
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_KINDS = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
    Opcode.STATISTICS: Statistics,
    Opcode.DATA_END: DataEnd,
}
DAMAGE = (McapError, ValueError, OverflowError, struct.error, EOFError, OSError, RuntimeError, zstandard.ZstdError)
"""What reading a bad record may raise."""


def part_of(path: Path) -> Path:
    """Where a file is written before it is renamed; raises RigError if either name is a symbolic link."""
    part = path.with_name(path.name + ".part")
    for place in (path, part):
        if place.is_symlink():
            raise RigError(f"{place}: is a symbolic link; name the file itself")
    return part


def opened(path: Path) -> BufferedIOBase:
    """The file behind its first eight bytes; raises RigError with a sentence if it is no MCAP file."""
    try:
        content = path.open("rb")
        start = content.read(len(_MAGIC))
    except OSError as error:
        raise RigError(f"{path}: cannot be opened ({error.strerror}); check the name") from error
    if start == _MAGIC:
        return content
    content.close()
    if not start:
        raise RigError(f"{path}: is empty; record it again")
    raise RigError(f"{path}: is no MCAP file; give a recording made by `rig record` or `rig import`")


def whole(content: BufferedIOBase) -> Iterator[McapRecord]:
    """Every record of a complete file that `opened` gave; raises one of DAMAGE where it is cut or damaged.

    A record that is refused for its size or name raises RigError, without the name of the file.
    """
    crc, messages = zlib.crc32(_MAGIC), 0
    for opcode, body in _split(content):
        for record in records(opcode, body):
            if isinstance(record, DataEnd) and record.data_section_crc not in (0, crc):
                raise ValueError("the checksum of its data is wrong")
            if isinstance(record, Statistics) and record.message_count != messages:
                raise ValueError(f"{messages} messages where its statistics count {record.message_count}")
            messages += isinstance(record, Message)
            yield record
        crc = zlib.crc32(body, zlib.crc32(_HEAD.pack(opcode, len(body)), crc))
        if opcode == Opcode.FOOTER:
            if content.read() != _MAGIC:
                break
            return
    raise EOFError("its end is missing")


def complete(content: BufferedIOBase) -> Iterator[McapRecord]:
    """Every sound record of a file that `opened` gave, cut off or damaged as it may be."""
    try:
        for opcode, body in _split(content):
            try:
                found = list(records(opcode, body))
            except DAMAGE:
                continue
            yield from found
            if opcode == Opcode.FOOTER:
                return
    except DAMAGE:
        return


def records(opcode: int, body: bytes) -> Iterator[McapRecord]:
    """The records that matter here in one top-level record; a chunk is decompressed within MAX_BYTES.

    Raises one of DAMAGE if the checksum is wrong or the content is no such record, RigError if it is refused.
    """
    if opcode == Opcode.CHUNK:
        for inner, content in _split(BytesIO(_decompressed(Chunk.read(ReadDataStream(BytesIO(body)))))):
            if inner == Opcode.MESSAGE:
                yield _message(content)
            elif inner in (Opcode.SCHEMA, Opcode.CHANNEL):
                yield from records(inner, content)
    elif opcode == Opcode.MESSAGE:
        yield _message(body)
    elif opcode in _KINDS:
        record = _KINDS[Opcode(opcode)].read(ReadDataStream(BytesIO(body)))
        if isinstance(record, Attachment):
            _check_attachment(record, body)
        yield record


def _message(body: bytes) -> Message:
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(channel, log_time, body[_MESSAGE.size :], publish_time, sequence)


def _split(content: BufferedIOBase) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of every record."""
    while head := content.read(_HEAD.size):
        opcode, length = _HEAD.unpack(head)
        if opcode == 0:
            raise ValueError("a record without a kind")
        if length > MAX_BYTES:
            raise RigError(f"a record declares {length} bytes; write records of at most {MAX_BYTES} bytes")
        body = content.read(length)
        if len(body) < length:
            raise EOFError(f"a record of {length} bytes ends after {len(body)}")
        yield opcode, body


def _decompressed(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_BYTES:
        raise RigError(f"a chunk declares {size} bytes when decompressed; write at most {MAX_BYTES}")
    if chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    elif chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _check_attachment(record: Attachment, body: bytes) -> None:
    name = PurePosixPath(record.name.replace("\\", "/"))
    if name.is_absolute() or ".." in name.parts:
        raise RigError(f"the attachment {record.name!r} is named like a path out of its folder; rename it")
    (crc,) = struct.unpack("<I", body[-4:])
    if crc not in (0, zlib.crc32(body[:-4])):
        raise ValueError(f"the checksum of the attachment {record.name!r} is wrong")
