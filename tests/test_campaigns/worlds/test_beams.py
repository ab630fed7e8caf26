"""Modes against Bernoulli-Euler theory."""

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.campaigns.worlds.beams import modes_of
from tests.campaigns.worlds.machine import MODES
from tests.test_campaigns.worlds.examples import beam

BAR = beam()


def wavenumbers(equation, count, first):
    """Roots of a characteristic equation, one in each interval of pi."""
    return np.array([brentq(equation, (k + first) * np.pi, (k + first + 1) * np.pi) for k in range(count)])


def hertz(beta, bar=BAR):
    return (beta / bar.length_m) ** 2 * np.sqrt(bar.bending_stiffness_n_m2 / bar.mass_per_length_kg_per_m) / (2 * np.pi)


@pytest.mark.parametrize(("clamped", "sign", "rigid"), [(True, 1.0, 0), (False, -1.0, 2)])
def test_frequencies_are_those_of_theory(clamped, sign, rigid):
    """cos b cosh b = -1 clamped, = 1 free; the error of n Hermite elements grows as (b / n)^4 / 1440 at least."""
    beta = wavenumbers(lambda b: np.cos(b) + sign / np.cosh(b), MODES - rigid, 0.0 if clamped else 1.0)
    found = modes_of(beam(clamped=clamped)).omega_rad_per_s[rigid:] / (2 * np.pi)
    np.testing.assert_allclose(found, hertz(beta), rtol=1.2e-3)
    np.testing.assert_allclose(found[:12], hertz(beta[:12]), rtol=1e-4)
    assert np.all(found >= hertz(beta) * (1 - 1e-7))  # by Rayleigh, from above


def test_a_free_beam_carries_its_mass_in_two_rigid_modes():
    modes = modes_of(beam(clamped=False))
    mass_kg = BAR.mass_per_length_kg_per_m * BAR.length_m
    assert np.all(modes.omega_rad_per_s[:2] == 0)
    assert modes.carried[:2] @ modes.carried[:2] == pytest.approx(mass_kg)
    np.testing.assert_allclose(modes.carried[2:], 0, atol=1e-6)


def test_a_mass_at_the_tip_obeys_its_characteristic_equation():
    mass_kg = 1.3
    ratio = mass_kg / (BAR.mass_per_length_kg_per_m * BAR.length_m)

    def equation(b):
        return 1 + np.cos(b) * np.cosh(b) + ratio * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))

    beta = brentq(equation, 0.5, 1.85)
    found = modes_of(beam(masses=((1.0, mass_kg),))).omega_rad_per_s[0] / (2 * np.pi)
    assert found == pytest.approx(hertz(beta), rel=1e-6)


def test_a_clamp_that_gives_obeys_its_characteristic_equation():
    """k_r (1 + cos b cosh b) = (E I b / l) (cosh b sin b - sinh b cos b)."""
    stiffness = BAR.bending_stiffness_n_m2 / BAR.length_m / 0.05

    def equation(b):
        turned = BAR.bending_stiffness_n_m2 * b / BAR.length_m / stiffness
        return 1 + np.cos(b) * np.cosh(b) + turned * (np.sinh(b) * np.cos(b) - np.cosh(b) * np.sin(b))

    beta = brentq(equation, 1.0, 2.0)
    found = modes_of(beam(clamp_n_m_per_rad=stiffness)).omega_rad_per_s[0] / (2 * np.pi)
    assert found == pytest.approx(hertz(beta), rel=1e-6)


def test_a_soft_spring_in_the_middle_lets_a_free_beam_bounce():
    modes = modes_of(beam(clamped=False, springs=((0.5, 50.0),)))
    bounce = np.sqrt(50.0 / (BAR.mass_per_length_kg_per_m * BAR.length_m))
    assert modes.omega_rad_per_s[:2].max() == pytest.approx(bounce, rel=1e-3)


def test_every_mode_has_its_own_factors():
    rng = np.random.default_rng(1)
    faster, damped = rng.uniform(0.99, 1.01, (2, MODES))
    plain = modes_of(BAR)
    other = modes_of(beam(frequency_factors=tuple(faster), damping_factors=tuple(damped)))
    np.testing.assert_allclose(other.omega_rad_per_s / plain.omega_rad_per_s, faster)
    np.testing.assert_allclose(other.damping_ratio / plain.damping_ratio, damped)


def test_the_static_deflection_under_a_tip_force_is_that_of_a_cantilever():
    """l^3 / (3 E I), of which 24 modes leave out less than a ten-thousandth."""
    modes = modes_of(BAR)
    flexibility = np.sum((modes.shapes(1.0) / modes.omega_rad_per_s) ** 2)
    assert flexibility == pytest.approx(BAR.length_m**3 / (3 * BAR.bending_stiffness_n_m2), rel=1e-4)
