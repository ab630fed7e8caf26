"""Statistic S of the diagnosis as a function of all candidates at once, about one fitted rig.

Notes for maintainers
1. The residuals of a fitted rig are taken as linear in theta: nuisance parameters, contact tolerances, parameters of
   effects that are in the rig already, and strengths of candidates at some places,

       linear residual of sensor i in band b:  r - X theta,   L_bi(theta) = mean |r - X theta|^2
       contact residual j, slow motion eliminated:  L_j(theta) = L_j0 + c_j (theta' M_j theta - 2 g_j' theta)

   both in the variances that the nominal rig states (`likelihood.NominalVariances`).
2. The statistic is that of `likelihood`, with p the pulls of the tolerances:

       S(theta) = N_b sum_bi ln((1 + L_bi)/2) + N sum_j ln((1 + L_j)/2) + |p + theta|^2 + inputs

3. It is majorised at theta_k, as ln is concave: every L weighs N/(1 + L(theta_k)). Each step is a bounded least-squares
   problem in one small normal matrix (Lange, Hunter and Yang, J. Comput. Graph. Stat. 9, 2000).
4. Only the knots of the slow motion are eliminated. Contact tolerances are explicit, with their prior: eliminated, they
   would absorb contact laws at almost no cost.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from identify.gaps.residual.fit import DERIVATIVE_STEP, bounded_minimum
from identify.gaps.residual.likelihood import NominalVariances
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn, residual_decrease
from identify.gaps.search.candidates import Candidate, strength_columns
from identify.gaps.search.hypothesis import Hypothesis, parameters_of, step_sizes_of, with_effects
from identify.gaps.search.local_columns import LocalColumns
from identify.gaps.search.pooled import equations_without_drift
from identify.signals.recent_values import RecentValues
from rig.errors import RigError
from rig.model.description import Rig

MAX_MAJORIZATIONS = 5
"""Steps of the majorisation at most. Effort."""
STATISTIC_TOLERANCE = 0.1
"""Decrease of S below which the majorisation ends: odds change by 1 %."""
RELATIVE_RIDGE = 1e-5
"""Added to the diagonal, relative: rounding of sums of 1e5 products in single precision."""
RIDGE_FLOOR = 1e-15
"""Added to the diagonal, of its largest entry: what the record does not show stays zero."""
ELIMINATION_ROUNDING = 1e-9
"""Added to the diagonal, of a column's square before the slow motion is eliminated: rounding of the difference."""
MIN_REMAINING_SHARE = 1e-9
"""Least share of a column's weighted square that the nuisance parameters must leave of it."""

ROWS_PER_BLOCK = 1 << 12
"""Rows of the spectra that are multiplied at once. Effort: a weighted copy of all would double the memory."""

Theta = Float[np.ndarray, " columns"]
Levels = tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " contacts"]]


@dataclass(frozen=True)
class CandidateTerm:
    """Candidate at one place: its columns, its parameters at theta = 0, and the range of theta.

    theta is in units of `Candidate.step_sizes` of the strengths.
    """

    candidate: Candidate
    start_values: Float[np.ndarray, " parameters"]
    strength_indices: tuple[int, ...]
    column_indices: Int[np.ndarray, " selected"]
    theta_min: Float[np.ndarray, " selected"]
    theta_max: Float[np.ndarray, " selected"]

    def values_at(self, theta: Theta) -> Float[np.ndarray, " parameters"]:
        """Parameters of the effect at theta."""
        effect_values = self.start_values.copy()
        indices = list(self.strength_indices)
        effect_values[indices] += theta[self.column_indices] * self.candidate.step_sizes[indices]
        return effect_values


@dataclass(frozen=True)
class Solution:
    """Minimum of S over some columns, all others zero."""

    theta: Theta
    statistic: float


@dataclass(frozen=True)
class LocalModel:
    """Statistic S(theta) about a fitted rig.

    column_spectra holds X and residual_spectrum r: windowed, in nominal standard deviations, real and imaginary
    parts, scaled so that the squares of a cell's rows add up to L. cell_of_row is the index of a row's band and sensor.
    present_columns are those of every solution: tolerances, whose `pulls` are p, then the effects already in the rig.
    """

    column_spectra: Float[np.ndarray, "columns rows"]
    residual_spectrum: Float[np.ndarray, " rows"]
    cell_of_row: Int[np.ndarray, " rows"]
    contact_matrices: Float[np.ndarray, "contacts columns columns"]
    contact_gradients: Float[np.ndarray, "contacts columns"]
    contact_levels: Float[np.ndarray, " contacts"]
    input_matrix: Float[np.ndarray, "columns columns"]
    input_slope: Float[np.ndarray, " columns"]
    pulls: Float[np.ndarray, " tolerances"]
    theta_min: Theta
    theta_max: Theta
    samples_per_cell: float
    samples_per_contact: float
    present_columns: Int[np.ndarray, " selected"]
    candidate_terms: tuple[CandidateTerm, ...]
    recent_levels: RecentValues[Levels] = field(default_factory=lambda: RecentValues(2), repr=False)

    def levels(self, theta: Theta) -> Levels:
        """Levels L of all cells, and of all contacts."""
        return self.recent_levels.get(theta.tobytes(), lambda: self._levels_at(theta))

    def _levels_at(self, theta: Theta) -> Levels:
        base_count = self.present_columns.size
        added_indices = base_count + np.flatnonzero(theta[base_count:])
        spectrum = self.residual_spectrum - theta[:base_count].astype(np.float32) @ self.column_spectra[:base_count]
        spectrum -= theta[added_indices].astype(np.float32) @ self.column_spectra[added_indices]
        contact_levels = self.contact_levels + np.einsum("k,jkl,l->j", theta, self.contact_matrices, theta)
        contact_levels -= 2 * self.contact_gradients @ theta
        return np.bincount(self.cell_of_row, spectrum.astype(float) ** 2), np.maximum(contact_levels, 0.0)

    def statistic(self, theta: Theta) -> float:
        """Statistic S, up to a constant of the record."""
        cell_levels, contact_levels = self.levels(theta)
        residual_cost = self.samples_per_cell * np.sum(np.log1p(cell_levels))
        residual_cost += self.samples_per_contact * np.sum(np.log1p(contact_levels))
        input_cost = theta @ self.input_matrix @ theta - 2 * self.input_slope @ theta
        return float(residual_cost + np.sum((self.pulls + theta[: self.pulls.size]) ** 2) + input_cost)

    def normal_equations(
        self, theta: Theta, column_indices: Int[np.ndarray, " selected"]
    ) -> tuple[Float[np.ndarray, "selected selected"], Float[np.ndarray, " selected"]]:
        """Matrix A and right-hand side b of S majorised at theta, whose minimum x solves A x = b."""
        cell_levels, contact_levels = self.levels(theta)
        cell_weights = self.samples_per_cell / (1 + cell_levels)
        row_weights = np.sqrt(cell_weights[self.cell_of_row]).astype(np.float32)
        matrix, right_side = self.input_matrix[np.ix_(column_indices, column_indices)], self.input_slope[column_indices]
        for first_row in range(0, row_weights.size, ROWS_PER_BLOCK):
            row_slice = slice(first_row, first_row + ROWS_PER_BLOCK)
            weighted_spectra = self.column_spectra[column_indices, row_slice]
            weighted_spectra *= row_weights[row_slice]
            matrix += weighted_spectra @ weighted_spectra.T
            right_side += weighted_spectra @ (self.residual_spectrum[row_slice] * row_weights[row_slice])
        for contact_weight, contact_matrix, gradient in zip(
            self.samples_per_contact / (1 + contact_levels), self.contact_matrices, self.contact_gradients, strict=True
        ):
            matrix += contact_weight * contact_matrix[np.ix_(column_indices, column_indices)]
            right_side += contact_weight * gradient[column_indices]
        is_tolerance = column_indices < self.pulls.size
        matrix[is_tolerance, is_tolerance] += 1.0
        right_side[is_tolerance] -= self.pulls[column_indices[is_tolerance]]
        return matrix, right_side

    def minimum(self, terms: Sequence[CandidateTerm], start_theta: Theta | None = None) -> Solution:
        """Minimum of S with some candidates, by majorisation from `start_theta`."""
        column_indices = np.concatenate([self.present_columns, *(term.column_indices for term in terms)]).astype(int)
        theta = np.zeros(len(self.column_spectra))
        if start_theta is not None:
            theta[column_indices] = start_theta[column_indices]
        best_solution = Solution(theta, self.statistic(theta))
        for _ in range(MAX_MAJORIZATIONS):
            normal_matrix, right_side = self.normal_equations(best_solution.theta, column_indices)
            diagonal = np.diag(normal_matrix)
            diagonal_shift = RELATIVE_RIDGE * diagonal + RIDGE_FLOOR * diagonal.max()
            normal_matrix += np.diag(diagonal_shift)  # what is not shown stays zero
            theta = np.zeros(len(self.column_spectra))
            current_theta = best_solution.theta[column_indices]
            least_step = self.theta_min[column_indices] - current_theta
            greatest_step = self.theta_max[column_indices] - current_theta
            step = bounded_minimum(normal_matrix, right_side - normal_matrix @ current_theta, least_step, greatest_step)
            theta[column_indices] = current_theta + step
            solution = Solution(theta, self.statistic(theta))
            statistic_decrease = best_solution.statistic - solution.statistic
            if statistic_decrease > 0:
                best_solution = solution
            if statistic_decrease < STATISTIC_TOLERANCE:
                break
        return best_solution

    def without_superfluous(
        self, terms: Sequence[CandidateTerm], solution: Solution, least_gain: float
    ) -> tuple[list[CandidateTerm], Solution]:
        """Terms without those before the last that the others have made superfluous, and their minimum."""
        chosen_terms = list(terms)
        for term in chosen_terms[:-1]:
            remaining_terms = [other_term for other_term in chosen_terms if other_term is not term]
            reduced_solution = self.minimum(remaining_terms, solution.theta)
            if reduced_solution.statistic - solution.statistic < least_gain:
                chosen_terms, solution = remaining_terms, reduced_solution
        return chosen_terms, solution

    def promised_decreases(self, terms: Sequence[CandidateTerm], solution: Solution) -> Float[np.ndarray, " terms"]:
        """Lower bound of the decrease of S by each joining term: that of the majorised S within its range."""
        matrix, right_side = self.normal_equations(solution.theta, np.arange(len(self.column_spectra)))
        slope = right_side - matrix @ solution.theta
        joined = np.concatenate([self.present_columns, *(term.column_indices for term in terms)]).astype(int)
        response = np.linalg.solve(matrix[np.ix_(joined, joined)] + 1e-12 * np.eye(joined.size), matrix[joined])
        decreases = np.zeros(len(self.candidate_terms))
        for term_index, term in enumerate(self.candidate_terms):
            columns = term.column_indices
            curvature = matrix[np.ix_(columns, columns)] - matrix[np.ix_(columns, joined)] @ response[:, columns]
            is_absorbed = np.diag(curvature) <= MIN_REMAINING_SHARE * np.diag(matrix)[columns]
            if np.any(np.isin(columns, joined)) or np.any(is_absorbed):
                continue
            reduced_slope = slope[columns] - response[:, columns].T @ slope[joined]
            theta_step = np.clip(np.linalg.solve(curvature, reduced_slope), term.theta_min, term.theta_max)
            decreases[term_index] = 2 * reduced_slope @ theta_step - theta_step @ curvature @ theta_step
        return decreases


def local_model(
    linearization: Linearization,
    residual: Residual,
    nominal_variances: NominalVariances,
    rig: Rig,
    present_set: Hypothesis,
    candidates: Sequence[Candidate],
) -> LocalModel:
    """Local model about the residual of `rig` with the effects `present_set`, with the columns of every candidate."""
    added_count = sum(len(candidate.start_values()) * len(candidate.parameters.strengths) for candidate in candidates)
    added_count += len(parameters_of(present_set.candidates))
    local_columns = LocalColumns(linearization, residual, nominal_variances, added_count)
    for column in _present_columns(linearization, residual, rig, present_set):
        local_columns.append(column)
    present_count, terms = local_columns.column_count - residual.pulls.size, list[CandidateTerm]()
    for candidate in candidates:
        for start_values in candidate.start_values():
            with suppress(RigError):  # no such rig
                new_columns = strength_columns(linearization, residual, candidate, start_values)
                terms.append(_candidate_term(candidate, start_values, local_columns.column_count))
                for linear_decrease, contact_decreases in new_columns:
                    single_decreases = [decrease.astype(np.float32) for decrease in contact_decreases]
                    local_columns.append((linear_decrease.astype(np.float32), single_decreases))
    return _local_model_of_columns(
        local_columns, nominal_variances, present_count, tuple(terms), _present_theta_bounds(present_set)
    )


def _candidate_term(
    candidate: Candidate, start_values: Float[np.ndarray, " parameters"], first_column: int
) -> CandidateTerm:
    """Term of a candidate at `start_values`, whose columns begin with `first_column`."""
    strength_indices = list(candidate.parameters.strengths)
    theta_ends = [
        (bound[strength_indices] - start_values[strength_indices]) / candidate.step_sizes[strength_indices]
        for bound in candidate.parameters.bounds
    ]
    column_indices = first_column + np.arange(len(strength_indices))
    theta_min, theta_max = np.minimum(*theta_ends), np.maximum(*theta_ends)
    return CandidateTerm(candidate, start_values, tuple(strength_indices), column_indices, theta_min, theta_max)


def _present_columns(
    linearization: Linearization, residual: Residual, rig: Rig, present_set: Hypothesis
) -> Iterator[ResidualColumn]:
    """Decrease of the residuals by a step of each parameter of the effects already in the rig."""
    candidates, values = present_set.candidates, present_set.values
    build_rig = partial(with_effects, rig, candidates)
    steps = step_sizes_of(candidates)
    signed_shares = np.where(values + steps > parameters_of(candidates).bounds[1], -DERIVATIVE_STEP, DERIVATIVE_STEP)
    for signed_share, step in zip(signed_shares, np.diag(steps), strict=True):
        stepped_rig = build_rig(values + signed_share * step)
        linear_decrease, contact_decreases = residual_decrease(linearization, stepped_rig, residual)
        yield (linear_decrease / signed_share, [column / signed_share for column in contact_decreases])


def _present_theta_bounds(
    present_set: Hypothesis,
) -> tuple[Float[np.ndarray, " present"], Float[np.ndarray, " present"]]:
    if not present_set.candidates:
        return np.zeros(0), np.zeros(0)
    parameter_bounds = parameters_of(present_set.candidates).bounds
    theta_bounds = [(bound - present_set.values) / step_sizes_of(present_set.candidates) for bound in parameter_bounds]
    return np.minimum(*theta_bounds), np.maximum(*theta_bounds)


def _local_model_of_columns(
    columns: LocalColumns,
    nominal_variances: NominalVariances,
    present_count: int,
    terms: tuple[CandidateTerm, ...],
    present_range: tuple[Float[np.ndarray, " present"], Float[np.ndarray, " present"]],
) -> LocalModel:
    record, residual = columns.linearization.record, columns.residual
    column_count, cell_of_row = columns.column_count, columns.cell_of_row
    pulls, oversampling = residual.pulls, record.oversampling
    sensor_count, time_count = len(record.sensors), residual.linear_residual.shape[1]
    input_rows, input_residual = columns.input_rows[:column_count], residual.linear_residual[sensor_count:].ravel()
    contact_matrices, contact_gradients, contact_levels = [], [], []
    for contact_index, contact_fit in enumerate(residual.contacts):
        contact_rows = columns.contact_rows(contact_index)
        contact_matrix, gradient = equations_without_drift(residual, contact_index, contact_rows)
        contact_matrix += np.diag(ELIMINATION_ROUNDING * np.einsum("rk,rk->k", contact_rows, contact_rows))
        sum_of_squares = float(np.sum(contact_fit.residual[: contact_fit.observation.force_weights.size] ** 2))
        contact_level = _contact_mean_square(nominal_variances, residual, contact_index)
        contact_matrices.append(contact_matrix * contact_level / sum_of_squares if sum_of_squares else contact_matrix)
        contact_gradients.append(gradient * contact_level / sum_of_squares if sum_of_squares else gradient)
        contact_levels.append(contact_level)
    theta_min, theta_max = np.full(column_count, -np.inf), np.full(column_count, np.inf)
    theta_min[: pulls.size], theta_max[: pulls.size] = -PULL_LIMIT - pulls, PULL_LIMIT - pulls
    present_effects = slice(pulls.size, pulls.size + present_count)
    theta_min[present_effects], theta_max[present_effects] = present_range
    for term in terms:
        theta_min[term.column_indices], theta_max[term.column_indices] = term.theta_min, term.theta_max
    band_count = int(cell_of_row.max()) // sensor_count + 1
    independent_sample_count = time_count / oversampling
    return LocalModel(
        column_spectra=columns.spectra[:column_count],
        residual_spectrum=columns.spectrum(residual.linear_without_lines),
        cell_of_row=cell_of_row,
        contact_matrices=np.array(contact_matrices).reshape(len(contact_matrices), column_count, column_count),
        contact_gradients=np.array(contact_gradients).reshape(len(contact_gradients), column_count),
        contact_levels=np.array(contact_levels),
        input_matrix=(input_rows @ input_rows.T).astype(float) / oversampling,
        input_slope=(input_rows @ input_residual.astype(np.float32)).astype(float) / oversampling,
        pulls=pulls,
        theta_min=theta_min,
        theta_max=theta_max,
        samples_per_cell=independent_sample_count / band_count,
        samples_per_contact=independent_sample_count,
        present_columns=np.arange(pulls.size + present_count),
        candidate_terms=terms,
    )


def _contact_mean_square(nominal_variances: NominalVariances, residual: Residual, contact_index: int) -> float:
    """Mean square of a contact's residual relative to the nominal rig's variances."""
    contact_fit, weights = residual.contacts[contact_index], residual.contacts[contact_index].observation.force_weights
    residual_n = np.divide(contact_fit.residual[: weights.size], weights, out=np.zeros(weights.size), where=weights > 0)
    return float(np.mean((residual_n * nominal_variances.observations[contact_index].force_weights) ** 2))
