"""The noise that a record itself tells, whatever its description states."""

import numpy as np
import pytest

from identify.signals.noise import heard_density, least_density

RATE_HZ = 2048.0


def ringing(duration_s):
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    modes = ((1e-3, 0.6, 30.0), (2e-4, 3.0, 190.0))
    return sum(size * np.exp(-rate * time_s) * np.sin(2 * np.pi * hz * time_s) for size, rate, hz in modes)


@pytest.mark.parametrize("duration_s", [1.0, 4.0, 20.0])
@pytest.mark.parametrize("density", [5e-8, 1e-6])
def test_the_noise_beside_a_decay_is_heard(duration_s, density):
    signal = ringing(duration_s)
    rng = np.random.default_rng(402)
    noise = density * np.sqrt(RATE_HZ / 2) * rng.standard_normal(signal.size)
    assert heard_density(signal + noise, RATE_HZ)[0] == pytest.approx(
        density, rel=0.15
    )  # three of its deviations in the shortest record


def test_motion_alone_is_not_surely_noise():
    assert not heard_density(ringing(4.0), RATE_HZ)[1]
    walk = np.cumsum(np.random.default_rng(403).standard_normal(20_000))
    assert not heard_density(walk, RATE_HZ)[1]


def test_no_channel_shows_less_than_24_bits():
    assert least_density(np.array([2.0, -1.0]), 200.0) == pytest.approx(2e-7 / 10)
