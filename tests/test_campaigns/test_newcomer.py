"""The newcomer's machine moves as the equations of motion say, and a short session finds what is true."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.campaigns.newcomer import one_mass
from tests.campaigns.newcomer_machine import OVERSAMPLED, cantilever_modes, mass, motion, noise_force

pytestmark = pytest.mark.long


def test_the_mass_moves_as_its_equation_says():
    """Against an adaptive Runge-Kutta method, through a dozen contacts."""
    rate_hz, kg, hz, ratio, gap, k = 1024.0, 1.2, 7.0, 0.01, 0.6e-3, 1.5e4
    force = noise_force(1.0, (0.5, 20), rate_hz, 2.0, seed=1)
    (found,), _ = motion(mass(kg, hz, ratio, gap, k), force, rate_hz)
    time_s, omega = np.arange(force.size) / (rate_hz * OVERSAMPLED), 2 * np.pi * hz

    def slope(t, state):
        x, v = state
        contact = k * (x - np.clip(x, -gap, gap))
        return [v, (np.interp(t, time_s, force) - contact) / kg - 2 * ratio * omega * v - omega**2 * x]

    span = time_s[0], time_s[-1]
    expected = solve_ivp(slope, span, [0.0, 0.0], t_eval=time_s, rtol=1e-9, atol=1e-12, max_step=1e-3).y[0]
    assert np.sum(np.diff(np.abs(expected) > gap)) > 12
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


def test_the_cantilever_has_the_frequencies_and_the_tip_of_the_textbook():
    """f1 = 0.5596 sqrt(E I / (rho A L^4)), and shapes whose tip is 2 / sqrt(mass)."""
    frequencies, shapes = cantilever_modes(0.5, 0.04, 0.008, 3, np.array([0.0, 0.5]))
    root = np.sqrt(210e9 * 0.008**2 / 12 / 7850 / 0.5**4)
    np.testing.assert_allclose(frequencies / root, [0.5596, 3.5069, 9.8194], rtol=1e-4)
    np.testing.assert_allclose(np.abs(shapes[1]) * np.sqrt(7850 * 0.04 * 0.008 * 0.5), 2.0, rtol=1e-3)


@pytest.mark.study
def test_a_short_session_of_one_mass(tmp_path):
    steps = one_mass(tmp_path, 15.0)
    assert [step.words.split()[:2] for step in steps][-1] == ["identify", "gap"]
    assert json.loads((tmp_path / "gap" / "gap.json").read_bytes())["verdict"] == "explained"
