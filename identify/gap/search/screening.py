"""Which effects are worth a fit: by the slope of the cost at what is believed, and over a grid of large values."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.gap.candidates import Candidate
from identify.gap.fit import derivative, reduced
from identify.gap.grounded import needs_every_line
from identify.gap.linear import linear_model
from identify.gap.nuisance import LIMIT
from identify.gap.residual import Base, Residual, same_but_laws
from identify.gap.spectra import Record
from rig.description import Rig
from rig.errors import RigError

STRENGTHS = (0.3, 0.6, 1.2, 2.4, 4.8)
"""Multiples of what a typical effect adds: a grid on which no minimum of the linear residual is missed."""
THINNED = 8
"""Every so-many-th line tells enough of where a minimum lies."""


@dataclass(frozen=True)
class Screened:
    """A candidate, what it promises to gain, and the values to begin a fit with."""

    candidate: Candidate
    gain: float
    values: Float[np.ndarray, " parameters"]


def score_screening(base: Base, at: Residual, candidates: Sequence[Candidate]) -> list[Screened]:
    """The gain of the linearised cost at a residual, with nuisance parameters and drifts free; the best first.

    This is Rao's score test of each effect, at every place that it is tried at.
    """
    equations = reduced(base, at)
    count = len(equations.gradient)
    free = np.flatnonzero(np.abs(at.nuisance) < LIMIT - 1e-6)
    found = []
    for candidate in candidates:
        best = Screened(candidate, 0.0, candidate.default)
        low, high = candidate.bounds
        for start in candidate.starts:
            moved = start.copy()
            moved[0] = start[0] + candidate.steps[0]
            try:
                column = derivative(base, candidate.applied(base.rig, moved), at)
            except RigError:
                continue
            normal = equations.joined([column])
            inner = np.linalg.solve(normal.matrix[np.ix_(free, free)], normal.matrix[free, count])
            curvature = normal.matrix[count, count] - normal.matrix[count, free] @ inner
            slope = normal.gradient[count] - normal.gradient[free] @ inner
            if curvature <= 1e-9 * normal.matrix[count, count]:
                continue
            strength = np.clip(start[0] + slope / curvature * candidate.steps[0], low[0], high[0])
            size = (strength - start[0]) / candidate.steps[0]
            gain = float(2 * slope * size - curvature * size**2)
            if gain > best.gain:
                values = start.copy()
                values[0] = strength
                best = Screened(candidate, gain, values)
        found.append(best)
    return sorted(found, key=lambda one: -one.gain)


def grid_screening(base: Base, candidates: Sequence[Candidate]) -> list[Screened]:
    """By the linear residual alone, over a grid of strengths and places: what is too large for a slope to tell.

    Of effects that change the linear model.
    """
    thin = _thinned(base.record)
    discrepancy = base.scales.discrepancy[1::THINNED]
    before = _linear_cost(thin, base.rig, discrepancy)
    found = []
    for candidate in candidates:
        changed = candidate.applied(base.rig, candidate.default)
        linear = not same_but_laws(base.rig, changed) and changed.loads == base.rig.loads
        if not linear or candidate.kind.stochastic or needs_every_line(changed):
            continue
        costs = []
        for values in _grid(candidate):
            try:
                costs.append((_linear_cost(thin, candidate.applied(base.rig, values), discrepancy), values))
            except RigError:
                continue
        if costs:
            least, values = min(costs, key=lambda c: c[0])
            found.append(Screened(candidate, before - least, values))
    return sorted(found, key=lambda one: -one.gain)


def _grid(candidate: Candidate) -> Iterator[Float[np.ndarray, " parameters"]]:
    """Strengths within the bounds, at every place."""
    for place in candidate.starts:
        for strength in candidate.strengths(STRENGTHS):
            values = place.copy()
            values[0] = strength
            yield values


def _thinned(record: Record) -> Record:
    some = slice(1, None, THINNED)
    return replace(
        record,
        omega=record.omega[some],
        **{name: getattr(record, name)[..., some] for name in ("force", "delivered", "displaced", "noise", "power")},
    )


def _linear_cost(thin: Record, rig: Rig, discrepancy: Float[np.ndarray, " lines"]) -> float:
    model = linear_model(thin, rig, discrepancy)
    return THINNED * float(np.sum(np.abs(model.residual) ** 2))
