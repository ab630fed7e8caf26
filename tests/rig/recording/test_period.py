"""A force that repeats."""

import numpy as np

from rig.recording.period import force_period_samples


def test_the_period_of_a_force_is_found_and_that_of_noise_is_not():
    rng = np.random.default_rng(5)
    period = rng.standard_normal(700)
    assert force_period_samples(np.tile(period, 5) + 0.01 * rng.standard_normal(3500)) == 700
    assert force_period_samples(np.tile(period, 2)) == 700
    assert force_period_samples(np.tile(period, 2)[:1300]) is None, "shorter than two periods"
    assert force_period_samples(rng.standard_normal(6000)) is None
    band = np.fft.irfft(np.exp(2j * np.pi * rng.random(3001)) * (np.arange(3001) < 300), 6000)
    assert force_period_samples(band) is None
    assert force_period_samples(np.zeros(100)) is None
