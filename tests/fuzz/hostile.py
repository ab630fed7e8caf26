"""Files made to do harm, of every class that is known: each is refused, within the bounds of memory and time.

Bombs, external and virtual storage, links, samples that were never written, deep keys, clocks that jump, attachments
and keys that are given twice, decimal marks of another country.
"""

import re
import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import h5py
import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk

from rig.lab.importing import import_file
from rig.model.description import to_json
from rig.model.tolerances import tolerances_named
from rig.recording import RIG_NAME, read
from rig.recording.container import MAX_RECORD_BYTES
from rig.recording.messages import decode_block
from rig.recording.recovery import recover
from rig.recording.segments import segments
from tests.blocks import encode_block
from tests.fuzz.judging import refused, refused_or_right
from tests.fuzz.records import MAGIC, rewritten
from tests.fuzz.tables import FEW, MAP, RATE_HZ, SDOF, A, X, table

JUMPS_S = (-3600.0, -1.0, 0.01, 1.0, 3600.0, 1e9)
SWELLS = 100_000_000
"""Bytes that a bomb of HDF5 makes."""


def hostile_recording(rng: np.random.Generator, folder: Path, sound: bytes) -> str:
    """Read, in one piece or segments, and recovered."""
    change = _RECORDINGS[rng.integers(len(_RECORDINGS))]
    path = folder / "bad.mcap"
    path.write_bytes(change(rng, sound))
    works: tuple[Callable[[], object], ...] = (
        lambda: read(path),
        lambda: list(segments(path, 1.0, 0.0)),
        lambda: recover(path, folder / "saved.mcap"),
    )
    for work in works:
        refused(folder, work)
    return "refused"


def _clock_that_jumps(rng: np.random.Generator, sound: bytes) -> bytes:
    """From a block on, or all of one group."""
    jump_ns, wrong = round(JUMPS_S[rng.integers(len(JUMPS_S))] * 1e9), int(rng.integers(3))
    first = 1024 * int(rng.integers(1, 4))

    def changed(topic: str, data: bytes) -> bytes:
        block, number = decode_block(data), numbers.setdefault(topic, len(numbers))
        jumps = number == wrong or (whole and block.first_sample >= first)
        time_ns = block.time_ns + (jump_ns if jumps else 0)
        return encode_block(time_ns, block.first_sample, block.sample_rate_hz, block.values)

    numbers: dict[str, int] = {}
    whole = bool(rng.random() < 0.5)
    wrong = -1 if whole else wrong
    return rewritten(sound, None, None, message=changed)


def _attachment_twice(rng: np.random.Generator, sound: bytes) -> bytes:
    text = to_json(SDOF)
    twice = [(RIG_NAME, text), (RIG_NAME, text.replace(b"5.0", b"6.0", 1)), ("photo.jpg", b"1")][rng.integers(3)]
    return rewritten(sound, None, None, attachments=(twice, ("photo.jpg", b"2")))


def _key_twice(rng: np.random.Generator, sound: bytes) -> bytes:
    """Some key of rig.json, with another value in front, as the last is believed."""

    def doubled(text: bytes) -> bytes:
        keys = list(re.finditer(rb'"\w+"(?=\s*:)', text))
        key = keys[rng.integers(len(keys))]
        return text[: key.start()] + key[0] + b": 7, " + text[key.start() :]

    return rewritten(sound, doubled, None)


def _provenance_twice(rng: np.random.Generator, sound: bytes) -> bytes:
    one, other = rng.choice(10**6, size=2, replace=False)
    return rewritten(sound, None, None, provenances=({"recorded": str(one)}, {"recorded": str(other)}))


@cache
def _bomb(compression: str) -> bytes:
    data = struct.pack("<BQ", 0x80, MAX_RECORD_BYTES - 9) + bytes(MAX_RECORD_BYTES - 9)
    packed = zstandard.compress(data) if compression == "zstd" else lz4.frame.compress(data)
    builder = RecordBuilder()
    Chunk(compression, packed, 0, 0, zlib.crc32(data), len(data)).write(builder)
    return bytes(builder.end())


def _bombs(rng: np.random.Generator, sound: bytes) -> bytes:
    """Chunks that are each as large as one may be: of zstd a thousandth of a per cent of that in the file."""
    compression = ("zstd", "lz4")[rng.integers(2)]
    return MAGIC + _bomb(compression) * int(rng.integers(5, 40)) + sound[8:]


_RECORDINGS = (_clock_that_jumps, _attachment_twice, _key_twice, _provenance_twice, _bombs)


def hostile_hdf5(rng: np.random.Generator, folder: Path) -> str:
    """Storage elsewhere, links and bombs, in an HDF5 file or a MATLAB file of version 7.3."""
    matlab, store = bool(rng.random() < 0.5), _STORED[rng.integers(len(_STORED))]
    place = folder / ("lab.mat" if matlab else "lab.h5")
    (folder / "secret.bin").write_bytes(np.arange(FEW, dtype="<f8").tobytes())
    with h5py.File(folder / "other.h5", "w") as other:
        other["secret"] = np.arange(float(FEW))
    with h5py.File(place, "w", userblock_size=512 if matlab else 0) as file:
        for name in (X, A):
            file.create_dataset(name, data=table()[1][name])
        store(rng, file, folder)
        for name in file if matlab else ():
            if isinstance(file.get(name, getlink=True), h5py.HardLink) and isinstance(file[name], h5py.Dataset):
                file[name].attrs["MATLAB_class"] = np.bytes_("double")
    if matlab:
        head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
        place.write_bytes(head + place.read_bytes()[len(head) :])
    columns = {"force": ("force", "N"), X: (X, "m"), A: (A, "m/s^2")}
    entries = {name: f'{name} = {{ column = "{column}", unit = "{unit}" }}' for name, (column, unit) in columns.items()}
    told = [f"sample_rate_hz = {RATE_HZ}", entries["force"], "[sensors]", entries[X], entries[A]]
    return _imported(folder, place.name, "\n".join(told).encode(), store is not _hard_links)


def _external(rng: np.random.Generator, file: h5py.File, folder: Path) -> None:
    path = ("/etc/passwd", str(folder / "secret.bin"), "secret.bin")[rng.integers(3)]
    file.create_dataset("force", (FEW,), "u1" if path == "/etc/passwd" else "<f8", external=[(path, 0, 8 * FEW)])


def _virtual(rng: np.random.Generator, file: h5py.File, _: Path) -> None:
    """Of another file, which may be missing; where it is, or is not named, the fill value stands."""
    layout, end = h5py.VirtualLayout((FEW,), "<f8"), int(rng.integers(1, FEW + 1))
    source = h5py.VirtualSource(("other.h5", "missing.h5")[rng.integers(2)], "secret", (FEW,))
    layout[:end] = source[:end]
    file.create_virtual_dataset("force", layout, fillvalue=float(rng.integers(2)))


def _external_link(rng: np.random.Generator, file: h5py.File, folder: Path) -> None:
    path = ("other.h5", str(folder / "other.h5"), "missing.h5")[rng.integers(3)]
    file["force"] = h5py.ExternalLink(path, ("/secret", "/", "/none")[rng.integers(3)])


def _soft_link(rng: np.random.Generator, file: h5py.File, _: Path) -> None:
    """To itself, in a ring, or to nothing."""
    file["force"] = h5py.SoftLink(("/force", "/ring", "/none")[rng.integers(3)])
    file["ring"] = h5py.SoftLink("/force")


def _never_written(rng: np.random.Generator, file: h5py.File, _: Path) -> None:
    """None of its chunks, or but the first."""
    size = int(rng.choice([FEW, 2 * FEW, 10**6, 250_000_000]))
    dataset = file.create_dataset("force", (size,), ("<f8", "u1")[rng.integers(2)], chunks=(FEW // 2,))
    if rng.random() < 0.5:
        dataset[: FEW // 2] = 1


def _compressed(rng: np.random.Generator, file: h5py.File, _: Path) -> None:
    """Zeros by the hundred million, a thousandth of them in the file."""
    size = SWELLS * int(rng.integers(1, 4))
    dataset = file.create_dataset("force", (size,), "u1", chunks=(1 << 22,), compression="gzip")
    packed = zlib.compress(bytes(1 << 22), 1)
    for first in range(0, size, 1 << 22):
        dataset.id.write_direct_chunk((first,), packed)


def _hard_links(rng: np.random.Generator, file: h5py.File, _: Path) -> None:
    """Groups that each hold the next several times: as many ways as there are atoms."""
    file.create_dataset("force", data=table()[1]["force"])
    group = file.create_group("web")
    for _ in range(int(rng.integers(2, 30))):
        inner = group.create_group("0")
        for name in range(1, int(rng.integers(2, 12))):
            group[str(name)] = inner
        group = inner
    group["data"] = np.zeros(3)


_STORED = (_external, _virtual, _external_link, _soft_link, _never_written, _compressed, _hard_links)


def deep_keys(rng: np.random.Generator, folder: Path) -> str:
    """Keys of many dots and tables within tables in a map or in tolerances; lists within lists in rig.json."""
    depth = int(10 ** rng.uniform(0.5, 5))
    deep = (
        ".".join(["a"] * depth) + " = 1",
        f"[{'.'.join(['a'] * depth)}]\nb = 1",
        "a = " + "[" * depth + "]" * depth,
        "a = " + "{ b = " * depth + "1" + " }" * depth,
    )[rng.integers(4)].encode()
    kind = rng.integers(3)
    if kind == 0:
        path = folder / "t.toml"
        path.write_bytes(deep)
        return refused(folder, lambda: tolerances_named(str(path)))
    lines = MAP.encode().split(b"\n")
    if kind == 1:
        lines.insert(int(rng.integers(len(lines))), deep)
        told, rig = b"\n".join(lines), to_json(SDOF)
    else:
        told, rig = MAP.encode(), to_json(SDOF).replace(b"5.0", b"[" * depth + b"]" * depth, 1)
    return _imported(folder, "lab.csv", told, content=table()[0], rig=rig)


def decimal_marks(rng: np.random.Generator, folder: Path) -> str:
    """Where the decimal mark is a comma, cells with a point: a thousand and a half for who wrote it, or a mixture."""
    lines = table()[0].decode().split("\n")
    rows = [[cell.replace(".", ",") for cell in line.split(",")] for line in lines[3:-1]]
    cells = ("1.500", "1.5", "12.345", "-1.000", "1.500,0", "1.234.567", "1e-3.0")
    for _ in range(int(rng.choice([1, 2, 600]))):
        rows[rng.integers(len(rows))][rng.integers(1, 4)] = cells[rng.integers(len(cells))]
    table_ = "\n".join([*(line.replace(",", ";") for line in lines[:3]), *map(";".join, rows), ""]).encode()
    told = MAP.replace('delimiter = ","', 'delimiter = ";"').replace('decimal = "."', 'decimal = ","').encode()
    return _imported(folder, "lab.csv", told, content=table_)


def _imported(
    folder: Path, name: str, told: bytes, must_be_refused: bool = True, content: bytes | None = None, rig: bytes = b""
) -> str:
    (folder / "rig.json").write_bytes(rig or to_json(SDOF))
    (folder / "map.toml").write_bytes(told)
    if content is not None:
        (folder / name).write_bytes(content)

    def work() -> None:
        import_file(folder / name, folder / "map.toml", folder / "r.mcap")
        np.testing.assert_array_equal(read(folder / "r.mcap").force_n, table()[1]["force"])

    return (refused if must_be_refused else refused_or_right)(folder, work)
