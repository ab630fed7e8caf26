"""Scores of one answer: what is recalled, what is false, what is covered, and whether the verdict is right."""

import itertools

import pytest

from tests.campaigns.score_effects import Estimate, Named, TrueOne
from tests.campaigns.score_sets import not_answered, score_set, true_ones, verdict_right
from tests.test_campaigns.blind_cases import case, effect

VERDICTS = ("consistent", "cannot_tell", "small", "explained", "partly_explained", "unexplained")


def mass(grams, at, above=True, body="barrel", **more):
    whole = {"mass_kg": grams / 1e3, "relative_position": at}
    return TrueOne(
        name="added_mass", place={"body": body, "position_m": at}, whole=whole, above=above, length_m=1.0, **more
    )


def a_mass(grams, at, error=0.1, body="barrel"):
    values = {"mass_kg": Estimate(grams / 1e3, error / 1e3), "relative_position": Estimate(at, 0.005)}
    return (Named(name="added_mass", place={"body": body}, values=values),)


def law(name, contact="contact_1", above=True, **whole):
    return TrueOne(name=name, place={"contact": contact}, whole=whole, above=above)


def a_law(name, contact="contact_1", **values):
    return Named(name=name, place={"contact": contact}, values={k: Estimate(*v) for k, v in values.items()})


CLEARANCE = law("contact_clearance", factor=1.058)
FOUND = (a_law("contact_clearance", factor=(1.060, 0.002)),)
DRAG = TrueOne(
    name="quadratic_drag",
    place={"body": "barrel", "position_m": 0.9},
    above=True,
    library=False,
    stand_ins=("ground_damper",),
)


def test_two_masses_on_a_body_are_each_recalled():
    score = score_set([mass(9.3, 0.3), mass(11.9, 0.9)], [a_mass(12.0, 0.89), a_mass(9.25, 0.305)], "explained")
    assert (score.visible, score.recalled, score.false_names, score.verdict_right) == (2, 2, 0, True)
    assert (score.parameters, score.covered) == (4, 3)  # 0.89 is two standard errors off


def test_masses_too_close_to_be_told_apart_may_be_named_as_one():
    """11.9 g at 0.542 and 9.3 g at 0.488 m: 21.2 g at 0.518 m."""
    score = score_set([mass(11.9, 0.542), mass(9.3, 0.488)], [a_mass(21.3, 0.516)], "explained")
    assert (score.recalled, score.false_names, score.named_of_all) == (2, 0, 2)
    assert (score.parameters, score.covered) == (2, 2)
    far = score_set([mass(11.9, 0.542), mass(9.3, 0.488)], [a_mass(21.3, 0.8)], "explained")
    assert (far.recalled, far.false_names, far.verdict_right) == (0, 1, False)


def test_masses_farther_apart_meet_in_their_centre():
    score = score_set([mass(10.0, 0.40), mass(10.0, 0.56)], [a_mass(20.5, 0.48)], "explained")
    assert (score.recalled, score.false_names) == (2, 0)
    assert score_set([mass(10.0, 0.40), mass(10.0, 0.56)], [a_mass(60.0, 0.48)], "explained").false_names == 1


def test_a_weak_cable_need_not_be_named_and_may_be():
    cables = [mass(4.0, 0.2, above=False, uncounted=True), mass(5.0, 0.7, above=False, uncounted=True, body="cradle")]
    silent = score_set([CLEARANCE, *cables], [FOUND], "explained")
    named = score_set([CLEARANCE, *cables], [FOUND, a_mass(5.1, 0.71, body="cradle")], "explained")
    assert (silent.verdict_right, named.verdict_right) == (True, True)
    assert (silent.visible, silent.recalled, silent.true_effects, silent.named_of_all) == (1, 1, 3, 1)
    assert (named.recalled, named.false_names, named.named_of_all) == (1, 0, 2)


def test_a_stiffness_beside_a_power_law_is_part_of_it_if_the_reference_force_says_so():
    """1.3 times the stiffness under the exponent 1.5 is a reference force of 20 N / 1.3^3 = 9.1 N."""
    hertz = law("hertz_stop", exponent=1.5, reference_force_n=20.0)

    def score(reference_n, contact="contact_1"):
        named = a_law("hertz_stop", exponent=(1.49, 0.02), reference_force_n=(reference_n, 2.0))
        return score_set([hertz, law("contact_stiffness", contact, factor=1.3)], [(named,)], "explained")

    assert (score(10.0).recalled, score(10.0).verdict_right) == (2, True)
    assert (score(20.0).recalled, score(20.0).verdict_right) == (1, False)
    assert score(10.0, "contact_2").recalled == 1


def test_two_stops_are_the_same_in_either_numbers():
    """1.7 times both and 2.0 times the lower one are 3.4 times the lower and 1.7 times the upper one."""
    both = law("contact_stiffness", factor=1.7)
    lower = TrueOne(name="one_stop", place={"contact": "contact_1", "side": "lower"}, whole={"factor": 2.0}, above=True)

    def stop(side, *factor):
        place = {"contact": "contact_1", "side": side}
        return (Named(name="one_stop", place=place, values={"factor": Estimate(*factor)}),)

    by_stop = score_set([both, lower], [stop("lower", 3.42, 0.05), stop("upper", 1.71, 0.05)], "explained")
    together = [(a_law("contact_stiffness", factor=(1.71, 0.05)),), stop("lower", 2.01, 0.05)]
    as_drawn = score_set([both, lower], together, "explained")
    for score in (by_stop, as_drawn):
        assert (score.recalled, score.false_names, score.verdict_right, score.covered) == (2, 0, True, 2)
    wrong = score_set([both, lower], [stop("lower", 2.0, 0.05), stop("upper", 1.71, 0.05)], "explained")
    assert (wrong.recalled, wrong.covered) == (2, 1)


def test_the_wrong_contact_body_or_side_is_a_false_name():
    wrong = (a_law("contact_clearance", "contact_2", factor=(1.06, 0.01)),)
    score = score_set([CLEARANCE], [wrong], "explained")
    assert (score.recalled, score.false_names, score.parameters, score.verdict_right) == (0, 1, 0, False)
    side = TrueOne(name="one_stop", place={"contact": "contact_1", "side": "upper"}, whole={"factor": 2.0}, above=True)
    lower = Named(name="one_stop", place={"contact": "contact_1", "side": "lower"})
    assert score_set([side], [(lower,)], "explained").false_names == 1


def test_all_contacts_may_be_named_one_by_one():
    both = law("contact_damping", "all", damping_n_s_per_m=10.0)
    each = [(a_law("contact_damping", f"contact_{k}", damping_n_s_per_m=(10.1, 0.2)),) for k in (1, 2)]
    contacts = ("contact_1", "contact_2")
    assert score_set([both], each, "explained", contacts).recalled == 1
    half = score_set([both], each[:1], "partly_explained", contacts)
    assert (half.recalled, half.false_names) == (0, 1)
    assert score_set([both], [(a_law("contact_damping", "all"),)], "explained", contacts).recalled == 1


def test_of_look_alikes_one_has_to_be_right():
    softer = Named(name="youngs_modulus", place={"beam": "cradle"}, values={"factor": Estimate(0.988, 0.003)})
    clamp = Named(name="clamp_compliance", place={"beam": "cradle"}, values={"compliance": Estimate(0.01, 0.002)})
    true = TrueOne(name="clamp_compliance", place={"beam": "cradle"}, whole={"compliance": 0.013}, above=True)
    score = score_set([true], [(softer, clamp)], "explained")
    assert (score.recalled, score.false_names, score.parameters, score.covered) == (1, 0, 1, 1)


def test_a_band_is_right_if_it_overlaps_by_half():
    true = TrueOne(name="base_motion", whole={"low_hz": 10.0, "high_hz": 14.0}, above=True)

    def found(low, high):
        return (Named(name="base_motion", values={"low_hz": Estimate(low, 0.1), "high_hz": Estimate(high, 0.1)}),)

    assert score_set([true], [found(10.5, 15.0)], "explained").recalled == 1
    assert score_set([true], [found(13.0, 20.0)], "explained").recalled == 0


def test_one_true_effect_is_not_recalled_by_two_names():
    score = score_set([mass(10.0, 0.5)], [a_mass(5.0, 0.49), a_mass(5.0, 0.51)], "explained")
    assert (score.recalled, score.false_names) == (1, 1)


def test_stand_ins_of_what_is_outside_are_no_false_names():
    damper = (Named(name="ground_damper", place={"body": "barrel"}),)
    part = score_set([DRAG], [damper], "partly_explained")
    assert (part.false_names, part.visible, part.verdict_right) == (0, 0, True)
    elsewhere = score_set([DRAG], [(Named(name="ground_damper", place={"body": "cradle"}),)], "partly_explained")
    assert elsewhere.false_names == 1


@pytest.mark.parametrize(
    ("truths", "recalled", "names", "false", "right"),
    [
        ([], 0, 0, 0, {"consistent", "cannot_tell", "small"}),
        ([], 0, 1, 1, {"consistent", "cannot_tell"}),
        ([mass(3.0, 0.5, above=False)], 0, 1, 0, {*VERDICTS} - {"unexplained"}),
        ([CLEARANCE], 1, 1, 0, {"explained"}),
        ([CLEARANCE], 1, 2, 1, set()),
        ([CLEARANCE], 0, 0, 0, set()),
        ([CLEARANCE, mass(50.0, 0.5)], 1, 1, 0, {"partly_explained"}),
        ([CLEARANCE, mass(50.0, 0.5)], 2, 2, 0, {"explained"}),
        ([DRAG], 0, 0, 0, {"partly_explained", "unexplained"}),
        ([DRAG], 0, 1, 0, {"explained", "partly_explained", "unexplained"}),
    ],
)
def test_the_verdict_is_right_by_the_decision_table(truths, recalled, names, false, right):
    assert {v for v in VERDICTS if verdict_right(truths, recalled, names, false, v)} == right


def test_the_order_of_names_and_truths_does_not_matter():
    truths = [mass(9.3, 0.3), mass(11.9, 0.9), CLEARANCE, mass(5.0, 0.34, above=False)]
    names = [a_mass(12.0, 0.89), a_mass(14.3, 0.31), FOUND]
    scores = set()
    for t, n in itertools.product(itertools.permutations(truths), itertools.permutations(names)):
        score = score_set(t, n, "explained")
        found = {true.whole.get("mass_kg"): named for true, named in zip(t, score.found, strict=True)}
        scores.add((tuple(sorted(found.items(), key=str)), score.false_names, score.parameters, score.covered))
    assert len(scores) == 1


def test_of_masses_that_look_alike_the_one_on_the_right_body_is_meant():
    either = (*a_mass(10.1, 0.5, body="cradle"), *a_mass(10.1, 0.5))
    score = score_set([mass(10.0, 0.5)], [either], "explained")
    assert (score.recalled, score.false_names) == (1, 0)
    assert dict(score.errors) == pytest.approx({"added_mass.mass_kg": 1.0, "added_mass.relative_position": 0.0})


def test_what_was_refused_names_nothing():
    score = not_answered([CLEARANCE, DRAG])
    assert (score.visible, score.recalled, score.false_names, score.verdict_right) == (1, 0, 0, False)
    assert not score.true_alone


def test_what_is_true_of_a_case_is_the_whole_deviation():
    put_in = effect("added_mass", {"body": "barrel", "position_m": 0.5}, mass_kg=0.2, relative_position=0.5)
    (true,) = true_ones(case("single", put_in), [True])
    assert (true.whole, true.length_m, true.library) == (put_in.parameters, 1.0, True)
