"""The joint sparse search: the local model is the statistic itself, and what is true is selected and nothing beside."""

from dataclasses import replace

import numpy as np
import pytest

from identify.gaps.decision.prepare import prepare_recording
from identify.gaps.residual.likelihood import misfit
from identify.gaps.search.candidates import candidates, effect_range_scale
from identify.gaps.search.hypothesis import Hypothesis, Search, fit_briefly
from identify.gaps.search.local_model import local_model
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.sparse import best_selection, ranked_hypotheses, reduced_and_variants
from rig.effects.added_mass import AddedMass
from rig.effects.base_motion import ShakingBase
from rig.effects.contact_damping import ContactDamping
from rig.model.tolerances import LABORATORY
from rig.simulation.reference import BarrelCradle

pytestmark = pytest.mark.long

SETTINGS = BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=16.0, seed=78)
MASS = AddedMass(mass_kg=0.05, relative_position=0.7)
DAMPING = ContactDamping(damping_n_s_per_m=20.0, contact="contact_1")


def search_of(recording):
    """The nominal rig fitted to a recording, and what a search may try there."""
    observation = prepare_recording(recording, LABORATORY)
    linearization, residual = fit_nuisance(observation.record, recording.rig)
    names = [s.name for s in recording.rig.sensors]
    known = candidates(effect_range_scale(observation.record, recording.rig), names, False)
    return Search(observation.nominal_variances, linearization, residual, tuple(known))


@pytest.fixture(scope="module")
def pair(recorded_machine):
    return search_of(recorded_machine(SETTINGS, MASS, DAMPING))


@pytest.fixture(scope="module")
def model(pair):
    steady = [c for c in pair.candidates if not c.kind.stochastic]
    nothing = pair.nominal_fit().hypothesis
    return local_model(
        pair.linearization, pair.nominal_residual, pair.nominal_variances, pair.linearization.rig, nothing, steady
    )


def test_is_the_statistic_where_it_is_expanded(pair, model):
    """Level by level; lines that stand out of a residual count apart there."""
    left = misfit(pair.linearization.record, pair.nominal_variances, pair.nominal_residual)
    cells, contacts = model.levels(np.zeros(len(model.column_spectra)))
    near = np.isclose(cells.reshape(left.mean_squares.shape), left.mean_squares, rtol=1e-3)
    assert near.mean() > 0.9
    assert contacts == pytest.approx(left.contact_mean_squares, rel=1e-2)


def test_majorisation_never_raises_the_statistic(model):
    solution = model.minimum([])
    assert solution.statistic <= model.statistic(np.zeros(len(model.column_spectra)))
    for term in model.candidate_terms[::20]:
        assert model.minimum([term], solution.theta).statistic <= solution.statistic + 1e-6


def test_an_effect_that_dominates_is_selected_alone(pair, model):
    """It bends the model of the others."""
    selection = best_selection(model, pair.nominal_fit().hypothesis)
    assert [part.name for part in selection.candidates] == ["added_mass:barrel"]


def test_an_effect_takes_over_its_equal_at_one_place_alone(pair):
    """Two springs whose places the record does not tell apart are one; the fit without one of them starts from it."""
    spring = next(candidate for candidate in pair.candidates if candidate.name == "linear_spring:barrel")
    values, nominal = np.array([1936.0, 0.853, 178.0, 0.861]), pair.nominal_fit().hypothesis.misfit
    for place_deviation, expected in ((0.1, [2114.0, 0.853]), (0.001, [1936.0, 0.853])):
        covariance = np.diag(np.square([50.0, place_deviation, 50.0, place_deviation]))
        assert Hypothesis((spring, spring), values, covariance, nominal).values_of([0]) == pytest.approx(expected)


def test_a_set_of_which_a_part_cannot_stand_alone_loses_that_part(pair):
    """A spring of negative stiffness pushes a free barrel away once the spring that holds it is left out."""
    spring = next(candidate for candidate in pair.candidates if candidate.name == "linear_spring:barrel")
    springs, values = (spring, spring), np.array([300.0, 0.853, -200.0, 0.5])
    joint_fit = fit_briefly(pair, springs, np.array([300.0, 0.853, 1.0, 0.5]), pair.nominal_residual)
    hypothesis = Hypothesis(springs, values, np.eye(4) * 1e-12, joint_fit.hypothesis.misfit)
    remaining_fit, _ = reduced_and_variants(pair, replace(joint_fit, hypothesis=hypothesis))
    assert remaining_fit.hypothesis.effect_names in ((), ("linear_spring:barrel",))


@pytest.mark.study
def test_finds_both_effects_with_their_numbers(pair):
    best, *others = ranked_hypotheses(pair)
    assert sorted(best.effects) == ["added_mass", "contact_damping"]
    values = dict(zip(best.effects, best.values_by_candidate(), strict=True))
    assert values["added_mass"] == pytest.approx([MASS.mass_kg, MASS.relative_position], rel=0.03)
    assert values["contact_damping"] == pytest.approx([DAMPING.damping_n_s_per_m], rel=0.1)
    assert () in {one.effect_names for one in others}
    assert {("added_mass:barrel",), ("contact_damping:contact_1",)} <= {one.effect_names for one in others}
    assert all(one.cost > best.cost for one in others)


def test_names_nothing_where_nothing_is(recorded_machine):
    (nothing,) = ranked_hypotheses(search_of(recorded_machine(SETTINGS)))
    assert nothing.candidates == ()


@pytest.mark.study
def test_a_strong_base_motion_leads_to_what_stands_beside_it(recorded_machine):
    """Its spectrum is not fitted by Gauss-Newton: the mass is searched on the shaken rig."""
    shaking = ShakingBase(acceleration_rms_m_per_s2=1.4, low_hz=44.0, high_hz=66.0)
    best, *_ = ranked_hypotheses(
        search_of(recorded_machine(SETTINGS, AddedMass(mass_kg=0.2, relative_position=0.7), shaking))
    )
    values = dict(zip(best.effects, best.values_by_candidate(), strict=True))
    assert sorted(values) == ["added_mass", "base_motion"]
    assert values["added_mass"] == pytest.approx([0.2, 0.7], rel=0.05)
    assert values["base_motion"] == pytest.approx([1.4, 44.0, 66.0], rel=0.1)
