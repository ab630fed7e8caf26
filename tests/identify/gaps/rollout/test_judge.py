"""Vetoes: of wrong corrections, of none that is right, and how often by chance."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.rollout.judge import (
    Paired,
    confirmed,
    falls_short,
    judged,
    paired_blocks,
    shrunk,
    standard_error,
    veto,
)
from identify.gaps.rollout.results import NullErrors, Rollout
from rig.errors import RigError
from rig.simulation import prediction
from tests.identify.gaps.rollout.conftest import BELIEVED, CLEARANCE, DAMPING, FRICTION


def test_a_right_correction_shrinks_the_gap_and_is_not_vetoed(damped, nulls):
    told = judged(damped.recording, damped.fitted(), damped.fitted(DAMPING), nulls, prediction.modal)
    assert told.code == "not_vetoed"
    assert not told.whole.at_floor
    assert 0.7 < told.whole.shrunk <= 1
    assert told.shrunk_95[0] < told.whole.shrunk <= told.shrunk_95[1] + 1e-9
    assert told.log_ratio < -3 * told.log_ratio_error
    assert set(told.by_sensor) == {s.name for s in BELIEVED.sensors}
    assert 0.05 < told.horizon_s < 0.2


def test_a_clearance_that_tolerances_take_up_is_a_gap_of_the_rig_as_it_stands(wide_clearance, nulls):
    told = judged(
        wide_clearance.recording, wide_clearance.fitted(), wide_clearance.fitted(CLEARANCE), nulls, prediction.modal
    )
    assert told.code == "not_vetoed"
    assert told.whole.nominal > 1.5 * told.within
    assert told.whole.shrunk > 0.7


def test_a_null_is_at_the_floor_and_not_vetoed(null, nulls):
    told = judged(null.recording, null.fitted(), null.fitted(), nulls, prediction.modal)
    assert told.code == "not_vetoed"
    assert told.whole.at_floor
    assert told.shrunk_95 is None
    assert told.log_ratio == 0.0


@pytest.mark.parametrize("wrong", [FRICTION, "added_mass:mass_kg=0.2,relative_position=0.8,body=barrel"])
def test_a_wrong_correction_is_vetoed(null, nulls, wrong):
    told = judged(null.recording, null.fitted(), null.fitted(wrong), nulls, prediction.modal)
    assert told.code == "worse"
    assert told.vetoed


def test_without_a_horizon_or_a_predictor_nothing_is_judged(null, nulls):
    at = null.fitted()
    hopeless = NullErrors(samples=(16,), nominal=((0.5,),), within=((0.5,),))
    assert judged(null.recording, at, at, [hopeless], prediction.modal).code == "no_horizon"

    def refusing(*_):
        raise RigError("no")

    told = judged(null.recording, at, at, nulls, refusing)
    assert (told.code, told.vetoed, told.windows) == ("not_simulated", False, 0)


def test_vetoes_by_chance_are_as_rare_as_stated():
    rng = np.random.default_rng(1)
    codes = [veto(Paired(0.3 * rng.standard_normal(25), np.full(25, -1e-3))) for _ in range(4000)]
    assert 0.006 < np.mean([code == "worse" for code in codes]) < 0.014  # 1 %, three standard errors


def test_neighbouring_blocks_that_resemble_each_other_count_for_fewer():
    rng = np.random.default_rng(2)
    means, errors = [], []
    for _ in range(2000):
        noise = rng.standard_normal(60)
        row = np.empty(60)
        row[0] = noise[0] / np.sqrt(1 - 0.25)
        for k in range(1, 60):
            row[k] = 0.5 * row[k - 1] + noise[k]
        means.append(row.mean())
        errors.append(standard_error(row))
    assert np.mean(errors) == pytest.approx(np.std(means), rel=0.12)


def paired_errors():
    """Errors e of the rig to come, and a change D that has nothing to do with them."""
    rng = np.random.default_rng(3)
    first = np.arange(0, 24_000, 200)
    return first, *(0.1 * rng.standard_normal((2, first.size, 4, 200)))


def test_errors_of_a_right_correction_fall_as_expected():
    first, e, change = paired_errors()
    right = paired_blocks(e - change, e, first, 1000.0)
    assert right.log_ratios.mean() == pytest.approx(right.expected.mean(), rel=0.05)
    assert right.expected.mean() == pytest.approx(-np.log(2) / 2, rel=0.05)
    assert veto(right) == "not_vetoed"
    assert not falls_short(right)
    assert veto(paired_blocks(e, e - change, first, 1000.0)) == "worse"


def test_a_correction_that_changes_much_and_gains_nothing_falls_short():
    first, e, change = paired_errors()
    half = paired_blocks(e - change / 2, e + change / 2, first, 1000.0)
    assert half.log_ratios.mean() == pytest.approx(0.0, abs=0.02)
    assert veto(half) == "not_vetoed"
    assert falls_short(half)


@pytest.mark.parametrize(
    ("simulated", "code"),
    [
        ((-0.5, -0.55, -0.48, -0.52), "no_improvement"),
        ((-0.5, 0.1, -0.4, -0.02), "not_vetoed"),  # some such machines gain nothing either
        ((-0.01, -0.011, -0.012, -0.01), "not_vetoed"),  # what nobody could see
        ((-0.5, -0.55), "not_vetoed"),  # too few
    ],
)
def test_simulations_decide_whether_prediction_had_to_improve(simulated, code):
    told = Rollout(code="not_vetoed", log_ratio=-0.01, log_ratio_error=0.02, falls_short=True)
    assert confirmed(told, simulated).code == code
    assert confirmed(replace(told, falls_short=False), simulated).code == "not_vetoed"


def test_long_windows_are_cut_into_blocks():
    errors = np.ones((1, 2, 5000))
    errors[:, :, 2000:3000] = 2.0
    paired = paired_blocks(np.ones((1, 2, 5000)), errors, np.array([0]), 1000.0)
    np.testing.assert_allclose(paired.log_ratios, np.log([1, 1, 2, 1, 1]), atol=1e-9)


@pytest.mark.parametrize(("corrected", "share"), [(0.1, 1.0), (0.3, 0.0), (0.2, (9 - 4) / (9 - 1)), (0.05, 1.0)])
def test_how_far_a_gap_shrinks(corrected, share):
    assert shrunk(0.3, corrected, 0.1) == pytest.approx(share)
