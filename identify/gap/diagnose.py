"""The diagnosis: is there a gap, which effect or pair of effects causes it, or does none in the library."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.gap.candidates import Candidate, candidates, scale_of
from identify.gap.fit import Fit, fit
from identify.gap.floor import MARGIN, Floor, Floors, Remainder, remainder
from identify.gap.residual import Base, Residual, base_of
from identify.gap.results import Verdict
from identify.gap.search import Found, refined, search, settled, without_doubts
from identify.gap.shaking import shaken
from identify.gap.spectra import Record
from rig.description import Rig
from rig.errors import RigError

ALLOWED = 0.01
"""An effect may leave this share of the gap beyond the floor: no effect is described more exactly."""
SLIGHT = 0.5
"""No effect counts that gains less than so many standard deviations of a tolerance cost."""
ASIDE = 1e-3
"""Nothing more is looked for in what is a smaller share of the gap than this."""
WORTHWHILE = 0.2
"""A second effect must take away this share of what the first one leaves."""
SECOND = 0.1
"""... and of what it leaves on the validation record."""
UNEXPLAINED = 2.0
"""What leaves a gap is taken for so many times as costly, and no cause at all for as much more than the best one."""
TRIED = 2
"""So many first effects are followed by a search for a second, ..."""
NEARLY = 3.0
"""... if they leave at most this multiple of what the best one leaves, ..."""
HOPELESS = 0.95
"""... and the best one at most this share of the gap."""
SHARPNESS = 20.0
"""Probabilities go with this power of what is left: a remainder 10 % larger is some seven times less likely."""


@dataclass(frozen=True)
class Explanation:
    """One or two effects with their parameters, fitted on one record and laid against another."""

    parts: tuple[Candidate, ...]
    fitted: Fit
    rig: Rig
    remainder: Remainder
    validated: Residual

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(c.kind.name for c in self.parts)


@dataclass(frozen=True)
class Outcome:
    """What was found: explanations best first by the validation record, and the believed rig's own remainders."""

    verdict: Verdict
    explanations: tuple[Explanation, ...]
    probabilities: tuple[float, ...]
    nominal: Residual
    validation: Base
    validation_nominal: Residual
    validation_remainder: Remainder


def diagnosed(
    fit_record: Record, validation: Record, floors: Floors, progress: Callable[[float], None] = lambda _: None
) -> Outcome:
    """Searches on one record, decides on the other."""
    rig = fit_record.rig
    floor, other_floor = floors.of(fit_record), floors.of(validation)
    base, at = settled(fit_record, rig, levels=floor.contacts)
    known = candidates(scale_of(fit_record, rig), [s.name for s in fit_record.sensors], fit_record.zero_known)
    first_look = remainder(base, at, floor)
    progress(0.05)
    judge, judged = settled(validation, rig, levels=other_floor.contacts)
    before = remainder(judge, judged, other_floor)
    fits: list[tuple[tuple[Candidate, ...], Fit]] = [
        ((f.candidate,), f.fitted) for f in worthwhile(base, at, known, floor)
    ]
    progress(0.4)
    pairs: dict[frozenset[str], tuple[tuple[Candidate, ...], Fit]] = {}
    for i, (parts, first) in enumerate(_firsts(fits, at, floor)):
        about, left = settled(fit_record, applied(rig, parts, first.values), base.seen, first.residual)
        if explained(remainder(about, left, floor), first_look, floor, ASIDE):
            break
        for second in worthwhile(about, left, known, floor)[:TRIED]:
            both = (*parts, second.candidate)
            names = frozenset(c.name for c in both)
            if second.gain > WORTHWHILE * _excess(left, floor) and names not in pairs:
                pairs[names] = _together(base, both, first, second)
        progress(0.4 + 0.25 * (i + 1))
        if any(explained(remainder(base, f.residual, floor), first_look, floor, ASIDE) for _, f in pairs.values()):
            break
    explanations = []
    for parts, fitted in [*fits[:3], *pairs.values()]:
        try:
            explanations.append(_validated(judge, parts, fitted, rig, other_floor))
        except RigError:
            continue
    explanations.sort(key=lambda e: _price(e, before, other_floor))
    verdict, probabilities = _verdict(explanations, before, other_floor, judged)
    progress(1.0)
    return Outcome(verdict, tuple(explanations), probabilities, at, judge, judged, before)


def _firsts(
    fits: Sequence[tuple[tuple[Candidate, ...], Fit]], at: Residual, floor: Floor
) -> list[tuple[tuple[Candidate, ...], Fit]]:
    """Those first effects that are worth a search for a second: the best, and others that leave about as little."""
    if not fits:
        return []
    excess = [_excess(f.residual, floor) for _, f in fits[:TRIED]]
    if excess[0] > HOPELESS * _excess(at, floor):
        return []
    return [f for f, left in zip(fits, excess, strict=False) if left <= NEARLY * excess[0]]


def applied(rig: Rig, parts: Sequence[Candidate], values: Float[np.ndarray, " parameters"]) -> Rig:
    """The rig with several effects, whose parameters stand one after the other."""
    at = 0
    for part in parts:
        count = len(part.parameters)
        rig = part.applied(rig, values[at : at + count])
        at += count
    return rig


def worthwhile(base: Base, at: Residual, known: Sequence[Candidate], floor: Floor) -> list[Found]:
    """Effects that gain clearly more than on any null recording, most first."""
    steady = [c for c in known if not c.kind.stochastic]
    found = search(base, at, steady, floor.gains)
    if base.rig.base_motion is None:
        found += [f for c in known if c not in steady and (f := shaken(base, at, c))]
    spurious = {name: MARGIN * gain for name, gain in floor.gains.items()}
    least = SLIGHT**2 * at.strictness
    count = [f for f in found if f.gain > max(least, spurious.get(f.candidate.kind.name, 0.0))]
    return sorted(count, key=lambda f: -f.gain)


def _excess(at: Residual, floor: Floor) -> float:
    """The cost that a residual has beyond what nulls have."""
    rows, times = at.linear.shape
    expected = float(np.mean(floor.linear)) * rows * times
    expected += times * len(floor.contacts)
    return max(at.cost - expected, 0.0)


def _together(base: Base, parts: tuple[Candidate, ...], first: Fit, second: Found) -> tuple[tuple[Candidate, ...], Fit]:
    """Two effects fitted together, from where each was found; a base motion keeps what was found."""
    values = np.concatenate([first.values, second.fitted.values])
    steps = np.concatenate([c.steps for c in parts])
    low, high = (np.concatenate(ends) for ends in zip(*(c.bounds for c in parts), strict=True))
    if any(c.kind.stochastic for c in parts):
        covariance = np.zeros((values.size, values.size))
        covariance[: first.values.size, : first.values.size] = first.covariance
        covariance[first.values.size :, first.values.size :] = second.fitted.covariance
        return parts, Fit(values, covariance, second.fitted.residual)
    build = partial(applied, base.rig, parts)
    about = base_of(base.record, build(values), base.seen, second.fitted.residual)
    both = fit(about, build, values, steps, (low, high), without_doubts(second.fitted.residual))
    return parts, refined(base, build, both, steps, (low, high))


def _validated(judge: Base, parts: tuple[Candidate, ...], fitted: Fit, rig: Rig, floor: Floor) -> Explanation:
    corrected = applied(rig, parts, fitted.values)
    about, residual = settled(judge.record, corrected, judge.seen)
    return Explanation(parts, fitted, corrected, remainder(about, residual, floor), residual)


def _price(explanation: Explanation, before: Remainder, floor: Floor) -> float:
    """The cost on the validation record; a second effect must earn its place, and what leaves a gap costs double."""
    cost = explanation.validated.cost * (1 + SECOND * (len(explanation.parts) - 1))
    return cost if explained(explanation.remainder, before, floor) else UNEXPLAINED * cost


def _verdict(
    explanations: Sequence[Explanation], before: Remainder, floor: Floor, judged: Residual
) -> tuple[Verdict, tuple[float, ...]]:
    """The verdict, and the probabilities of the explanations; what they lack of one is that of none of them."""
    helpful = [e for e in explanations if e.validated.cost < judged.cost]
    if not helpful:
        return ("no_gap" if before.at_floor(floor) else "none_of_these"), tuple(0.0 for _ in explanations)
    costs = np.array([_price(e, before, floor) for e in explanations])
    best = helpful[0]
    accepted = explained(best.remainder, before, floor)
    none = costs.min() * (UNEXPLAINED if accepted else 1 / UNEXPLAINED)
    weights = np.append(costs, none)
    likely = (weights / weights.min()) ** -SHARPNESS
    share = likely / likely.sum()
    return ("effect" if accepted else "none_of_these"), tuple(float(p) for p in share[:-1])


def explained(after: Remainder, before: Remainder, floor: Floor, share: float = ALLOWED) -> bool:
    """Whether what an effect leaves is at the floor, up to a share of the gap."""
    each = zip(after.each, before.each, floor.limits, strict=True)
    return all(left <= limit + share * gap for left, gap, limit in each)
