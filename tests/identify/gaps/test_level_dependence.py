"""Records of several levels, of machines whose stiffness or damping follows the level or does not."""

from functools import reduce

import numpy as np
import pytest

from identify.gaps.decision.differences import _trend
from identify.gaps.decision.level_dependence import have_levels, level_dependence
from identify.gaps.results import Compared, LevelDependence
from identify.gaps.wording import level_words
from rig.effects import effect_named
from rig.model.unmeasured_force import Value
from rig.simulation.reference import Sdof

LEVELS_N = (30.0, 12.0, 61.0)


def compared(by_level):
    return Compared(
        parameter="linear_spring.stiffness_n_per_m",
        place="mass",
        values=tuple(Value(x, 0.1, "N/m") for x in (-20.0, -10.0, -40.0)),
        p_value=1e-6,
        trend="differs",
        by_level=by_level,
    )


@pytest.fixture(scope="module")
def rigs():
    """A mass whose spring loses stiffness and whose damping grows with the level."""
    texts = [
        (f"linear_spring:stiffness_n_per_m={k},body=mass", f"structural_damping:factor={c},body=mass")
        for k, c in ((-20, 1.3), (-10, 1.0), (-40, 1.9))
    ]
    return [reduce(lambda rig, t: effect_named(t).applied_to(rig), one, Sdof().rig()) for one in texts]


def test_a_mode_that_follows_the_level_is_told_from_the_lowest_to_the_highest(rigs):
    told = level_dependence(rigs, LEVELS_N, [compared("falls")], 100.0)
    lowest, highest = rigs[1].bodies[0], rigs[2].bodies[0]
    stiffness = [lowest.stiffness_n_per_m + k for k in (-10, -40)]
    assert (told.lowest_n, told.highest_n) == (12.0, 61.0)
    assert told.frequency_change == pytest.approx(np.sqrt(stiffness[1] / stiffness[0]) - 1, rel=1e-6)
    ratio = np.sqrt(stiffness[0] / stiffness[1]) if highest.damping_n_s_per_m != lowest.damping_n_s_per_m else 1.0
    assert told.damping_change == pytest.approx(1.9 * ratio - 1, rel=0.05)
    words = level_words(told)
    assert words.startswith("The machine softens with the motion")
    assert "from 12 to 61 N rms" in words


@pytest.mark.parametrize("trend", ["differs", "none"])
def test_what_does_not_follow_the_level_is_not_told_as_its(rigs, trend):
    assert level_dependence(rigs, LEVELS_N, [compared("falls"), compared(trend)], 100.0) is None
    assert level_dependence(rigs, LEVELS_N, [], 100.0) is None


def test_forces_within_a_quarter_are_one_level():
    assert have_levels(LEVELS_N)
    assert not have_levels((12.0, 13.0, 14.0))
    assert not have_levels((0.0, 13.0))


def test_a_trend_is_one_of_the_levels_in_their_order():
    values, covariance = np.array([-20.0, -10.0, -40.0]), 0.01 * np.eye(3)
    order = np.argsort(LEVELS_N)
    assert _trend(values, covariance) == "differs"
    assert _trend(values[order], covariance) == "falls"


@pytest.mark.parametrize(
    ("shift", "damping", "kind", "cause"),
    [
        (-0.013, 0.9, "softens", "friction or clearance"),
        (0.02, 0.1, "stiffens", "a hardening spring"),
        (0.0, 0.9, "is damped more", "friction or clearance"),
        (0.0, -0.3, "is damped less", "friction or clearance"),
    ],
)
def test_the_words_are_those_of_the_changes(shift, damping, kind, cause):
    told = LevelDependence(
        lowest_n=12.0, highest_n=61.0, body="wing", frequency_hz=7.3, frequency_change=shift, damping_change=damping
    )
    words = level_words(told)
    assert words.startswith(f"The machine {kind} with the motion: from 12 to 61 N rms")
    assert cause in words
