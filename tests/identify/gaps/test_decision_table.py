"""The deciding function against the table as the design states it, written out a second time here."""

import math

import numpy as np
import pytest

from identify.gaps.decision_table import Bounded, Evidence, Strength, Verdict

CASES = 2000


def drawn(rng):
    """Evidence at random, with values at and around every threshold, and what is no number."""

    def p():
        return float(rng.choice([0.0, 1e-9, 0.0099, 0.01, 0.0101, 0.0499, 0.05, 0.3, 1.0, rng.uniform()]))

    def quantity(name):
        value, threshold = rng.uniform(0, 2), float(rng.choice([0.5, 1.0]))
        upper = float(rng.choice([value + rng.exponential(0.3), threshold, 0.1, math.nan, math.inf]))
        return Bounded(name, "%", value, None if rng.uniform() < 0.2 else upper, threshold)

    def strength(name):
        centre, half = rng.normal(), rng.exponential()
        return Strength(name, float(rng.choice([0.1, 0.949, 0.95, 0.999])), (centre - half, centre + half), 0.0)

    return Evidence(
        p_value=p(),
        quantities=tuple(quantity(f"q{k}") for k in range(rng.integers(0, 4))),
        strengths=tuple(strength(f"e{k}") for k in range(rng.integers(0, 4))),
        p_value_after=p(),
        quantities_after=tuple(quantity(f"q{k}") for k in range(rng.integers(0, 4))),
        removed=float(rng.choice([-0.2, 0.0, 0.499, 0.5, 0.9, 1.0])),
        vetoed=bool(rng.uniform() < 0.2),
        quantities_beside=tuple(quantity(f"q{k}") for k in range(rng.choice([0, 0, 1]))),
    )


def bounded(quantities):
    return len(quantities) > 0 and not any(q.upper is None or not q.upper < q.threshold for q in quantities)


def tabled(e):
    """The table of the design, row by row."""
    named = [s for s in e.strengths if s.inclusion_probability >= 0.95 and math.prod(s.interval_95) > 0]
    rows = {
        (False, True): "consistent",
        (False, False): "cannot_tell",
        (True, True): "small",
        (True, False): "unexplained",
    }
    beside = not e.quantities_beside or bounded(e.quantities_beside)
    verdict = rows[e.p_value < 0.01, bounded(e.quantities) and beside]
    if verdict == "unexplained" and named:
        enough = bounded(e.quantities_after) or e.p_value_after >= 0.05
        verdict = "explained" if enough and not e.vetoed else "partly_explained" if e.removed >= 0.5 else verdict
    return verdict


def test_decides_as_the_table_says():
    rng = np.random.default_rng(35)
    met = set()
    for _ in range(CASES):
        evidence = drawn(rng)
        assert evidence.verdict == tabled(evidence), evidence
        met.add(evidence.verdict)
    assert met == set(Verdict)


def test_contradicts_no_number_beside_it():
    rng = np.random.default_rng(36)
    for _ in range(CASES):
        e = drawn(rng)
        if e.verdict == "explained":
            assert e.p_value_after >= 0.05 or bounded(e.quantities_after)
            assert not e.vetoed
        if e.verdict in ("consistent", "small"):
            assert e.quantities
            assert bounded(e.quantities)
            assert not e.not_seen
            assert all(q.upper is not None and q.upper < q.threshold for q in e.quantities_beside)
        if e.verdict in ("explained", "partly_explained"):
            assert all(not low <= 0.0 <= high for low, high in (s.interval_95 for s in e.strengths if s.is_named))
            assert e.named
        if e.verdict in ("consistent", "cannot_tell"):
            assert e.p_value >= 0.01


@pytest.mark.parametrize(
    ("upper", "p_value", "verdict"),
    [(0.4, 1e-9, "small"), (0.6, 1e-9, "explained"), (0.4, 0.5, "consistent"), (0.6, 0.5, "cannot_tell")],
)
def test_tolerances_that_take_up_an_effect_make_it_neither_small_nor_absent(upper, p_value, verdict):
    """A clamp that gives way changes 7 % of the motion, of which frequencies within their tolerances leave 0.2 %."""
    little = Bounded("motion", "%", 0.1, 0.2, 0.5)
    evidence = Evidence(
        p_value=p_value,
        quantities=(little,),
        strengths=(Strength("clamp_compliance", 0.99, (0.5, 1.5), 0.0),),
        p_value_after=0.5,
        quantities_after=(little,),
        removed=0.9,
        quantities_beside=(Bounded("motion", "%", 0.3, upper, 0.5),),
    )
    assert evidence.verdict == verdict


@pytest.mark.parametrize("upper", [None, math.nan, math.inf])
def test_what_is_no_number_bounds_nothing(upper):
    quantity = Bounded("motion", "%", 0.1, upper, 0.5)
    evidence = Evidence(
        p_value=0.5, quantities=(quantity,), strengths=(), p_value_after=0.5, quantities_after=(), removed=0.0
    )
    assert evidence.verdict == "cannot_tell"
    assert evidence.not_seen == (quantity,)


@pytest.mark.parametrize(
    ("value", "why", "not_seen"), [(0.4, "", False), (0.4, "noise hides it", True), (0.1, "", True)]
)
def test_what_certainly_matters_is_seen_though_no_bound_is_known(value, why, not_seen):
    """A single second leaves no scatter, and so no bound."""
    assert Bounded("motion", "1", value, None, 0.2, why).not_seen == not_seen
