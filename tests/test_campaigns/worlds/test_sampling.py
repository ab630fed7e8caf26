"""The anti-aliasing filter and a channel's own delay."""

import numpy as np
import pytest

from tests.campaigns.worlds.sampling import HALF, PASS, STOP, Mounting, Sampler, taps

FACTOR = 16


def sampled(values, delays, pieces):
    sampler = Sampler(FACTOR, np.array(delays))
    for part in np.array_split(values, pieces, axis=1):
        sampler.add(part)
    return sampler.reach, sampler.samples()


def test_the_band_passes_and_what_would_alias_does_not():
    row = taps(FACTOR, 0.0, int(HALF * FACTOR) + 3)
    response = np.abs(np.fft.rfft(row, 2**18))
    share = np.fft.rfftfreq(2**18) * FACTOR
    assert np.abs(response[share <= PASS] - 1).max() < 1e-4
    assert response[share >= STOP].max() < 1e-4


@pytest.mark.parametrize("pieces", [1, 7, 90])
@pytest.mark.parametrize("delay", [0.0, 37.0, -20.3, 0.41])
def test_a_sine_comes_out_at_its_time_with_its_delay(pieces, delay):
    share = 0.3
    turns = 2 * np.pi * share / FACTOR * np.arange(6000)
    reach, found = sampled(np.array([np.sin(turns), np.cos(turns)]), [delay, 0.0], pieces)
    late = 2 * np.pi * share / FACTOR * (reach + FACTOR * np.arange(found.shape[1]))
    np.testing.assert_allclose(found[0], np.sin(late - 2 * np.pi * share / FACTOR * delay), atol=1.5e-4)
    np.testing.assert_allclose(found[1], np.cos(late), atol=1e-4)


def test_a_mounting_resonates_at_its_frequency():
    """The gain of (2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2): sqrt(1 + 4 zeta^2) / (2 zeta) at w, 1 far below."""
    step_s, zeta = 2.0**-14, 0.05
    time_s = np.arange(2**15) * step_s
    for hertz, gain in ((100.0, np.sqrt(1 + 4 * zeta**2) / (2 * zeta)), (2.0, 1.0)):
        mounting = Mounting(100.0, zeta, step_s)
        motion = np.sin(2 * np.pi * hertz * time_s)
        followed = np.concatenate([mounting.follow(part) for part in np.split(motion, 8)])
        assert np.abs(followed[2**14 :]).max() == pytest.approx(gain, rel=0.01)
