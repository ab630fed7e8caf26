"""Friction behind a backlash: its loop in closed form, and its numbers found again."""

import numpy as np
import pytest

from identify.laws import SLIDING, identify_law
from identify.laws.piecewise import Sampled
from identify.laws.sliding import SlidingFriction, sliding_friction
from identify.signals.spectra import decimated
from tests.identify.laws.test_identification import SECONDS, gap, mass_with, motion_m

LAW = SlidingFriction(upper_n=9.0, lower_n=6.0, backlash_m=1.2e-3, stiffness_n_per_m=2e4)
NAMES = ("upper_n", "lower_n", "backlash_m", "stiffness_n_per_m")


def test_the_loop_of_a_triangular_motion_has_its_corners_where_they_belong():
    """After a reversal: unloaded over F/k, nothing over the backlash, loaded over F/k of the other way, sliding."""
    amplitude = 3e-3
    eta = np.interp(np.arange(40001), [0, 10000, 20000, 30000, 40000], amplitude * np.array([-1, 1, -1, 1, -1]))
    force = LAW(eta)
    rising, falling = slice(20000, 30001), slice(30000, 40001)
    k, b = LAW.stiffness_n_per_m, LAW.backlash_m
    up = np.cumsum([-amplitude, LAW.lower_n / k, b, LAW.upper_n / k])
    assert np.allclose(force[rising], np.interp(eta[rising], up, [-LAW.lower_n, 0, 0, LAW.upper_n]), atol=1e-9)
    down = np.cumsum([amplitude, -LAW.upper_n / k, -b, -LAW.lower_n / k])
    expected = np.interp(-eta[falling], -down, [LAW.upper_n, 0, 0, -LAW.lower_n])
    assert np.allclose(force[falling], expected, atol=1e-9)


def test_without_sliding_it_is_a_dead_zone():
    eta = motion_m(np.arange(8192) / 512)[0]
    held = SlidingFriction(upper_n=1e9, lower_n=1e9, backlash_m=1.6e-3, stiffness_n_per_m=1e4)
    expected = 1e4 * np.sign(eta) * np.maximum(np.abs(eta - eta[0]) - 0.8e-3, 0)
    start = np.abs(eta - eta[0]) < 5e-4
    assert np.allclose(held(eta)[start], expected[start])
    assert np.allclose(held(eta), 1e4 * ((eta - eta[0]) - np.clip(eta - eta[0], -0.8e-3, 0.8e-3)))


def test_its_standard_errors_are_those_of_the_noise():
    scores = []
    fine = 16
    eta = motion_m(np.arange(24 * fine * 4096) / (fine * 4096))[0]
    clean = decimated(LAW(eta), fine * 16)
    for seed in range(4):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(clean.size)
        found = sliding_friction(Sampled(eta[::fine], clean + noise, 4096.0, 16), slice(64, -64))
        scores += [(getattr(found, n) - getattr(LAW, n)) / e for n, e in zip(NAMES, found.errors, strict=True)]
    assert 0.5 < np.std(scores) < 1.7


def test_identify_law_names_it_with_intervals():
    law = identify_law(mass_with(LAW), seconds=SECONDS).report.laws[0]
    assert law.best == SLIDING
    assert law.verdict.startswith("friction behind a backlash: it slides at ")
    for name in NAMES:
        assert getattr(law.sliding, name).value == pytest.approx(getattr(LAW, name), rel=5e-3)
    best = next(c.held_out_error_n for c in law.candidates if c.law == SLIDING)
    assert best < 0.1 * min(c.held_out_error_n for c in law.candidates if c.law != SLIDING)


def test_a_dead_zone_is_not_taken_for_it():
    law = identify_law(mass_with(gap), seconds=SECONDS).report.laws[0]
    assert law.sliding is None
    assert law.verdict.startswith("dead zone")
