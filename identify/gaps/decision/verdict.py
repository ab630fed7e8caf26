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
class Decision:
    """The verdict with the reason for it, the probabilities of the hypotheses judged, and of something unknown.

    best is the likeliest hypothesis with effects, whatever the verdict.
    """

    verdict: Verdict
    criterion: str
    probabilities: tuple[float, ...]
    unknown: float
    nothing: Judged
    best: Judged | None
    p_before: float
    p_after: float


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
    nothing = next(j for j in ranked if not j.hypothesis.parts)
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
    return Decision(verdict, criterion, tuple(likely), of_unknown, nothing, best, p_before, p_after)


def doubted(ranked: Sequence[Judged], verdict: Verdict) -> Judged | None:
    """Beside "no gap": effects that, on the records that were fitted and the one that validates together, are likelier
    than the believed rig by `DOUBT`, where that leaves something of the fitted ones or strains its tolerances."""
    nothing = next(j for j in ranked if not j.hypothesis.parts)
    if verdict != "no_gap" or not nothing.hypothesis.leaves_something:
        return None

    def evidence(one: Judged) -> float:
        return one.log_posterior - one.hypothesis.cost / (2 * TEMPERATURE)

    best = max(ranked, key=evidence)
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
