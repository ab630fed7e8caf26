"""Sums over the samples of a free motion, against the samples themselves."""

import numpy as np
import pytest

from identify.linear.sampled_motion import Sampling, free_motion, sampled_accelerations
from identify.signals.kinematics import taper

RATE_HZ, SAMPLES, FADING, LENGTH = 256.0, 2048, 128, 4096


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(("natural_hz", "damping_ratio"), [(20.0, 0.01), (20.0, 0.0), (3.3, 0.7), (9.0, 1.0)])
def test_the_transform_is_that_of_the_samples(natural_hz, damping_ratio, order):
    """Also of an undamped mode on a line (20 Hz), where sums of powers are 0/0; the mean is left to other terms."""
    omega = 2 * np.pi * RATE_HZ / LENGTH * np.arange(LENGTH // 2 + 1)
    omega[0] = 0.01 * omega[1]
    window = taper(SAMPLES, FADING)
    window[0] = 0.5
    fading = int(np.count_nonzero(window[1:] < 1))
    by_state = sampled_accelerations(natural_hz, damping_ratio, Sampling(order, RATE_HZ, SAMPLES, fading, omega))
    time_s = np.arange(SAMPLES) / RATE_HZ
    for state, spectrum in enumerate(by_state):
        row = free_motion(natural_hz, damping_ratio, state, time_s)[order]
        expected = np.fft.rfft(row * window, LENGTH) * (1j * omega) ** (2 - order) / RATE_HZ
        assert np.linalg.norm(spectrum[1:] - expected[1:]) < 1e-5 * np.linalg.norm(expected[1:])
