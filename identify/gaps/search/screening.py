"""Screening of effects: by the slope of the cost at the nominal rig, and over a grid of large values."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.fit import Column, Reduced, derivative, reduced
from identify.gaps.residual.grounded import needs_every_line
from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.lines import sharpest
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, residual_of, same_but_laws
from identify.gaps.search.attached import attached
from identify.gaps.search.candidates import Candidate
from identify.linear.model import ResponseCache
from rig.errors import RigError
from rig.model.description import Rig

STRENGTHS = (0.3, 0.6, 1.2, 2.4, 4.8)
"""Multiples of what a typical effect adds: a grid on which no minimum of the linear residual is missed."""
THINNED = 16
"""Every so-many-th line tells enough of where a minimum lies."""
PEAKS, AROUND_HZ = 1, 2.0
"""So many lines of a residual are followed, by how far they stand out within this band."""


@dataclass(frozen=True)
class Screened:
    """A candidate, what it promises to gain, and the values to begin a fit with."""

    candidate: Candidate
    gain: float
    values: Float[np.ndarray, " parameters"]


def score_screening(linearization: Linearization, at: Residual, candidates: Sequence[Candidate]) -> list[Screened]:
    """The gain of the linearised cost at a residual, with nuisance parameters and drifts free; the best first.

    This is Rao's score test of each effect, at every place that it is tried at.
    """
    equations = reduced(linearization, at)
    sharp_hz, loud = [], equations
    if any(c.kind.grid_screened for c in candidates):
        sharp_hz, loud = followed_hz(linearization, at, PEAKS).tolist(), equations.with_lines()
    found = [
        max(_looked(linearization, loud if c.kind.grid_screened else equations, c, sharp_hz), key=lambda one: one.gain)
        for c in candidates
    ]
    return sorted(found, key=lambda one: -one.gain)


def followed_hz(linearization: Linearization, at: Residual, count: int) -> Float[np.ndarray, " lines"]:
    """Frequencies of the lines that stand out most of the linear and the contact residuals."""
    rows = np.concatenate([at.linear, *(c.residual[None, : at.linear.shape[1]] for c in at.contacts)])
    rate_hz = linearization.record.rate_hz
    return rate_hz * sharpest(rows, count, AROUND_HZ / rate_hz, linearization.record.repeats)


def _looked(
    linearization: Linearization, equations: Reduced, candidate: Candidate, sharp_hz: Sequence[float]
) -> list[Screened]:
    """Gains of the strengths from every start, each within its bounds; none where the record sees nothing."""
    strong, at = candidate.parameters.strengths, equations.at
    found = [Screened(candidate, 0.0, candidate.default)]
    starts: list[Float[np.ndarray, " parameters"]] = []
    columns: list[Column] = []
    for start in candidate.starts(sharp_hz):
        with suppress(RigError):  # no such rig
            own: list[Column] = []
            for i in strong:
                moved = start.copy()
                moved[i] = start[i] + candidate.steps[i]
                rig = candidate.applied(linearization.rig, moved)
                own.append(attached(linearization, rig, at) or derivative(linearization, rig, at))
            starts.append(start)
            columns += own
    normal = equations.joined(columns)
    count = len(equations.gradient)
    free = np.flatnonzero(np.abs(at.nuisance) < LIMIT - 1e-6)
    inner = np.linalg.solve(normal.matrix[np.ix_(free, free)], normal.matrix[free, count:])
    steps = candidate.steps[strong]
    low, high = (ends[strong] for ends in candidate.parameters.bounds)
    for k, start in enumerate(starts):
        mine = slice(count + k * len(strong), count + (k + 1) * len(strong))
        solved = inner[:, mine.start - count : mine.stop - count]
        curvature = normal.matrix[mine, mine] - normal.matrix[mine][:, free] @ solved
        slope = normal.gradient[mine] - solved.T @ normal.gradient[free]
        if np.any(np.diag(curvature) <= 1e-9 * np.maximum(np.diag(normal.matrix)[mine], 1.0)):
            continue  # nothing moves there, as a force on a clamp
        size = (np.clip(start[strong] + np.linalg.solve(curvature, slope) * steps, low, high) - start[strong]) / steps
        values = start.copy()
        values[strong] = start[strong] + size * steps
        found.append(Screened(candidate, float(2 * slope @ size - size @ curvature @ size), values))
    return found


def grid_screening(linearization: Linearization, candidates: Sequence[Candidate]) -> list[Screened]:
    """Screening by the linear residual over a grid of strengths and places, of what is too large for a slope.

    Of effects that change the linear model, where a selection of lines tells it: not of a rig that rubs on the ground.
    """
    if needs_every_line(linearization.rig):
        return []
    thin = _thinned(linearization.record)
    discrepancy, cache = linearization.scales.discrepancy[:, 1::THINNED], ResponseCache(thin.omega)

    def cost(rig: Rig) -> float:
        model = linear_model(thin, rig, discrepancy, cache)
        return THINNED * float(np.sum(np.abs(model.residual) ** 2))

    before = cost(linearization.rig)
    found = []
    for candidate in candidates:
        changed = candidate.applied(linearization.rig, candidate.default)
        linear = not same_but_laws(linearization.rig, changed) and changed.loads == linearization.rig.loads
        if not linear or candidate.kind.stochastic or needs_every_line(changed):
            continue
        costs = []
        for values in _grid(candidate):
            try:
                costs.append((cost(candidate.applied(linearization.rig, values)), values))
            except RigError:
                continue
        if costs:
            least, values = min(costs, key=lambda c: c[0])
            found.append(Screened(candidate, before - least, values))
    return sorted(found, key=lambda one: -one.gain)


def of_laws(rig: Rig, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that change contact laws alone."""
    return [c for c in candidates if same_but_laws(rig, c.applied(rig, c.default))]


def law_screening(linearization: Linearization, fresh: Residual, candidates: Sequence[Candidate]) -> list[Screened]:
    """Screening by the contact residuals over a grid of strengths, of effects `of_laws`, the best first; at a residual
    whose slow motion followed no law yet.

    A smaller clearance has no slope where the believed contact is open. The gain is that of a variance which is not
    known, sum of n ln(mean square) over the contacts, as the slow motion errs more at one contact than at another.
    """
    unknowns, before = tuple(c.unknowns for c in fresh.contacts), _scatter(fresh)
    found = []
    for candidate in candidates:
        values = candidate.starts()[0]
        best = Screened(candidate, 0.0, values)
        for strength in candidate.strengths(STRENGTHS):
            tried = np.append(strength, values[1:])
            with suppress(RigError):  # no such law
                rig = candidate.applied(linearization.rig, tried)
                there = residual_of(linearization, rig, fresh.nuisance, unknowns, like=fresh)
                best = max(best, Screened(candidate, before - _scatter(there), tried), key=lambda one: one.gain)
        found.append(best)
    return sorted(found, key=lambda one: -one.gain)


def _scatter(at: Residual) -> float:
    return float(sum(c.residual.size * np.log(c.cost) for c in at.contacts))


def _grid(candidate: Candidate) -> Iterator[Float[np.ndarray, " parameters"]]:
    """Strengths within the bounds, at every place."""
    for place in candidate.starts():
        for strength in candidate.strengths(STRENGTHS):
            values = place.copy()
            values[0] = strength
            yield values


def _thinned(record: Record) -> Record:
    some = slice(1, None, THINNED)
    return replace(
        record,
        omega=record.omega[some],
        windows_responses=False,
        **{
            name: getattr(record, name)[..., some]
            for name in ("forces", "delivered", "displaced", "faded", "noise", "power")
        },
    )
