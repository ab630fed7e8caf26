"""Laws fitted under a low-pass: straight pieces, and friction behind a backlash with its loop in closed form."""

import dataclasses

import numpy as np
import pytest

from identify.laws import SLIDING, identify_law
from identify.laws.fitted_laws import (
    ForceSamples,
    Friction,
    Part,
    fitted_friction,
    fitted_piecewise_linear,
    force_without_low_pass,
    law_knees_m,
    monotonic_runs,
)
from identify.laws.results import SlidingLaw, sliding_estimates
from identify.signals.spectra import at_force_rate, decimated
from tests.identify.laws.test_identification import LOWER_M, SECONDS, STIFFNESS, UPPER_M, gap, mass_with, motion_m

LAW = Friction(upper_n=9.0, lower_n=6.0, backlash_m=1.2e-3, stiffness_n_per_m=2e4)
NAMES = ("upper_n", "lower_n", "backlash_m", "stiffness_n_per_m")


def slider_n(law, eta):
    return law.slider_n(monotonic_runs(eta), np.zeros_like(eta))


def observed(law, noise_n=0.0, rate_hz=256, seed=0):
    """A law's force for 40 s, low-passed from 65536 Hz as separated forces are."""
    fine, factor = 16, 4096 // rate_hz
    eta, rate, _ = motion_m(np.arange(40 * fine * 4096) / (fine * 4096))
    force = at_force_rate(decimated(law(eta), fine), factor)
    noise = noise_n * np.random.default_rng(seed).standard_normal(force.size)
    return ForceSamples(eta[::fine], rate[::fine], force + noise, 4096.0, factor)


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
    force = slider_n(LAW, eta)
    rising, falling = slice(20000, 30001), slice(30000, 40001)
    k, b = LAW.stiffness_n_per_m, LAW.backlash_m
    up = np.cumsum([-amplitude, LAW.lower_n / k, b, LAW.upper_n / k])
    assert np.allclose(force[rising], np.interp(eta[rising], up, [-LAW.lower_n, 0, 0, LAW.upper_n]), atol=1e-9)
    down = np.cumsum([amplitude, -LAW.upper_n / k, -b, -LAW.lower_n / k])
    expected = np.interp(-eta[falling], -down, [LAW.upper_n, 0, 0, -LAW.lower_n])
    assert np.allclose(force[falling], expected, atol=1e-9)


def test_without_sliding_it_is_a_dead_zone():
    eta = motion_m(np.arange(8192) / 512)[0]
    held = Friction(upper_n=1e9, lower_n=1e9, backlash_m=1.6e-3, stiffness_n_per_m=1e4)
    expected = 1e4 * np.sign(eta) * np.maximum(np.abs(eta - eta[0]) - 0.8e-3, 0)
    start = np.abs(eta - eta[0]) < 5e-4
    assert np.allclose(slider_n(held, eta)[start], expected[start])
    assert np.allclose(slider_n(held, eta), 1e4 * ((eta - eta[0]) - np.clip(eta - eta[0], -0.8e-3, 0.8e-3)))


def bristle_n(eta, friction_n, stiffness_n_per_m):
    """Dahl's friction by its differential equation, z' = eta' (1 - sign(eta') k z / F): no corner and no backlash."""
    force = np.zeros_like(eta)
    for i, dx in enumerate(np.diff(eta)):
        force[i + 1] = force[i] + stiffness_n_per_m * (dx - abs(dx) * force[i] / friction_n)
    return force


def driven(force_of, seconds=12, noise_n=0.5, seed=0, rate_hz=512.0):
    """Samples of a driven damper; force_of(eta, rate)."""
    fine = 8
    eta, rate, _ = motion_m(np.arange(round(seconds * rate_hz) * fine) / (fine * rate_hz))
    clean = at_force_rate(decimated(force_of(eta, rate), fine), 1)
    noise = noise_n * np.random.default_rng(seed).standard_normal(clean.size)
    return ForceSamples(eta[::fine], rate[::fine], clean + noise, rate_hz, 1)


BESIDE = {"constant_n": 115.0, "viscous_n_s_per_m": 700.0, "elastic_n_per_m": 9e3}
SLIDING_N = 60.0


def beside_n(eta, rate):
    return BESIDE["constant_n"] + BESIDE["viscous_n_s_per_m"] * rate + BESIDE["elastic_n_per_m"] * eta


def set_valued_n(eta, rate):
    return SLIDING_N * np.sign(rate) + beside_n(eta, rate)


def errors_in_half_widths(law: SlidingLaw) -> dict[str, float]:
    """Errors of what is told, in half widths of the 95 % intervals."""
    told = {field: getattr(law, field) for field in ("upper_n", *BESIDE)}
    true = BESIDE | {"upper_n": SLIDING_N}
    return {field: (e.value - true[field]) / (1.96 * e.standard_error) for field, e in told.items()}


def test_constant_force_damper_and_spring_are_found_beside_a_set_valued_slider():
    fit = fitted_friction(driven(set_valued_n), INNER, by_speed=False)
    law = sliding_estimates(fit, ())
    assert all(abs(error) < 1.5 for error in errors_in_half_widths(law).values())
    assert law.upper_n == law.lower_n  # no asymmetry is asked for
    assert law.backlash_m is None
    assert law.stiffness_n_per_m is None  # rigid: no value at a bound
    assert law.undetermined == ("stiffness_n_per_m",)
    assert "stiffness" not in " ".join(name for name, _ in law.value_texts)


def test_they_are_found_beside_dahls_friction():
    def dahl_n(eta, rate):
        return bristle_n(eta, SLIDING_N, 2e6) + beside_n(eta, rate)

    law = sliding_estimates(fitted_friction(driven(dahl_n), INNER, by_speed=False), ())
    assert law.upper_n.value == pytest.approx(SLIDING_N, rel=0.06)  # rounded as it turns, unlike the law's
    for field, true in BESIDE.items():
        assert getattr(law, field).value == pytest.approx(true, rel=0.1)
    assert law.backlash_m is None
    assert law.upper_n == law.lower_n


def test_a_slider_that_pushes_one_way_alone_is_a_constant_force():
    """229 N one way and nothing the other: the mean is a constant force, not a parameter at its bound."""

    def one_way_n(_, rate):
        return np.where(rate > 0, 229.0, 0.0)

    law = sliding_estimates(fitted_friction(driven(one_way_n), INNER, by_speed=False), ())
    assert law.constant_n.value == pytest.approx(114.5, rel=0.02)
    assert law.upper_n.value == law.lower_n.value == pytest.approx(114.5, rel=0.02)


def test_a_reversal_speed_is_found_far_from_its_prior():
    def smooth_n(eta, rate):
        return SLIDING_N * np.tanh(rate / 0.03) + 50.0 * eta / 1e-3

    fit = fitted_friction(driven(smooth_n), INNER, by_speed=True)
    law = sliding_estimates(fit, ())
    speed = law.reversal_speed_m_per_s
    assert abs(speed.value - 0.03) < 2.5 * speed.standard_error
    assert speed.standard_error < 3e-3
    assert set(fit.parts) == {Part.FRICTION, Part.ELASTIC, Part.REVERSAL}


def test_without_friction_a_damper_and_a_spring_are_left():
    fit = fitted_friction(driven(lambda eta, rate: 700.0 * rate + 9e3 * eta), INNER, by_speed=False)
    assert set(fit.parts) == {Part.VISCOUS, Part.ELASTIC}


def test_a_tolerance_widens_the_intervals_by_what_it_changes():
    samples = driven(set_valued_n)
    fit = fitted_friction(samples, INNER, by_speed=False)
    stronger = dataclasses.replace(samples, force_n=0.97 * samples.force_n)
    plain, widened = (sliding_estimates(fit, changed).upper_n.standard_error for changed in ((), (stronger,)))
    assert np.sqrt(widened**2 - plain**2) == pytest.approx(0.03 * SLIDING_N, rel=0.02)


def share_of_intervals_that_hold(draws):
    """Of the four values of a set-valued slider in motions and noises of several draws."""
    errors = []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        phase, size = rng.uniform(0, 2 * np.pi), rng.uniform(0.7, 1.3)

        def force_of(eta, rate, size=size, phase=phase):
            return set_valued_n(eta, rate) + 4.0 * size * np.sin(2 * np.pi * eta / 1e-3 + phase)  # not in the law

        law = sliding_estimates(fitted_friction(driven(force_of, noise_n=2.0, seed=seed), INNER, by_speed=False), ())
        errors += errors_in_half_widths(law).values()
    return float(np.mean(np.abs(errors) < 1))


def test_intervals_hold_the_truth_though_the_law_misses_a_ripple():
    assert share_of_intervals_that_hold(3) > 0.8


@pytest.mark.study
def test_intervals_hold_the_truth_in_many_draws():
    assert share_of_intervals_that_hold(40) > 0.9


@pytest.mark.parametrize("start_share", [-0.98, 0.999])
def test_a_knee_at_the_end_of_the_range_is_dropped(start_share):
    samples = observed(lambda eta: STIFFNESS * eta, noise_n=1.0)
    end_m = float(np.abs(samples.eta_m).max())
    law = fitted_piecewise_linear(samples, INNER, np.array([start_share * end_m]))
    assert not law.knees_m.size


def test_its_standard_errors_are_those_of_the_noise():
    scores = []
    fine = 16
    eta, rate, _ = motion_m(np.arange(10 * fine * 4096) / (fine * 4096))
    clean = at_force_rate(decimated(slider_n(LAW, eta), fine), 16)
    for seed in range(3):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(clean.size)
        samples = ForceSamples(eta[::fine], rate[::fine], clean + noise, 4096.0, 16)
        estimates = fitted_friction(samples, slice(64, -64), by_speed=False).estimates()
        assert set(estimates) == set(NAMES)
        scores += [(value - getattr(LAW, name)) / error for name, (value, error) in estimates.items()]
    assert 0.3 < np.std(scores) < 1.3


def test_identify_law_names_it_with_intervals():
    law = identify_law(mass_with(lambda eta: slider_n(LAW, eta)), seconds=SECONDS).report.laws[0]
    assert law.best == SLIDING
    assert law.fits
    assert law.verdict.startswith("dry friction: sliding force one way ")
    for name in NAMES:
        assert getattr(law.sliding, name).value == pytest.approx(getattr(LAW, name), rel=5e-3)
    others = [c.held_out_error_n for c in law.candidates if c.law != SLIDING]
    assert law.candidate(SLIDING).held_out_error_n < 0.1 * min(others)


def test_a_dead_zone_is_not_taken_for_it():
    law = identify_law(mass_with(gap), seconds=SECONDS).report.laws[0]
    assert law.sliding is None
    assert law.verdict.startswith("dead zone")
