"""A recording that was killed, cut, flipped or out of disk: what is brought back is exactly what was recorded."""

import json
import os
import re
import signal
import struct
import subprocess
import sys
import time
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.errors import RigError
from rig.recording import channel_groups, read, read_truth, truth_path, writing
from rig.recording.recovery import recover
from rig.simulation.reference import Sdof
from tests.campaigns.killed_recordings import stored_samples
from tests.running import exit_status

RIG = Sdof().rig()
DURATION_S = 40.0
RECORDER = f"""
import os, resource, sys, time
from pathlib import Path
from rig.errors import RigError
from rig.simulation.excitation import BandLimitedGaussian
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import Sdof

def recorded(path, pause_s):
    record(Sdof().rig(), BandLimitedGaussian(rms_n=0.5, low_hz=0.0, high_hz=15.0), plant=modal.simulate,
           duration_s={DURATION_S}, step_s=2.0**-13, path=Path(path), progress=lambda _: time.sleep(pause_s))

for line in sys.stdin:
    path, pause_s, limit = line.split()
    child = os.fork() if limit != "whole" else 0
    if child == 0:
        if limit.isdigit():
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit), resource.RLIM_INFINITY))
        try:
            recorded(path, float(pause_s))
        except RigError as error:
            Path(path + ".said").write_text(str(error))
        if limit != "whole":
            os._exit(0)
    print(child, flush=True)
    if child:
        os.waitpid(child, 0)
"""


@pytest.fixture(scope="module")
def recorder():
    """Starts recordings, each in a process of its own that has compiled already; gives that process's number."""
    with subprocess.Popen(
        [sys.executable, "-c", RECORDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:

        def start(path, pause_s=0.0, limit="none"):
            process.stdin.write(f"{path} {pause_s} {limit}\n")
            process.stdin.flush()
            return int(process.stdout.readline())

        yield start
        process.stdin.close()


@pytest.fixture(scope="module")
def complete(recorder, tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    recorder(path, limit="whole")
    return path.stat().st_size, read(path), read_truth(truth_path(path))


def check_prefix(recovered, complete):
    """Every group of the one is the beginning of the other."""
    assert recovered.rig == complete.rig
    assert set(recovered.signals) == set(complete.signals)
    for group, signals in complete.signals.items():
        np.testing.assert_array_equal(
            recovered.signals[group].values, signals.values[:, : recovered.samples], strict=True
        )


@pytest.mark.parametrize("seed", range(6))
def test_a_killed_recording_keeps_every_complete_chunk(recorder, complete, tmp_path, seed):
    rng = np.random.default_rng(seed)
    path, saved = tmp_path / "r.mcap", tmp_path / "saved.mcap"
    part_path = tmp_path / "r.mcap.part"
    process = recorder(path, pause_s=0.02)
    size, undisturbed, undisturbed_truth = complete
    reached = rng.uniform(0.1, 0.9) * size
    deadline = time.monotonic() + 30
    while not part_path.exists() or part_path.stat().st_size < reached:
        assert time.monotonic() < deadline
        time.sleep(0.002)
    time.sleep(rng.uniform(0, 0.03))
    os.kill(process, signal.SIGKILL)
    assert not path.exists()
    losses = recover(part_path, saved)
    stored, recovered = stored_samples(part_path), read(saved)
    check_prefix(recovered, undisturbed)
    assert recovered.samples == min(values.shape[1] for values in stored.values()) > 0
    for loss in losses:
        assert loss.found == stored[loss.group].shape[1]
        assert loss.kept == recovered.samples
        assert loss.asked == DURATION_S * RIG.sample_rate_hz
    if seed == 0:
        recover(truth_path(path).with_name(truth_path(path).name + ".part"), tmp_path / "saved.truth.mcap")
        check_prefix(read_truth(tmp_path / "saved.truth.mcap"), undisturbed_truth)


def test_a_full_disk_keeps_every_complete_chunk(recorder, complete, tmp_path):
    path, (size, undisturbed, _) = tmp_path / "r.mcap", complete
    recorder(path, limit=size // 2)
    said = tmp_path / "r.mcap.said"
    recorder(tmp_path / "other.mcap", limit=1)  # answers when the one before has ended
    assert f"{path}: cannot be written to its end (File too large); make room and save" in said.read_text()
    assert not path.exists()
    recover(tmp_path / "r.mcap.part", tmp_path / "saved.mcap")
    saved = read(tmp_path / "saved.mcap")
    check_prefix(saved, undisturbed)
    assert saved.samples > 0.3 * undisturbed.samples


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "r.mcap"
    rng = np.random.default_rng(1)
    values = {name: rng.standard_normal((len(g.names), 12_000)) for name, g in channel_groups(RIG).items()}
    with writing(path, RIG, channel_groups(RIG), {"made_by": "a test"}) as recording:
        for first in range(0, 12_000, 1000):
            for name, rows in values.items():
                recording.append(name, rows[:, first : first + 1000])
    return path, read(path)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=20)
@given(st.floats(0, 1), st.floats(0, 1, exclude_max=True), st.integers(0, 255))
def test_what_is_recovered_of_a_cut_and_flipped_file_is_true(small, tmp_path, fraction, place, change):
    path, complete = small
    content = bytearray(path.read_bytes())
    content[int(place * len(content))] ^= change
    bad, saved = tmp_path / "bad.mcap", tmp_path / "saved.mcap"
    bad.write_bytes(content[: int(fraction * len(content))])
    try:
        recover(bad, saved)
    except RigError:
        return
    check_prefix(read(saved), complete)


def test_a_sound_file_comes_back_whole_and_says_so(small, tmp_path):
    path, complete = small
    losses = recover(path, tmp_path / "saved.mcap")
    recovered = read(tmp_path / "saved.mcap")
    check_prefix(recovered, complete)
    assert recovered.samples == complete.samples
    assert all(loss.kept == loss.found == complete.samples for loss in losses)
    assert recovered.provenance["made_by"] == "a test"
    assert "recovered from r.mcap; force: 12000 samples kept (23.4375 s), 0 lost" in recovered.provenance["history 1"]


def chunk_places(content):
    """Start and stop of each chunk (opcode 6) of a file."""
    offset, places = 8, []
    while offset < len(content) - 8:
        stop = offset + 9 + int.from_bytes(content[offset + 1 : offset + 9], "little")
        if content[offset] == 6:
            places.append((offset, stop))
        offset = stop
    return places


@pytest.mark.parametrize("checksum", ["wrong", "none"])
def test_a_flipped_chunk_ends_what_is_recovered_and_what_lies_behind_is_counted_as_lost(small, tmp_path, checksum):
    path, complete = small
    content = bytearray(path.read_bytes())
    (start, stop), *_ = chunk_places(content)[2:]
    content[stop - 100] ^= 1
    if checksum == "none":  # as the format allows
        content[start + 33 : start + 37] = bytes(4)
    (tmp_path / "bad.mcap").write_bytes(content)
    losses = recover(tmp_path / "bad.mcap", tmp_path / "saved.mcap")
    check_prefix(read(tmp_path / "saved.mcap"), complete)
    assert all(0 < loss.kept < loss.found < complete.samples for loss in losses)


def test_blocks_that_claim_the_same_place_with_other_values_end_what_is_recovered(small, tmp_path):
    path, complete = small
    content = path.read_bytes()
    (start, stop), *_ = chunk_places(content)
    chunk = bytearray(content[start + 9 : stop])
    third = chunk.index(bytes(message_head(2048)))  # its number and its time become 0, which are the first block's
    assert chunk[third - 2 : third] == b"\x08\x04"  # seconds
    chunk[third - 1 : third + 3] = b"\x00\x10\x80\x00"
    chunk[24:28] = struct.pack("<I", zlib.crc32(chunk[40:]))
    (tmp_path / "bad.mcap").write_bytes(content[: start + 9] + chunk + content[stop : len(content) // 2])
    with pytest.raises(RigError, match="there is nothing to recover"):
        recover(tmp_path / "bad.mcap", tmp_path / "saved.mcap")
    assert complete.samples == 12_000


def message_head(first_sample):
    """Field 2 of a block, as protobuf writes it."""
    return bytes([2 << 3, first_sample & 0x7F | 0x80, first_sample >> 7])


def test_a_channel_that_a_flip_gave_another_number_is_not_believed(small, tmp_path):
    """No checksum guards the channels in front of the chunks; the first chunk repeats them."""
    path, _ = small
    content = bytearray(path.read_bytes())
    for record in range(2, 6, 2):  # the displacement's channel and the acceleration's get the force's number
        offset = [m.start() for m in re.finditer(rb"/rig/\w+/block", content)][record // 2] - 8
        content[offset : offset + 2] = struct.pack("<H", 1)
    (tmp_path / "bad.mcap").write_bytes(content[: len(content) // 2])
    with pytest.raises(RigError, match="channel 1 is described in two ways"):
        recover(tmp_path / "bad.mcap", tmp_path / "saved.mcap")


def test_what_cannot_be_recovered_is_refused(small, tmp_path):
    path, _ = small
    content = path.read_bytes()
    first_chunk = chunk_places(content)[0]
    bad = tmp_path / "bad.mcap"
    for text, sentence in (
        (b"", "is empty"),
        (b"no mcap at all", "is no MCAP file"),
        (content[:20], "has no attachment rig.json"),
        (content[: first_chunk[1] - 1], "holds no complete chunk of every group"),
    ):
        bad.write_bytes(text)
        with pytest.raises(RigError, match=sentence):
            recover(bad, tmp_path / "saved.mcap")
        assert not (tmp_path / "saved.mcap").exists()


def test_the_file_being_saved_is_never_written_over(small, tmp_path):
    part_path = tmp_path / "r.mcap.part"
    part_path.write_bytes(small[0].read_bytes())
    with pytest.raises(RigError, match="would be written over"):
        recover(part_path, tmp_path / "r.mcap")
    assert part_path.read_bytes() == small[0].read_bytes()


def test_the_command(small, tmp_path, capsys):
    cut, saved = tmp_path / "cut.mcap", tmp_path / "saved.mcap"
    content = small[0].read_bytes()
    cut.write_bytes(content[: len(content) // 2])

    def rig(*words):
        return exit_status("rig", *words), *capsys.readouterr()

    status, out, err = rig("recover", cut, "--out", saved)
    assert (status, err) == (0, "")
    samples = read(saved).samples
    assert f"force: {samples} samples kept" in out
    assert "besides what was never stored" in out
    assert rig("check", saved)[0] == 0
    status, out, err = rig("recover", cut, "--out", saved)
    assert (status, out) == (1, "")
    assert "exists already" in err
    status, out, _ = rig("recover", cut, "--out", saved, "--force", "--json")
    assert {group["kept"] for group in json.loads(out)["groups"]} == {samples}
