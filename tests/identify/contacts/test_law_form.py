"""Law of a stop in the fit: what its damper does between two samples, and its derivatives by finite differences."""

import numpy as np
import pytest

from identify.contacts.law_form import LawForm, damping_share
from rig.model.contact_laws import DeadZone

LAW = np.array([4e-4, 6e-4, 7e4, 20.0])
STEP_S = 1 / 16384
FORMS = [
    LawForm(step_s=STEP_S),
    LawForm("power law", step_s=STEP_S),
    LawForm("cannot pull", step_s=STEP_S),
    LawForm("spring", spring_indices=(0,), step_s=STEP_S),
]


def motions():
    """Displacements in and out of the play, and rates; away from places where a derivative jumps."""
    rng = np.random.default_rng(0)
    eta = rng.uniform(-8e-4, 1e-3, 4000)
    rate = rng.normal(0, 0.2, eta.size)
    half_travel = np.abs(rate) * STEP_S / 2
    jumps = np.stack([np.abs(np.abs(distance) - half_travel) for distance in (eta - 6e-4, eta + 4e-4)])
    jumps = np.concatenate([jumps, [np.abs(np.abs(eta - wall) - half_travel) for wall in (6.1e-4, -4.1e-4)]])
    return [signal[(jumps > 2e-7).all(axis=0)] for signal in (eta, rate)]


def test_the_law_of_single_samples_is_that_of_rig():
    eta, rate = motions()
    law = DeadZone(
        lower_clearance_m=LAW[0], upper_clearance_m=LAW[1], stiffness_n_per_m=LAW[2], damping_n_s_per_m=LAW[3]
    )
    np.testing.assert_allclose(LawForm().force_n(LAW, eta, rate), law.force_n(eta, rate), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("onset", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("rate_m_per_s", [0.3, -0.05, 1e-9])
def test_between_samples_the_damping_acts_as_long_as_the_stop_is_closed(onset, rate_m_per_s):
    times = (np.arange(4000) + 0.5) / 4000 - 0.5
    for distance_m in np.linspace(-2e-5, 2e-5, 9):
        between_m = distance_m + rate_m_per_s * STEP_S * times
        share_between = onset * (between_m > 0) + (1 - onset) * np.clip(between_m / 1e-5, 0.0, 1.0)
        share = damping_share(np.array([distance_m]), np.array([rate_m_per_s]), onset, STEP_S)
        if abs(distance_m) > 1e-12 or rate_m_per_s > 1e-6:
            assert share.acting[0] == pytest.approx(share_between.mean(), abs=2e-3)


@pytest.mark.parametrize("onset", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_derivatives_are_those_of_the_force(form, onset):
    eta, rate = motions()
    law = np.append(LAW, 1.2) if form.exponent_count else LAW
    if form.name == "spring":
        law = np.array([0.0, 0.0, 7e4, 20.0])
    by_eta, _, by_onset, *by_law = form.derivatives(law, eta, rate, onset)

    def force(law=law, eta=eta, onset=onset):
        return form.force_n(law, eta, rate, onset)

    def assert_slope(derivative, upper, lower, step):
        slope = (upper - lower) / (2 * step)
        size = np.abs(slope).max()
        is_same = np.abs(derivative - slope) <= 1e-4 * max(size, 1e-9)
        assert is_same.mean() > 0.999  # a stop that cannot pull lets go at a few samples

    assert_slope(by_eta, force(eta=eta + 1e-8), force(eta=eta - 1e-8), 1e-8)
    assert_slope(by_onset, force(onset=onset + 1e-3), force(onset=onset - 1e-3), 1e-3)
    for index, derivative in enumerate(by_law):
        if form.name == "spring" and index < 2:
            continue
        step = np.zeros(law.size)
        step[index] = 1e-8 if index < 2 else 1e-5 * law[index]
        assert_slope(derivative, force(law=law + step), force(law=law - step), step[index])
