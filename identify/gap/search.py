"""Which effect, put into the rig, explains the residual best: a linear look at all of them, then fits of the best."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gap.candidates import Candidate
from identify.gap.fit import Fit, derivative, fit, reduced
from identify.gap.residual import Base, Residual

DEEP = 8
"""So many of the effects that look best are fitted."""
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


@dataclass(frozen=True)
class Look:
    """What a candidate would gain, linearly, from one of its starts; and where that leads."""

    candidate: Candidate
    gain: float
    values: Float[np.ndarray, " parameters"]


def looks(base: Base, at: Residual, candidates: Sequence[Candidate]) -> list[Look]:
    """The best linear look at every candidate, best first."""
    equations = reduced(base, at)
    count = len(equations.gradient)
    found = []
    for candidate in candidates:
        best = Look(candidate, 0.0, candidate.default)
        step = candidate.steps[0]
        low, high = candidate.bounds
        for start in candidate.starts:
            moved = start.copy()
            moved[0] = candidate.neutral + step
            normal = equations.joined([derivative(base, lambda v: candidate.applied(base.rig, v), moved, at)])
            inner = np.linalg.solve(normal.matrix[:count, :count], normal.matrix[:count, count])
            curvature = normal.matrix[count, count] - normal.matrix[count, :count] @ inner
            slope = normal.gradient[count] - normal.gradient[:count] @ inner
            if curvature <= 1e-9 * normal.matrix[count, count]:
                continue
            size = (np.clip(candidate.neutral + slope / curvature * step, low[0], high[0]) - candidate.neutral) / step
            gain = 2 * slope * size - curvature * size**2
            if gain > best.gain:
                values = start.copy()
                values[0] = candidate.neutral + size * step
                best = Look(candidate, float(gain), values)
        found.append(best)
    return sorted(found, key=lambda look: -look.gain)


def search(base: Base, at: Residual, candidates: Sequence[Candidate]) -> list[Found]:
    """The candidates that explain most of the residual `at` of the base's rig, best first."""
    ordered = looks(base, at, candidates)
    chosen = [look for look in ordered[:DEEP] if look.gain > WORTH * ordered[0].gain]
    found = []
    for look in chosen:
        candidate = look.candidate
        fitted = fit(
            base,
            lambda v, c=candidate: c.applied(base.rig, v),
            look.values,
            candidate.steps,
            candidate.bounds,
            start=at,
        )
        found.append(Found(candidate, fitted, at.cost - fitted.cost))
    return sorted(found, key=lambda one: -one.gain)
