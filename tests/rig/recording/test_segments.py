"""A recording read segment by segment."""

import tracemalloc

import numpy as np
import pytest

from rig.errors import RigError
from rig.recording import channel_groups, container, read, writing
from rig.recording.segments import segments
from rig.simulation.reference import Sdof

RIG = Sdof().rig()
RATE_HZ = RIG.sample_rate_hz
SAMPLES = 400_000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("segments") / "long.mcap"
    rng = np.random.default_rng(1)
    with writing(path, RIG, channel_groups(RIG), {"made_by": "a test"}) as recording:
        for first in range(0, SAMPLES, 3000):
            for name, channels in channel_groups(RIG).items():
                recording.append(name, rng.standard_normal((len(channels.names), min(3000, SAMPLES - first))))
    return path


@pytest.mark.parametrize(("length_s", "overlap_s"), [(20.0, 0.0), (20.0, 5.0), (31.7, 12.0), (1e4, 1.0)])
def test_the_segments_are_what_is_in_the_file(path, length_s, overlap_s):
    recording = read(path)
    start, pieces = 0, list(segments(path, length_s, overlap_s))
    for piece in pieces:
        assert piece.rig == recording.rig
        assert piece.start_s == start / RATE_HZ
        for name, signals in piece.signals.items():
            expected = recording.signals[name].values[:, start : start + piece.samples]
            np.testing.assert_array_equal(signals.values, expected)
        start += piece.samples - round(overlap_s * RATE_HZ)
    assert pieces[-1].end_s == recording.duration_s
    assert {p.samples for p in pieces[:-1]} <= {round(length_s * RATE_HZ)}
    if len(pieces) > 1:
        assert length_s / 2 < pieces[-1].duration_s < 1.5 * length_s


def test_no_more_is_held_than_a_segment(path, monkeypatch):
    monkeypatch.setattr(container, "_WINDOW_BYTES", 1 << 19)
    tracemalloc.start()
    for _ in segments(path, 10.0, 2.0):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.4 * path.stat().st_size


def test_a_file_that_is_cut_off_says_so_where_it_ends(path, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    pieces = []
    with pytest.raises(RigError, match=f"{cut}: is cut off or damaged"):
        pieces.extend(segments(cut, 20.0, 0.0))


def test_a_file_without_a_force_is_refused(tmp_path):
    path = tmp_path / "no_force.mcap"
    groups = {name: g for name, g in channel_groups(RIG).items() if name != "force"}
    with writing(path, RIG, groups, {}) as recording:
        for name, channels in groups.items():
            recording.append(name, np.zeros((len(channels.names), 5000)))
    with pytest.raises(RigError, match="no channel /rig/force/block"):
        next(segments(path, 2.0, 0.0))
