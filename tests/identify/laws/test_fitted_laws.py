"""Laws fitted under a low-pass: straight pieces, and friction behind a backlash with its loop in closed form."""

import numpy as np
import pytest

from identify.laws import SLIDING, identify_law
from identify.laws.fitted_laws import (
    BacklashFriction,
    ForceSamples,
    fitted_backlash_friction,
    fitted_piecewise_linear,
    force_without_low_pass,
    law_knees_m,
)
from identify.signals.spectra import at_force_rate, decimated
from tests.identify.laws.test_identification import LOWER_M, SECONDS, STIFFNESS, UPPER_M, gap, mass_with, motion_m

LAW = BacklashFriction(upper_n=9.0, lower_n=6.0, backlash_m=1.2e-3, stiffness_n_per_m=2e4)
NAMES = ("upper_n", "lower_n", "backlash_m", "stiffness_n_per_m")


def observed(law, noise_n=0.0, rate_hz=256, seed=0):
    """A law's force for 40 s, low-passed from 65536 Hz as separated forces are."""
    fine, factor = 16, 4096 // rate_hz
    eta = motion_m(np.arange(40 * fine * 4096) / (fine * 4096))[0]
    force = at_force_rate(decimated(law(eta), fine), factor)
    return ForceSamples(
        eta[::fine], force + noise_n * np.random.default_rng(seed).standard_normal(force.size), 4096.0, factor
    )


INNER = slice(64, -64)


def test_straight_pieces_are_found_from_too_many_knees_in_the_wrong_places():
    samples = observed(gap)
    law = fitted_piecewise_linear(samples, INNER, np.array([-2e-3, -0.3e-3, 0.3e-3, 2e-3]))
    assert np.allclose(law.knees_m, [-LOWER_M, UPPER_M], rtol=1e-5)
    assert np.allclose(law.slopes_n_per_m, [STIFFNESS, 0, STIFFNESS], atol=1e-5 * STIFFNESS)
    assert np.allclose(law_knees_m(law, -3e-3, 3e-3), law.knees_m, atol=6e-3 / 4000)


def test_a_law_of_many_knees_gives_the_largest_of_them():
    knees = np.linspace(-2.7e-3, 2.7e-3, 19)

    def law(eta):
        return np.maximum(eta[:, None] - knees, 0) @ np.where(np.arange(19) % 2, 1.0, 3.0)

    assert np.allclose(law_knees_m(law, -3e-3, 3e-3), knees[::2][:8], atol=6e-3 / 4000)


@pytest.mark.study
def test_standard_errors_of_straight_pieces_are_those_of_the_noise():
    """Over many noises the errors are about as large as the standard errors say: chi2 of 2 knees and 3 slopes."""
    scores = []
    for seed in range(12):
        law = fitted_piecewise_linear(observed(gap, noise_n=0.3, seed=seed), INNER, np.array([-LOWER_M, UPPER_M]))
        scores += [
            *((law.knees_m - [-LOWER_M, UPPER_M]) / law.knee_errors_m),
            *((law.slopes_n_per_m - [STIFFNESS, 0, STIFFNESS]) / law.slope_errors_n_per_m),
        ]
    assert 0.7 < np.std(scores) < 1.4


def test_what_the_low_pass_does_is_taken_off_without_a_law():
    samples = observed(gap, rate_hz=64)
    true = gap(samples.eta_at_force_m)[INNER]
    assert np.std(force_without_low_pass(samples, INNER) - true) < 0.2 * np.std(samples.force_n[INNER] - true)


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
    held = BacklashFriction(upper_n=1e9, lower_n=1e9, backlash_m=1.6e-3, stiffness_n_per_m=1e4)
    expected = 1e4 * np.sign(eta) * np.maximum(np.abs(eta - eta[0]) - 0.8e-3, 0)
    start = np.abs(eta - eta[0]) < 5e-4
    assert np.allclose(held(eta)[start], expected[start])
    assert np.allclose(held(eta), 1e4 * ((eta - eta[0]) - np.clip(eta - eta[0], -0.8e-3, 0.8e-3)))


def test_its_standard_errors_are_those_of_the_noise():
    scores = []
    fine = 16
    eta = motion_m(np.arange(24 * fine * 4096) / (fine * 4096))[0]
    clean = at_force_rate(decimated(LAW(eta), fine), 16)
    for seed in range(4):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(clean.size)
        friction = fitted_backlash_friction(ForceSamples(eta[::fine], clean + noise, 4096.0, 16), slice(64, -64))
        scores += [
            (getattr(friction, n) - getattr(LAW, n)) / e for n, e in zip(NAMES, friction.standard_errors, strict=True)
        ]
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
