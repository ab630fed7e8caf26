"""The verdict: one statistic, and what is too small to matter."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identify.gaps.decision.comparison import (
    PRIOR_UNKNOWN,
    TEMPERATURE,
    Judged,
    closed,
    matters_surely,
    probabilities,
    size,
)
from identify.gaps.decision.null_reference import NullReference
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import USUAL, Matters, Verdict
from identify.gaps.search.attached import ATTACHED
from identify.gaps.unmeasured_force.force import SAME_M
from identify.gaps.unmeasured_force.location import ForcePlace
from rig.model.description import Rig

HALF = 0.5
"""An effect explains the gap in part if it closes this share of it: more than it leaves."""
DOUBT = float(np.log(19))
"""Logarithm of the odds."""
UNKNOWN_PLACES = 100
"""An unknown force may act at so many places that a record tells apart (bodies of some metres, 20 mm each)."""


@dataclass(frozen=True)
class Weighed:
    """A hypothesis judged on the validation record, and its probability."""

    judged: Judged
    probability: float


def nothing_of(ranked: Sequence[Judged]) -> Judged:
    """The believed rig among hypotheses."""
    return next(j for j in ranked if not j.hypothesis.parts)


@dataclass(frozen=True)
class Decision:
    """The verdict with the reason for it, the hypotheses judged, likeliest first, and the probability of something
    unknown. p_before and p_after are p-values of what the believed rig leaves, and the likeliest effects."""

    verdict: Verdict
    criterion: str
    weighed: tuple[Weighed, ...]
    unknown: float
    p_before: float
    p_after: float

    @property
    def nothing(self) -> Judged:
        """The believed rig."""
        return nothing_of([w.judged for w in self.weighed])

    @property
    def probability_nothing(self) -> float:
        return next(w.probability for w in self.weighed if w.judged is self.nothing)

    @property
    def best(self) -> Judged | None:
        """The likeliest hypothesis with effects, whatever the verdict."""
        return next((w.judged for w in self.weighed if w.judged.hypothesis.parts), None)

    @property
    def helps(self) -> bool:
        """Whether effects explain the gap, at least in part."""
        return self.verdict in ("explained", "partly_explained")

    @property
    def likeliest_rig(self) -> Rig | None:
        """With the likeliest effects and what was fitted beside them, whatever the verdict."""
        return self.best.corrected if self.best else None

    @property
    def corrected_rig(self) -> Rig | None:
        return self.likeliest_rig if self.helps else None

    @property
    def without(self) -> Misfit:
        """What the believed rig leaves with the nuisance parameters of the likeliest effects."""
        return self.best.without if self.best else self.nothing.misfit

    @property
    def after(self) -> Misfit:
        """What is left with the likeliest effects."""
        return self.best.misfit if self.best else self.nothing.misfit

    @property
    def left_to_describe(self) -> Misfit:
        """What the likeliest effects leave if they explain a part, else what the believed rig leaves."""
        return self.after if self.verdict == "partly_explained" else self.nothing.misfit


def decided(
    ranked: Sequence[Judged],
    unknown: float | None,
    null_reference: NullReference,
    matters: Matters,
    beside: float | None = None,
) -> Decision:
    """From hypotheses judged on the validation record, likeliest first; `unknown` is -2 ln p of it with the unmeasured
    force that explains it best.

    A gap that matters, and that tolerances and noise do not explain, is one: the probability of the believed rig alone
    is then that of something unknown. `beside` is -2 ln p with the likeliest effects and the unmeasured force that
    explains best what they leave: they are then as likely as they are alone or with it.
    """
    nothing = nothing_of(ranked)
    best = next((j for j in ranked if j.hypothesis.parts), None)
    scores = [j.log_posterior for j in ranked]
    if best:
        with_force = _log_posterior(best.log_prior, beside)
        scores[ranked.index(best)] = float(np.logaddexp(best.log_posterior, with_force))
    scores.append(_log_posterior(0.0, unknown))
    *likely, of_unknown = (float(p) for p in probabilities(np.array(scores)))
    p_before = null_reference.p_value(nothing.misfit)
    p_after = null_reference.p_value(best.misfit) if best else p_before
    if matters_surely(nothing.misfit, matters) and p_before < USUAL:
        alone = ranked.index(nothing)
        of_unknown, likely[alone] = of_unknown + likely[alone], 0.0
    verdict, criterion = _judged(ranked, nothing, best, of_unknown > max(likely), p_before, p_after, matters)
    weighed = tuple(Weighed(one, probability) for one, probability in zip(ranked, likely, strict=True))
    return Decision(verdict, criterion, weighed, of_unknown, p_before, p_after)


def doubted(decision: Decision) -> Judged | None:
    """Beside "no gap": effects that, on the records that were fitted and the one that validates together, are likelier
    than the believed rig by `DOUBT`, where that leaves something of the fitted ones or strains its tolerances."""
    nothing = decision.nothing
    if decision.verdict != "no_gap" or not nothing.hypothesis.leaves_something:
        return None

    def evidence(one: Judged) -> float:
        return one.log_posterior - one.hypothesis.cost / (2 * TEMPERATURE)

    best = max((w.judged for w in decision.weighed), key=evidence)
    return best if evidence(best) - evidence(nothing) > DOUBT else None


def acts_where_they_do(force: ForcePlace, believed: Rig, rig: Rig) -> bool:
    """Whether an unmeasured force acts where effects do: at what they attached, at a contact or in a sensor that they
    changed. One force of another law is no companion of theirs, but their rival."""
    if force.kind == "sensor":
        changed = [b.name for a, b in zip(believed.sensors, rig.sensors, strict=True) if a != b]
        return changed == [force.sensor]
    there = [c.at for c, d in zip(rig.contacts, believed.contacts, strict=True) if c.law != d.law]
    for kind in ATTACHED:
        there += [one.station for one in getattr(rig, kind)[len(getattr(believed, kind)) :]]
    return any(
        one.body == other.body and abs(one.position_m - other.position_m) <= SAME_M
        for one in force.stations
        for other in there
    )


def _log_posterior(log_prior: float, cost: float | None) -> float:
    """With an unmeasured force, which may be at any of `UNKNOWN_PLACES`; without any: impossible."""
    if cost is None:
        return -np.inf
    return log_prior + float(np.log(PRIOR_UNKNOWN / UNKNOWN_PLACES)) - cost / (2 * TEMPERATURE)


def _judged(
    ranked: Sequence[Judged],
    nothing: Judged,
    best: Judged | None,
    unknown_first: bool,
    p_before: float,
    p_after: float,
    matters: Matters,
) -> tuple[Verdict, str]:
    if best is None or ranked[0] is nothing or unknown_first:
        return _without_effect(nothing, p_before, unknown_first, matters)
    without, after = size(best.without, matters), size(best.misfit, matters)
    made = float(np.sqrt(max(without**2 - after**2, 0.0)))
    share = closed(best.without, best.misfit, matters)
    usual, little = p_after >= USUAL, not matters_surely(best.misfit, matters)
    verdict: Verdict = "explained" if little or usual else "partly_explained" if share >= HALF else "unknown"
    left = f"what is left is {_times(after, little)}"
    if made <= 1 and not matters_surely(nothing.misfit, matters):
        return "no_gap", f"what the likeliest effect changes is {made:.2g} times what matters"
    if verdict == "unknown":
        return verdict, f"the likeliest effect closes {100 * max(share, 0.0):.0f} % of the gap alone"
    if usual and not little:
        left = f"tolerances and noise leave as much in {100 * p_after:.0f} % of all cases"
    return verdict, left


def _without_effect(nothing: Judged, p_before: float, unknown_first: bool, matters: Matters) -> tuple[Verdict, str]:
    """Where no effect of the library is the likeliest hypothesis."""
    if not matters_surely(nothing.misfit, matters):
        return "no_gap", f"what the believed rig leaves is {_times(size(nothing.misfit, matters), True)}"
    if not unknown_first and p_before >= USUAL:
        return "no_gap", f"tolerances and noise leave as much in {100 * p_before:.0f} % of all cases"
    return "unknown", "no effect of the library is likelier than something unknown"


def _times(left: float, little: bool) -> str:
    """More than what matters by no more than its scatter is little too."""
    scatter = ", by no more than its scatter over the record" if little and left > 1 else ""
    return f"{left:.2g} times what matters{scatter}"
