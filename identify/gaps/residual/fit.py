"""Gauss-Newton fit of an effect's parameters p, jointly with nuisance parameters, drifts and contact tolerances.

The normal equations H d = g are those of `Residual.cost`, with the unknowns of each contact eliminated (Schur
complement). Derivatives are finite differences of the effect's parameters and columns of everything else.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from identify.gaps.residual.law import PullSides
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.residual import Linearization, Residual, ResidualColumn, residual_decrease, residual_of
from identify.signals.gauss_newton import Step, gauss_newton
from rig.errors import RigError
from rig.model.description import Rig

MAX_STEPS, MAX_SIDE_ROUNDS = 12, 4
"""Gauss-Newton steps at most, and times at most that a step is solved again because a contact's tolerance crosses its
limit in it. Numerical."""
DERIVATIVE_STEP = 1e-3
"""Share of a candidate's steps over which derivatives are taken: eliminating nuisance parameters leaves little. Set by
hand, between rounding and curvature."""
BOUND_SLACK, SINGLE_PRECISION = 1e-9, 1e-6
"""Slack of bounds; share added to the diagonal where rounding makes the normal equations indefinite. Numerical."""
COST_TOLERANCE = 3e-5
"""Relative decrease of the cost that ends a fit, a tenth of a standard error; ... Derived: a tenth of a standard error
costs 0.01 of 25 s * 20 Hz = 500 independent samples, 2e-5."""
UNEXPLAINED_TOLERANCE = 1e-3
"""... or the same decrease as a share of the cost beyond noise. Set by hand."""
NEGLIGIBLE_SHARE = 0.1
"""Share of the negligible decrease below which a step is not evaluated. Set by hand."""

Values = Float[np.ndarray, " parameters"]
BuildRig = Callable[[Values], Rig]


@dataclass(frozen=True)
class ParameterFit:
    """Parameters of least cost, and their covariance for 1 / `Record.oversampling` as many independent samples."""

    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    residual: Residual

    @property
    def cost(self) -> float:
        return self.residual.cost


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations H d = g of nuisance parameters and effect parameters; contact unknowns are eliminated.

    unknown_solutions holds each contact's solution u = a - B d as (a, B); cost_decrease_by_contacts is that by the
    contact unknowns alone.
    """

    matrix: Float[np.ndarray, "global global"]
    gradient: Float[np.ndarray, " global"]
    unknown_solutions: tuple[tuple[Float[np.ndarray, " _"], Float[np.ndarray, "_ global"]], ...]
    cost_decrease_by_contacts: float

    def predicted_cost_decrease(self, step: Float[np.ndarray, " global"]) -> float:
        """Decrease of the cost by a step d if the residual were linear, 2 g'd - d'Hd and that by the unknowns."""
        return float(self.cost_decrease_by_contacts + 2 * self.gradient @ step - step @ self.matrix @ step)

    def contact_unknown_steps(self, step: Float[np.ndarray, " global"]) -> list[Float[np.ndarray, " _"]]:
        """Steps of each contact's unknowns that belong to a step of the other parameters."""
        return [step_alone - step_by_parameter @ step for step_alone, step_by_parameter in self.unknown_solutions]


@dataclass(frozen=True)
class EliminatedContact:
    """Unknowns of one contact, eliminated from the normal equations of the nuisance parameters.

    With J the contact residual's columns by its unknowns and r the residual: nuisance_columns are its columns N by the
    nuisance parameters, unknowns_by_nuisance = J'N, solved_by_nuisance = (J'J)^-1 J'N, unknowns_gradient = J'r,
    unknowns_step = (J'J)^-1 J'r. straight_cost_fall is the fall of the cost to that of r, in which the excess of pulls
    is straight (`residual_on_limit_sides`).
    """

    unknowns_solver: SuperLU
    nuisance_columns: Float[np.ndarray, "_ nuisances"]
    unknowns_by_nuisance: Float[np.ndarray, "unknowns nuisances"]
    solved_by_nuisance: Float[np.ndarray, "unknowns nuisances"]
    unknowns_gradient: Float[np.ndarray, " unknowns"]
    unknowns_step: Float[np.ndarray, " unknowns"]
    straight_cost_fall: float


@dataclass(frozen=True)
class ReducedEquations:
    """Normal equations of the nuisance parameters at a residual, with the contact unknowns eliminated."""

    linearization: Linearization
    residual: Residual
    matrix: Float[np.ndarray, "nuisances nuisances"]
    gradient: Float[np.ndarray, " nuisances"]
    eliminated_contacts: tuple[EliminatedContact, ...]

    def with_outstanding_lines(self) -> "ReducedEquations":
        """Equations whose gradient includes the outstanding lines, for effects that may explain them."""
        residual = replace(self.residual, linear_without_lines=self.residual.linear_residual)
        lines_over_time = residual.linear_without_lines - self.residual.linear_without_lines
        gradient_of_lines = self.linearization.columns.products_with(lines_over_time.ravel())
        return replace(self, residual=residual, gradient=self.gradient + gradient_of_lines)

    def with_columns(self, columns: list[ResidualColumn]) -> NormalEquations:
        """Normal equations of the nuisance parameters, followed by one parameter for each column."""
        nuisance_count, parameter_count = len(self.gradient), len(self.gradient) + len(columns)
        matrix, gradient = np.zeros((parameter_count, parameter_count)), np.zeros(parameter_count)
        matrix[:nuisance_count, :nuisance_count], gradient[:nuisance_count] = self.matrix, self.gradient
        linear_columns = np.array([column[0].ravel() for column in columns])
        linear_columns = linear_columns.reshape(len(columns), self.residual.linear_residual.size)
        matrix[:nuisance_count, nuisance_count:] = self.linearization.columns.products_with(linear_columns)
        matrix[nuisance_count:, nuisance_count:] = linear_columns @ linear_columns.T
        gradient[nuisance_count:] = linear_columns @ self.residual.linear_without_lines.ravel()
        unknown_solutions = []
        for j, (contact, eliminated) in enumerate(zip(self.residual.contacts, self.eliminated_contacts, strict=True)):
            contact_columns = np.array([c[1][j] for c in columns]).reshape(len(columns), contact.residual.size).T
            by_unknown = contact.columns_by_unknown.T @ contact_columns
            solved = eliminated.unknowns_solver.solve(by_unknown)
            nuisance_products = eliminated.nuisance_columns.T @ contact_columns
            matrix[:nuisance_count, nuisance_count:] += nuisance_products - eliminated.unknowns_by_nuisance.T @ solved
            matrix[nuisance_count:, nuisance_count:] += contact_columns.T @ contact_columns - by_unknown.T @ solved
            gradient[nuisance_count:] += contact_columns.T @ contact.residual - solved.T @ eliminated.unknowns_gradient
            all_solved = np.concatenate([eliminated.solved_by_nuisance, solved], axis=1)
            unknown_solutions.append((eliminated.unknowns_step, all_solved))
        matrix[nuisance_count:, :nuisance_count] = matrix[:nuisance_count, nuisance_count:].T
        cost_decrease = sum(
            e.unknowns_gradient @ e.unknowns_step + e.straight_cost_fall for e in self.eliminated_contacts
        )
        return NormalEquations(matrix, gradient, tuple(unknown_solutions), float(cost_decrease))


def reduced_equations(
    linearization: Linearization, residual: Residual, pull_sides: Sequence[PullSides] | None = None
) -> ReducedEquations:
    """Normal equations of the nuisance parameters, with their unit normal priors weighted by `oversampling`.

    `pull_sides` are those of each contact's pulls, by default the present ones.
    """
    oversampling = linearization.record.oversampling
    normal_matrix = linearization.column_gram + oversampling * np.eye(len(linearization.columns.parameters))
    gradient = linearization.columns.products_with(residual.linear_without_lines.ravel())
    gradient = gradient - oversampling * residual.nuisance_pulls
    eliminated = []
    for j, contact in enumerate(residual.contacts):
        sides = contact.pull_limit_sides_after() if pull_sides is None else pull_sides[j]
        columns, straight_residual = contact.columns_on_limit_sides(sides), contact.residual_on_limit_sides(sides)
        solver, by_nuisance = splu(csc_matrix(columns.T @ columns)), contact_jacobian(linearization, residual, j)
        contact_gradient, products = columns.T @ straight_residual, columns.T @ by_nuisance
        solved = solver.solve(products)
        normal_matrix = normal_matrix + by_nuisance.T @ by_nuisance - products.T @ solved
        gradient = gradient + by_nuisance.T @ contact.residual - solved.T @ contact_gradient
        step, cost_fall = solver.solve(contact_gradient), contact.cost - float(straight_residual @ straight_residual)
        eliminated.append(EliminatedContact(solver, by_nuisance, products, solved, contact_gradient, step, cost_fall))
    return ReducedEquations(linearization, residual, normal_matrix, gradient, tuple(eliminated))


def contact_jacobian(
    linearization: Linearization, residual: Residual, contact_index: int
) -> Float[np.ndarray, "_ nuisances"]:
    """Decrease of one contact's residual per standard deviation of each nuisance parameter."""
    weights, contact_fit = linearization.observations[contact_index].force_weights, residual.contacts[contact_index]
    columns = linearization.columns
    force_decreases_n = columns.contact_force_n[:, contact_index].astype(float)
    moves_contact = np.any(columns.eta_m[:, contact_index], axis=1)
    eta_changes_m = columns.finer_eta_m[moves_contact, contact_index]
    force_decreases_n[columns.eta_parameter_indices[moves_contact]] -= contact_fit.tangent.force_change_n(eta_changes_m)
    jacobian = np.zeros((contact_fit.residual.size, len(columns.parameters)))
    jacobian[: weights.size] = weights[:, None] * force_decreases_n.T
    return jacobian


def contact_residual_columns(
    linearization: Linearization, residual: Residual, contact_index: int, column_count: int
) -> Float[np.ndarray, "rows columns"]:
    """Columns of one contact's residual by the nuisance parameters and the tolerances of every contact; zero beyond."""
    contact_fit, nuisance_count = residual.contacts[contact_index], len(linearization.columns.parameters)
    columns = np.zeros((contact_fit.residual.size, column_count))
    columns[:, :nuisance_count] = contact_jacobian(linearization, residual, contact_index)
    first_tolerance = nuisance_count + sum(earlier.pulls.size for earlier in residual.contacts[:contact_index])
    sample_count = contact_fit.observation.force_weights.size
    tolerance_columns = contact_fit.columns_by_unknown[:sample_count, contact_fit.observation.tolerance_slice]
    columns[:sample_count, first_tolerance : first_tolerance + contact_fit.pulls.size] = tolerance_columns.toarray()
    return columns


def fit(
    linearization: Linearization,
    build_rig: BuildRig,
    start_values: Values,
    parameter_steps: Values,
    bounds: tuple[Values, Values],
    start_residual: Residual | None = None,
    max_steps: int = MAX_STEPS,
) -> ParameterFit:
    """Minimise the cost over parameters within bounds, from `start_values`; `parameter_steps` scale derivatives' steps.

    `start_residual` gives the nuisance parameters and contact unknowns to start from.
    """
    pulls, unknowns = None, None
    if start_residual:
        pulls, unknowns = start_residual.nuisance_pulls, tuple(contact.unknowns for contact in start_residual.contacts)
        if linearization.tuning.pulls and not pulls.any():
            pulls = None  # the modes' parameters start at the values that the record's modes give
    start_point = _Point(start_values, residual_of(linearization, build_rig(start_values), pulls, unknowns))
    step_from = partial(_step, linearization, build_rig, parameter_steps, bounds)
    best_point, last_step = gauss_newton(start_point, step_from, _negligible_cost_decrease, max_steps, NEGLIGIBLE_SHARE)
    if linearization.record.measured_modes:  # within a sharp mode's width the nuisance columns change already
        last_step = step_from(start_point)
    return ParameterFit(best_point.values, last_step.covariance, best_point.residual)


@dataclass(frozen=True)
class _Point:
    values: Values
    residual: Residual

    @property
    def cost(self) -> float:
        return self.residual.cost


@dataclass(frozen=True)
class _Step(Step[_Point]):
    covariance: Float[np.ndarray, "parameters parameters"]


def _negligible_cost_decrease(point: _Point) -> float:
    return max(COST_TOLERANCE * point.cost, UNEXPLAINED_TOLERANCE * (point.cost - point.residual.residual_count))


def _step(
    linearization: Linearization, build_rig: BuildRig, steps: Values, bounds: tuple[Values, Values], point: _Point
) -> _Step:
    """Gauss-Newton step within bounds, and the parameters' covariance by this linearisation."""
    values, residual, nuisance_count = point.values, point.residual, len(linearization.columns.parameters)
    inward_steps = DERIVATIVE_STEP * np.where(values + steps > bounds[1], -steps, steps)
    columns = [
        _residual_decrease_by_step(linearization, build_rig, values, s, residual)
        for s in np.eye(values.size) * inward_steps
    ]
    scaled_bounds = np.sort((np.stack(bounds) - values) / inward_steps, axis=0)
    least_step = np.concatenate([-PULL_LIMIT - residual.nuisance_pulls, scaled_bounds[0]])
    greatest_step = np.concatenate([PULL_LIMIT - residual.nuisance_pulls, scaled_bounds[1]])
    pull_sides = [contact.pull_limit_sides_after() for contact in residual.contacts]
    for _ in range(MAX_SIDE_ROUNDS):
        equations = reduced_equations(linearization, residual, pull_sides).with_columns(columns)
        ridge = np.r_[np.zeros(nuisance_count), 1e-9 * np.diag(equations.matrix)[nuisance_count:] + 1e-300]
        full_step = bounded_minimum(equations.matrix + np.diag(ridge), equations.gradient, least_step, greatest_step)
        steps_of_contacts = zip(residual.contacts, equations.contact_unknown_steps(full_step), strict=True)
        sides_before, pull_sides = (
            pull_sides,
            [contact.pull_limit_sides_after(step) for contact, step in steps_of_contacts],
        )
        if all(np.array_equal(*pair) for pair in zip(sides_before, pull_sides, strict=True)):
            break

    def point_after(step_share: float) -> _Point | None:
        step = step_share * full_step
        stepped_values = np.clip(values + step[nuisance_count:] * inward_steps, *bounds)
        step[nuisance_count:] = (stepped_values - values) / inward_steps
        unknowns = [
            contact.unknowns + step_share * contact_step
            for contact, contact_step in zip(
                residual.contacts, equations.contact_unknown_steps(step / step_share), strict=True
            )
        ]
        try:
            rig, pulls = build_rig(stepped_values), residual.nuisance_pulls + step[:nuisance_count]
            return _Point(stepped_values, residual_of(linearization, rig, pulls, tuple(unknowns), reusable=residual))
        except RigError:  # no such rig
            return None

    scaled_covariance = scaled_inverse(equations.matrix)[nuisance_count:, nuisance_count:]
    covariance = linearization.record.oversampling * scaled_covariance * np.outer(inward_steps, inward_steps)
    return _Step(point_after, equations.predicted_cost_decrease(full_step), covariance)


def _residual_decrease_by_step(
    linearization: Linearization, build_rig: BuildRig, values: Values, step: Values, residual: Residual
) -> ResidualColumn:
    """Decrease of the residuals by a step; where sharp modes ring, by extrapolation, 2 d(step) - d(2 step) / 2.

    A shift by a fraction of a resonance's width is nonlinear, and nuisance parameters cannot absorb its curvature.
    """
    linear_decrease, contact_decreases = residual_decrease(linearization, build_rig(values + step), residual)
    if not linearization.record.measured_modes:
        return linear_decrease, contact_decreases
    double_linear_decrease, double_decreases = residual_decrease(linearization, build_rig(values + 2 * step), residual)
    decreases = zip(contact_decreases, double_decreases, strict=True)
    return 2 * linear_decrease - double_linear_decrease / 2, [2 * single - double / 2 for single, double in decreases]


def scaled_inverse(normal_matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Pseudo-inverse of normal equations after scaling to a unit diagonal; zero for parameters without information."""
    diagonal_root = np.sqrt(np.diag(normal_matrix))
    inverse_diagonal_root = np.divide(1.0, diagonal_root, out=np.zeros_like(diagonal_root), where=diagonal_root > 0)
    scaling = np.outer(inverse_diagonal_root, inverse_diagonal_root)
    return np.asarray(np.linalg.pinv(normal_matrix * scaling, hermitian=True) * scaling)


def bounded_minimum(
    matrix: Float[np.ndarray, "n n"],
    gradient: Float[np.ndarray, " n"],
    lower_bounds: Float[np.ndarray, " n"],
    upper_bounds: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Minimise x'Mx/2 - g'x over lower_bounds <= x <= upper_bounds.

    Raises RigError if M or g is not finite, or if M is singular beyond single-precision rounding.
    """
    if not (np.isfinite(matrix).all() and np.isfinite(gradient).all()):
        raise RigError(
            "rig.json's contacts or modes are beyond any that this recording can be compared with; check its numbers"
        )
    cholesky_factor = _cholesky(matrix)
    whitened_gradient = solve_triangular(cholesky_factor, gradient, lower=True)
    bounds = np.minimum(lower_bounds, 0.0) - BOUND_SLACK, np.maximum(upper_bounds, 0.0) + BOUND_SLACK
    return np.asarray(lsq_linear(cholesky_factor.T, whitened_gradient, bounds, "bvls").x)


def _cholesky(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Cholesky factor of a matrix of single-precision products; a diagonal shift if rounding made it indefinite."""
    for shift_share in (0.0, SINGLE_PRECISION):
        with suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.cholesky(matrix + shift_share * np.diag(np.diag(matrix))))
    raise RigError(
        "the recording does not tell contact forces and tolerances of this rig apart; measure more stations, or "
        "describe fewer contacts in rig.json"
    )
