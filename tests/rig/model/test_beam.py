"""Analytic modes of uniform beams against Bernoulli-Euler theory."""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

from rig.errors import RigError
from rig.model.beam import MAX_MODES, Beam


def beam(end_condition, **changes):
    return Beam(**{"name": "b", "ends": end_condition, "length_m": 1.3, "width_m": 0.05, "thickness_m": 0.01} | changes)


@pytest.mark.parametrize(("end_condition", "sign"), [("clamped-free", 1), ("free-free", -1)])
def test_wavenumbers_solve_the_characteristic_equation(end_condition, sign):
    b = beam(end_condition)
    omega = 2 * np.pi * b.frequencies_hz(MAX_MODES)[b.rigid_modes :]
    wavenumber = np.sqrt(omega * np.sqrt(b.mass_per_length_kg_per_m / b.bending_stiffness_n_m2)) * b.length_m
    residual = np.cos(wavenumber) + sign / np.cosh(wavenumber)  # cos cosh = -1 clamped-free, +1 free-free
    np.testing.assert_allclose(residual, 0, atol=1e-12)
    spacing = np.diff(wavenumber)
    np.testing.assert_allclose(spacing[3:], np.pi, rtol=1e-4)  # no root left out: they tend to equal spacing
    assert wavenumber[0] < (1 if sign > 0 else 2) * np.pi


def test_first_frequencies_are_those_of_the_textbook():
    b = beam("clamped-free")
    unit_hz = np.sqrt(b.youngs_modulus_pa * b.thickness_m**2 / 12 / b.density_kg_per_m3) / b.length_m**2 / (2 * np.pi)
    np.testing.assert_allclose(b.frequencies_hz(3), np.array([1.8751, 4.6941, 7.8548]) ** 2 * unit_hz, rtol=1e-4)
    free = beam("free-free").frequencies_hz(4)
    np.testing.assert_allclose(free, np.array([0, 0, 4.7300, 7.8532]) ** 2 * unit_hz, rtol=1e-4)


@pytest.mark.parametrize("end_condition", ["clamped-free", "free-free"])
def test_modes_are_orthonormal_in_mass_and_diagonal_in_stiffness(end_condition):
    b = beam(end_condition)
    nodes, weights = leggauss(200)
    x, w = (nodes + 1) / 2 * b.length_m, weights / 2 * b.length_m
    shapes = b.shapes(x, MAX_MODES)
    mass = b.mass_per_length_kg_per_m * (shapes * w[:, None]).T @ shapes
    np.testing.assert_allclose(mass, np.eye(MAX_MODES), atol=1e-10)
    curvature = b.shapes(x, MAX_MODES, order=2)
    stiffness = b.bending_stiffness_n_m2 * (curvature * w[:, None]).T @ curvature
    omega = 2 * np.pi * b.frequencies_hz(MAX_MODES)
    scale = np.where(omega > 0, omega, omega[b.rigid_modes])
    np.testing.assert_allclose(stiffness / np.outer(scale, scale), np.diag((omega / scale) ** 2), atol=1e-9)


@pytest.mark.parametrize("end_condition", ["clamped-free", "free-free"])
@pytest.mark.parametrize("mode", [3, 10, MAX_MODES])
def test_ends_obey_their_conditions(end_condition, mode):
    b = beam(end_condition)
    beta = (
        np.sqrt(2 * np.pi * b.frequencies_hz(mode)[-1])
        * (b.mass_per_length_kg_per_m / b.bending_stiffness_n_m2) ** 0.25
    )
    h = 0.01 / beta
    # one-sided differences of the end's neighbourhood, in units of the wavelength
    left_shape = b.shapes(h * np.arange(5), mode)[:, -1] * np.sqrt(b.mass_kg)
    right_shape = b.shapes(b.length_m - h * np.arange(5), mode)[:, -1] * np.sqrt(b.mass_kg)
    second, third = np.array([35, -104, 114, -56, 11]) / 12, np.array([-5, 18, -24, 14, -3]) / 2
    for shape in [right_shape] if end_condition == "clamped-free" else [left_shape, right_shape]:
        assert abs(second @ shape) / 0.01**2 < 1e-2  # no moment
        assert abs(third @ shape) / 0.01**3 < 2e-2  # no shear force
        assert abs(shape[0]) == pytest.approx(2, rel=1e-6)  # every elastic shape ends at twice 1/sqrt(mass)
    if end_condition == "clamped-free":
        assert abs(left_shape[0]) < 1e-12
        assert abs(np.array([-25, 48, -36, 16, -3]) / 12 @ left_shape) / 0.01 < 1e-6  # no slope


def test_free_beam_moves_rigidly_in_its_first_two_modes():
    b = beam("free-free")
    x = np.linspace(0, b.length_m, 5)
    shapes = b.shapes(x, 2)
    np.testing.assert_allclose(shapes[:, 0], 1 / np.sqrt(b.mass_kg))
    inertia = b.mass_kg * b.length_m**2 / 12
    np.testing.assert_allclose(shapes[:, 1], (x - b.length_m / 2) / np.sqrt(inertia), atol=1e-12)
    np.testing.assert_array_equal(b.damping_ratios(4), [0, 0, b.damping_ratio, b.damping_ratio])


def test_static_deflection_is_the_sum_of_the_modes():
    b = beam("clamped-free")
    tip = b.shapes(np.array([b.length_m]), MAX_MODES)[0]
    deflection = np.sum(tip**2 / (2 * np.pi * b.frequencies_hz(MAX_MODES)) ** 2)
    expected = b.length_m**3 / (3 * b.bending_stiffness_n_m2)
    remainder = 12 / (3 * np.pi**4 * MAX_MODES**3)  # the terms fall as 12 / beta^4 with beta = (n - 1/2) pi
    assert 1 - deflection / expected == pytest.approx(remainder, rel=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {"length_m": 0.0},
        {"width_m": -1.0},
        {"thickness_m": float("nan")},
        {"youngs_modulus_pa": float("inf")},
        {"density_kg_per_m3": 0.0},
        {"damping_ratio": -0.1},
    ],
)
def test_a_bad_value_is_named(changes):
    (field, value), *_ = changes.items()
    with pytest.raises(RigError, match=rf"'b': {field} is {value}; give"):
        beam("clamped-free", **changes)


@pytest.mark.parametrize("modes", [0, MAX_MODES + 1])
def test_mode_counts_have_limits(modes):
    with pytest.raises(RigError, match=rf"{modes} modes asked for; a beam has 1 to {MAX_MODES}"):
        beam("free-free").frequencies_hz(modes)
