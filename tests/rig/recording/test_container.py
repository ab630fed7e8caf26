"""Files that were made to do harm: refused by one sentence, before anything large is read."""

import json
import os
import struct
import tracemalloc
import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata
from mcap.writer import CompressionType, Writer

from rig.commands.command_line import refuse_existing
from rig.errors import RigError
from rig.model.description import to_json
from rig.recording import RIG_NAME, channel_groups, container, read, writing
from rig.recording.container import MAX_RECORD_BYTES
from rig.recording.messages import BLOCK_NAME, BLOCK_SCHEMA
from rig.recording.recovery import recover
from rig.recording.segments import segments
from rig.simulation.reference import Sdof
from tests.blocks import encode_block

RIG = Sdof().rig()
GROUPS = channel_groups(RIG)
MAGIC = b"\x89MCAP0\r\n"


def write(path):
    with writing(path, RIG, GROUPS, {"made_by": "a test"}) as recording:
        for name in GROUPS:
            recording.append(name, np.ones((1, 3000)))


def with_record_in_front(path, record):
    """The file with a further record behind its magic, so that it is the first to be read."""
    content = path.read_bytes()
    path.write_bytes(MAGIC + record + content[8:])


def attachment(name, data=b"", declared=None):
    encoded = name.encode()
    body = struct.pack("<QQI", 0, 0, len(encoded)) + encoded + struct.pack("<I", 0)
    body += struct.pack("<Q", len(data) if declared is None else declared) + data
    return struct.pack("<BQ", Opcode.ATTACHMENT, len(body) + 4) + body + struct.pack("<I", zlib.crc32(body))


def chunk(compression, data, size, crc=1):
    builder = RecordBuilder()
    Chunk(compression, data, 0, 0, crc, size).write(builder)
    return builder.end()


def metadata(name, **entries):
    builder = RecordBuilder()
    Metadata(name=name, metadata=entries).write(builder)
    return builder.end()


@pytest.mark.parametrize(
    ("record", "sentence"),
    [
        (attachment("../../.ssh/authorized_keys", b"x"), "is named like a path out of its folder"),
        (attachment("..\\rig.json", b"x"), "is named like a path out of its folder"),
        (attachment("/etc/passwd", b"x"), "is named like a path out of its folder"),
        (struct.pack("<BQ", Opcode.ATTACHMENT, 2**31) + b"x", f"a record declares {2**31} bytes"),
        (struct.pack("<BQ", Opcode.CHUNK, 2**64 - 1), f"a record declares {2**64 - 1} bytes"),
        (attachment("photo.jpg", b"x", declared=2**31), "damaged"),
        (attachment("photo.jpg", b"x", declared=2**64 - 1), "damaged"),
        (chunk("lz4", lz4.frame.compress(b"x"), 2**62), f"a chunk declares {2**62} bytes when decompressed"),
        (chunk("zstd", zstandard.compress(b"x"), MAX_RECORD_BYTES + 1), "bytes when decompressed"),
        (chunk("lz4", lz4.frame.compress(bytes(MAX_RECORD_BYTES)), 1000), "the checksum of a chunk is wrong"),
        (chunk("zstd", zstandard.compress(bytes(MAX_RECORD_BYTES)), 1000), "the checksum of a chunk is wrong"),
        (chunk("brotli", b"x", 1), "unknown compression 'brotli'"),
        (struct.pack("<BQ", 0, 0), "a record without a kind"),
        (attachment(RIG_NAME, to_json(RIG)), "more than one attachment is named 'rig.json'"),
        (attachment("photo.jpg", b"1") + attachment("photo.jpg", b"1"), "attachment is named 'photo.jpg'"),
        (metadata("provenance", made_by="another"), "the provenance gives 'made_by' twice"),
        (metadata("weather", rain="x" * (5 << 20)), "a description declares"),
    ],
)
def test_what_is_made_to_do_harm_is_refused_within_little_memory(tmp_path, record, sentence):
    path = tmp_path / "r.mcap"
    write(path)
    read(path)
    with_record_in_front(path, record)
    tracemalloc.start()
    try:
        with pytest.raises(RigError) as caught:
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 1e7
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(f"{path}: ")
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_chunks_that_hold_more_than_their_file_allows_are_refused_by_every_reader(tmp_path):
    """Five chunks of zeros, each as large as one may be: 20 kB make 335 MB, and are not kept meanwhile."""
    path, data = tmp_path / "r.mcap", struct.pack("<BQ", 0x80, MAX_RECORD_BYTES - 9) + bytes(MAX_RECORD_BYTES - 9)
    write(path)
    packed = chunk("zstd", zstandard.compress(data), MAX_RECORD_BYTES, zlib.crc32(data))
    with_record_in_front(path, 5 * packed)
    assert path.stat().st_size < 2e5
    for work in (read, lambda p: recover(p, tmp_path / "saved.mcap"), lambda p: next(segments(p, 2.0, 0.0))):
        tracemalloc.start()
        try:
            with pytest.raises(RigError, match="what its chunks hold would take"):
                work(path)
            assert tracemalloc.get_traced_memory()[1] < 2.5 * MAX_RECORD_BYTES  # a chunk and what it is decompressed in
        finally:
            tracemalloc.stop()
    assert [p.name for p in tmp_path.iterdir()] == ["r.mcap"]


def test_what_compresses_well_within_reason_is_read(tmp_path):
    path = tmp_path / "r.mcap"
    write(path)
    data = struct.pack("<BQ", 0x80, 10**7) + bytes(10**7)
    with_record_in_front(path, 3 * chunk("zstd", zstandard.compress(data), len(data), zlib.crc32(data)))
    content = path.read_bytes()
    offset = content.index(struct.pack("<BQ", Opcode.DATA_END, 4))
    path.write_bytes(content[: offset + 9] + bytes(4) + content[offset + 13 :])  # without the checksum of all data
    assert read(path).samples == 3000


def test_a_flip_in_what_mcap_does_not_check_is_found(tmp_path):
    """The description of the rig and the provenance lie outside the chunks."""
    path = tmp_path / "r.mcap"
    write(path)
    content = path.read_bytes()
    for text in (b'"frequency_hz": 5.0', b"a test"):
        offset = content.index(text) + len(text) - 1
        path.write_bytes(content[:offset] + bytes([content[offset] ^ 1]) + content[offset + 1 :])
        with pytest.raises(RigError, match="the checksum of"):
            read(path)


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", CompressionType)
def test_what_other_writers_make_is_read(tmp_path, compression, chunked):
    path, values = tmp_path / "r.mcap", np.random.default_rng(1).standard_normal((1, 3000))
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=10_000, compression=compression, use_chunking=chunked)
        writer.start()
        writer.add_attachment(0, 0, "photo.jpg", "image/jpeg", b"x" * 1000)
        writer.add_attachment(0, 0, RIG_NAME, "application/json", to_json(RIG))
        schema = writer.register_schema(BLOCK_NAME, "protobuf", BLOCK_SCHEMA)
        for group, channels in GROUPS.items():
            (place,) = channels.stations
            metadata = {
                "quantity": channels.quantity,
                "unit": channels.unit,
                "sample_rate_hz": json.dumps(channels.sample_rate_hz),
                "names": json.dumps(channels.names),
                "stations": json.dumps([{"body": place.body, "position_m": place.position_m}]),
            }
            channel = writer.register_channel(f"/rig/{group}/block", "protobuf", schema, metadata)
            for first in range(0, 3000, 500):
                time_ns = round(first / channels.sample_rate_hz * 1e9)
                block = encode_block(time_ns, first, channels.sample_rate_hz, values[:, first : first + 500])
                writer.add_message(channel, 0, block, 0)
        writer.finish()
    for signals in read(path).signals.values():
        np.testing.assert_array_equal(signals.values, values)


def test_an_output_that_is_a_symbolic_link_is_refused(tmp_path):
    target, path = tmp_path / "precious", tmp_path / "r.mcap"
    target.write_text("precious")
    for link in (path, tmp_path / "r.mcap.part"):
        link.symlink_to(target)
        for forced in (True, False):
            with pytest.raises(RigError, match="is a symbolic link; name the file itself"):
                refuse_existing(path, forced)
        with pytest.raises(RigError, match="is a symbolic link; name the file itself"):
            write(path)
        assert link.is_symlink()
        link.unlink()
        assert target.read_text() == "precious"


def test_what_a_kill_left_is_not_overwritten_unasked(tmp_path):
    (tmp_path / "r.mcap.part").write_bytes(b"what is left")
    with pytest.raises(RigError, match=r"r\.mcap\.part: is being written or was cut off"):
        refuse_existing(tmp_path / "r.mcap", False)
    refuse_existing(tmp_path / "r.mcap", True)


def test_a_file_that_is_cut_while_it_is_read_is_refused(tmp_path, monkeypatch):
    """A mapped file would end the process by a bus error."""
    path = tmp_path / "r.mcap"
    write(path)

    def cut(channel):
        os.truncate(path, 1000)
        return channel.topic.endswith("/block")

    monkeypatch.setattr(container, "_WINDOW_BYTES", 1000)
    monkeypatch.setattr("rig.recording.file.has_sample_blocks", cut)
    with pytest.raises(RigError, match="is cut off"):
        read(path)
