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

from identify.gaps.residual.fit import DERIVATIVE_STEP, Values, bounded_minimum, contact_residual_columns
from identify.gaps.residual.likelihood import NominalVariances, misfit
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, residual_decrease
from identify.gaps.search.hypothesis import Hypothesis, parameters_of, step_sizes_of, with_effects
from identify.gaps.search.nominal import fit_nuisance
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig

MAX_POOLING_ROUNDS = 2
"""Gauss-Newton steps over several records at most."""
STEP_TOLERANCE = 0.1
"""Change of a parameter, in standard errors, below which the steps end."""


@dataclass(frozen=True)
class RecordInformation:
    """-2 ln p of one record as a quadratic of tolerances and parameters (in units of their steps)."""

    tolerance_names: tuple[Hashable, ...]
    normal_matrix: Float[np.ndarray, "unknowns unknowns"]
    right_side: Float[np.ndarray, " unknowns"]
    constant_cost: float


@dataclass(frozen=True)
class LinearizedRecord:
    """Record fitted with a rig by its own tolerances, the information on these, and the cost -2 ln p."""

    linearization: Linearization
    residual: Residual
    tolerance_information: RecordInformation
    contact_tolerance_columns: tuple[Float[np.ndarray, "_ tolerances"], ...]
    cost: float

    def information_with(
        self, build_rig: Callable[[Values], Rig], parameter_values: Values, step_sizes: Values, upper_bounds: Values
    ) -> RecordInformation:
        """Information of the record on tolerances and parameters; `build_rig` makes the rig from `parameter_values`."""
        information, pulls = self.tolerance_information, self.residual.pulls
        signed_shares = np.where(parameter_values + step_sizes > upper_bounds, -DERIVATIVE_STEP, DERIVATIVE_STEP)
        parameter_decreases = []
        for signed_share, step in zip(signed_shares, np.diag(step_sizes), strict=True):
            rig = build_rig(parameter_values + signed_share * step)
            linear_decrease, contact_decreases = residual_decrease(self.linearization, rig, self.residual)
            parameter_decreases.append([decrease / signed_share for decrease in (linear_decrease, *contact_decreases)])
        tolerance_count, oversampling = len(information.tolerance_names), self.linearization.record.oversampling
        nuisance_count = len(self.linearization.columns.parameters)
        unknown_count = tolerance_count + len(parameter_decreases)
        normal_matrix, gradient = np.zeros((unknown_count, unknown_count)), np.zeros(unknown_count)
        if parameter_decreases:
            linear_columns = np.array([column[0].ravel() for column in parameter_decreases])
            normal_matrix[:nuisance_count, tolerance_count:] = self.linearization.columns.products_with(linear_columns)
            normal_matrix[tolerance_count:, tolerance_count:] = linear_columns @ linear_columns.T
            gradient[tolerance_count:] = linear_columns @ self.residual.linear_without_lines.ravel()
        for index, tolerance_columns in enumerate(self.contact_tolerance_columns, start=1):
            effect_columns = np.array([column[index] for column in parameter_decreases])
            effect_columns = effect_columns.reshape(len(parameter_decreases), len(tolerance_columns)).T
            all_columns = np.concatenate([tolerance_columns, effect_columns], axis=1)
            contact_matrix, contact_gradient = equations_without_drift(self.residual, index - 1, all_columns)
            normal_matrix[:, tolerance_count:] += contact_matrix[:, tolerance_count:]
            gradient[tolerance_count:] += contact_gradient[tolerance_count:]
        normal_matrix[tolerance_count:, :tolerance_count] = normal_matrix[:tolerance_count, tolerance_count:].T
        normal_matrix, gradient = normal_matrix / oversampling, gradient / oversampling
        normal_matrix[:tolerance_count, :tolerance_count] = information.normal_matrix
        gradient[:tolerance_count] = information.right_side - information.normal_matrix @ pulls
        expansion_point = np.append(pulls, parameter_values / step_sizes)
        return _information_at(information.tolerance_names, normal_matrix, gradient, expansion_point, self.cost)


def linearized_record(record: Record, nominal_variances: NominalVariances, rig: Rig) -> LinearizedRecord:
    """Fit of a rig to a record by its tolerances, at the scales that the record shows, with its information."""
    linearization, residual = fit_nuisance(record, rig)
    nuisance_count, oversampling = len(linearization.columns.parameters), record.oversampling
    tolerance_names: list[Hashable] = [
        (id(record), index) if parameter.kind == "initial state" else parameter
        for index, parameter in enumerate(linearization.columns.parameters)
    ]
    for rig_contact, contact_fit in zip(residual.model.rig.contacts, residual.contacts, strict=True):
        tolerance_names += [(rig_contact.name, index) for index in range(contact_fit.pulls.size)]
    normal_matrix, gradient = np.zeros((len(tolerance_names), len(tolerance_names))), np.zeros(len(tolerance_names))
    normal_matrix[:nuisance_count, :nuisance_count] = linearization.column_gram
    gradient[:nuisance_count] = linearization.columns.products_with(residual.linear_without_lines.ravel())
    columns_by_contact = []
    for contact_index in range(len(residual.contacts)):
        columns = contact_residual_columns(linearization, residual, contact_index, len(tolerance_names))
        contact_matrix, contact_gradient = equations_without_drift(residual, contact_index, columns)
        normal_matrix, gradient = normal_matrix + contact_matrix, gradient + contact_gradient
        columns_by_contact.append(columns)
    cost = misfit(record, nominal_variances, residual).minus_two_log
    normal_matrix, gradient = normal_matrix / oversampling, gradient / oversampling
    information = _information_at(tuple(tolerance_names), normal_matrix, gradient, residual.pulls, cost)
    return LinearizedRecord(linearization, residual, information, tuple(columns_by_contact), cost)


def _information_at(
    tolerance_names: tuple[Hashable, ...],
    normal_matrix: Float[np.ndarray, "unknowns unknowns"],
    cost_gradient: Float[np.ndarray, " unknowns"],
    expansion_point: Float[np.ndarray, " unknowns"],
    cost_at_point: float,
) -> RecordInformation:
    """Information from the derivatives at a point, where -2 ln p is `cost_at_point`, prior of tolerances included."""
    pulls, right_side = expansion_point[: len(tolerance_names)], cost_gradient + normal_matrix @ expansion_point
    constant_cost = cost_at_point - float(pulls @ pulls - expansion_point @ (right_side + cost_gradient))
    return RecordInformation(tolerance_names, normal_matrix, right_side, constant_cost)


def equations_without_drift(
    residual: Residual, contact_index: int, unknown_columns: Float[np.ndarray, "_ unknowns"]
) -> tuple[Float[np.ndarray, "unknowns unknowns"], Float[np.ndarray, " unknowns"]]:
    """Normal equations of a contact's residual by `unknown_columns`, with its slow motion eliminated."""
    contact_fit = residual.contacts[contact_index]
    normal_matrix, gradient = unknown_columns.T @ unknown_columns, unknown_columns.T @ contact_fit.residual
    if not contact_fit.observation.drift_spline.knot_count:
        return normal_matrix, gradient
    drift_solver, drift_columns = contact_fit.drift_solver, contact_fit.drift_columns
    coupling = drift_columns.T @ unknown_columns
    normal_matrix = normal_matrix - coupling.T @ drift_solver.solve(coupling)
    return normal_matrix, gradient - coupling.T @ drift_solver.solve(drift_columns.T @ contact_fit.residual)


@dataclass(frozen=True)
class PooledEstimate:
    """Estimate from several records; parameters that differ by record follow each other in the order of the records."""

    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    cost: float


def pooled(
    information_by_record: Sequence[RecordInformation],
    step_sizes: Values,
    bounds: tuple[Values, Values],
    prior_centre: Values,
    differs_by_record: bool = False,
) -> PooledEstimate:
    """Estimate of tolerances shared by all records, and of parameters shared or `differs_by_record`, of least -2 ln p.

    A weak prior, `prior_centre` with the width of the range, keeps parameters that a record does not show in range.
    """
    names = list(dict.fromkeys(name for information in information_by_record for name in information.tolerance_names))
    tolerance_count, parameter_count = len(names), len(step_sizes)
    copy_count = len(information_by_record) if differs_by_record else 1
    bounds_in_steps = np.sort(np.stack(bounds) / step_sizes, axis=0)
    prior_widths = np.tile(bounds_in_steps[1] - bounds_in_steps[0], copy_count)
    prior_means = np.concatenate([np.zeros(tolerance_count), np.tile(prior_centre / step_sizes, copy_count)])
    prior_precisions = np.concatenate([np.ones(tolerance_count), prior_widths**-2.0])
    normal_matrix, right_side = np.diag(prior_precisions), prior_precisions * prior_means
    for record_index, information in enumerate(information_by_record):
        first = tolerance_count + (record_index * parameter_count if differs_by_record else 0)
        indices = [*(names.index(name) for name in information.tolerance_names), *range(first, first + parameter_count)]
        normal_matrix[np.ix_(indices, indices)] += information.normal_matrix
        right_side[indices] += information.right_side
    lower_bounds, upper_bounds = (
        np.append(np.full(tolerance_count, sign * PULL_LIMIT), np.tile(bound, copy_count)) - prior_means
        for sign, bound in zip((-1, 1), bounds_in_steps, strict=True)
    )
    slope = right_side - normal_matrix @ prior_means
    unknowns = prior_means + bounded_minimum(normal_matrix, slope, lower_bounds, upper_bounds)
    cost = sum(information.constant_cost for information in information_by_record) + float(
        unknowns @ normal_matrix @ unknowns - 2 * right_side @ unknowns + prior_means @ (prior_precisions * prior_means)
    )
    tiled_steps = np.tile(step_sizes, copy_count)
    covariance = np.linalg.inv(normal_matrix)[tolerance_count:, tolerance_count:] * np.outer(tiled_steps, tiled_steps)
    # the bounds of `bounded_minimum` have slack
    values = np.clip(unknowns[tolerance_count:] * tiled_steps, *(np.tile(bound, copy_count) for bound in bounds))
    return PooledEstimate(values, covariance, cost)


def fitted_to_all_records(
    records: Sequence[Record], variances_by_record: Sequence[NominalVariances], hypothesis: Hypothesis
) -> Hypothesis:
    """Hypothesis with parameters fitted to all records together, from those fitted to one.

    The normal equations of the records are added after the elimination of each one's slow motion. Effects that are
    known by their spectrum alone, or have parameters of every record's own (the phase of a tone), keep their values.
    """
    candidates = hypothesis.candidates
    if not candidates or any(candidate.kind.stochastic or candidate.kind.of_a_record for candidate in candidates):
        return hypothesis
    rig, step_sizes, bounds = records[0].rig, step_sizes_of(candidates), parameters_of(candidates).bounds
    build_rig = partial(with_effects, rig, candidates)

    def pooled_about(values: Values) -> _PooledFit:
        cost, information_by_record = 0.0, list[RecordInformation]()
        for record, nominal_variances in zip(records, variances_by_record, strict=True):
            record_fit = linearized_record(record, nominal_variances, build_rig(values))
            cost += record_fit.cost
            information_by_record.append(record_fit.information_with(build_rig, values, step_sizes, bounds[1]))
        return _PooledFit(values, pooled(information_by_record, step_sizes, bounds, values), cost)

    def refit(earlier: _PooledFit) -> _PooledFit:
        if earlier.has_settled:
            return earlier
        try:
            later = pooled_about(earlier.pooled_estimate.values)
        except RigError:  # no rig has these values together
            return earlier
        return earlier if later.cost > earlier.cost else later

    best_fit = refit_until_settled(
        pooled_about(hypothesis.values), refit, lambda earlier, later: later is earlier, max_rounds=MAX_POOLING_ROUNDS
    )
    return Hypothesis(candidates, best_fit.expansion_values, best_fit.pooled_estimate.covariance, hypothesis.misfit)


@dataclass(frozen=True)
class _PooledFit:
    """Pooled fit linearised about values, and the sum of the records' -2 ln p there, each with its own tolerances."""

    expansion_values: Values
    pooled_estimate: PooledEstimate
    cost: float

    @property
    def has_settled(self) -> bool:
        """True if no value changes by more than `STEP_TOLERANCE` standard errors."""
        change = np.abs(self.pooled_estimate.values - self.expansion_values)
        return bool(np.all(change < STEP_TOLERANCE * np.sqrt(np.diag(self.pooled_estimate.covariance))))
