"""Where an unmeasured force is the rival of an effect, and where its companion; what prediction rules out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from identify.gaps.decision.bounds import NominalDifference, contact_force_share_bound
from identify.gaps.decision.comparison import (
    TEMPERATURE,
    ValidatedHypothesis,
    split_likelihood_ratio_p_value,
    with_model_averaged_covariance,
)
from identify.gaps.decision.judge import is_unmeasured_force_possible, with_birge_ratio_errors
from identify.gaps.decision.notes import Attempt
from identify.gaps.decision.null_reference import NullReference, NullSimulation
from identify.gaps.decision.predicted import prediction_checked_decision
from identify.gaps.decision.verdict import decide as decide_verdict
from identify.gaps.decision.verdict import is_force_at_effects
from identify.gaps.decision_table import Bounded, Evidence, Strength
from identify.gaps.residual.likelihood import Misfit, NominalVariances
from identify.gaps.results import Matters
from identify.gaps.rollout.results import Rollout
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force.location import ForcePlace
from rig.effects import effect_named, effects
from rig.effects.base import Scale
from rig.model.description import Station
from rig.simulation.reference import BarrelCradle

RIG = BarrelCradle(sensors="acceleration", noise_density=1e-3).rig()


@pytest.mark.parametrize(
    ("effect", "force", "is_rival"),
    [
        ("linear_spring:relative_position=0.8,body=cradle", ForcePlace("force", (Station("cradle", 0.82),)), True),
        ("linear_spring:relative_position=0.8,body=cradle", ForcePlace("force", (Station("cradle", 0.5),)), False),
        ("linear_spring:relative_position=0.8,body=cradle", ForcePlace("force", (Station("barrel", 0.8),)), False),
        ("sensor_gain:sensor={sensor},factor=1.1", ForcePlace("sensor", sensor_name="{sensor}"), True),
        ("common_gain:factor=1.1", ForcePlace("sensor", sensor_name="{sensor}"), False),
        ("youngs_modulus:factor=1.1", ForcePlace("distributed", body_names=("cradle",)), False),
    ],
)
def test_a_force_at_the_place_of_an_effect_is_its_rival(effect, force, is_rival):
    sensor = RIG.sensors[3].name
    rig = effect_named(effect.format(sensor=sensor)).applied_to(RIG)
    if force.sensor_name:
        force = ForcePlace("sensor", sensor_name=sensor)
    assert is_force_at_effects(force, RIG, rig) is is_rival


def test_a_pair_of_forces_at_a_contact_is_the_rival_of_another_law():
    rig = effect_named("contact_clearance:factor=1.1,contact=contact_1").applied_to(RIG)
    first, second = RIG.contacts
    assert is_force_at_effects(ForcePlace("pair", (first.at, first.against)), RIG, rig)
    assert not is_force_at_effects(ForcePlace("pair", (second.at, second.against)), RIG, rig)


ONES = np.ones((40, 6))


def misfit_of_level(level: float) -> Misfit:
    """A residual of this variance in every band of every sensor."""
    none = np.ones((20, 0))
    return Misfit(
        nominal_variances=NominalVariances(ONES, 0.5 * ONES, 1e3 * ONES, np.full(40, 50.0), ()),
        variance_by_second=np.full((20, 40, 6), level),
        variance_correction=ONES,
        contact_mean_square_by_second=none,
        contact_beyond_noise_n2=none,
        contact_force_n2=none,
        pulls=np.zeros(4),
        drift_cost=0.0,
        input_cost=0.0,
        line_cost=0.0,
        independent_sample_count=80.0,
    )


def validated_hypothesis(level: float, effect: str = "", share: float = 1.0) -> ValidatedHypothesis:
    """A hypothesis of one effect or none, so many times as strong as is typical, with an error of a tenth of that."""
    misfit = misfit_of_level(level)
    if not effect:
        nothing = Hypothesis((), np.zeros(0), np.zeros((0, 0)), misfit)
        return ValidatedHypothesis(nothing, RIG, RIG, misfit, misfit, 0.0)
    kind = effects()[effect]
    place = next(iter(kind.placements(RIG, [])))
    scale = Scale(RIG, 10.0, 30.0).with_place(place)
    candidate = Candidate(kind, place, kind.parameters(scale), kind.typical(scale))
    values = np.array([share * candidate.typical_values[0], *candidate.typical_values[1:]])
    covariance = np.diag((0.1 * np.abs(candidate.typical_values)) ** 2)
    hypothesis = Hypothesis((candidate,), values, covariance, misfit)
    return ValidatedHypothesis(hypothesis, RIG, RIG, misfit, misfit_of_level(60.0), 0.0)


MASS, SPRING = validated_hypothesis(1.5, "added_mass"), validated_hypothesis(1.52, "linear_spring")
NOMINAL = validated_hypothesis(60.0)


def null_reference(share_by_band):
    machines = (NullSimulation(x, 0.0, 1.0, share_by_band, 0.0, ()) for x in np.linspace(-9, 9, 12))
    return NullReference("key", tuple(machines))


NULLS = null_reference((0.0,))
DIFFERENCE = NominalDifference(1e-9, Bounded("motion", "1", 0.2, 0.3, 5e-3), ())


def decide(ranked, vetoed):
    return decide_verdict(ranked, DIFFERENCE, NULLS, Matters(), None, vetoed)


@pytest.mark.parametrize(("bands_left", "growth"), [(0, 1.0), (15, 1.0), (25, 3.0)])
def test_what_a_set_leaves_in_most_of_the_motion_enters_its_standard_errors(bands_left, growth):
    mass = validated_hypothesis(1.0, "added_mass")
    level_by_band = np.where(np.arange(40) < bands_left, 5.0, 1.0)
    misfit = replace(mass.misfit, variance_by_second=np.tile(level_by_band[None, :, None], (20, 1, 6)))
    nulls = null_reference(tuple(mass.misfit.share_by_band))
    grown = with_birge_ratio_errors(replace(mass, misfit=misfit), nulls).hypothesis.covariance
    np.testing.assert_allclose(np.sqrt(np.diag(grown) / np.diag(mass.hypothesis.covariance)), growth, rtol=1e-6)


def test_intervals_hold_what_rivals_of_some_probability_say():
    """Of two rivals as likely, the deviation counts half; of one without the effect, or of no probability, nothing."""
    mass, other = validated_hypothesis(1.0, "added_mass"), validated_hypothesis(1.0, "linear_spring")
    moved = replace(mass, hypothesis=replace(mass.hypothesis, values=np.add(mass.hypothesis.values, [0.3, 0.1])))
    unlikely = replace(moved, log_prior=moved.log_prior - 60.0)

    def variances(*rivals):
        spread, *_ = with_model_averaged_covariance([mass, other, validated_hypothesis(1.0), *rivals])
        return np.diag(spread.hypothesis.covariance) - np.diag(mass.hypothesis.covariance)

    np.testing.assert_allclose(variances(), 0.0)
    np.testing.assert_allclose(variances(unlikely), 0.0, atol=1e-12)
    np.testing.assert_allclose(variances(moved), [0.045, 0.005])


def test_a_value_at_its_limit_has_the_spread_of_its_rivals_too():
    mass = validated_hypothesis(1.0, "added_mass")
    at_limit = replace(mass, hypothesis=replace(mass.hypothesis, covariance=np.diag([1.0, 0.0])))
    moved = replace(mass, hypothesis=replace(mass.hypothesis, values=np.add(mass.hypothesis.values, [0.3, 0.1])))
    spread, _ = with_model_averaged_covariance([at_limit, moved])
    np.testing.assert_allclose(np.diag(spread.hypothesis.covariance), [1.045, 0.005])


def test_two_effects_of_one_name_are_paired_with_the_nearest():
    mass = validated_hypothesis(1.0, "added_mass")
    values, (candidate,) = mass.hypothesis.values, mass.hypothesis.candidates
    both = replace(
        mass.hypothesis,
        candidates=(candidate, candidate),
        values=np.concatenate([np.add(values, [0.5, 0.4]), np.add(values, [0.02, 0.0])]),
        covariance=np.eye(4),
    )
    spread, _ = with_model_averaged_covariance([mass, replace(mass, hypothesis=both)])
    increase = spread.hypothesis.covariance - mass.hypothesis.covariance
    np.testing.assert_allclose(increase, [[0.5 * 0.02**2, 0.0], [0.0, 0.0]], atol=1e-15)
    _, spread_of_both = with_model_averaged_covariance([mass, replace(mass, hypothesis=both)])
    np.testing.assert_allclose(np.diag(spread_of_both.hypothesis.covariance), [1.0, 1.0, 1 + 0.5 * 0.02**2, 1.0])


@pytest.mark.parametrize(("squared_share", "value"), [(0.25, 0.5), (4.0, None)])
def test_a_share_above_the_whole_force_is_not_seen(squared_share, value):
    bound = contact_force_share_bound("force of contact_1", np.full(20, squared_share), 1e-6, 0.03)
    assert (bound.value, bound.not_seen) == (value, value is None)


def ruling_out(*worse):
    return lambda one: Attempt(Rollout(code="no_improvement" if any(one is w for w in worse) else "not_vetoed"))


def test_a_likely_rival_takes_the_place_of_what_prediction_rules_out():
    ranked = [MASS, SPRING, NOMINAL]
    unvetoed = prediction_checked_decision(ranked, decide, ruling_out())
    assert unvetoed.decision.named_hypothesis is MASS
    assert not unvetoed.ruled_out
    without_mass = prediction_checked_decision(ranked, decide, ruling_out(MASS))
    assert without_mass.decision.named_hypothesis is SPRING
    assert without_mass.decision.corrects_rig
    assert without_mass.ruled_out == (MASS,)
    assert not without_mass.is_vetoed


@pytest.mark.parametrize(
    ("short_sets", "named", "ruled_out"), [((MASS,), SPRING, (MASS,)), ((MASS, SPRING), MASS, ())], ids=["mass", "both"]
)
def test_a_likely_rival_that_predicts_as_expected_takes_the_place_of_one_that_falls_short(short_sets, named, ruled_out):
    def predict(named_set):
        return Attempt(Rollout(code="not_vetoed", falls_short=any(named_set is short for short in short_sets)))

    outcome = prediction_checked_decision([MASS, SPRING, NOMINAL], decide, predict)
    assert outcome.decision.named_hypothesis is named
    assert outcome.decision.corrects_rig
    assert outcome.ruled_out == ruled_out


def test_a_veto_stays_where_no_other_effect_was_likely():
    nothing_told = validated_hypothesis(1.52, "linear_spring", 0.1)
    for ranked, worse in (
        ([MASS, SPRING, NOMINAL], (MASS, SPRING)),
        ([MASS, validated_hypothesis(5.0, "linear_spring"), NOMINAL], (MASS,)),
        ([MASS, nothing_told, NOMINAL], (MASS,)),
    ):
        outcome = prediction_checked_decision(ranked, decide, ruling_out(*worse))
        assert outcome.is_vetoed
        assert outcome.decision.named_hypothesis is MASS
        assert not outcome.decision.corrects_rig
        assert not outcome.ruled_out


@pytest.mark.parametrize(("share_alone", "named_alone"), [(1.0, True), (0.1, False)])
def test_an_effect_that_a_pair_names_stands_alone_only_where_it_is_named_there(share_alone, named_alone):
    mass, weak_spring = MASS.hypothesis, validated_hypothesis(1.5, "linear_spring", 0.1).hypothesis
    pair_hypothesis = Hypothesis(
        mass.candidates + weak_spring.candidates,
        np.concatenate([mass.values, weak_spring.values]),
        block_diag(mass.covariance, weak_spring.covariance),
        mass.misfit,
    )
    pair, alone = replace(MASS, hypothesis=pair_hypothesis), validated_hypothesis(1.52, "added_mass", share_alone)
    decision = decide([pair, alone, NOMINAL], vetoed=False)
    assert decision.evidence.named == (mass.candidates[0].name,)
    assert decision.named_hypothesis is (alone if named_alone else pair)


def test_what_the_named_effect_changes_is_bounded_beside_it():
    """The nominal rig, its tolerances fitted, leaves little; with the tolerances as beside the mass it leaves much."""
    named = decide([MASS, NOMINAL], vetoed=False).evidence
    assert named.quantities_beside[0].value == MASS.nominal_misfit.unexplained_share
    unnamed = decide([validated_hypothesis(1.0, "added_mass", 0.1), NOMINAL], vetoed=False).evidence
    assert not unnamed.named
    assert not unnamed.quantities_beside


def weighted(level, cost, effect="added_mass"):
    """A hypothesis that leaves this level of the record held back, and has this cost on the one that was fitted."""
    validated = validated_hypothesis(level, effect)
    fitted_misfit = replace(validated.misfit, drift_cost=cost - validated.misfit.minus_two_log)
    return replace(validated, hypothesis=replace(validated.hypothesis, misfit=fitted_misfit))


def test_the_split_p_value_is_that_of_the_mixture_by_the_fitted_record():
    nominal, right, wrong = validated_hypothesis(1.2), weighted(1.0, 0.0), weighted(1.2, 600.0, "linear_spring")
    gain = nominal.misfit.minus_two_log - right.misfit.minus_two_log
    assert gain > 20
    alone = split_likelihood_ratio_p_value([nominal, right])
    assert alone == pytest.approx(np.exp(-gain / (2 * TEMPERATURE)))
    assert split_likelihood_ratio_p_value([nominal, right, wrong, wrong]) == pytest.approx(alone, rel=1e-6)
    preferred_wrongly = [nominal, weighted(1.0, 600.0), weighted(1.2, 0.0, "linear_spring")]
    assert split_likelihood_ratio_p_value(preferred_wrongly) == pytest.approx(1.0, rel=1e-6)
    assert split_likelihood_ratio_p_value([nominal]) == 1.0


@pytest.mark.parametrize(
    ("upper", "p_value_after", "is_named", "looks"),
    [
        (0.4, 1e-8, True, True),
        (0.4, 0.5, True, False),
        (0.4, 1e-8, False, False),
        (0.6, 0.5, True, False),
        (0.6, 1e-8, False, True),
    ],
)
def test_a_small_effect_that_leaves_more_than_noise_has_an_unmeasured_force_as_rival(
    upper, p_value_after, is_named, looks
):
    """A drag too small to matter was called a damper, as no force by another law was tried."""
    motion = Bounded("motion", "1", 0.3, upper, 0.5)
    strength = Strength("ground_damper", 0.99 if is_named else 0.5, (3.9, 5.4), 0.0)
    evidence = Evidence(
        p_value=1e-9,
        quantities=(motion,),
        strengths=(strength,),
        p_value_after=p_value_after,
        quantities_after=(motion,),
        removed=0.4,
    )
    assert is_unmeasured_force_possible(evidence) is looks
