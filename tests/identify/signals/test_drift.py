"""Priors of slow motion and of slow forces: what they say of noise that is drawn by its spectrum."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from identify.signals.drift import DriftPrior, slow_force_density, spline
from identify.signals.kinematics import CORNER_HZ

RATE_HZ, SAMPLE_COUNT = 200.0, 12000
CORNER = 2 * np.pi * CORNER_HZ


def integrated_noise(density, seed):
    """Slow force of a spectral density s^2 omega^2 / (omega^6 + omega_c^6), as the prior has it."""
    omega = 2 * np.pi * np.fft.rfftfreq(SAMPLE_COUNT, 1 / RATE_HZ)
    white = np.fft.rfft(np.random.default_rng(seed).standard_normal(SAMPLE_COUNT) * np.sqrt(RATE_HZ / 2))
    return np.fft.irfft(white * density * omega / np.sqrt(omega**6 + CORNER**6))


def test_the_slow_part_of_an_error_is_told_from_its_white_part():
    omega = 2 * np.pi * np.arange(1, 6000) / 60
    slow, white = 3.0**2 * omega**2 / (omega**6 + CORNER**6), 0.01**2
    density, rest_n = slow_force_density(slow + white, omega)
    assert density == pytest.approx(3.0, rel=0.04)
    assert rest_n == pytest.approx(0.01 * np.sqrt(100), rel=0.1)
    assert slow_force_density(np.full(omega.size, white), omega)[0] == pytest.approx(0.0, abs=1e-12)


def test_a_slow_force_is_followed_within_its_prior_beside_the_drift():
    """Fitted to a slow force with a little noise, knots return it, pull as the prior expects, and move nothing."""
    prior = DriftPrior(np.zeros(SAMPLE_COUNT), 1e-3, 1e-3, spring_n_per_m=1e4, slow_force_density=3.0)
    curve = spline(SAMPLE_COUNT, RATE_HZ, prior)
    force_n, noise_n = integrated_noise(3.0, seed=1), 0.01
    weighted = curve.force_n / noise_n
    normal = (weighted.T @ weighted + curve.curvature.T @ curve.curvature).tocsc()
    knots = spsolve(normal, weighted.T @ (force_n / noise_n))
    assert np.std(curve.force_n @ knots - force_n) < 0.1 * np.std(force_n)
    assert not np.any(curve.value @ knots)
    force_pulls = (curve.curvature @ knots)[curve.curvature.shape[0] // 3 :]
    assert 0.2 < np.mean(force_pulls[force_pulls != 0] ** 2) < 1.5


def test_without_a_slow_force_a_drift_has_the_knots_of_its_displacement_alone():
    prior = DriftPrior(np.zeros(SAMPLE_COUNT), 1e-3, 1e-3, spring_n_per_m=0.0)
    curve = spline(SAMPLE_COUNT, RATE_HZ, prior)
    assert not curve.force_n.nnz
    assert curve.knot_count == 1203


def test_a_slower_noise_tightens_the_prior_below_its_frequency_alone():
    """With equal densities the prior is that of one; with a smaller one, slow curvature costs more and fast as much."""
    curves = [spline(SAMPLE_COUNT, RATE_HZ, DriftPrior(np.zeros(SAMPLE_COUNT), 1.0, s, 0.0)) for s in (1.0, 0.1)]
    time_s = np.arange(curves[0].knot_count) * 0.05
    costs = [[np.sum((curve.curvature @ np.sin(2 * np.pi * f * time_s)) ** 2) for f in (0.2, 9.9)] for curve in curves]
    assert costs[1][0] == pytest.approx(100 * costs[0][0], rel=0.1)
    assert costs[1][1] == pytest.approx(costs[0][1], rel=0.1)
