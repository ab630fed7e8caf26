"""Law of an annular contact in the fit: that of rig.json, and its derivatives by finite differences."""

import numpy as np
import pytest

from identify.contacts.annular_law import ring_derivatives, ring_force_n
from rig.model.contact_laws.annular import Annular

VALUES = np.array([2e-3, 5e5, 200.0, 0.1, np.log(0.01), 0.0, 1e-4, -2e-4, 0.0, 0.0])


def motions():
    """Motions within the ring and beyond it, some metres a second along and across."""
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 400), 2e-3 + rng.uniform(-1e-4, 3e-4, 400)
    eta = radius * np.stack([np.cos(angle), np.sin(angle)]) + VALUES[6:8, None]
    away = np.abs(radius - VALUES[0] - 5e-6) > 6e-6  # of the knees at the wall and where the damping has risen
    return eta[:, away], rng.normal(0, 0.02, eta.shape)[:, away]


def test_the_law_is_that_of_rig():
    law = Annular(
        clearance_m=2e-3,
        stiffness_n_per_m=5e5,
        damping_n_s_per_m=200.0,
        friction_coefficient=0.1,
        center_y_m=1e-4,
        center_z_m=-2e-4,
    )
    eta, rate = motions()
    np.testing.assert_allclose(ring_force_n(VALUES, *eta, *rate), law.force_n(eta, rate), rtol=1e-9, atol=1e-9)


def test_a_damper_that_acts_at_once_is_whole_from_the_wall_on():
    at_once = VALUES.copy()
    at_once[5] = 1.0
    eta_y, eta_z = np.array([2e-3 + 1e-6, 2e-3 - 1e-6]) + 1e-4, np.full(2, -2e-4)
    force_y, _ = ring_force_n(at_once, eta_y, eta_z, np.full(2, 0.02), np.zeros(2))
    np.testing.assert_allclose(force_y, [5e5 * 1e-6 + 200.0 * 0.02, 0.0], rtol=1e-9)


@pytest.mark.parametrize("onset", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("speed_m_per_s", [0.3, -0.05])
def test_between_samples_the_damping_acts_as_long_as_the_ring_is_closed(onset, speed_m_per_s):
    """A sample's force is the mean over the time that it stands for, of a pulse that is shorter than that time."""
    step_s, times = 1 / 16384, (np.arange(4000) + 0.5) / 4000 - 0.5
    damper = VALUES.copy()
    damper[[1, 3, 5]] = 1e5, 0.0, onset
    for depth_m in np.linspace(-2e-5, 2e-5, 9):
        eta_y = 2e-3 + 1e-4 + np.r_[depth_m, depth_m + speed_m_per_s * step_s * times]
        still = np.zeros(eta_y.size)
        rate = np.full(eta_y.size, speed_m_per_s)
        at_samples, _ = ring_force_n(damper, eta_y[:1], still[:1] - 2e-4, rate[:1], still[:1], step_s)
        between, _ = ring_force_n(damper, eta_y[1:], still[1:] - 2e-4, rate[1:], still[1:])
        closed_n = 1e5 * np.maximum(eta_y - 2.1e-3, 0.0)
        if speed_m_per_s > 0:  # a ring does not pull: as it opens, its spring pushes less than the damper pulls
            assert at_samples[0] - closed_n[0] == pytest.approx(np.mean(between - closed_n[1:]), abs=0.01)
        else:
            assert 0 <= at_samples[0] <= closed_n[0]


def test_the_moment_at_which_a_damper_sets_in_moves_with_the_displacement():
    values, step_s = VALUES.copy(), 1 / 4096
    values[5] = 0.7
    eta, rate = motions()
    found = ring_derivatives(values, eta, rate, step_s).by_eta
    for component in range(2):
        step = np.zeros((2, 1))
        step[component] = 1e-9
        after, before = (ring_force_n(values, *(eta + sign * step), *rate, step_s) for sign in (1, -1))
        np.testing.assert_allclose(found[:, component], (after - before) / 2e-9, atol=1e-5 * np.abs(found).max())


@pytest.mark.parametrize("onset", [0.0, 0.7])
def test_derivatives_are_those_of_the_force(onset):
    values = VALUES.copy()
    values[5] = onset
    eta, rate = motions()
    found = ring_derivatives(values, eta, rate)

    def close(derivative, forward, backward, step):
        difference = (forward - backward) / (2 * step)
        np.testing.assert_allclose(derivative, difference, atol=1e-6 * np.abs(difference).max())

    for component in range(2):
        step = np.zeros((2, 1))
        step[component] = 1e-9
        forces = (ring_force_n(values, *(eta + sign * step), *rate) for sign in (1, -1))
        close(found.by_eta[:, component], *forces, 1e-9)
        forces = (ring_force_n(values, *eta, *(rate + sign * 1e3 * step)) for sign in (1, -1))
        close(found.by_rate[:, component], *forces, 1e-6)
    for k in range(8):
        step = np.zeros(10)
        step[k] = 1e-6 * max(abs(values[k]), 1e-3)
        forces = (ring_force_n(values + sign * step, *eta, *rate) for sign in (1, -1))
        close(found.by_law[k], *forces, step[k])
