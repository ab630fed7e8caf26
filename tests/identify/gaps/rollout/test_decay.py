"""Modes of decays against the frequencies and damping ratios that made them."""

import numpy as np
import pytest

from identify.gaps.rollout.decay import compared_modes
from identify.signals.ringing import RingingMode, modes_of_decay

MODES = ((8.4, 0.01, 1.0), (52.3, 0.004, 0.5), (146.0, 0.02, 0.3))


@pytest.fixture
def decay():
    rng, time_s = np.random.default_rng(1), np.arange(8192) / 2048
    rows = np.zeros((5, time_s.size))
    for hz, zeta, size in MODES:
        pole = 2 * np.pi * hz * (-zeta + 1j * np.sqrt(1 - zeta**2))
        rows += size * np.outer(rng.standard_normal(5), (np.exp(pole * time_s) * np.exp(1j * rng.uniform(0, 6))).real)
    return rows + 1e-4 * rng.standard_normal(rows.shape)


def test_every_mode_is_found(decay):
    found = modes_of_decay(decay, 2048.0, 200.0, 6)
    assert len(found) == 3
    for mode, (hz, zeta, _) in zip(found, MODES, strict=True):
        assert mode.frequency_hz == pytest.approx(hz, rel=1e-4)
        assert mode.damping_ratio == pytest.approx(zeta, rel=0.01)


def test_nothing_rings_in_silence_or_in_noise():
    assert modes_of_decay(np.zeros((3, 4000)), 2048.0, 200.0, 6) == []
    noise = np.random.default_rng(1).standard_normal((3, 4000))
    assert all(mode.damping_ratio > 0.001 or mode.share < 0.05 for mode in modes_of_decay(noise, 2048.0, 200.0, 3))


def test_modes_are_compared_with_the_nearest_and_missed_ones_named():
    measured = [RingingMode(10.0, 0.01, 0.5), RingingMode(50.0, 0.02, 0.5)]
    first, second = compared_modes(
        measured, [RingingMode(11.0, 0.03, 1.0)], [RingingMode(49.0, 0.01, 0.5), RingingMode(10.1, 0.01, 0.5)]
    )
    assert (first.nominal, first.corrected) == ((11.0, 0.03), (10.1, 0.01))
    assert (second.nominal, second.corrected) == (None, (49.0, 0.01))
