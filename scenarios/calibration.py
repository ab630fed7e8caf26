"""Whether probabilities hold: reliability, the Brier score, and the temperature that sealed answers ask for."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp

from identify.gaps.decision.comparison import PRIOR_NOTHING, PRIOR_UNKNOWN, TEMPERATURE
from identify.gaps.decision.verdict import UNKNOWN_PLACES
from identify.gaps.results import Left, Matters
from scenarios.scoreboard import ScoredCase, wilson

OLD_POWER = 20
"""The rule before: probability in proportion to (what is left)^-20, without anything unknown."""
EDGES = (0.0, 0.5, 0.7, 0.9, 0.97, 0.99, 1.0)
TEMPERATURES, STEPS = (0.05, 500.0), 200


class Bin(msgspec.Struct, frozen=True):
    """So many of so many that were given a probability from low to high are right; probability is its mean."""

    low: float
    high: float
    probability: float
    right: int
    of: int
    interval_95: tuple[float, float]


class Calibration(msgspec.Struct, frozen=True):
    """Of the likeliest hypothesis: the reliability diagram, the Brier score, and that of the rule before.

    An answer that lacks only what is below its limit is right; brier_whole counts it as wrong.
    """

    bins: tuple[Bin, ...]
    brier: float
    brier_before: float
    brier_whole: float


class Tempered(msgspec.Struct, frozen=True):
    """The temperature at which the right hypotheses are likeliest, and that at which the Brier score of the likeliest
    one is least; without are cases whose right one was not judged."""

    temperature: float
    by_brier: float
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

    def probabilities(self, temperature: float) -> Float[np.ndarray, " hypotheses"]:
        scores = self.log_prior - self.minus_two_log / (2 * temperature)
        return np.asarray(np.exp(scores - logsumexp(scores)))

    def likeliest(self, temperature: float) -> tuple[float, bool]:
        """The probability of the likeliest, and whether it is right."""
        shares = self.probabilities(temperature)
        return float(shares.max()), bool(self.right[np.argmax(shares)])

    def log_right(self, temperature: float) -> float:
        """The logarithm of the probability of all that is right."""
        scores = self.log_prior - self.minus_two_log / (2 * temperature)
        return float(logsumexp(scores[self.right]) - logsumexp(scores))


def hypotheses_of(c: ScoredCase) -> Hypotheses:
    gap = c.found.gap
    prior = [cause.log_prior for cause in gap.causes] + [np.log(PRIOR_NOTHING)]
    costs = [cause.minus_two_log for cause in gap.causes] + [gap.nothing_minus_two_log]
    right = [c.holds(cause.effects) for cause in gap.causes] + [c.nothing_right]
    if gap.unknown_gain is not None:
        prior.append(np.log(PRIOR_UNKNOWN / UNKNOWN_PLACES))
        costs.append(gap.nothing_minus_two_log - gap.unknown_gain)
        right.append(c.unknown_right)
    return Hypotheses(np.array(prior), np.array(costs), np.array(right))


def likeliest(c: ScoredCase, whole: bool = False) -> tuple[float, bool]:
    """The probability of the likeliest hypothesis, and whether it is right; with `whole` only if it holds every effect,
    those below their limits too."""
    gap, right = c.found.gap, c.is_truth if whole else c.holds
    told = [(cause.probability, right(cause.effects)) for cause in gap.causes[:1]]
    told += [(gap.probability_nothing, c.nothing_right), (gap.probability_unknown, c.unknown_right)]
    return max(told, key=lambda t: t[0])


def likeliest_before(c: ScoredCase) -> tuple[float, bool]:
    """Likewise by the rule before, as far as what is stored tells."""
    gap = c.found.gap
    left = [size_of(cause.left, gap.matters) for cause in gap.causes] + [c.best.before]
    right = [c.holds(cause.effects) for cause in gap.causes] + [c.nothing_right]
    scores = -OLD_POWER * np.log(np.maximum(left, 1e-12))
    first = int(np.argmax(scores))
    return float(np.exp(scores[first] - logsumexp(scores))), right[first]


def size_of(left: Left, matters: Matters) -> float:
    """The size of a gap from what is told of it, in units of what matters (as `comparison.size`)."""
    contacts = sum((share / matters.contact) ** 2 for share in left.contact_shares.values())
    return float(np.sqrt((left.share / matters.motion) ** 2 + contacts))


def calibrated(compared: Sequence[ScoredCase]) -> Calibration:
    """Of all cases."""
    now, before = ([rule(c) for c in compared] for rule in (likeliest, likeliest_before))
    said, right = np.array([p for p, _ in now]), np.array([r for _, r in now])
    bins = []
    for low, high in pairwise(EDGES):
        inside = (said >= low) & ((said < high) | (high == EDGES[-1]))
        if np.any(inside):
            count, of = int(right[inside].sum()), int(inside.sum())
            bins.append(Bin(low, high, float(said[inside].mean()), count, of, wilson(count, of)))
    return Calibration(tuple(bins), brier(now), brier(before), brier([likeliest(c, whole=True) for c in compared]))


def brier(told: Sequence[tuple[float, bool]]) -> float:
    """The mean square of probability less outcome: 0 at best, 0.25 for a coin's (Brier, Mon. Weather Rev. 78, 1950)."""
    return float(np.mean([(p - right) ** 2 for p, right in told])) if told else float("nan")


def calibrated_temperature(cases: Sequence[Hypotheses]) -> Tempered:
    """The temperature of the largest product of the right hypotheses' probabilities, and of the least Brier score."""
    known = [one for one in cases if one.right.any()]

    def mean_log(temperature: float) -> float:
        return float(np.mean([one.log_right(temperature) for one in known]))

    if not known:
        return Tempered(TEMPERATURE, TEMPERATURE, np.nan, np.nan, 0, len(cases))
    bounds = tuple(np.log(TEMPERATURES))
    found = minimize_scalar(lambda t: -mean_log(float(np.exp(t))), bounds=bounds, method="bounded")
    grid = np.geomspace(*TEMPERATURES, STEPS)  # by the Brier score there may be several minima
    scores = [brier([one.likeliest(t) for one in cases]) for t in grid]
    best, by_brier = float(np.exp(found.x)), float(grid[np.argmin(scores)])
    return Tempered(best, by_brier, mean_log(best), mean_log(TEMPERATURE), len(known), len(cases) - len(known))
