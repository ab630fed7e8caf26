"""Information of each record, and of all together, on tolerances and on the parameters of effects.

About the fit of a record, its -2 ln p is

    level + z'Mz - 2 b'z        z: the tolerances of the rig and of its contacts, then the parameters

with each contact's slow motion eliminated (a Schur complement). Tolerances are one draw that all records of a rig
share: records are added with one prior |t|^2 of the tolerances t. Each record has its own slow motion and scales.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.fit import DERIVATIVE_STEP, Values, bounded_minimum, contact_jacobian
from identify.gaps.residual.likelihood import NominalVariances, misfit, nominal_variances_of
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, derivative, linearized
from identify.gaps.search.hypothesis import Hypothesis, applied, parameters_of, steps_of
from identify.gaps.search.nominal import fit_nuisance
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig

ROUNDS = 2
"""Gauss-Newton steps over several records at most."""
STEP_TOLERANCE = 0.1
"""Change of a parameter, in standard errors, below which the steps end."""


@dataclass(frozen=True)
class Information:
    """-2 ln p of one record as a quadratic of tolerances and parameters (in units of their steps)."""

    tolerances: tuple[Hashable, ...]
    normal_matrix: Float[np.ndarray, "unknowns unknowns"]
    right_side: Float[np.ndarray, " unknowns"]
    constant: float


@dataclass(frozen=True)
class LinearizedRecord:
    """Record fitted with a rig by its own tolerances, the information on these, and the cost -2 ln p."""

    linearization: Linearization
    residual: Residual
    information: Information
    rows: tuple[Float[np.ndarray, "_ tolerances"], ...]
    cost: float

    def with_parameters(
        self, build: Callable[[Values], Rig], values: Values, steps: Values, high: Values
    ) -> Information:
        """Information of the record on tolerances and parameters; `build` makes the rig from `values`."""
        signs = np.where(values + steps > high, -DERIVATIVE_STEP, DERIVATIVE_STEP)
        derivatives = [
            derivative(self.linearization, build(values + signs[i] * step), self.residual)
            for i, step in enumerate(np.diag(steps))
        ]
        columns = [
            tuple(block / sign for block in (linear, *contacts))
            for (linear, contacts), sign in zip(derivatives, signs, strict=True)
        ]
        tolerance_information, ratio = self.information, self.linearization.record.sample_ratio
        count, nuisance_count = len(tolerance_information.tolerances), len(self.linearization.columns.parameters)
        size = count + len(columns)
        normal_matrix, gradient = np.zeros((size, size)), np.zeros(size)
        if columns:
            linear = np.array([column[0].ravel() for column in columns])
            normal_matrix[:nuisance_count, count:] = self.linearization.columns.products(linear)
            normal_matrix[count:, count:] = linear @ linear.T
            gradient[count:] = linear @ self.residual.linear_without_lines.ravel()
        for j, tolerance_rows in enumerate(self.rows):
            contact_columns = (
                np.array([column[1 + j] for column in columns]).reshape(len(columns), len(tolerance_rows)).T
            )
            contact_matrix, contact_gradient = without_drift(
                self.residual, j, np.concatenate([tolerance_rows, contact_columns], axis=1)
            )
            normal_matrix[:, count:] += contact_matrix[:, count:]
            gradient[count:] += contact_gradient[count:]
        normal_matrix[count:, :count] = normal_matrix[:count, count:].T
        normal_matrix, gradient = normal_matrix / ratio, gradient / ratio
        normal_matrix[:count, :count] = tolerance_information.normal_matrix
        gradient[:count] = tolerance_information.right_side - tolerance_information.normal_matrix @ self.residual.pulls
        point = np.append(self.residual.pulls, values / steps)
        return _quadratic(tolerance_information.tolerances, normal_matrix, gradient, point, self.cost)


def linearized_record(record: Record, nominal_variances: NominalVariances, rig: Rig) -> LinearizedRecord:
    """Fit of a rig to a record by its tolerances, at the scales that the record shows, with its information."""
    linearization, residual = fit_nuisance(record, rig)
    nuisance_count, ratio = len(linearization.columns.parameters), record.sample_ratio
    names = (
        *((id(record), k) if p.kind == "initial state" else p for k, p in enumerate(linearization.columns.parameters)),
        *(
            (c.name, k)
            for c, contact in zip(residual.model.rig.contacts, residual.contacts, strict=True)
            for k in range(contact.pulls.size)
        ),
    )
    normal_matrix, gradient = np.zeros((len(names), len(names))), np.zeros(len(names))
    normal_matrix[:nuisance_count, :nuisance_count] = linearization.gram
    gradient[:nuisance_count] = linearization.columns.products(residual.linear_without_lines.ravel())
    contact_rows = []
    for j, contact in enumerate(residual.contacts):
        rows = np.zeros((contact.residual.size, len(names)))
        rows[:, :nuisance_count] = contact_jacobian(linearization, residual, j)
        first = nuisance_count + sum(c.pulls.size for c in residual.contacts[:j])
        sample_count = contact.observation.weights.size
        rows[:sample_count, first : first + contact.pulls.size] = contact.columns[
            :sample_count, contact.observation.tolerance_slice
        ].toarray()
        contact_matrix, contact_gradient = without_drift(residual, j, rows)
        normal_matrix, gradient = normal_matrix + contact_matrix, gradient + contact_gradient
        contact_rows.append(rows)
    cost = misfit(record, nominal_variances, residual).minus_two_log
    information = _quadratic(names, normal_matrix / ratio, gradient / ratio, residual.pulls, cost)
    return LinearizedRecord(linearization, residual, information, tuple(contact_rows), cost)


def _quadratic(
    tolerances: tuple[Hashable, ...],
    normal_matrix: Float[np.ndarray, "unknowns unknowns"],
    gradient: Float[np.ndarray, " unknowns"],
    point: Float[np.ndarray, " unknowns"],
    cost: float,
) -> Information:
    """Information from the derivatives at a point, where -2 ln p is `cost`, the prior of the tolerances included."""
    pulls, right_side = point[: len(tolerances)], gradient + normal_matrix @ point
    return Information(
        tolerances, normal_matrix, right_side, cost - float(pulls @ pulls - point @ (right_side + gradient))
    )


def without_drift(
    residual: Residual, contact_index: int, rows: Float[np.ndarray, "_ unknowns"]
) -> tuple[Float[np.ndarray, "unknowns unknowns"], Float[np.ndarray, " unknowns"]]:
    """Normal equations of a contact's residual by `rows`, with its slow motion eliminated."""
    contact_residual = residual.contacts[contact_index]
    normal_matrix, gradient = rows.T @ rows, rows.T @ contact_residual.residual
    if not contact_residual.observation.curve.knots:
        return normal_matrix, gradient
    drift_solver, drift_columns = contact_residual.drift_solver, contact_residual.drift_columns
    coupling = drift_columns.T @ rows
    return normal_matrix - coupling.T @ drift_solver.solve(coupling), gradient - coupling.T @ drift_solver.solve(
        drift_columns.T @ contact_residual.residual
    )


@dataclass(frozen=True)
class PooledEstimate:
    """Estimate from several records; parameters that differ by record follow each other in the order of the records."""

    tolerances: dict[Hashable, float]
    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    cost: float


def pooled(
    records: Sequence[Information],
    steps: Values,
    bounds: tuple[Values, Values],
    prior_centre: Values,
    per_record: bool = False,
) -> PooledEstimate:
    """Estimate of tolerances shared by all records, and of parameters shared or `per_record`, of least -2 ln p.

    A weak prior, `prior_centre` with the width of the range, keeps parameters that a record does not show in range.
    """
    names = list(dict.fromkeys(name for information in records for name in information.tolerances))
    count, size, copies = len(names), len(steps), len(records) if per_record else 1
    step_bounds = np.sort(np.stack(bounds) / steps, axis=0)
    widths = np.tile(step_bounds[1] - step_bounds[0], copies)
    centre = np.concatenate([np.zeros(count), np.tile(prior_centre / steps, copies)])
    prior = np.concatenate([np.ones(count), widths**-2.0])
    normal_matrix, right_side = np.diag(prior), prior * centre
    for k, information in enumerate(records):
        first = count + (k * size if per_record else 0)
        unknowns = [*(names.index(name) for name in information.tolerances), *range(first, first + size)]
        normal_matrix[np.ix_(unknowns, unknowns)] += information.normal_matrix
        right_side[unknowns] += information.right_side
    low, high = (
        np.append(np.full(count, sign * LIMIT), np.tile(bound, copies))
        for sign, bound in zip((-1, 1), step_bounds, strict=True)
    )
    z = centre + bounded_minimum(normal_matrix, right_side - normal_matrix @ centre, low - centre, high - centre)
    cost = sum(information.constant for information in records) + float(
        z @ normal_matrix @ z - 2 * right_side @ z + centre @ (prior * centre)
    )
    scale = np.tile(steps, copies)
    covariance = np.linalg.inv(normal_matrix)[count:, count:] * np.outer(scale, scale)
    values = np.clip(
        z[count:] * scale, np.tile(bounds[0], copies), np.tile(bounds[1], copies)
    )  # the bounds of `bounded_minimum` have slack
    return PooledEstimate(dict(zip(names, z[:count].tolist(), strict=True)), values, covariance, cost)


def nominal_variances_by_record(records: Sequence[Record]) -> list[NominalVariances]:
    return [nominal_variances_of(linearized(record, record.rig)) for record in records]


def fitted_together(
    records: Sequence[Record], variances_by_record: Sequence[NominalVariances], hypothesis: Hypothesis
) -> Hypothesis:
    """Hypothesis with parameters fitted to all records together, from those fitted to one.

    The normal equations of the records are added after the elimination of each one's slow motion. Effects that are
    known by their spectrum alone, or have parameters of every record's own (the phase of a tone), keep their values.
    """
    candidates = hypothesis.candidates
    if not candidates or any(candidate.kind.stochastic or candidate.kind.of_a_record for candidate in candidates):
        return hypothesis
    rig, steps, bounds = records[0].rig, steps_of(candidates), parameters_of(candidates).bounds
    build = partial(applied, rig, candidates)

    def pooled_about(values: Values) -> _PooledFit:
        cost, information = 0.0, list[Information]()
        for record, nominal_variances in zip(records, variances_by_record, strict=True):
            record_fit = linearized_record(record, nominal_variances, build(values))
            cost += record_fit.cost
            information.append(record_fit.with_parameters(build, values, steps, bounds[1]))
        return _PooledFit(values, pooled(information, steps, bounds, values), cost)

    def refit(before: _PooledFit) -> _PooledFit:
        if before.settled:
            return before
        try:
            after = pooled_about(before.pooled.values)
        except RigError:  # no rig has these values together
            return before
        return before if after.cost > before.cost else after

    best_fit = refit_until_settled(
        pooled_about(hypothesis.values), refit, lambda before, after: after is before, rounds=ROUNDS
    )
    return Hypothesis(candidates, best_fit.values, best_fit.pooled.covariance, hypothesis.misfit)


@dataclass(frozen=True)
class _PooledFit:
    """Pooled fit linearised about values, and the sum of the records' -2 ln p there, each with its own tolerances."""

    values: Values
    pooled: PooledEstimate
    cost: float

    @property
    def settled(self) -> bool:
        """True if no value changes by more than `STEP_TOLERANCE` standard errors."""
        errors = np.sqrt(np.diag(self.pooled.covariance))
        return bool(np.all(np.abs(self.pooled.values - self.values) < STEP_TOLERANCE * errors))
