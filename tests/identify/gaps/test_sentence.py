"""The words of a diagnosis: sentence, next steps, intervals and probabilities."""

import re

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.bounds import contact_force_share_bound
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision_table import Bounded, Strength
from identify.gaps.page.advice import next_steps, place, unexplained_ranges_hz
from identify.gaps.results import Band, Gap
from identify.gaps.wording import (
    bound_words,
    error_change_words,
    interval,
    probability,
    removed_share_words,
    verdict_words,
)
from identify.pages.wording import COVERED, percent
from rig.model.unmeasured_force import UnmeasuredForce, Value


def test_the_sentence_is_made_of_what_gap_json_says(diagnosis):
    assert sentence(msgspec.json.decode(msgspec.json.encode(diagnosis), type=Gap)) == diagnosis.sentence


def test_the_sentence_begins_with_effect_value_and_place(gaps):
    begin = "An added mass of 0.1414 ± 0.0021 kg on the barrel at 0.9899 ± 0.0041 m"
    assert gaps["explained"].sentence.startswith(f"{begin} explains the difference: with it")
    assert gaps["partly_explained"].sentence.startswith(f"{begin} explains the difference in part: it removes 87.0 %")
    assert gaps["small"].sentence.startswith(f"{begin} is there, too small to matter")
    cables = "An added mass of 0.01200 ± 0.00020 kg on the barrel at 0.9110 ± 0.0039 m and an added mass of"
    assert gaps["cables"].sentence.startswith(cables)


def test_a_veto_is_said(gaps):
    assert gaps["vetoed"].verdict == "unexplained"
    assert "predicts the measured motion worse than without" in gaps["vetoed"].sentence
    assert "corrected rig.json" not in " ".join(next_steps(gaps["vetoed"]))


def test_shares_that_noise_hides_are_no_numbers(gaps):
    before = gaps["vetoed"].before
    hidden = replace(before, share=0.0, contact_shares=dict.fromkeys(before.contact_shares, 0.0))
    evidence = replace(gaps["vetoed"].evidence, removed=0.87)
    said = sentence(replace(gaps["vetoed"], before=hidden, evidence=evidence))
    assert "noise hides by how much" in said
    assert "removes 87.0 % of what strains its tolerances" in said
    nothing = replace(evidence, removed=0.0)
    assert "removes nothing that is seen" in sentence(replace(gaps["vetoed"], before=hidden, evidence=nothing))
    assert "0.0 %" not in said


def test_an_effect_that_a_tolerance_would_take_up_is_said_without_shares(gaps):
    before = replace(gaps["cables"].before, share=0.0, contact_shares={}, largest_pull=4.84)
    said = sentence(replace(gaps["cables"], before=before))
    assert "which a tolerance would have to take up without them: it would be off by 4.8 standard" in said
    assert "0.0 %" not in said


def test_what_tolerances_take_up_of_a_named_effect_is_said(gaps):
    evidence = gaps["explained"].evidence
    little = tuple(replace(bound, value=2e-3, upper=3e-3, why="") for bound in evidence.quantities)
    changed = tuple(replace(bound, value=0.066, upper=0.07, why="") for bound in evidence.quantities[:1])
    hidden = replace(evidence, quantities=little, quantities_beside=changed)
    assert hidden.verdict == "explained"
    said = sentence(replace(gaps["explained"], evidence=hidden))
    assert "; tolerances take up the rest of the 6.6 % of the motion that it changes." in said
    assert "take up" not in gaps["explained"].sentence


def test_a_small_difference_without_a_name_is_described(gaps):
    drag = gaps["unexplained"].unknown
    assert drag is not None
    likeliest = f"the likeliest, {gaps['small'].causes[0].words[0]}"
    for chance, lower, reason in (
        (0.4, 0.1, "named for it"),
        (0.8, 0.1, f"{likeliest}, has a probability of 80.0 %"),
        (0.99, -0.1, f"{likeliest}, may be nothing: its interval includes no change"),
    ):
        causes = tuple(
            replace(
                cause,
                probability=chance if rank == 0 else 0.0,
                strengths=tuple(
                    replace(one, inclusion_probability=chance, interval_95=(lower, 0.2)) for one in cause.strengths
                ),
            )
            for rank, cause in enumerate(gaps["small"].causes)
        )
        evidence = replace(gaps["small"].evidence, strengths=causes[0].strengths)
        said = sentence(replace(gaps["small"], causes=causes, evidence=evidence, unknown=drag))
        assert "No effect of the library is " in said
        assert f"{reason}. The difference looks like" in said


def test_what_may_stand_in_the_place_of_an_effect_is_said(gaps):
    mass, clamp = gaps["explained"].causes[0].words[0], gaps["explained"].causes[1].words[0]
    assert f"Instead of {mass} it may be {clamp}: these records hardly tell them apart." in gaps["explained"].sentence
    assert "hardly tell" not in gaps["pair"].sentence


def test_what_keeps_an_explanation_from_being_used_as_it_is_stands_beside_the_verdict(gaps):
    assert verdict_words(gaps["explained"]) == "explained, but another cause fits as well"
    assert verdict_words(gaps["pair"]) == "explained, but the records differ"
    assert verdict_words(gaps["cables"]) == "explained"


def test_what_to_do_depends_on_the_verdict(gaps):
    steps = {name: " ".join(next_steps(gap)) for name, gap in gaps.items()}
    assert "Nothing needs to be done" in steps["consistent"]
    assert "corrected rig.json" in steps["explained"]
    assert "To test for clamp compliance: measure close to the clamp." in steps["explained"]
    for word in ("better rig, not as the right one", "the cradle near 0.80 m", "50.02 Hz", "weigh the part"):
        assert word in steps["partly_explained"]
    for word in ("Do not rely on rig.json", "the barrel near 0.89 m", "follows the displacement"):
        assert word in steps["unexplained"]
    assert "corrected" not in steps["unexplained"]


@pytest.mark.parametrize(("scatter", "limit"), [(6.4e-4, 0.022), (1.2e-3, 0.022), (1.2e-3, 0.024)])
def test_a_longer_record_is_asked_for_by_the_length_that_settles_the_matter(gaps, scatter, limit):
    """As many seconds that scatter as these do bound the force below what matters."""
    squares = scatter * np.sqrt(np.arange(1, 9) / 8)
    squares += 4e-4 - squares.mean()
    bound = contact_force_share_bound("force of contact_1", squares, 0.0, limit)
    assert bound.not_seen
    evidence = replace(gaps["cannot_tell"].evidence, quantities=(bound,))
    unsure = replace(gaps["cannot_tell"], evidence=evidence, not_seen=(bound,))
    times = re.search("Record about (twice|[0-9]+ times) as long", " ".join(next_steps(unsure)))[1].split()[0]
    assert contact_force_share_bound(
        "force of contact_1", np.tile(squares, 2 if times == "twice" else int(times)), 0.0, limit
    ).holds
    hidden = replace(evidence, quantities=(replace(bound, upper=None, why="noise hides it"),))
    assert "Record longer or excite more strongly" in " ".join(next_steps(replace(unsure, evidence=hidden)))


def test_a_rest_in_the_force_of_a_contact_leads_to_it_and_is_named_with_its_limit(gaps):
    gap = gaps["partly_explained"]
    bands = tuple(replace(band, after=0.0) for band in gap.bands)
    after = replace(gap.after, share=1e-3, contact_shares={"contact_1": 0.01, "contact_2": 0.036})
    rest = replace(gap, bands=bands, after=after)
    assert "3.6 % of the force of contact_2 (3.0 % matters) stays unexplained." in sentence(rest)
    motion = Bounded("motion", "1", 1e-3, 5.8e-3, 5e-3)
    unbounded = replace(
        rest, after=replace(after, contact_shares={}), evidence=replace(gap.evidence, quantities_after=(motion,))
    )
    assert "the motion (0.1 % unexplained, at most 0.6 %; 0.5 % matters) stays unsettled." in sentence(unbounded)
    step = "Look at contact_2: the rest lies in its force, of which 3.6 % is unexplained."
    assert any(text.startswith(step) and "lateral_motion" in text for text in next_steps(rest))


def test_a_description_that_explains_little_is_a_hint(gaps):
    gap = gaps["partly_explained"]
    little = replace(gap, unknown=replace(gap.unknown, explained=0.165))
    steps = " ".join(next_steps(little))
    assert (
        "hint, as it explains only 16.5 % of the mean square of what is left: look at the cradle near 0.80 m" in steps
    )
    assert "switch motors" not in steps
    said = sentence(little)
    nearest = f"the nearest explains 16.5 % of its mean square: {gap.unknown.sentence}."
    assert f"The rest has no simple form; {nearest}" in said
    assert f"The rest looks like {gap.unknown.sentence}." in gap.sentence


def test_what_is_left_is_named_by_its_frequencies(gaps):
    gap = gaps["partly_explained"]
    after_and_usual = [(0.1, 0.2), (0.1, 0.01), (0.1, 0.01), (0.001, 0.0), (0.1, 0.0)] + 8 * [(0, 0)]
    bands = tuple(
        Band(low_hz=2.0 * i, high_hz=2.0 * i + 2, before=0.1, after=after, usual=usual)
        for i, (after, usual) in enumerate(after_and_usual)
    )
    assert unexplained_ranges_hz(replace(gap, bands=bands)) == [(2.0, 10.0)]
    assert unexplained_ranges_hz(replace(gap, bands=bands[:1])) == []


def test_an_interval_has_two_digits_of_its_half_width():
    for value, half, unit, said in (
        (0.1414, 0.0021, "kg", "0.1414 ± 0.0021 kg"),
        (1.0, 0.034, "1", "1.000 ± 0.034"),
        (123456.0, 1200.0, "N/m", "123500 ± 1200 N/m"),
        (-0.5, 0.0999, "m", "-0.50 ± 0.10 m"),
        (1.83e-4, 7.8e-6, "s", "(1.830 ± 0.078)e-4 s"),
        (2.96e10, 8e8, "N/m^3", "(2.960 ± 0.080)e10 N/m³"),
        (0.0, 0.25, "N", "0.00 ± 0.25 N"),
        (-0.001, 0.25, "N", "0.00 ± 0.25 N"),
    ):
        assert interval(Value(value, half / COVERED, unit)) == said


@pytest.mark.parametrize("error", [0.0, float("nan"), float("inf")])
def test_no_interval_is_claimed_where_there_is_none(error):
    assert interval(Value(0.25, error, "N")) == "0.2500 N (no interval)"


def test_nothing_is_said_to_be_certain():
    assert percent(0.0004) == "< 0.1 %"
    assert percent(0.99996) == "> 99.9 %"
    assert percent(0.934) == "93.4 %"


def test_what_closes_nothing_is_said_to_close_nothing(gaps):
    cause = gaps["pair"].causes[0]
    assert removed_share_words(cause) == "94.0 % (91.0 to 96.0 %)"
    assert removed_share_words(replace(cause, explained=0.02, interval_95=(-0.1, 0.2))) == "nothing"
    assert probability(1.0) == "> 99.9 %"


def test_a_bound_of_zero_is_less_than_a_tenth_of_a_per_cent(gaps):
    evidence = gaps["small"].evidence
    quantities = tuple(replace(bound, upper=0.0) if bound.name != "motion" else bound for bound in evidence.quantities)
    said = sentence(replace(gaps["small"], evidence=replace(evidence, quantities=quantities)))
    assert "that of the force of contact_1 less than 0.1 %" in said
    assert "0.0 %" not in said


@pytest.mark.parametrize(
    ("upper", "words"), [(0.005019, "0.5019 %"), (0.0051, "0.51 %"), (0.006, "0.6 %"), (0.004999, "0.5 %")]
)
def test_a_bound_above_its_limit_does_not_read_as_the_limit(upper, words):
    told = bound_words(Bounded("motion", "1", 0.0, upper, 0.005))
    assert told == f"the motion (< 0.1 % unexplained, at most {words}; 0.5 % matters)"


def test_a_mass_has_no_place_along_it():
    force = UnmeasuredForce(
        sentence="", kind="force", body="carriage", position_m=0.0, band_hz=(1.0, 2.0), rms_n=1.0, explained=0.9
    )
    assert place(force) == "the carriage"
    assert place(replace(force, body="barrel", position_error_m=0.01)) == "the barrel near 0.00 m"
    pair = replace(force, body="barrel", position_error_m=0.0, against_body="cradle", against_position_m=0.45)
    assert place(pair) == "the barrel near 0.00 m and the cradle near 0.45 m"


def test_a_likelier_cause_with_the_named_effect_and_one_of_uncertain_size_is_said(gaps):
    gap = gaps["partly_explained"]
    named, friction = gap.causes[0], "a dry friction of 0.8 ± 1.1 N in contact_2"
    uncertain = Strength("coulomb_friction:contact_2", 0.984, (-0.3, 1.9), 0.0, ())
    fuller = replace(
        named,
        effects=(*named.effects, "coulomb_friction"),
        words=(*named.words, friction),
        strengths=(*named.strengths, uncertain),
        probability=0.984,
        explained=0.93,
    )
    told = sentence(replace(gap, causes=(named, fuller)))
    assert f"Beside it there may be {friction}, of uncertain size (98.4 %): together they remove 93.0 %." in told
    two = replace(
        fuller, words=(*fuller.words, "a tone"), strengths=(*fuller.strengths, replace(uncertain, effect="tone:all"))
    )
    assert f"Beside it there may be {friction} and a tone, of uncertain size" in sentence(
        replace(gap, causes=(named, two))
    )
    assert "of uncertain size" not in sentence(replace(gap, causes=(named, replace(fuller, probability=0.4))))
    assert "of uncertain size" not in gap.sentence


def test_a_quantity_that_stays_unsettled_is_that_of_the_corrected_rig(gaps):
    """Its value of the rig as it is stood beside the values without and with the cause as a third one."""
    gap = gaps["cables"]
    before = Bounded("force of contact_2", "1", 0.0, 0.045, 3e-2)
    after = replace(before, value=0.016, upper=0.037)
    evidence = replace(gap.evidence, quantities=(*gap.evidence.quantities[:1], before), quantities_after=(after,))
    said = sentence(replace(gap, evidence=evidence, not_seen=(before,)))
    assert said.endswith(
        "Not tested to your limit: the error of the force of contact_2 is at most 3.7 %, you asked for 3.0 %."
    )
    assert "4.5 %" not in said


def test_a_band_whose_share_of_the_motion_is_small_is_not_said_to_matter(gaps):
    """A limit of the whole motion was held against shares of bands."""
    gap = gaps["partly_explained"]
    bands = [Band(low_hz=2.0 * i, high_hz=2.0 * i + 2, before=0.2, after=0.0, usual=0.01) for i in range(30)]
    bands[2] = replace(bands[2], after=0.1, motion_share=0.9)
    bands[20] = replace(bands[20], after=0.1, motion_share=0.01)
    assert unexplained_ranges_hz(replace(gap, bands=tuple(bands))) == [(4.0, 6.0)]
    at_noise_level = replace(gap, evidence=replace(gap.evidence, p_value_after=0.3))
    assert unexplained_ranges_hz(replace(at_noise_level, bands=tuple(bands))) == []


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (0.0, 0.016, "of the motion rises from < 0.1 % to 1.6 %"),
        (0.016, 0.0, "of the motion falls from 1.6 % to < 0.1 %"),
        (0.0161, 0.0159, "of the motion stays at 1.6 %"),
    ],
)
def test_an_error_that_rises_is_not_said_to_fall(gaps, before, after, words):
    shares = replace(gaps["explained"].before, share=before, contact_shares={"contact_1": 0.0})
    assert error_change_words(shares, replace(shares, share=after)) == f"the error {words}"
