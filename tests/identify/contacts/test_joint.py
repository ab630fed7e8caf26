"""The start of a contact's law: by the samples at which its force says that it is closed."""

import numpy as np
import pytest

from identify.contacts.start import ContactRecord, regressed
from identify.signals.drift import Drift, spline
from rig.model.contact_laws import penetration_m


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
    curve = spline(time_s.size, rate_hz, Drift(bend, noise_density=5e-3, spring_n_per_m=0.0))
    velocity = np.gradient(eta_m, 1 / rate_hz)
    none, share, moving = np.zeros((0, time_s.size)), np.zeros(0), np.zeros(0, dtype=bool)
    seen = ContactRecord(eta_m, velocity, rate_hz, force_n, 1, 0.0, 0.0, None, none, share, moving, share, none, moving)
    law, knots = regressed(seen, curve)
    assert law[0] == pytest.approx(clearance_m, rel=0.1)
    assert law[2] == pytest.approx(stiffness, rel=0.7)
    assert np.std((curve.value @ knots - slow_m)[100:-100]) < 2e-4
