"""Every new effect, recorded on one mass between stops: its derivative is right, and a fit finds it."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized, residual_decrease, residual_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Search, fit_effects
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.screening import peak_frequencies_hz
from rig.simulation.excitation import force_history
from rig.simulation.reference import Sdof
from rig.simulation.replay import modal

SETTINGS = Sdof(sensors="displacement", duration_s=20.0)
RIG = SETTINGS.rig()
RIG = replace(RIG, sensors=tuple(replace(s, noise_density=1e-9) for s in RIG.sensors))
FORCE_N = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
NEW = {  # true values beside the typical ones
    "hertz_stop:stop": {"exponent": 1.3, "reference_force_n": 2.5},
    "one_stop:stop:upper": {},
    "one_stop:stop:lower": {},
    "linear_spring:mass": {"stiffness_n_per_m": -200.0},
    "hardening_spring:mass": {"cubic_n_per_m3": -1.5e8},
    "ground_damper:mass": {"damping_n_s_per_m": 6.0},
    "ground_friction:mass": {"force_n": 0.2},
    "force_shift": {"shift_s": -2e-3},
    "force_gain": {"factor": 1.8},
    "tone:mass": {"cosine_n": 0.1, "sine_n": -0.05, "frequency_hz": 7.3},
}


def case(name):
    """The candidate, its true values, and the record of a rig that has them."""
    null = record_of(modal(RIG, RIG, FORCE_N, 1))
    scale = effect_range_scale(null, RIG)
    found = next(c for c in candidates(scale, ["mass"], null.zero_known) if c.name == name)
    truth = np.array([NEW[name].get(p, v) for p, v in zip(found.parameters.names, found.typical_values, strict=True)])
    low, high = found.parameters.bounds
    assert np.all((low <= truth) & (truth <= high))
    return found, truth, record_of(modal(RIG, found.effect(truth).applied_to(RIG), FORCE_N, 1))


@pytest.fixture(scope="module", params=NEW)
def recorded(request):
    return case(request.param)


def stacked(linear, contacts):
    return np.concatenate([linear.ravel(), *contacts])


def test_the_derivative_by_the_strength_foretells_the_residual_on_its_other_side(recorded):
    candidate, truth, record = recorded
    actual = candidate.applied(RIG, truth)
    linearization = linearized(record, actual)
    at = residual_of(linearization, actual)
    step = np.zeros(truth.size)
    step[0] = 0.1 * candidate.step_sizes[0]
    column = stacked(*residual_decrease(linearization, candidate.applied(RIG, truth + step), at))
    there = residual_of(
        linearization, candidate.applied(RIG, truth - step), at.nuisance_pulls, tuple(c.unknowns for c in at.contacts)
    )
    grown = stacked(there.linear_residual, [c.residual for c in there.contacts]) - stacked(
        at.linear_residual, [c.residual for c in at.contacts]
    )
    assert np.linalg.norm(column) > 0
    assert np.linalg.norm(grown - column) < 0.05 * np.linalg.norm(column)


def test_a_fit_from_a_third_of_its_strength_finds_it(recorded):
    candidate, truth, record = recorded
    linearization, believed = fit_nuisance(record, RIG)
    neutral = [p.neutral for p in candidate.parameters]
    start = np.array([t if n is None else n + 0.3 * (t - n) for t, n in zip(truth, neutral, strict=True)])
    begun = Search(nominal_variances_of(linearized(record, RIG)), linearization, believed, ())
    found = fit_effects(begun, (candidate,), start, believed).hypothesis
    assert found.misfit.minus_two_log < begun.nominal_fit().cost
    np.testing.assert_allclose(found.values, truth, rtol=0.05, atol=1e-12)


def test_the_frequency_of_a_tone_stands_out_of_the_residual():
    _, truth, record = case("tone:mass")
    linearization, believed = fit_nuisance(record, RIG)
    found = peak_frequencies_hz(linearization, believed, 3)
    assert np.min(np.abs(found - truth[2])) < 0.1 / SETTINGS.duration_s
