"""The floor: how far one more null may go."""

import numpy as np
import pytest

from identify.gap.floor import FALSE_ALARMS, limits_of


def test_one_more_null_seldom_exceeds_a_limit() -> None:
    rng = np.random.default_rng(5)
    exceeded = []
    for _ in range(2000):
        centre = rng.normal(size=(4, 1, 4))
        left = np.exp(centre + np.array([0.2, 0.3, 0.8, 0.15]) * rng.standard_normal((4, 7, 4)))
        limits = np.array(limits_of(left[:, :6]))
        exceeded.append(np.any(left[:, 6] > limits, axis=1))
    assert np.mean(exceeded) == pytest.approx(FALSE_ALARMS, abs=0.01)


def test_limits_keep_a_distance_from_nulls_that_are_all_alike() -> None:
    assert np.all(np.array(limits_of(np.ones((4, 6, 4)))) > 1.2)
