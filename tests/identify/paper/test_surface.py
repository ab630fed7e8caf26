"""Clearances from the restoring force surface and from how often a relative displacement occurs."""

import numpy as np
import pytest
from scipy.stats import binom

from identify.linear.modal import ModalEquation
from identify.paper.surface import MIN_CONTACT_SHARE, Stops, fit_surface, restoring_force, stops_from_eta_density
from rig.model.contact_laws import penetration_m
from rig.simulation.excitation import QUIET_S, force_history
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.reference import Sdof

SAMPLES = 8000
RATE_HZ = 1000.0
STOPS_M = ((0.8e-3, 1.1e-3), (0.5e-3, 0.9e-3))
"""Lower and upper, of two contacts."""
STIFFNESS_N_PER_M = (3e4, 8e4)
SHAPES = (0.7, -0.4)
NATURAL, ZETA = 2 * np.pi * 12.0, 0.03


def smooth(rng, rows, high_hz):
    """Gaussian noise of unit variance and no content above high_hz."""
    spectrum = np.fft.rfft(rng.standard_normal((rows, SAMPLES)), axis=1)
    spectrum[:, int(high_hz * SAMPLES / RATE_HZ) :] = 0
    signals = np.fft.irfft(spectrum, SAMPLES, axis=1)
    return signals / signals.std(axis=1, keepdims=True)


def equation_and_force(noise_n=0.0, seed=1, stops=STOPS_M, shapes=SHAPES):
    """A modal equation that balances exactly, but for noise in the force; and its relative displacements."""
    rng = np.random.default_rng(1)
    eta = 1e-3 * smooth(rng, 2, 30.0)
    q = 1e-3 * smooth(rng, 1, 30.0)[0]
    omega = 2 * np.pi * np.fft.rfftfreq(SAMPLES, 1 / RATE_HZ)
    rate, acceleration = (np.fft.irfft(np.fft.rfft(q) * (1j * omega) ** n, SAMPLES) for n in (1, 2))
    contact = [s * k * penetration_m(e, *d) for s, k, e, d in zip(shapes, STIFFNESS_N_PER_M, eta, stops, strict=True)]
    shape_at_force = 0.5
    force = (acceleration + 2 * ZETA * NATURAL * rate + NATURAL**2 * q + sum(contact)) / shape_at_force
    equation = ModalEquation(
        body="b",
        mode_number=1,
        frequency_hz=NATURAL / (2 * np.pi),
        damping_ratio=ZETA,
        shape_at_force=shape_at_force,
        shape_at_contacts=np.array(shapes),
        visibility=tuple(abs(s) for s in shapes),
        displacement=q,
        velocity=rate,
        acceleration=acceleration,
    )
    return equation, force + noise_n * np.random.default_rng(1000 + seed).standard_normal(SAMPLES), eta


def start(stops=STOPS_M, ratio=1.15):
    return tuple(Stops(ratio * lower, upper / ratio, 0.0, 0.0, 0.0) for lower, upper in stops)


@pytest.mark.parametrize("factor", [1, 4])
def test_unequal_stops_and_stiffnesses_are_recovered(factor):
    equation, force, eta = equation_and_force()
    surface = fit_surface(equation, force, eta, factor, start())
    fitted, measured = surface.fitted_modal_force, surface.measured_modal_force
    assert measured.shape == fitted.shape == (SAMPLES // factor,)
    for stops, (lower, upper) in zip(surface.stops, STOPS_M, strict=True):
        assert stops.lower_m == pytest.approx(lower, rel=1e-5)
        assert stops.upper_m == pytest.approx(upper, rel=1e-5)
        assert stops.clearance_m == pytest.approx((lower + upper) / 2, rel=1e-5)
    np.testing.assert_allclose(surface.stiffness_n_per_m, STIFFNESS_N_PER_M, rtol=1e-5)
    np.testing.assert_allclose(fitted, measured, atol=1e-4 * np.std(measured))


def test_the_surface_is_the_contacts_share_on_the_linear_part():
    equation, force, eta = equation_and_force()
    surface = fit_surface(equation, force, eta, 1, start())
    np.testing.assert_array_equal(surface.measured_modal_force, restoring_force(equation, force))
    linear = 2 * ZETA * NATURAL * equation.velocity + NATURAL**2 * equation.displacement
    size, parts = np.std(surface.measured_modal_force), surface.fitted_contact_parts
    np.testing.assert_allclose(surface.fitted_modal_force - parts.sum(axis=0), linear, atol=1e-4 * size)
    for j, share in enumerate(parts):
        expected = SHAPES[j] * STIFFNESS_N_PER_M[j] * penetration_m(eta[j], *STOPS_M[j])
        np.testing.assert_allclose(share, expected, atol=1e-4 * size)


def test_standard_errors_cover():
    """Errors in standard errors over independent noise: their size, and how many lie within one and within two."""
    draws, noise_n = 25, 4.0
    scores = {"lower": [], "upper": [], "clearance": []}
    for seed in range(draws):
        equation, force, eta = equation_and_force(noise_n, seed)
        for stops, (lower, upper) in zip(fit_surface(equation, force, eta, 1, start()).stops, STOPS_M, strict=True):
            scores["lower"].append((stops.lower_m - lower) / stops.lower_error_m)
            scores["upper"].append((stops.upper_m - upper) / stops.upper_error_m)
            scores["clearance"].append((stops.clearance_m - (lower + upper) / 2) / stops.clearance_error_m)
            assert 1e-5 < stops.lower_error_m / lower < 0.1
    for sizes in scores.values():
        assert 1 / 1.5 < np.sqrt(np.mean(np.square(sizes))) < 1.5
    sizes = np.abs([*scores["lower"], *scores["upper"]])
    for multiple, share in ((1.0, 0.683), (2.0, 0.954)):
        least, most = binom.ppf([1e-4, 1 - 1e-4], sizes.size, share) / sizes.size
        assert least <= np.mean(sizes < multiple) <= most


def test_a_contact_that_the_equation_does_not_see_takes_no_part():
    equation, force, eta = equation_and_force(shapes=(0.7, 0.0))
    surface = fit_surface(equation, force, eta, 1, start())
    assert surface.stops[0].lower_m == pytest.approx(STOPS_M[0][0], rel=1e-5)
    assert surface.stops[1] is None
    assert np.isnan(surface.stiffness_n_per_m[1])
    assert not surface.fitted_contact_parts[1].any()


@pytest.mark.parametrize("started", [True, False])
def test_a_contact_that_never_closes_has_no_stops(started):
    stops = (STOPS_M[0], (9e-3, 9e-3))
    equation, force, eta = equation_and_force(stops=stops)
    first, second = start(stops)
    surface = fit_surface(equation, force, eta, 1, (first, second if started else None))
    assert surface.stops[0].upper_m == pytest.approx(STOPS_M[0][1], rel=1e-4)
    assert surface.stops[1] is None
    assert np.std(surface.fitted_contact_parts[1]) < 1e-3 * np.std(surface.fitted_contact_parts[0])


def test_a_contact_that_hardly_closes_has_no_stops():
    _, _, eta = equation_and_force()
    for share, is_determined in ((MIN_CONTACT_SHARE / 2, False), (4 * MIN_CONTACT_SHARE, True)):
        both = float(np.quantile(np.abs(eta[1]), 1 - share))
        stops = (STOPS_M[0], (both, both))
        equation, force, _ = equation_and_force(stops=stops)
        surface = fit_surface(equation, force, eta, 1, start(stops, ratio=1.01))
        assert (surface.stops[1] is not None) == is_determined


def boltzmann(lower, upper, slope, stiffness, samples, rng):
    """Draws with log p = -slope x^2 / 2 - stiffness dz(x)^2 / 2, by the inverse of the distribution function."""
    x = np.linspace(-5, 5, 20_001)
    density = np.exp(-slope * x**2 / 2 - stiffness * penetration_m(x, lower, upper) ** 2 / 2)
    cumulative = np.cumsum(density) / density.sum()
    return np.interp(rng.uniform(size=samples), cumulative, x)


@pytest.mark.parametrize(("lower", "upper"), [(0.8, 0.8), (0.6, 1.0)])
def test_stops_from_the_density_that_the_method_assumes(lower, upper):
    rng = np.random.default_rng(1)
    stops = stops_from_eta_density(1e-3 * boltzmann(lower, upper, 0.5, 20.0, 200_000, rng))
    assert stops.lower_m == pytest.approx(1e-3 * lower, abs=4 * stops.lower_error_m)
    assert stops.upper_m == pytest.approx(1e-3 * upper, abs=4 * stops.upper_error_m)
    assert stops.clearance_m == pytest.approx(1e-3 * (lower + upper) / 2, abs=4 * stops.clearance_error_m)
    assert max(stops.lower_error_m, stops.upper_error_m) < 0.05e-3


@pytest.mark.study
def test_clearance_from_the_occurrence_of_a_randomly_shaken_mass():
    """Under a force that is white as far as the mass can follow, its displacement has the assumed density.

    The standard error of one record is as large as the last bound; eight records together are held to it.
    """
    step_s, duration_s, estimates = 2.0**-12, 400.0, []
    for seed in range(1, 9):
        settings = Sdof(high_hz=200.0, rms_n=1.8, seed=seed)
        force_n = force_history(settings.force(), duration_s, step_s)
        eta = concatenated(modal.simulate(settings.rig(), force_n, step_s, lambda _: None)).eta_m[0]
        estimates.append(stops_from_eta_density(eta[round((QUIET_S + 1) / step_s) :: 8]))
    values, errors = (np.array(x) for x in zip(*((f.clearance_m, f.clearance_error_m) for f in estimates), strict=True))
    assert np.abs((values - settings.clearance_m) / errors).max() < 3
    assert values.mean() == pytest.approx(settings.clearance_m, rel=0.15)


def test_a_mirrored_displacement_swaps_the_stops():
    eta = 1e-3 * boltzmann(0.6, 1.0, 0.5, 20.0, 100_000, np.random.default_rng(2))
    stops, mirrored = stops_from_eta_density(eta), stops_from_eta_density(-eta)
    assert stops.upper_m > stops.lower_m
    assert mirrored.lower_m == pytest.approx(stops.upper_m, rel=1e-2)
    assert mirrored.upper_m == pytest.approx(stops.lower_m, rel=1e-2)
