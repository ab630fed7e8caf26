"""Probabilities against answers, by hand."""

import numpy as np
import pytest

from identify.gaps.decision.comparison import PRIOR_NOTHING, PRIOR_UNKNOWN
from identify.gaps.decision.verdict import UNKNOWN_PLACES
from identify.gaps.results import Left, Matters
from scenarios.calibration import (
    Hypotheses,
    brier,
    calibrated,
    calibrated_temperature,
    hypotheses_of,
    likeliest,
    likeliest_before,
    size_of,
)
from tests.scenarios.blind_cases import ABOVE, BELOW, case, cause, compared, effect, gap

GAIN = case("single", effect("force_gain", factor=1.1))
DRAG = case("outside", effect("quadratic_drag", drag_n_s2_per_m2=4.0))


def test_brier_by_hand():
    assert brier([(0.9, True), (0.6, False)]) == pytest.approx((0.01 + 0.36) / 2)
    assert brier([(0.5, True), (0.5, False)]) == 0.25


@pytest.mark.parametrize(
    ("truth", "one", "told"),
    [
        (GAIN, gap("explained", cause("force_gain", probability=0.7), nothing=0.2), (0.7, True)),
        (GAIN, gap("explained", cause("common_gain", probability=0.7), nothing=0.2), (0.7, False)),
        (GAIN, gap("consistent", cause("force_gain", probability=0.3), nothing=0.7), (0.7, False)),
        (DRAG, gap("unexplained", cause("force_gain", probability=0.3), nothing=0.0, unknown=0.7), (0.7, True)),
        (DRAG, gap("explained", cause("force_gain", probability=0.8), nothing=0.0), (0.8, False)),
        (case("null"), gap("consistent", nothing=0.6, unknown=0.4), (0.6, True)),
    ],
)
def test_the_likeliest_may_be_nothing_or_unknown(truth, one, told):
    assert likeliest(compared(truth, one)) == told


def test_nothing_is_right_below_the_limit():
    one = gap("consistent", cause("common_gain", probability=0.1), nothing=0.9)
    assert likeliest(compared(GAIN, one, BELOW)) == (0.9, True)
    assert likeliest(compared(DRAG, one, before=1.0)) == (0.9, True)
    assert likeliest(compared(DRAG, one, before=2.0)) == (0.9, False)


def test_a_pair_of_which_one_is_below_its_limit_is_that_of_the_other():
    pair = case("pair", effect("force_gain", factor=1.1), effect("tone", frequency_hz=20.0))
    one, other = (gap("explained", cause(name, probability=0.9), nothing=0.0) for name in ("force_gain", "tone"))
    assert likeliest(compared(pair, one, ABOVE, BELOW)) == (0.9, True)
    assert likeliest(compared(pair, one, ABOVE, BELOW), whole=True) == (0.9, False)
    assert likeliest(compared(pair, other, ABOVE, BELOW)) == (0.9, False)


def test_the_rule_before_weighs_what_is_left():
    one = gap("explained", cause("force_gain", leaves=0.005), cause("common_gain", leaves=0.0055))
    probability, right = likeliest_before(compared(GAIN, one, before=2.0))
    weights = np.array([1.0, 1.1, 2.0]) ** -20
    assert right
    assert probability == pytest.approx(weights[0] / weights.sum())


def test_the_size_is_in_what_matters():
    left = Left(share=0.015, contact_shares={"a": 0.03, "b": 0.06}, p_value=0.5)
    assert size_of(left, Matters(motion=5e-3, contact=3e-2)) == pytest.approx(np.sqrt(9 + 1 + 4))


def test_bins_hold_every_case():
    told = [(0.3, True), (0.6, False), (0.95, True), (0.95, False), (0.98, True), (0.999, True), (1.0, True)]
    some = [
        compared(GAIN, gap("explained", cause("force_gain" if right else "common_gain", probability=p), nothing=0.0))
        for p, right in told
    ]
    found = calibrated(some)
    assert [(b.right, b.of) for b in found.bins] == [(1, 1), (0, 1), (1, 2), (1, 1), (2, 2)]
    assert all(b.low <= b.probability <= b.high for b in found.bins)
    assert found.bins[2].probability == pytest.approx(0.95)
    assert found.brier == pytest.approx(brier(told))


def test_hypotheses_hold_what_probabilities_are_made_of():
    one = gap(
        "explained",
        cause("force_gain", log_prior=-5.0, minus_two_log=10.0),
        cause("common_gain", log_prior=-4.0, minus_two_log=30.0),
        nothing_minus_two_log=50.0,
        unknown_gain=20.0,
    )
    of = hypotheses_of(compared(GAIN, one))
    np.testing.assert_allclose(
        of.log_prior, [-5.0, -4.0, np.log(PRIOR_NOTHING), np.log(PRIOR_UNKNOWN / UNKNOWN_PLACES)]
    )
    np.testing.assert_allclose(of.minus_two_log, [10.0, 30.0, 50.0, 30.0])
    assert of.right.tolist() == [True, False, False, False]
    weights = np.exp(of.log_prior - of.minus_two_log / 8)
    np.testing.assert_allclose(of.probabilities(4.0), weights / weights.sum())
    assert of.log_right(4.0) == pytest.approx(np.log(weights[0] / weights.sum()))


def test_the_temperature_that_drew_the_answers_is_found():
    """Answers drawn from the posterior at a temperature ask for that temperature."""
    rng, temperature, cases = np.random.default_rng(3), 9.0, []
    for _ in range(700):
        prior, costs = np.log(rng.dirichlet(np.ones(4))), rng.uniform(0, 60, 4)
        of = Hypotheses(prior, costs, np.zeros(4, dtype=bool))
        of.right[rng.choice(4, p=of.probabilities(temperature))] = True
        cases.append(of)
    found = calibrated_temperature(cases)
    assert found.temperature == pytest.approx(temperature, rel=0.15)
    assert found.by_brier == pytest.approx(temperature, rel=0.25)
    assert found.mean_log_probability > found.at_present
    assert (found.cases, found.without) == (700, 0)


def test_a_case_whose_truth_was_not_judged_does_not_count():
    known = Hypotheses(np.zeros(2), np.array([0.0, 10.0]), np.array([True, False]))
    lost = Hypotheses(np.zeros(2), np.array([0.0, 10.0]), np.array([False, False]))
    found = calibrated_temperature([known, lost])
    assert (found.cases, found.without) == (1, 1)
