"""Which effect, put into the rig, explains the residual best: a linear look at all of them, then fits of the best."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.gap.candidates import Candidate
from identify.gap.doubts import LIMIT
from identify.gap.fit import Build, Fit, Values, derivative, fit, reduced
from identify.gap.law import Seen
from identify.gap.residual import Base, Residual, base_of, residual_of, same_but_laws
from identify.gap.scan import linear_starts
from identify.gap.spectra import Record
from rig.description import Rig
from rig.oscillator import Oscillator

DEEP = 4
"""So many of the effects that look best are fitted."""
FINAL = 3
"""So many of those are kept, ..."""
RIVAL = 0.5
"""... and fitted to the end, if they gained this share of what the best one did, ..."""
ALIKE = 1.1
"""... or leave no more than this multiple of what it leaves."""
ROUNDS = 2
"""The doubts are linearised anew so many times, ..."""
AGAIN = 2
"""... and those about a single mass so many times more."""
WORTH = 0.02
"""An effect whose linear gain is a smaller share of the best one's is not."""


@dataclass(frozen=True)
class Found:
    """A candidate with its fitted parameters, and by how much the cost fell."""

    candidate: Candidate
    fitted: Fit
    gain: float


def fitted_rig(base: Base, start: Residual | None = None) -> Fit:
    """The base's own rig with doubts, drifts and contact tolerances fitted."""
    nothing = np.zeros(0)
    return fit(base, lambda _: base.rig, nothing, nothing, (nothing, nothing), start)


def settled(
    record: Record,
    rig: Rig,
    seen: tuple[Seen, ...] | None = None,
    start: Residual | None = None,
    levels: Sequence[float] | None = None,
) -> tuple[Base, Residual]:
    """A rig fitted so to a record, linearised anew about its doubts where they bend the residual."""
    base = base_of(record, rig, seen, start, levels)
    at = fitted_rig(base, start).residual
    for _ in range(_again(rig)):
        base = base_of(record, rig, base.seen, at)
        at = fitted_rig(base, at).residual
    return base, at


def _again(rig: Rig) -> int:
    return AGAIN if any(isinstance(b, Oscillator) for b in rig.bodies) else 0


@dataclass(frozen=True)
class Look:
    """What a candidate would gain, linearly, from one of its starts; and where that leads."""

    candidate: Candidate
    gain: float
    values: Float[np.ndarray, " parameters"]


def looks(base: Base, at: Residual, candidates: Sequence[Candidate], bounded: bool = True) -> list[Look]:
    """The best linear look at every candidate, best first; bounded by what is plausible, or by nothing."""
    equations = reduced(base, at)
    count = len(equations.gradient)
    free = np.flatnonzero(np.abs(at.doubts) < LIMIT - 1e-6)
    found = []
    for candidate in candidates:
        best = Look(candidate, 0.0, candidate.default)
        step = candidate.steps[0]
        low, high = candidate.bounds
        for start in candidate.starts:
            moved = start.copy()
            moved[0] = candidate.neutral + step
            normal = equations.joined([derivative(base, candidate.applied(base.rig, moved), at)])
            inner = np.linalg.solve(normal.matrix[np.ix_(free, free)], normal.matrix[free, count])
            curvature = normal.matrix[count, count] - normal.matrix[count, free] @ inner
            slope = normal.gradient[count] - normal.gradient[free] @ inner
            if curvature <= 1e-9 * normal.matrix[count, count]:
                continue
            size = slope / curvature
            if bounded:
                size = (np.clip(candidate.neutral + size * step, low[0], high[0]) - candidate.neutral) / step
            gain = 2 * slope * size - curvature * size**2
            if gain > best.gain:
                values = start.copy()
                values[0] = candidate.neutral + size * step
                best = Look(candidate, float(gain), values)
        found.append(best)
    return sorted(found, key=lambda look: -look.gain)


def search(base: Base, at: Residual, candidates: Sequence[Candidate], least: Mapping[str, float]) -> list[Found]:
    """The candidates that explain most of the residual `at` of the base's rig, best first.

    They are looked at linearly from where the rig alone fits best, and from where no drift has yet been bent to it;
    and the linear residual is scanned for large ones. Those that promise most are fitted for a few steps each, the
    best of them to the end. `least` is what each effect must promise, by its name.
    """
    fresh = residual_of(base, base.rig)
    begun: dict[str, list[tuple[Fit, Candidate]]] = {}
    bent = without_doubts(at)
    for source, start in (
        (looks(base, at, candidates), bent),
        (looks(base, fresh, [c for c in candidates if quiet(base, c)]), None),
        (linear_starts(base, candidates), None),
    ):
        for look in source[:DEEP]:
            if look.gain <= max(WORTH * source[0].gain, least.get(look.candidate.kind.name, 0.0)):
                continue
            about = None if start else base_of(base.record, look.candidate.applied(base.rig, look.values), base.seen)
            begun.setdefault(look.candidate.name, []).append(
                (_fit(base, look.candidate, look.values, start, 3, about), look.candidate)
            )
    best = sorted((min(tries, key=lambda t: t[0].cost) for tries in begun.values()), key=lambda t: t[0].cost)
    if not best:
        return []
    least_cost = best[0][0].cost
    close = [at.cost - f.cost > RIVAL * (at.cost - least_cost) or f.cost < ALIKE * least_cost for f, _ in best]
    fits = [
        (refined(base, partial(c.applied, base.rig), fitted, c.steps, c.bounds) if rival else fitted, c)
        for (fitted, c), rival in zip(best[:FINAL], close, strict=False)
    ]
    found = [Found(candidate, fitted, at.cost - fitted.cost) for fitted, candidate in fits]
    return sorted(found, key=lambda one: -one.gain)


def without_doubts(at: Residual) -> Residual:
    """Where to start with an effect: doubts and tolerances that were bent to do without it are straight again.

    They stay as they are where none is at its limit.
    """
    if at.strain < LIMIT - 1e-6:
        return at
    straight = tuple(replace(c, unknowns=np.append(c.unknowns[:-3], np.zeros(3))) for c in at.contacts)
    return replace(at, doubts=np.zeros_like(at.doubts), contacts=straight)


def refined(base: Base, build: Build, fitted: Fit, steps: Values, bounds: tuple[Values, Values]) -> Fit:
    """Fitted to the end, with the doubts linearised anew about where the parameters have come to."""
    for _ in range(ROUNDS + _again(base.rig)):
        about = base_of(base.record, build(fitted.values), base.seen, fitted.residual)
        before = fitted.cost
        fitted = fit(about, build, fitted.values, steps, bounds, fitted.residual)
        if before - fitted.cost < 1e-3 * fitted.cost:
            break
    return fitted


def quiet(base: Base, candidate: Candidate) -> bool:
    """Whether the linear residual does not see an effect."""
    rig = candidate.applied(base.rig, candidate.default)
    return same_but_laws(base.rig, rig) or rig.loads != base.rig.loads


def _fit(
    base: Base,
    candidate: Candidate,
    values: Float[np.ndarray, " parameters"],
    start: Residual | None,
    most: int,
    about: Base | None = None,
) -> Fit:
    build = partial(candidate.applied, base.rig)
    return fit(about or base, build, values, candidate.steps, candidate.bounds, start, most)
