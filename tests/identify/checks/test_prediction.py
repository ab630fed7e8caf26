"""Duration of the motion in a record."""

import numpy as np
import pytest

from identify.checks.prediction import effective_motion_duration_s

PER_S = 200.0


@pytest.mark.parametrize(("moves_s", "lasts_s"), [(20.0, 20.0), (10.0, 20.0), (5.0, 10.0)])
def test_motion_over_less_than_half_of_a_record_counts_for_twice_as_long(moves_s, lasts_s):
    time_s = np.arange(20 * PER_S) / PER_S
    moving = np.random.default_rng(1).standard_normal((3, time_s.size)) * (time_s < moves_s)
    assert effective_motion_duration_s(moving, PER_S) == pytest.approx(lasts_s, rel=0.1)


def test_a_decay_lasts_as_long_as_its_power_says():
    """Of a power exp(-t / tau), (integral of p)^2 / integral of p^2 = 2 tau; tau is half that of the motion."""
    time_s = np.arange(100 * PER_S) / PER_S
    moving = np.exp(-time_s / 8.0)[None] * np.random.default_rng(2).standard_normal((20, time_s.size))
    assert effective_motion_duration_s(moving, PER_S) == pytest.approx(2 * 2 * 4.0, rel=0.1)
