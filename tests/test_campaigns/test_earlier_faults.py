"""The machines that were once answered wrongly: each can be built, and differs from its rig.json as its row says."""

import numpy as np
import pytest
from msgspec.structs import replace

from tests.campaigns.earlier_faults import ROWS, machine_of
from tests.campaigns.worlds.instruments import Measured

UNCHANGED = ("carriage", "clipped", "mostly_open")


@pytest.mark.parametrize("name", ROWS)
def test_every_row_is_a_machine_that_differs_as_it_says(name):
    row = ROWS[name]
    rig, true, excitations = machine_of(row, np.random.default_rng(3))
    nothing = type(row)(row.description, row.machine, level_n=row.level_n)
    same_rig, as_built, same_excitations = machine_of(nothing, np.random.default_rng(3))
    assert rig == same_rig
    assert excitations == same_excitations
    assert (true == as_built) is (name in UNCHANGED)
    assert [s.name for s in true.sensors] == [s.name for s in rig.sensors]


def test_a_softer_storey_is_one_spring_of_one_frame():
    softer, as_built = (
        machine_of(row, np.random.default_rng(3))[1] for row in (ROWS["storey"], type(ROWS["storey"])("", "frame"))
    )
    (one,), (other,) = softer.lumped, as_built.lumped
    np.testing.assert_allclose(np.divide(one.between_n_per_m, other.between_n_per_m), [1.0, 0.95, 1.0])
    assert replace(one, between_n_per_m=other.between_n_per_m) == other


def test_a_clipped_channel_stays_within_its_limit():
    delivered = np.random.default_rng(1).standard_normal((5, 200))
    spoilt = ROWS["clipped"].alter_record(Measured(np.zeros(200), delivered, {}))
    changed = np.any(spoilt.delivered != delivered, axis=1)
    assert changed.tolist() == [False, False, False, True, False]
    assert np.abs(spoilt.delivered[3]).max() == pytest.approx(0.6 * np.abs(delivered[3]).max())
