from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.errors import RigError
from rig.recording.assembly import SampleAssembly
from rig.recording.channels import Channels
from rig.recording.messages import Block

CHANNELS = Channels("acceleration", "m/s^2", ("a", "b"), (None, None), 10.0)
VALUES = np.random.default_rng(1).standard_normal((2, 60))


def blocks(values=VALUES, length=7, first=0):
    return [
        Block(10**8 * (first + k), first + k, 10.0, values[:, k : k + length])
        for k in range(0, values.shape[1], length)
    ]


def assembly(first=0, room=0):
    return SampleAssembly(Path("r.mcap"), "acceleration", CHANNELS, first, room)


@given(st.permutations(range(9)), st.sampled_from([0, 5, 60, 100]), st.sampled_from([0, 1000]))
def test_blocks_in_any_order_and_room_make_the_same_samples(order, room, first):
    pieces, held = blocks(first=first), assembly(first, room)
    for k in order:
        memory = pieces[k].values.copy()
        held.add(Block(pieces[k].time_ns, pieces[k].first_sample, 10.0, memory))
        memory[:] = np.nan  # the file's next record is read into the same memory
    start_s, values = held.finish()
    assert start_s == pytest.approx(first / 10.0)
    np.testing.assert_array_equal(values, VALUES)


@pytest.mark.parametrize(("missing", "sentence"), [(3, "samples 21 to 28 missing"), (0, "samples 0 to 7 missing")])
def test_a_gap_is_named(missing, sentence):
    held = assembly()
    for k, block in enumerate(blocks()):
        if k != missing:
            held.add(block)
    with pytest.raises(RigError, match=sentence):
        held.finish()


def test_a_value_that_is_not_finite_is_named_by_its_place_in_the_record():
    values = VALUES.copy()
    values[1, 30] = np.inf
    held = assembly(first=100)
    for block in blocks(values, first=100):
        held.add(block)
    with pytest.raises(RigError, match=r"channel 'b' is not a finite number at sample 130 \(13.0000 s\)"):
        held.finish()


def test_a_value_that_nothing_measures_is_named():
    held = assembly()
    for block in blocks(np.where(VALUES[1, 7] == VALUES, -2e30, VALUES)):
        held.add(block)
    with pytest.raises(RigError, match=r"channel 'b' is -2e\+30, which nothing measures, at sample 7 \(0.7000 s\)"):
        held.finish()


def test_values_that_are_only_too_large_together_are_kept():
    held = assembly()
    for block in blocks(np.full((2, 20), 1e30)):
        held.add(block)
    np.testing.assert_array_equal(held.finish()[1], np.full((2, 20), 1e30))
