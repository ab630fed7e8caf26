"""Vetoes: of wrong corrections, of none that is right, and how often by chance."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.rollout.judge import (
    BlockLogRatios,
    compared_modes,
    error_log_ratios_by_block,
    falls_short,
    judge_correction,
    removed_mismatch_share,
    standard_error_of_mean,
    veto_code,
    with_simulation_veto,
)
from identify.gaps.rollout.results import NullErrors, Rollout
from identify.signals.ringing import RingingMode, modes_of_decay
from rig.errors import RigError
from rig.simulation import prediction
from tests.identify.gaps.rollout.conftest import BELIEVED, CLEARANCE, DAMPING, FRICTION

pytestmark = pytest.mark.long

MODES = ((8.4, 0.01, 1.0), (52.3, 0.004, 0.5), (146.0, 0.02, 0.3))


@pytest.mark.study
def test_a_right_correction_shrinks_the_gap_and_is_not_vetoed(damped, nulls):
    rollout = damped.judged(nulls, DAMPING)
    assert rollout.code == "not_vetoed"
    assert not rollout.whole.is_within_null_errors
    assert 0.7 < rollout.whole.shrunk <= 1
    assert rollout.shrunk_95[0] < rollout.whole.shrunk <= rollout.shrunk_95[1] + 1e-9
    assert rollout.log_ratio < -3 * rollout.log_ratio_error
    assert set(rollout.by_sensor) == {s.name for s in BELIEVED.sensors}
    assert 0.05 < rollout.horizon_s < 0.2


def test_a_clearance_that_tolerances_take_up_is_a_gap_of_the_rig_as_it_stands(wide_clearance, nulls):
    rollout = wide_clearance.judged(nulls, CLEARANCE)
    assert rollout.code == "not_vetoed"
    assert rollout.whole.nominal > 1.5 * rollout.within
    assert rollout.whole.shrunk > 0.7


def test_a_null_is_at_the_floor_and_not_vetoed(null, nulls):
    rollout = null.judged(nulls)
    assert rollout.code == "not_vetoed"
    assert rollout.whole.is_within_null_errors
    assert rollout.shrunk_95 is None
    assert rollout.log_ratio == 0.0


@pytest.mark.parametrize(
    "wrong",
    [pytest.param(FRICTION, marks=pytest.mark.study), "added_mass:mass_kg=0.2,relative_position=0.8,body=barrel"],
)
def test_a_wrong_correction_is_vetoed(null, nulls, wrong):
    rollout = null.judged(nulls, wrong)
    assert rollout.code == "worse"
    assert rollout.vetoed


def test_without_a_horizon_or_a_predictor_nothing_is_judged(null, nulls):
    residual = null.fitted()
    hopeless = NullErrors(samples=(16,), nominal=((0.5,),), within=((0.5,),))
    assert judge_correction(null.recording, residual, residual, [hopeless], prediction.modal).code == "no_horizon"

    def refusing(*_):
        raise RigError("no")

    rollout = judge_correction(null.recording, residual, residual, nulls, refusing)
    assert (rollout.code, rollout.vetoed, rollout.windows) == ("not_simulated", False, 0)


def test_vetoes_by_chance_are_as_rare_as_stated():
    rng = np.random.default_rng(1)
    codes = [veto_code(BlockLogRatios(0.3 * rng.standard_normal(25), np.full(25, -1e-3))) for _ in range(4000)]
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
        errors.append(standard_error_of_mean(row))
    assert np.mean(errors) == pytest.approx(np.std(means), rel=0.12)


def paired_errors():
    """Errors e of the rig to come, and a change D that has nothing to do with them."""
    rng = np.random.default_rng(3)
    first = np.arange(0, 24_000, 200)
    return first, *(0.1 * rng.standard_normal((2, first.size, 4, 200)))


def test_errors_of_a_right_correction_fall_as_expected():
    first, e, change = paired_errors()
    right = error_log_ratios_by_block(e - change, e, first, 1000.0)
    assert right.log_ratios.mean() == pytest.approx(right.expected_log_ratios.mean(), rel=0.05)
    assert right.expected_log_ratios.mean() == pytest.approx(-np.log(2) / 2, rel=0.05)
    assert veto_code(right) == "not_vetoed"
    assert not falls_short(right)
    assert veto_code(error_log_ratios_by_block(e, e - change, first, 1000.0)) == "worse"


def test_a_correction_that_changes_much_and_gains_nothing_falls_short():
    first, e, change = paired_errors()
    half = error_log_ratios_by_block(e - change / 2, e + change / 2, first, 1000.0)
    assert half.log_ratios.mean() == pytest.approx(0.0, abs=0.02)
    assert veto_code(half) == "not_vetoed"
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
    rollout = Rollout(code="not_vetoed", log_ratio=-0.01, log_ratio_error=0.02, falls_short=True)
    assert with_simulation_veto(rollout, simulated).code == code
    assert with_simulation_veto(replace(rollout, falls_short=False), simulated).code == "not_vetoed"


def test_long_windows_are_cut_into_blocks():
    errors = np.ones((1, 2, 5000))
    errors[:, :, 2000:3000] = 2.0
    paired = error_log_ratios_by_block(np.ones((1, 2, 5000)), errors, np.array([0]), 1000.0)
    np.testing.assert_allclose(paired.log_ratios, np.log([1, 1, 2, 1, 1]), atol=1e-9)


@pytest.mark.parametrize(("corrected", "share"), [(0.1, 1.0), (0.3, 0.0), (0.2, (9 - 4) / (9 - 1)), (0.05, 1.0)])
def test_how_far_a_gap_shrinks(corrected, share):
    assert removed_mismatch_share(0.3, corrected, 0.1) == pytest.approx(share)


@pytest.fixture
def decay():
    rng, time_s = np.random.default_rng(1), np.arange(8192) / 2048
    rows = np.zeros((5, time_s.size))
    for hz, zeta, size in MODES:
        pole = 2 * np.pi * hz * (-zeta + 1j * np.sqrt(1 - zeta**2))
        rows += size * np.outer(rng.standard_normal(5), (np.exp(pole * time_s) * np.exp(1j * rng.uniform(0, 6))).real)
    return rows + 1e-4 * rng.standard_normal(rows.shape)


def test_every_mode_is_found(decay):
    modes = modes_of_decay(decay, 2048.0, 200.0, 6)
    assert len(modes) == 3
    for mode, (hz, zeta, _) in zip(modes, MODES, strict=True):
        assert mode.frequency_hz == pytest.approx(hz, rel=1e-4)
        assert mode.damping_ratio == pytest.approx(zeta, rel=0.01)


def test_nothing_rings_in_silence_or_in_noise():
    assert modes_of_decay(np.zeros((3, 4000)), 2048.0, 200.0, 6) == []
    noise = np.random.default_rng(1).standard_normal((3, 4000))
    assert all(
        mode.damping_ratio > 0.001 or mode.energy_share < 0.05 for mode in modes_of_decay(noise, 2048.0, 200.0, 3)
    )


def test_modes_are_compared_with_the_nearest_and_missed_ones_named():
    measured = [RingingMode(10.0, 0.01, 0.5), RingingMode(50.0, 0.02, 0.5)]
    first, second = compared_modes(
        measured, [RingingMode(11.0, 0.03, 1.0)], [RingingMode(49.0, 0.01, 0.5), RingingMode(10.1, 0.01, 0.5)]
    )
    assert (first.nominal, first.corrected) == ((11.0, 0.03), (10.1, 0.01))
    assert (second.nominal, second.corrected) == (None, (49.0, 0.01))
