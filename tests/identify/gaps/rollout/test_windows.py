"""Windows, horizons, and how far rigs with contacts are predicted from what accelerometers show."""

import numpy as np
import pytest

from identify.gaps.rollout.results import NullErrors
from identify.gaps.rollout.states import measured_motion
from identify.gaps.rollout.windows import (
    disjoint_starts,
    horizon_ladder,
    predictable_horizon_samples,
    prediction_errors,
    rms_by_window,
)
from rig.simulation import prediction
from tests.identify.gaps.rollout.conftest import BELIEVED, CLEARANCE, DAMPING

HORIZON = round(0.1 * BELIEVED.sample_rate_hz)


def null_errors_of(samples, errors):
    rows = tuple((error, error) for error in errors)
    return NullErrors(samples=samples, nominal=rows, within=rows)


def test_windows_are_disjoint_and_within():
    first = disjoint_starts(100, 10_000, 300, 20)
    assert first.size == 20
    assert first[0] == 100
    assert first[-1] + 300 <= 10_100
    assert np.all(np.diff(first) >= 300)
    assert disjoint_starts(0, 1000, 300, 20).size == 3


def test_horizons_grow_up_to_the_record():
    ladder = horizon_ladder(1000)
    assert ladder[0] == 16
    assert 1000 / np.sqrt(2) < ladder[-1] <= 1000
    assert np.all(np.diff(ladder) > 0)


def test_the_horizon_is_the_longest_that_the_median_null_is_predicted_over():
    nulls = [
        null_errors_of((16, 23, 32), (0.02, 0.05, 0.2)),
        null_errors_of((16, 23, 32), (0.02, 0.3, 0.4)),
        null_errors_of((16, 23), (0.01, 0.09)),
    ]
    assert predictable_horizon_samples(nulls) == 23
    assert predictable_horizon_samples([null_errors_of((16,), (0.3,))]) is None


def errors(case, rig, residual):
    motion = measured_motion(case.recording, rig, residual)
    starts = disjoint_starts(motion.first_sample, motion.stop_sample - motion.first_sample, HORIZON, 60)
    return prediction_errors(motion, prediction.modal, starts, HORIZON)


def test_a_right_rig_is_predicted_over_a_tenth_of_a_second(null):
    residual = null.fitted()
    assert np.median(rms_by_window(errors(null, residual.corrected_rig, residual))) < 0.12


@pytest.mark.parametrize(
    ("name", "effect"), [("wide_clearance", CLEARANCE), pytest.param("damped", DAMPING, marks=pytest.mark.study)]
)
def test_the_rig_with_the_effect_predicts_better_in_most_windows(name, effect, request):
    case = request.getfixturevalue(name)
    believed, corrected = case.fitted(), case.fitted(effect)
    before = rms_by_window(errors(case, BELIEVED, believed))
    after = rms_by_window(errors(case, corrected.corrected_rig, corrected))
    assert np.median(before) > 1.3 * np.median(after)
    assert np.mean(after < before) > 0.75


def test_a_motion_that_is_lost_counts_as_a_large_error(null):
    def lost(*_):
        return np.full((2, 2, 12, 40), np.nan)

    motion = measured_motion(null.recording, BELIEVED, null.fitted())
    assert np.all(prediction_errors(motion, lost, np.array([5000, 6000]), 40) == 1e3)
