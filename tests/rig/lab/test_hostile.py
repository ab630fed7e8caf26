"""Files made to mislead, to exhaust or to reach beyond themselves: one sentence each, in bounded time and memory."""

import json
import math
import os
import struct
import subprocess
import sys
import zlib
from functools import cache
from select import select

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from rig.errors import RigError
from rig.lab.importing import import_file
from rig.limits import memory_bound_bytes
from rig.model.description import to_json
from rig.model.tolerances import tolerances_named
from rig.recording import read
from rig.simulation.reference import Sdof
from tests.uff_histories import time_history

RIG = Sdof(sensors="acceleration").rig()
RATE_HZ = RIG.sample_rate_hz
(A,) = (sensor.name for sensor in RIG.sensors)
SAMPLES, HUGE = 400, 250_000_000
FORCE, ACC = np.random.default_rng(1).standard_normal((2, SAMPLES))
MAP = f"""sample_rate_hz = {RATE_HZ}
force = {{ column = "force", unit = "N" }}
[sensors]
{A} = {{ column = "acc", unit = "m/s^2" }}
"""
MAX_SECONDS = 3.0
"""Of processor time, on a machine that is busy."""
WORKER = """
import json, resource, sys, time
from pathlib import Path
from rig.lab.importing import import_file
from rig.errors import RigError

status, clear = Path("/proc/self/status"), Path("/proc/self/clear_refs")

def peak_bytes():
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return 1024 * next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))

for line in sys.stdin:
    if clear.exists():
        clear.write_text("5")
    began, said = time.process_time(), ""
    try:
        import_file(*map(Path, json.loads(line)))
    except RigError as error:
        said = str(error)
    print(json.dumps([said, time.process_time() - began, peak_bytes()]), flush=True)
"""


@pytest.fixture(scope="module")
def worker():
    """A process that imports files and says after each what was said, and the seconds and bytes that it took."""
    words = [sys.executable, "-c", WORKER]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        process.kill()


def hdf5(path, write):
    """A file whose force is sound; `write` writes the other datasets."""
    with h5py.File(path, "w") as file:
        file["force"] = FORCE
        write(file)


def mat73(path, write):
    """The same as MATLAB's save -v7.3."""
    with h5py.File(path, "w", userblock_size=512) as file:
        file["force"] = FORCE[None]
        write(file)
    with path.open("rb+") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


WRITERS = {".h5": hdf5, ".mat": mat73}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.json").write_bytes(to_json(RIG))
    (tmp_path / "map.toml").write_text(MAP)
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["acc"] = ACC[None]
    (tmp_path / "secret.raw").write_bytes(ACC.tobytes())
    return tmp_path


def said(folder, name):
    with pytest.raises(RigError) as caught:
        import_file(folder / name, folder / "map.toml", folder / "r.mcap")
    assert not list(folder.glob("r.mcap*"))
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{folder}/")


@pytest.fixture
def measured(worker, folder):
    """Import a file in a worker process, check its time and memory, and return its sentence."""

    def measure(name):
        words = [str(folder / file_name) for file_name in (name, "map.toml", "r.mcap")]
        worker.stdin.write(json.dumps(words) + "\n")
        worker.stdin.flush()
        assert select([worker.stdout], [], [], 60)[0], "it does not end"
        sentence, seconds, peak_bytes = json.loads(worker.stdout.readline())
        print(f"{name}: {sentence} | {seconds:.2f} s | {peak_bytes / 1e6:.0f} MB")
        assert seconds < MAX_SECONDS
        assert peak_bytes < memory_bound_bytes((folder / name).stat().st_size)
        return sentence.removeprefix(f"{folder}/")

    return measure


def external_storage(place):
    return lambda file: file.create_dataset("acc", (1, SAMPLES), "f8", external=[(place, 0, 8 * SAMPLES)])


def virtual(source):
    def write(file):
        layout = h5py.VirtualLayout((1, SAMPLES), "f8")
        layout[:] = h5py.VirtualSource(source, "acc", (1, SAMPLES))
        file.create_virtual_dataset("acc", layout)

    return write


def external_link(file):
    file["acc"] = h5py.ExternalLink("secret.h5", "acc")


def partly(file):
    dataset = file.create_dataset("acc", (1, SAMPLES), "f8", chunks=(1, 100))
    dataset[0, :100] = ACC[:100]
    dataset[0, 300:] = ACC[300:]


def never(file):
    file.create_dataset("acc", (1, SAMPLES), "f8")


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize(
    ("write", "sentence"),
    [
        (external_storage("/etc/passwd"), "has its bytes in another file (external storage), which is not opened"),
        (external_storage("secret.raw"), "has its bytes in another file (external storage), which is not opened"),
        (virtual("secret.h5"), "is a view of other files (a virtual dataset), which is not opened"),
        (virtual("nowhere.h5"), "is a view of other files (a virtual dataset), which is not opened"),
        (external_link, "is a link to another file, which is not opened"),
        (partly, "has 200 of 400 samples that were never written"),
        (never, "has 400 of 400 samples that were never written"),
    ],
)
def test_what_a_file_does_not_hold_is_not_read(folder, suffix, write, sentence):
    WRITERS[suffix](folder / f"lab{suffix}", write)
    assert said(folder, f"lab{suffix}").startswith(f"lab{suffix}: 'acc' {sentence}; ")


def test_a_virtual_dataset_is_not_even_asked_for_its_size(folder, measured):
    """An unlimited virtual dataset would open its source, which may be a pipe."""
    os.mkfifo(folder / "pipe")

    def write(file):
        layout = h5py.VirtualLayout((SAMPLES,), "f8", maxshape=(None,))
        source = h5py.VirtualSource(str(folder / "pipe"), "acc", (SAMPLES,), maxshape=(None,))
        layout[: h5py.h5s.UNLIMITED] = source[: h5py.h5s.UNLIMITED]
        file.create_virtual_dataset("acc", layout)

    hdf5(folder / "lab.h5", write)
    assert "'acc' is a view of other files" in measured("lab.h5")


def test_what_is_not_asked_for_is_not_read(folder, measured):
    def write(file):
        file["acc"] = ACC[None]
        file["elsewhere"] = h5py.ExternalLink("secret.h5", "acc")
        file.create_dataset("large", (1, HUGE), "u1")
        file.create_dataset("raw", (1, SAMPLES), "f8", external=[("/etc/passwd", 0, 8 * SAMPLES)])

    for suffix, writer in WRITERS.items():
        writer(folder / f"lab{suffix}", write)
        assert measured(f"lab{suffix}") == ""
        np.testing.assert_array_equal(read(folder / "r.mcap").signals["acceleration"].values[0], ACC)
        (folder / "r.mcap").unlink()


@cache
def zeros():
    packer = zlib.compressobj()
    return b"".join(packer.compress(bytes(10**7)) for _ in range(33)) + packer.flush()


def deflated(file):
    """A chunk that is larger than the file says, by a million times."""
    dataset = file.create_dataset("acc", (1, SAMPLES), "u1", chunks=(1, SAMPLES), compression="gzip")
    dataset.id.write_direct_chunk((0, 0), zeros())


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize(
    ("write", "sentence"),
    [
        (lambda file: file.create_dataset("acc", (1, HUGE), "u1"), "column 'acc' would take 4162 MB of memory"),
        (
            lambda file: file.create_dataset("acc", data=np.zeros((1, 20_000_000), "u1"), compression="gzip"),
            "column 'acc' would take 470 MB of memory",
        ),
        (deflated, "'acc' has a chunk that swells beyond its 400 bytes; "),
    ],
    ids=["not written", "compressed", "chunk"],
)
def test_what_swells_is_refused_before_it_is_decoded(folder, suffix, write, sentence, measured):
    WRITERS[suffix](folder / f"lab{suffix}", write)
    assert measured(f"lab{suffix}").startswith(f"lab{suffix}: {sentence}")


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def array(kind, shape, name, content):
    head = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, head + element(1, name) + content)


def version_5(path, *elements):
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements))


def packed(head, zeros):
    """A compressed element: what stands at its beginning, and so many zeros."""
    packer = zlib.compressobj()
    pieces = [packer.compress(head), *(packer.compress(bytes(10**7)) for _ in range(zeros // 10**7)), packer.flush()]
    return struct.pack("<II", 15, sum(map(len, pieces))) + b"".join(pieces)


def declared(length, head):
    return struct.pack("<II", 14, length) + head


HEAD_OF_ACC = array(9, (1, HUGE), b"acc", b"")[8:] + struct.pack("<II", 2, HUGE)
HEAD_OF_STRUCT = array(2, (1, 1), b"run", b"")[8:] + element(5, struct.pack("<i", 4)) + element(1, b"acc\0")


def force(path):
    savemat(path, {"force": FORCE}, do_compression=False)
    return path.read_bytes()[128:]


@pytest.mark.parametrize(
    ("elements", "sentence"),
    [
        ([packed(declared(len(HEAD_OF_ACC) + HUGE, HEAD_OF_ACC), HUGE)], "column 'acc' with 1 more would take 4"),
        ([packed(declared(10**9, HEAD_OF_STRUCT), 10**8)], "its variable 'run' would take 1130 MB of memory"),
        (
            [packed(array(9, (1, SAMPLES), b"acc", element(9, ACC.tobytes())), 10**8)],
            "cannot be read as .mat (its compressed data are cut off, or swell beyond what they declare)",
        ),
        (
            [array(1, (1, 10**6), b"c", b"")],
            "cannot be read as .mat (its array 'c' has the size (1, 1000000), and the file may hold 100000 elements)",
        ),
    ],
    ids=["numbers", "struct", "undeclared", "cells"],
)
def test_what_swells_in_version_5_is_refused(folder, elements, sentence, measured):
    version_5(folder / "lab.mat", force(folder / "lab.mat"), *elements)
    assert measured("lab.mat").startswith(f"lab.mat: {sentence}")


def test_cells_within_cells_end(folder, measured):
    nested = array(9, (1, SAMPLES), b"", element(9, ACC.tobytes()))
    for _ in range(2000):
        nested = array(1, (1, 1), b"", nested)
    version_5(folder / "lab.mat", force(folder / "lab.mat"), nested)
    assert measured("lab.mat").startswith("lab.mat: cannot be read as .mat (its structs are more than 32 deep")


def many_ways(file):
    """25 groups with ten hard links each to the next: 10^25 names of one array."""
    group = file.create_group("g0")
    for level in range(1, 25):
        below = file.create_group(f"#refs#/g{level}")
        for k in range(10):
            group[f"a{k}"] = below
        group = below
    group["x"] = ACC[None]
    file["acc"] = ACC[None]


@pytest.mark.parametrize("suffix", WRITERS)
def test_an_object_that_many_ways_lead_to_is_listed_once(folder, suffix, measured):
    WRITERS[suffix](folder / f"lab{suffix}", many_ways)
    assert measured(f"lab{suffix}") == ""


def test_references_in_a_circle_end(folder, measured):
    def write(file):
        file["acc"] = ACC[None]
        cell = file.create_dataset("c", (100, 1), h5py.ref_dtype)
        cell[:, 0] = [cell.ref] * 100
        cell.attrs["MATLAB_class"] = np.bytes_("cell")

    mat73(folder / "lab.mat", write)
    assert measured("lab.mat") == ""


def test_groups_within_groups_end(folder):
    def write(file):
        group = file
        for _ in range(300):
            group = group.create_group("g")
        group["acc"] = ACC[None]

    for suffix, writer in WRITERS.items():
        writer(folder / f"lab{suffix}", write)
        assert "its groups are more than 32 deep" in said(folder, f"lab{suffix}")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (".".join(50_000 * "a") + " = 1", "it has a key of more than 32 parts"),
        (" . ".join(50_000 * ["'a b'"]) + " = 1", "it has a key of more than 32 parts"),
        ("[" + ".".join(50_000 * ['"a"']) + "]", "it has a key of more than 32 parts"),
        ("[sensors]\n" + "".join(f"s{k} = 1\n" for k in range(150_000)), "it has more than 1000 kB"),
        ("gain = " + 900_000 * "[", "its values are nested too deep"),
        ("gain = " + 900_000 * "1", "it has a number of too many digits"),
        ("gain = 0.1 # µ".encode("latin-1"), "it is not text in UTF-8"),
    ],
    ids=["bare", "quoted", "table", "size", "nested", "digits", "encoding"],
)
def test_toml_that_takes_long_is_refused(folder, text, sentence, measured):
    content = text if isinstance(text, bytes) else text.encode()
    (folder / "map.toml").write_bytes(content)
    (folder / "lab.csv").write_text("force,acc\n1,2\n")
    assert measured("lab.csv").startswith(f"map.toml: is no map: {sentence}; ")
    with pytest.raises(RigError, match=f"is no file of tolerances: {sentence}; "):
        tolerances_named(str(folder / "map.toml"))


def test_names_with_dots_are_no_deep_keys(folder):
    (folder / "t.toml").write_text("".join(f'[sensors."acc.{k}.x"]\ngain = 0.01\n' for k in range(200)))
    assert len(tolerances_named(str(folder / "t.toml")).sensors) == 200


def csv_map(folder, csv="", time='time = { column = "t", unit = "s" }', extra_lines=""):
    map_text = MAP.replace(f"sample_rate_hz = {RATE_HZ}", f"{time}\n{csv}\n{extra_lines}")
    (folder / "map.toml").write_text(map_text)


def stamped_rows():
    return [f"{k / RATE_HZ!r},{f!r},{a!r}" for k, (f, a) in enumerate(np.stack([FORCE, ACC], axis=1).tolist())]


@pytest.mark.parametrize("scale", [1e-9, 1e-300, 1 / 3000])
def test_a_record_far_above_the_rigs_rate_is_not_resampled(folder, scale):
    csv_map(folder, time=f'time = {{ column = "t", scale = {scale} }}', extra_lines="resample = true")
    (folder / "lab.csv").write_text("\n".join(["t,force,acc", *stamped_rows()]))
    rate = f"{RATE_HZ / scale:.6g}"
    assert said(folder, "lab.csv").startswith(
        f"lab.csv: it is sampled at {rate} Hz, over 1000 times sample_rate_hz 512 of the rig; correct the unit or scale"
    )


def test_a_rate_just_below_that_is_resampled(folder):
    rate_hz = 999 * RATE_HZ
    csv_map(folder, time=f"sample_rate_hz = {rate_hz}", extra_lines="resample = true")
    time_s = np.arange(20_000) / rate_hz
    rows = [f"{f!r},1.5" for f in np.sin(2 * np.pi * 20.0 * time_s).tolist()]
    (folder / "lab.csv").write_text("\n".join(["force,acc", *rows]))
    import_file(folder / "lab.csv", folder / "map.toml", folder / "r.mcap")
    recording = read(folder / "r.mcap")
    assert recording.samples == math.ceil(20_000 / 999)
    inside = slice(5, -5)
    expected = np.sin(2 * np.pi * 20.0 * recording.signals["force"].time_s)
    np.testing.assert_allclose(recording.force_n[inside], expected[inside], atol=2e-2)


@pytest.mark.parametrize(
    ("last", "sentence"),
    [("1e308", "line 2 has '-1e308' in column 't', which nothing measures"), ("1e-310", "it is sampled at")],
)
def test_stamps_at_the_ends_of_the_numbers_are_refused(folder, last, sentence):
    csv_map(folder, extra_lines="resample = true")
    (folder / "lab.csv").write_text(f"t,force,acc\n-{last},1,2\n0,1,2\n{last},1,2\n")
    assert said(folder, "lab.csv").startswith(f"lab.csv: {sentence}")


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        (["0;1.500;2", "0,1;2,5;2"], "line 2 has '1.500' in column 'force', and the decimal is ','"),
        (["0;2,5;1", "0,1;2,5;1.5"], "line 3 has '1.5' in column 'acc', and the decimal is ','"),
        (["0;1.234,5;2"], "line 2 has '1.234,5' in column 'force', and the decimal is ','"),
    ],
)
def test_a_point_where_the_decimal_is_a_comma_is_refused(folder, rows, sentence):
    csv_map(folder, 'csv = { delimiter = ";", decimal = "," }')
    (folder / "lab.csv").write_text("\n".join(["t;force;acc", *rows]))
    assert said(folder, "lab.csv").startswith(f"lab.csv: {sentence}; ")


def test_a_point_elsewhere_in_the_line_is_no_decimal(folder):
    csv_map(folder, 'csv = { delimiter = ";", decimal = "," }')
    text = "\n".join(row.translate(str.maketrans(",.", ";,")) + ";24.11." for row in stamped_rows())
    (folder / "lab.csv").write_text(f"t;force;acc;date\n{text}\n")
    import_file(folder / "lab.csv", folder / "map.toml", folder / "r.mcap")
    np.testing.assert_array_equal(read(folder / "r.mcap").force_n, FORCE)


def test_csv_of_short_numbers_keeps_within_its_memory(folder, measured):
    """A line of four bytes makes a string of fifty; so lines are read one after the other."""
    csv_map(folder, time=f"sample_rate_hz = {RATE_HZ}")
    (folder / "lab.csv").write_text("force,acc\n" + 400_000 * "1,2\n")
    assert measured("lab.csv") == ""


@pytest.mark.parametrize("encoding", ["zip", "idna", "punycode", "undefined", "unicode_escape", "no\0ne"])
def test_what_is_no_encoding_of_text_is_refused(folder, encoding):
    csv_map(folder, f"csv = {{ encoding = {json.dumps(encoding)} }}")
    (folder / "lab.csv").write_text("t,force,acc\n0,1,2\n")
    assert "there is no encoding " in said(folder, "lab.csv")


def test_a_line_of_delimiters_alone_takes_no_time(folder, measured):
    csv_map(folder)
    (folder / "lab.csv").write_text("t,force,acc\n" + 5_000_000 * "," + "\n")
    assert "a line has more than 1000000 characters" in measured("lab.csv")


def uff(folder, count=2):
    """Text, of as many time histories."""
    import pyuff

    path = folder / "lab.uff"
    path.unlink(missing_ok=True)
    time_s = np.arange(SAMPLES) / RATE_HZ
    rows = zip(("force", "acc", "more"), (FORCE, ACC, ACC), strict=True)
    histories = [time_history(name, time_s, row) for name, row in rows]
    pyuff.UFF(str(path)).write_sets(histories[:count], "add")
    return path


def test_a_uff_file_that_is_cut_anywhere_is_refused(folder):
    """The cut may be within a dataset that is not requested: the part before it would pass for the whole."""
    path = uff(folder, 3)
    content = path.read_bytes()
    _, third = [k + 7 for k in range(len(content)) if content[k : k + 14] == b"    -1\n    -1\n"]
    for size in (third + 3, third + 7, third + 20, third + 500, len(content) - 7, len(content) - 500):
        path.write_bytes(content[:size])
        assert "cut off" in said(folder, "lab.uff"), size


@pytest.mark.parametrize("points", [0, 399, 401, 999_999_999])
def test_a_uff_file_that_declares_other_samples_is_refused(folder, points, measured):
    path = uff(folder)
    path.write_bytes(path.read_bytes().replace(f"{4:10d}{SAMPLES:10d}".encode(), f"{4:10d}{points:10d}".encode()))
    assert f"of {points} samples" in measured("lab.uff")


def test_attributes_in_another_encoding_or_of_many_values(folder):
    def write(file):
        file["acc"] = ACC
        file["acc"].attrs["unit"] = np.bytes_("m/s²".encode("latin-1"))
        file["acc"].attrs["fs"] = np.array([RATE_HZ])

    hdf5(folder / "lab.h5", write)
    import_file(folder / "lab.h5", folder / "map.toml", folder / "r.mcap")
    (folder / "r.mcap").unlink()
    with h5py.File(folder / "lab.h5", "a") as file:
        file["acc"].attrs["fs"] = np.array([RATE_HZ, RATE_HZ])
    assert "its dataset 'acc' has an attribute 'fs' of other than one value" in said(folder, "lab.h5")
    with h5py.File(folder / "lab.h5", "a") as file:
        file["acc"].attrs["fs"] = "fast"
    assert "its dataset 'acc' has the sample rate 'fast'" in said(folder, "lab.h5")


def test_tdms_segments_that_each_list_every_channel_are_refused(folder, measured):
    """32 bytes of a segment that adds nothing to 4000 channels would take half a megabyte."""
    with TdmsWriter(str(folder / "lab.tdms")) as writer:
        writer.write_segment([ChannelObject("g", f"c{k}", np.zeros(1)) for k in range(4000)])
    empty = b"TDSm" + struct.pack("<IIQQI", 1 << 1, 4713, 4, 4, 0)
    with (folder / "lab.tdms").open("ab") as stream:
        stream.write(2000 * empty)
    assert "its 2001 segments would take 803 MB of memory" in measured("lab.tdms")


def test_a_uff_line_of_many_numbers_is_refused(folder, measured):
    path = uff(folder)
    head, mark, last = path.read_text().rpartition("    -1\n    -1\n")
    lines = head.splitlines()
    path.write_text("\n".join([*lines[:13], "0 " * 4_000_000, mark + last]))
    assert "has a line of more than 1000 characters" in measured("lab.uff")


def test_uff_numbers_beyond_the_count_are_counted_not_kept(folder, measured):
    path = uff(folder)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:-1], *(100_000 * ["0 " * 40]), lines[-1], ""]))
    assert "of 400 samples" in measured("lab.uff")


def test_labchart_channels_of_a_compressed_row_are_unpacked_once(folder, measured):
    """A thousand channels that each unpack ten megabytes would take a minute."""
    row, pieces = np.zeros((1, 1_500_000)), np.arange(1.0, 1001.0)[:, None]
    row[0, 5:405], row[0, 405:805] = FORCE, ACC
    bounds = {"datastart": np.stack([6 + 0 * pieces, 406 + 0 * pieces])[:, :500, 0], "dataend": None}
    bounds["dataend"] = bounds["datastart"] + 399
    savemat(folder / "lab.mat", {"data": row, **bounds}, do_compression=True)
    (folder / "map.toml").write_text(MAP.replace('"force", unit', "1, unit").replace('"acc", unit', "501, unit"))
    assert measured("lab.mat") == ""


def test_many_attributes_and_single_values_take_no_time(folder, measured):
    def write(file):
        file["acc"] = ACC
        group = file.create_group("g")
        for k in range(1000):
            group[f"s{k}"] = float(k)
            group[f"a{k}"] = np.zeros(20)
        for k in range(500):
            group.attrs[f"unit{k}"] = "N"

    hdf5(folder / "lab.h5", write)
    assert measured("lab.h5") == ""


def test_compressed_matlab_texts_that_swell_are_not_kept(folder, measured):
    savemat(folder / "text.mat", {"unit": np.array(["N" * 60_000] * 300)}, do_compression=True)
    version_5(folder / "lab.mat", force(folder / "lab.mat"), (folder / "text.mat").read_bytes()[128:])
    assert "there is no column 'acc'" in measured("lab.mat")
