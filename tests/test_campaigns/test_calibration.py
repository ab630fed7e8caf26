"""Probabilities against answers, by hand."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.comparison import PRIOR_NOTHING, PRIOR_UNKNOWN
from identify.gaps.decision.verdict import FORCE_PLACE_COUNT
from tests.campaigns.calibration import (
    Hypotheses,
    brier,
    calibrated,
    calibrated_temperature,
    hypotheses_of,
    inclusions,
    likeliest,
    null_p_values,
    reliability,
    uniformity,
)
from tests.test_campaigns.blind_cases import ABOVE, BELOW, EVIDENCE, case, cause, compared, effect, gap

GAIN = case("single", effect("force_gain", factor=1.1))
PAIR = case("pair", effect("force_gain", factor=1.1), effect("tone", frequency_hz=20.0))
DRAG = case("outside", effect("quadratic_drag", drag_n_s2_per_m2=4.0))
REPLACED = case("outside", effect("quadratic_drag", {"body": "barrel"}, stand_ins=("ground_damper",)))


def test_brier_by_hand():
    assert brier([(0.9, True), (0.6, False)]) == pytest.approx((0.01 + 0.36) / 2)
    assert brier([(0.5, True), (0.5, False)]) == 0.25


@pytest.mark.parametrize(
    ("truth", "one", "told"),
    [
        (GAIN, gap("explained", cause("force_gain", probability=0.7), nothing=0.2), (0.7, True)),
        (GAIN, gap("explained", cause("common_gain", probability=0.7), nothing=0.2), (0.7, False)),
        (GAIN, gap("explained", cause("force_gain", "tone", probability=0.7), nothing=0.2), (0.7, False)),
        (GAIN, gap("consistent", cause("force_gain", probability=0.3), nothing=0.7), (0.7, False)),
        (DRAG, gap("unexplained", cause("force_gain", probability=0.3), nothing=0.0, unknown=0.7), (0.7, True)),
        (DRAG, gap("explained", cause("force_gain", probability=0.8), nothing=0.0), (0.8, False)),
        (REPLACED, gap("explained", cause("ground_damper", probability=0.8), nothing=0.0), (0.8, True)),
        (case("null"), gap("consistent", nothing=0.6, unknown=0.4), (0.6, True)),
    ],
)
def test_the_likeliest_may_be_nothing_or_unknown(truth, one, told):
    assert likeliest(compared(truth, one), one) == told


def test_nothing_is_right_below_the_limit():
    one = gap("consistent", cause("common_gain", probability=0.1), nothing=0.9)
    assert likeliest(compared(GAIN, one, BELOW), one) == (0.9, True)
    assert likeliest(compared(DRAG, one, before=1.0), one) == (0.9, True)
    assert likeliest(compared(DRAG, one, before=2.0), one) == (0.9, False)


def test_a_set_is_right_with_every_visible_effect_and_nothing_false():
    one, other, both = (
        gap("explained", cause(*names, probability=0.9), nothing=0.0)
        for names in (("force_gain",), ("tone",), ("tone", "force_gain"))
    )
    assert [likeliest(compared(PAIR, g, ABOVE, BELOW), g)[1] for g in (one, other, both)] == [True, False, True]
    assert [likeliest(compared(PAIR, g, ABOVE, ABOVE), g)[1] for g in (one, other, both)] == [False, False, True]


def test_every_effect_of_the_likeliest_set_has_its_probability():
    named = cause("force_gain", probability=0.3)
    likely = cause("force_gain", "tone", probability=0.6, included=0.8)
    one = gap("explained", named, likely)
    assert inclusions(compared(GAIN, one), one) == [(0.8, True), (0.8, False)]
    assert inclusions(compared(GAIN, gap("consistent")), gap("consistent")) == []


def test_a_look_alike_that_is_there_makes_its_class_right():
    first = cause("common_gain", included=0.97, instead=("force_gain",))
    one = gap("explained", first, cause("force_gain", probability=0.08))
    assert inclusions(compared(GAIN, one), one) == [(0.97, True)]
    alone = gap("explained", cause("common_gain", included=0.97))
    assert inclusions(compared(GAIN, alone), alone) == [(0.97, False)]


def test_bins_hold_every_probability():
    told = [(0.3, True), (0.6, False), (0.95, True), (0.95, False), (0.98, True), (0.999, True), (1.0, True)]
    found = reliability(told)
    assert [(b.right, b.of) for b in found.bins] == [(1, 1), (0, 1), (1, 2), (1, 1), (2, 2)]
    assert all(b.low <= b.probability <= b.high for b in found.bins)
    assert found.bins[2].probability == pytest.approx(0.95)
    assert found.brier == pytest.approx(brier(told))
    assert reliability([]) is None


def test_refused_cases_are_in_no_calibration():
    one = gap("explained", cause("force_gain", probability=0.7), nothing=0.2)
    assert calibrated([compared(GAIN, one), compared(GAIN, None)]) == calibrated([compared(GAIN, one)])


def test_p_values_of_nulls_are_held_against_uniform_ones():
    def of(truth, p_value):
        return compared(truth, gap("consistent", evidence=replace(EVIDENCE, p_value=p_value)))

    cable = case("null", effect("added_mass", uncounted=True, mass_kg=0.01, relative_position=0.5))
    nulls = [of(case("null"), 0.2), of(case("null"), 0.7), compared(case("null"), None)]
    assert null_p_values([*nulls, of(cable, 0.1), of(GAIN, 0.3)]) == [0.2, 0.7]
    assert uniformity([0.2, 0.7]).distance == pytest.approx(0.3)  # two steps of one half
    even = [(k + 0.5) / 100 for k in range(100)]
    assert uniformity(even).p_value > 0.99
    assert uniformity([p**2 for p in even]).p_value < 0.01
    assert uniformity([]) is None


def test_hypotheses_hold_what_probabilities_are_made_of():
    one = gap(
        "explained",
        cause("force_gain", log_prior=-5.0, minus_two_log=10.0),
        cause("common_gain", log_prior=-4.0, minus_two_log=30.0),
        nothing_minus_two_log=50.0,
        unknown_gain=20.0,
    )
    of = hypotheses_of(compared(GAIN, one), one)
    np.testing.assert_allclose(
        of.log_prior, [-5.0, -4.0, np.log(PRIOR_NOTHING), np.log(PRIOR_UNKNOWN / FORCE_PLACE_COUNT)]
    )
    np.testing.assert_allclose(of.minus_two_log, [10.0, 30.0, 50.0, 30.0])
    assert of.right.tolist() == [True, False, False, False]
    weights = np.exp(of.log_prior - of.minus_two_log / 8)
    assert of.log_right(4.0) == pytest.approx(np.log(weights[0] / weights.sum()))


def test_the_temperature_that_drew_the_answers_is_found():
    """Answers drawn from the posterior at a temperature ask for that temperature."""
    rng, temperature, cases = np.random.default_rng(3), 9.0, []
    for _ in range(700):
        prior, costs = np.log(rng.dirichlet(np.ones(4))), rng.uniform(0, 60, 4)
        weights = np.exp(prior - costs / (2 * temperature))
        right = np.zeros(4, dtype=bool)
        right[rng.choice(4, p=weights / weights.sum())] = True
        cases.append(Hypotheses(prior, costs, right))
    found = calibrated_temperature(cases)
    assert found.temperature == pytest.approx(temperature, rel=0.15)
    assert found.interval_95[0] < temperature < found.interval_95[1] < 2 * found.interval_95[0]
    assert found.mean_log_probability > found.at_present
    assert (found.cases, found.without) == (700, 0)


def test_a_case_whose_truth_was_not_judged_does_not_count():
    known = Hypotheses(np.zeros(2), np.array([0.0, 10.0]), np.array([True, False]))
    lost = Hypotheses(np.zeros(2), np.array([0.0, 10.0]), np.array([False, False]))
    found = calibrated_temperature([known, lost])
    assert (found.cases, found.without) == (1, 1)
