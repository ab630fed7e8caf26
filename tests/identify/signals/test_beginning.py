"""Whether a record begins at rest, and what leads in one that does not."""

import numpy as np

from identify.signals.beginning import excitation_start, force_onset, lead_in

RATE_HZ = 1000.0


def noisy(samples, start, noise, size, seed=0):
    rng = np.random.default_rng(seed)
    return noise * rng.standard_normal(samples) + size * rng.standard_normal(samples) * (np.arange(samples) >= start)


def test_the_first_sample_of_the_force_is_found():
    assert abs(force_onset(noisy(5000, 1200, 0.01, 5.0), RATE_HZ) - 1200) <= 2
    assert force_onset(noisy(5000, 0, 0.01, 5.0), RATE_HZ) == 0


def test_a_rig_that_moves_before_its_force_is_not_at_rest():
    force = noisy(5000, 1200, 0.01, 5.0)
    still, moving = noisy(5000, 1200, 1e-4, 1.0, seed=1), np.sin(2 * np.pi * 40 * np.arange(5000) / RATE_HZ)
    assert excitation_start(force, [still], RATE_HZ) == force_onset(force, RATE_HZ)
    assert excitation_start(force, [still, moving], RATE_HZ) == 0


def test_noise_of_a_sensor_that_hardly_moves_is_no_motion():
    force = noisy(5000, 1200, 0.01, 5.0)
    assert excitation_start(force, [noisy(5000, 1200, 0.05, 1.0, seed=1)], RATE_HZ) == force_onset(force, RATE_HZ)


def test_a_lead_in_keeps_value_and_slope():
    time_s = np.arange(2000) / RATE_HZ
    signal = 3.0 + 2.0 * time_s + np.sin(2 * np.pi * time_s)
    joined = np.concatenate([lead_in(signal, 500), signal])
    before = 2 * signal[0] - signal[500:0:-1]
    np.testing.assert_allclose(joined[450:500], before[450:], rtol=5e-2)
    assert abs(joined[0]) < 1e-2
    slope = np.diff(joined) * RATE_HZ
    np.testing.assert_allclose(slope[498:502], 2.0 + 2 * np.pi, rtol=2e-2)
