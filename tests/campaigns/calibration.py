"""Whether probabilities hold: reliability, Brier scores, the temperature that answers ask for, p-values of nulls.

A set is right if it holds every visible effect and nothing false, as the verdict `explained` with it would be. Nothing
is right where nothing is above its limit, something unmeasured where an effect outside the library acts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import brentq, minimize_scalar
from scipy.special import logsumexp
from scipy.stats import chi2, kstest

from identify.gaps.decision.comparison import PRIOR_NOTHING, PRIOR_UNKNOWN, TEMPERATURE
from identify.gaps.decision.verdict import FORCE_PLACE_COUNT
from identify.gaps.decision_table import Verdict
from identify.gaps.results import Cause, Gap
from tests.campaigns.score_names import classes_of, effects_of, likeliest_set
from tests.campaigns.score_sets import score_set, verdict_right
from tests.campaigns.scoreboard import ScoredCase, wilson

EDGES = (0.0, 0.5, 0.7, 0.9, 0.97, 0.99, 1.0)
TEMPERATURES = (0.05, 500.0)
Told = Sequence[tuple[float, bool]]
"""Probabilities that were given, and whether what they were given to is right."""


class Bin(msgspec.Struct, frozen=True):
    """So many of so many that were given a probability from low to high are right; probability is its mean."""

    low: float
    high: float
    probability: float
    right: int
    of: int
    interval_95: tuple[float, float]


class Reliability(msgspec.Struct, frozen=True):
    """The reliability diagram, and the Brier score."""

    bins: tuple[Bin, ...]
    brier: float


class Uniformity(msgspec.Struct, frozen=True):
    """Kolmogorov's distance of p-values from a uniform distribution, and the p-value of that."""

    cases: int
    distance: float
    p_value: float


class Calibration(msgspec.Struct, frozen=True):
    """inclusion: of every effect of the likeliest set, or its look-alikes; sets: of the likeliest hypothesis."""

    inclusion: Reliability | None
    sets: Reliability | None
    nulls: Uniformity | None


class Tempered(msgspec.Struct, frozen=True):
    """The temperature at which the right hypotheses are likeliest; without are cases whose right one was not judged.

    interval_95 holds the temperatures whose likelihood is not lower than the largest by more than chi-squared allows
    (Wilks, Ann. Math. Stat. 9, 1938).
    """

    temperature: float
    interval_95: tuple[float, float]
    mean_log_probability: float
    at_present: float
    """The mean logarithm of the right hypothesis' probability at the temperature in use."""
    cases: int
    without: int


@dataclass(frozen=True)
class Hypotheses:
    """What the probabilities of one case are made of, and which hypotheses are right: causes, nothing, unknown."""

    log_prior: Float[np.ndarray, " hypotheses"]
    minus_two_log: Float[np.ndarray, " hypotheses"]
    right: Bool[np.ndarray, " hypotheses"]

    def log_right(self, temperature: float) -> float:
        """The logarithm of the probability of all that is right."""
        scores = self.log_prior - self.minus_two_log / (2 * temperature)
        return float(logsumexp(scores[self.right]) - logsumexp(scores))


def hypotheses_of(c: ScoredCase, gap: Gap) -> Hypotheses:
    prior = [cause.log_prior for cause in gap.causes] + [np.log(PRIOR_NOTHING)]
    costs = [cause.minus_two_log for cause in gap.causes] + [gap.nothing_minus_two_log]
    right = [set_right(c, cause) for cause in gap.causes] + [nothing_right(c)]
    if gap.unknown_gain is not None:
        prior.append(np.log(PRIOR_UNKNOWN / FORCE_PLACE_COUNT))
        costs.append(gap.nothing_minus_two_log - gap.unknown_gain)
        right.append(unmeasured_right(c))
    return Hypotheses(np.array(prior), np.array(costs), np.array(right))


def set_right(c: ScoredCase, cause: Cause) -> bool:
    classes = [(effect,) for effect in effects_of(cause)]
    return score_set(c.truths, classes, Verdict.EXPLAINED, c.contacts).verdict_right


def nothing_right(c: ScoredCase) -> bool:
    return verdict_right(c.truths, 0, 0, 0, Verdict.CONSISTENT)


def unmeasured_right(c: ScoredCase) -> bool:
    return c.truth.kind == "outside"


def likeliest(c: ScoredCase, gap: Gap) -> tuple[float, bool]:
    """The probability of the likeliest hypothesis, and whether it is right."""
    first = likeliest_set(gap)
    told = [(first.probability, set_right(c, first))] if first else []
    told += [(gap.probability_nothing, nothing_right(c)), (gap.probability_unknown, unmeasured_right(c))]
    return max(told, key=lambda t: t[0])


def inclusions(c: ScoredCase, gap: Gap) -> Told:
    """Of every effect of the likeliest set."""
    first = likeliest_set(gap)
    if first is None:
        return []
    right = score_set(c.truths, classes_of(first, gap), gap.verdict, c.contacts).names_right
    return [(s.inclusion_probability, is_right) for s, is_right in zip(first.strengths, right, strict=True)]


def calibrated(compared: Sequence[ScoredCase]) -> Calibration:
    """Of all cases that were diagnosed."""
    known = [(c, c.gap) for c in compared if c.gap]
    return Calibration(
        inclusion=reliability([one for pair in known for one in inclusions(*pair)]),
        sets=reliability([likeliest(*pair) for pair in known]),
        nulls=uniformity(null_p_values(compared)),
    )


def reliability(told: Told) -> Reliability | None:
    if not told:
        return None
    said, right = np.array([p for p, _ in told]), np.array([r for _, r in told], dtype=bool)
    bins = []
    for low, high in pairwise(EDGES):
        inside = (said >= low) & ((said < high) | (high == EDGES[-1]))
        if np.any(inside):
            count, of = int(right[inside].sum()), int(inside.sum())
            bins.append(Bin(low, high, float(said[inside].mean()), count, of, wilson(count, of)))
    return Reliability(tuple(bins), brier(told))


def brier(told: Told) -> float:
    """The mean square of probability less outcome: 0 at best, 0.25 for a coin's (Brier, Mon. Weather Rev. 78, 1950)."""
    return float(np.mean([(p - right) ** 2 for p, right in told]))


def null_p_values(compared: Sequence[ScoredCase]) -> list[float]:
    """Of machines that differ by tolerances alone: none of them has a cable that nobody counted."""
    return [c.gap.evidence.p_value for c in compared if c.gap and not c.truth.effects]


def uniformity(p_values: Sequence[float]) -> Uniformity | None:
    if not p_values:
        return None
    found = kstest(p_values, "uniform")
    return Uniformity(len(p_values), float(found.statistic), float(found.pvalue))


def calibrated_temperature(cases: Sequence[Hypotheses]) -> Tempered:
    """The temperature of the largest product of the right hypotheses' probabilities."""
    known = [one for one in cases if one.right.any()]

    def mean_log(temperature: float) -> float:
        return float(np.mean([one.log_right(temperature) for one in known]))

    if not known:
        return Tempered(TEMPERATURE, TEMPERATURES, np.nan, np.nan, 0, len(cases))
    bounds = tuple(np.log(TEMPERATURES))
    found = minimize_scalar(
        lambda t: -mean_log(float(np.exp(t))), bounds=bounds, method="bounded", options={"xatol": 1e-3}
    )
    best = float(np.exp(found.x))
    least = mean_log(best) - float(chi2.ppf(0.95, 1)) / (2 * len(known))
    low, high = (
        float(np.exp(brentq(lambda log_t: mean_log(np.exp(log_t)) - least, end, np.log(best), xtol=1e-3)))
        if mean_log(np.exp(end)) < least
        else float(np.exp(end))
        for end in bounds
    )
    return Tempered(best, (low, high), mean_log(best), mean_log(TEMPERATURE), len(known), len(cases) - len(known))
