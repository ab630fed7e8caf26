"""Recordings whose records are changed, swapped or made absurd, each record itself being sound."""

import struct
import zlib
from collections.abc import Callable, Sequence
from io import BytesIO

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.writer import Writer

from rig.recording.messages import decode_block
from tests.blocks import encode_block

MAGIC = b"\x89MCAP0\r\n"
Record = tuple[int, bytes]


def split(content: bytes) -> list[Record]:
    found, at = [], 0
    while at < len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        found.append((opcode, content[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def joined(records: list[Record]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records)


def records_changed(rng: np.random.Generator, content: bytes) -> bytes:
    """One change of the records of a file or of the messages of a chunk, with the checksums made right again."""
    records = split(content[8:-8])
    records = [(op, struct.pack("<I", 0) if op == Opcode.DATA_END else body) for op, body in records]
    if rng.random() < 0.4:
        records = _rearranged(rng, records)
    else:
        number = int(rng.choice([k for k, (op, _) in enumerate(records) if op == Opcode.CHUNK]))
        records[number] = (Opcode.CHUNK, _chunk_changed(rng, records[number][1]))
    return MAGIC + joined(records) + MAGIC


def _rearranged(rng: np.random.Generator, records: list[Record]) -> list[Record]:
    one, other = (int(k) for k in rng.integers(len(records), size=2))
    kind = rng.integers(5)
    if kind == 0:
        records[one], records[other] = records[other], records[one]
    elif kind == 1:
        del records[one]
    elif kind == 2:
        records.insert(other, records[one])
    elif kind == 3:
        records[one] = (records[other][0], records[one][1])  # a record that says it is another
    else:
        records.insert(other, (int(rng.integers(256)), rng.bytes(int(rng.integers(1000)))))
    return records


def _chunk_changed(rng: np.random.Generator, body: bytes) -> bytes:
    begin, end, _, _, name = struct.unpack_from("<QQQII", body)
    inner = split(body[32 + name + 8 :])
    size, compression = None, ("", "lz4", "zstd")[rng.integers(3)]
    kind = rng.integers(4)
    if kind == 0:
        inner = _rearranged(rng, inner)
    elif kind == 1:
        size = (0, 1, 10**6, 2**31, 2**63, 2**64 - 1)[rng.integers(6)]
    elif kind == 2:
        inner.append((Opcode.MESSAGE, bytes(int(rng.choice([30 << 20, 70 << 20])))))
    else:
        blocks = [k for k, (op, b) in enumerate(inner) if op == Opcode.MESSAGE and len(b) > 1000]
        if not blocks:  # the last chunk may hold previews alone
            return body
        number = int(rng.choice(blocks))
        inner[number] = (Opcode.MESSAGE, inner[number][1][:22] + _block_changed(rng, inner[number][1][22:]))
    data = joined(inner)
    pack = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}[compression]
    builder = RecordBuilder()
    Chunk(compression, pack(data), end, begin, zlib.crc32(data), len(data) if size is None else size).write(builder)
    return bytes(builder.end())[9:]


def _block_changed(rng: np.random.Generator, data: bytes) -> bytes:
    block = decode_block(data)
    time_ns, first, rate_hz, values = block.time_ns, block.first_sample, block.sample_rate_hz, block.values.copy()
    kind = rng.integers(5)
    if kind == 0:
        values[0, rng.integers(values.shape[1])] = (np.nan, np.inf, -np.inf)[rng.integers(3)]
    elif kind == 1:
        first = int((first + 1, 2**63, 2**64 - 1, 0 if first else 1024)[rng.integers(4)])
    elif kind == 2:
        rate_hz = (0.0, -1.0, np.nan, np.inf, 2 * rate_hz)[rng.integers(5)]
    elif kind == 3:
        values = values[:, : rng.integers(values.shape[1])]
    else:
        values = values.reshape(2, -1) if values.size % 2 == 0 else values[:, 1:]
    return encode_block(time_ns, first, rate_hz, values)


def rewritten(
    content: bytes,
    attachment: Callable[[bytes], bytes] | None,
    metadata: Callable[[int, dict[str, str]], dict[str, str]] | None,
    message: Callable[[str, bytes], bytes] | None = None,
    attachments: Sequence[tuple[str, bytes]] = (),
    provenances: Sequence[dict[str, str]] = (),
) -> bytes:
    """The blocks in a new file, by mcap's own writer; attachments, channels' metadata and blocks changed or added."""
    reader, stream = make_reader(BytesIO(content)), BytesIO()
    writer = Writer(stream, chunk_size=50_000)
    writer.start()
    for found in reader.iter_attachments():
        data = attachment(found.data) if attachment else found.data
        writer.add_attachment(0, 0, found.name, found.media_type, data)
    for name, data in attachments:
        writer.add_attachment(0, 0, name, "", data)
    for entries in provenances:
        writer.add_metadata("provenance", entries)
    numbers: dict[int, int] = {}
    for schema, channel, block in reader.iter_messages(log_time_order=False):
        if schema is None or not channel.topic.endswith("/block"):
            continue
        if channel.id not in numbers:
            about = dict(channel.metadata)
            about = metadata(len(numbers), about) if metadata else about
            name = writer.register_schema(schema.name, schema.encoding, schema.data)
            numbers[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, name, about)
        data = message(channel.topic, block.data) if message else block.data
        writer.add_message(numbers[channel.id], block.log_time, data, block.publish_time)
    writer.finish()
    return stream.getvalue()
