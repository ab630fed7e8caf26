"""Information of each record, and of all together, on tolerances and on an effect's parameters.

About where a record was fitted, its -2 ln p is

    level + z'Mz - 2 b'z        z: the tolerances of the rig and of its contacts, then the parameters

with each contact's slow motion eliminated (a Schur complement). Tolerances are one draw, which all records of a rig
share: records are added with one prior |t|^2 of the tolerances t. Each record has its own slow motion and scales.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.fit import FINE, Values, bounded, by_nuisance, derivative
from identify.gaps.residual.likelihood import Reference, misfit, reference_of
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, linearized
from identify.gaps.search.hypothesis import Hypothesis, applied, parameters_of, steps_of
from identify.gaps.search.nominal import fit_nuisance
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig

ROUNDS = 2
"""At most so many steps, until no parameter moves by more than ..."""
SETTLED = 0.1
"""... so many standard errors."""


@dataclass(frozen=True)
class Information:
    """The -2 ln p of one record, quadratic in tolerances and parameters (in their steps)."""

    tolerances: tuple[Hashable, ...]
    matrix: Float[np.ndarray, "all all"]
    vector: Float[np.ndarray, " all"]
    level: float


@dataclass(frozen=True)
class Linearised:
    """A record fitted with a rig by tolerances of its own: `said` is what it says of those, cost its -2 ln p."""

    linearization: Linearization
    at: Residual
    said: Information
    rows: tuple[Float[np.ndarray, "_ tolerances"], ...]
    cost: float

    def with_parameters(
        self, build: Callable[[Values], Rig], values: Values, steps: Values, high: Values
    ) -> Information:
        """Information of the record with parameters; `build` makes the rig of `values`."""
        signs = np.where(values + steps > high, -FINE, FINE)
        columns = [
            derivative(self.linearization, build(values + signs[i] * move), self.at)
            for i, move in enumerate(np.diag(steps))
        ]
        own = [tuple(part / sign for part in (c[0], *c[1])) for c, sign in zip(columns, signs, strict=True)]
        count, weight = len(self.said.tolerances), self.linearization.record.sample_ratio
        size, nuisances = count + len(own), len(self.linearization.columns.parameters)
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        if own:
            linear = np.array([c[0].ravel() for c in own])
            matrix[:nuisances, count:] = self.linearization.columns.products(linear)
            matrix[count:, count:] = linear @ linear.T
            gradient[count:] = linear @ self.at.quiet.ravel()
        for j, rows in enumerate(self.rows):
            mine = np.array([c[1 + j] for c in own]).reshape(len(own), len(rows)).T
            more, slope = without_drift(self.at, j, np.concatenate([rows, mine], axis=1))
            matrix[:, count:] += more[:, count:]
            gradient[count:] += slope[count:]
        matrix[count:, :count] = matrix[:count, count:].T
        matrix, gradient = matrix / weight, gradient / weight
        matrix[:count, :count] = self.said.matrix
        gradient[:count] = self.said.vector - self.said.matrix @ self.at.pulls
        return _quadratic(self.said.tolerances, matrix, gradient, np.append(self.at.pulls, values / steps), self.cost)


def linearised(record: Record, reference: Reference, rig: Rig) -> Linearised:
    """The rig fitted to the record by its tolerances, at the scales that the record shows."""
    linearization, at = fit_nuisance(record, rig, rounds=1)
    nuisances, weight = len(linearization.columns.parameters), record.sample_ratio
    names = (
        *((id(record), k) if p.kind == "initial state" else p for k, p in enumerate(linearization.columns.parameters)),
        *(
            (c.name, k)
            for c, own in zip(at.model.rig.contacts, at.contacts, strict=True)
            for k in range(own.pulls.size)
        ),
    )
    matrix, gradient = np.zeros((len(names), len(names))), np.zeros(len(names))
    matrix[:nuisances, :nuisances] = linearization.gram
    gradient[:nuisances] = linearization.columns.products(at.quiet.ravel())
    found = []
    for j, contact in enumerate(at.contacts):
        rows = np.zeros((contact.residual.size, len(names)))
        rows[:, :nuisances] = by_nuisance(linearization, at, j)
        own = nuisances + sum(c.pulls.size for c in at.contacts[:j])
        times = contact.seen.weights.size
        rows[:times, own : own + contact.pulls.size] = contact.columns[:times, contact.seen.tolerances].toarray()
        more, slope = without_drift(at, j, rows)
        matrix, gradient = matrix + more, gradient + slope
        found.append(rows)
    cost = misfit(record, reference, at).minus_two_log
    said = _quadratic(names, matrix / weight, gradient / weight, at.pulls, cost)
    return Linearised(linearization, at, said, tuple(found), cost)


def _quadratic(
    tolerances: tuple[Hashable, ...],
    matrix: Float[np.ndarray, "all all"],
    gradient: Float[np.ndarray, " all"],
    here: Float[np.ndarray, " all"],
    cost: float,
) -> Information:
    """Quadratic by the derivatives at `here`, where -2 ln p is `cost` with the prior of the tolerances in it."""
    pulls, vector = here[: len(tolerances)], gradient + matrix @ here
    return Information(tolerances, matrix, vector, cost - float(pulls @ pulls - here @ (vector + gradient)))


def without_drift(
    at: Residual, contact: int, rows: Float[np.ndarray, "_ all"]
) -> tuple[Float[np.ndarray, "all all"], Float[np.ndarray, " all"]]:
    """Normal equations of a contact's residual by `rows` with its slow motion eliminated."""
    one = at.contacts[contact]
    matrix, gradient = rows.T @ rows, rows.T @ one.residual
    if not one.seen.curve.knots:
        return matrix, gradient
    solver, curve = one.drift_solver, one.drift_columns
    coupled = curve.T @ rows
    return matrix - coupled.T @ solver.solve(coupled), gradient - coupled.T @ solver.solve(curve.T @ one.residual)


@dataclass(frozen=True)
class Pooled:
    """Estimate of records together: values and covariance of the parameters, each record's own one after the other."""

    tolerances: dict[Hashable, float]
    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    cost: float


def pooled(
    said: Sequence[Information], steps: Values, bounds: tuple[Values, Values], about: Values, own: bool = False
) -> Pooled:
    """Tolerances shared by all records, and parameters shared or each record's own, that make -2 ln p least.

    A record that does not see a parameter leaves it within its range: a prior about `about` of the range's width.
    """
    names = list(dict.fromkeys(name for one in said for name in one.tolerances))
    count, size, times = len(names), len(steps), len(said) if own else 1
    ends = np.sort(np.stack(bounds) / steps, axis=0)
    widths = np.tile(ends[1] - ends[0], times)
    centre = np.concatenate([np.zeros(count), np.tile(about / steps, times)])
    prior = np.concatenate([np.ones(count), widths**-2.0])
    matrix, vector = np.diag(prior), prior * centre
    for k, one in enumerate(said):
        first = count + (k * size if own else 0)
        at = [*(names.index(name) for name in one.tolerances), *range(first, first + size)]
        matrix[np.ix_(at, at)] += one.matrix
        vector[at] += one.vector
    low, high = (
        np.append(np.full(count, s * LIMIT), np.tile(end, times)) for s, end in zip((-1, 1), ends, strict=True)
    )
    z = centre + bounded(matrix, vector - matrix @ centre, low - centre, high - centre)
    cost = sum(one.level for one in said) + float(z @ matrix @ z - 2 * vector @ z + centre @ (prior * centre))
    scale = np.tile(steps, times)
    covariance = np.linalg.inv(matrix)[count:, count:] * np.outer(scale, scale)
    values = np.clip(z[count:] * scale, np.tile(bounds[0], times), np.tile(bounds[1], times))  # they have slack
    return Pooled(dict(zip(names, z[:count].tolist(), strict=True)), values, covariance, cost)


def references(records: Sequence[Record]) -> list[Reference]:
    return [reference_of(linearized(record, record.rig)) for record in records]


def fitted_together(records: Sequence[Record], seen: Sequence[Reference], one: Hypothesis) -> Hypothesis:
    """The hypothesis with parameters that all records share, from those that one record gave.

    The normal equations of the shared parameters are the sum of what the records say once each one's slow motion is
    eliminated, and then the tolerances. What is known by its spectrum alone, or is each record's own (a tone's phase),
    stays as it is.
    """
    parts = one.parts
    if not parts or any(p.kind.stochastic or p.kind.of_a_record for p in parts):
        return one
    rig, steps, bounds = records[0].rig, steps_of(parts), parameters_of(parts).bounds
    build = partial(applied, rig, parts)

    def around(values: Values) -> _PooledFit:
        cost, said = 0.0, list[Information]()
        for record, reference in zip(records, seen, strict=True):
            looked = linearised(record, reference, build(values))
            cost += looked.cost
            said.append(looked.with_parameters(build, values, steps, bounds[1]))
        return _PooledFit(values, pooled(said, steps, bounds, values), cost)

    def refit(before: _PooledFit) -> _PooledFit:
        if before.settled:
            return before
        try:
            after = around(before.pooled.values)
        except RigError:  # no rig has these values together
            return before
        return before if after.cost > before.cost else after

    best = refit_until_settled(around(one.values), refit, lambda before, after: after is before, rounds=ROUNDS)
    return Hypothesis(parts, best.values, best.pooled.covariance, one.misfit)


@dataclass(frozen=True)
class _PooledFit:
    """Fit of records together, linearised about values, and the sum of their -2 ln p there, each with tolerances of
    its own."""

    values: Values
    pooled: Pooled
    cost: float

    @property
    def settled(self) -> bool:
        """True if no value moves by more than `SETTLED` standard errors."""
        errors = np.sqrt(np.diag(self.pooled.covariance))
        return bool(np.all(np.abs(self.pooled.values - self.values) < SETTLED * errors))
