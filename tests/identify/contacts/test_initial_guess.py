"""First guesses: of a contact's law from the samples at which it is clearly closed, and of how a record that begins in
motion began from the times at which it is open."""

import numpy as np
import pytest

from identify.contacts.initial_guess import initial_state_pulls, regressed_guess
from identify.signals.drift import DriftPrior, spline
from rig.model.contact_laws import penetration_m
from tests.identify.contacts.contact_records import contact_record


@pytest.mark.parametrize("ringing", [0.0, 0.2])
def test_a_force_that_rings_while_the_contact_is_open_does_not_spoil_the_start(ringing):
    rate_hz, clearance_m, stiffness = 640.0, 5e-3, 3e5
    time_s = np.arange(round(20 * rate_hz)) / rate_hz
    slow_m = 4e-4 * np.sin(2 * np.pi * 0.2 * time_s)
    eta_m = 5.4e-3 * np.sin(2 * np.pi * 7 * time_s) * (1 + 0.05 * np.sin(2 * np.pi * 0.31 * time_s))
    force_n = stiffness * penetration_m(eta_m + slow_m, clearance_m, clearance_m)
    rings = np.random.default_rng(0).random(time_s.size) < 0.1
    force_n = np.where(rings & (force_n == 0), ringing * force_n.max() * np.sign(np.sin(2e3 * time_s)), force_n)
    bend = -((2 * np.pi * 0.2) ** 2) * slow_m
    curve = spline(time_s.size, rate_hz, DriftPrior(bend, 5e-3, 5e-3, spring_n_per_m=0.0))
    record = contact_record(
        force_n,
        np.zeros((0, time_s.size)),
        eta_m=eta_m,
        velocity_m_per_s=np.gradient(eta_m, 1 / rate_hz),
        sample_rate_hz=rate_hz,
        drift_spline=curve,
    )
    law, knots = regressed_guess(record)
    assert law[0] == pytest.approx(clearance_m, rel=0.1)
    assert law[2] == pytest.approx(stiffness, rel=0.7)
    assert np.std((curve.value @ knots - slow_m)[100:-100]) < 2e-4


def ringing_record(nuisance_n, force_n):
    """Record whose first two of three nuisance parameters are initial states."""
    return contact_record(force_n, nuisance_n, is_initial_state=np.array([True, True, False])[-len(nuisance_n) :])


@pytest.fixture
def ringing():
    """Two decaying motions from the record's start, and a small one of a tolerance."""
    time_s = np.arange(4000) / 1000
    ring = np.exp(-time_s) * np.stack([np.cos(60 * time_s), np.sin(60 * time_s)])
    return np.concatenate([500 * ring, 0.1 * np.ones((1, 4000))])


def test_a_record_that_begins_in_motion_tells_its_start_beside_sparse_contact_forces(ringing):
    contact_n = np.where(np.arange(4000) % 50 < 12, 80.0, 0.0) * np.random.default_rng(1).uniform(0, 1, 4000)
    pulls = initial_state_pulls(ringing_record(ringing, contact_n + np.array([1.3, -0.4, 0.0]) @ ringing))
    np.testing.assert_allclose(pulls, [1.3, -0.4, 0.0], atol=1e-3)


def test_tolerances_are_left_to_the_fit(ringing):
    assert not initial_state_pulls(ringing_record(ringing[2:], ringing[2])).any()
