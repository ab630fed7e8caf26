"""Clearances by the restoring force surface, and by the histogram of the relative displacement."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares, minimize

from identify.linear.modal import ModalEquation
from identify.signals.scores import PART_COUNT, cluster_scores
from identify.signals.spectra import decimated
from rig.model.contact_laws import penetration_m

MIN_CONTACT_SHARE = 2e-3
"""Share of the time for which a contact must be closed to determine its clearance."""
MAX_LOG_KAPPA = 20.0
"""Largest ln kappa of the density of a relative displacement, of one standard deviation: a rigid stop."""


Samples = Float[np.ndarray, " samples"]
Parameters = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class Stops:
    """Clearances of a contact to its lower and upper stop, with standard errors; mean_error_m is that of their mean.

    clearance_m is their mean, or the clearance of the only stop that is touched.
    """

    lower_m: float
    upper_m: float
    lower_error_m: float
    upper_error_m: float
    mean_error_m: float
    touched: tuple[bool, bool] = (True, True)

    @property
    def clearance_m(self) -> float:
        return self._of_touched_stops(self.lower_m, self.upper_m, (self.lower_m + self.upper_m) / 2)

    @property
    def clearance_error_m(self) -> float:
        return self._of_touched_stops(self.lower_error_m, self.upper_error_m, self.mean_error_m)

    def _of_touched_stops(self, lower_value: float, upper_value: float, mean_value: float) -> float:
        return mean_value if all(self.touched) else lower_value if self.touched[0] else upper_value


@dataclass(frozen=True)
class Surface:
    """Restoring force of a modal equation, measured and fitted, at every `decimation`-th sample of the record.

    measured_modal_force = shape_at_force F - q'' (N / sqrt(kg));
    fitted_modal_force = damping q' + stiffness q + sum_j shape_j k_j dz_j(eta_j).
    fitted_contact_parts are the parts of each contact in the fitted force.
    """

    equation: ModalEquation
    decimation: int
    measured_modal_force: Float[np.ndarray, " samples"]
    fitted_modal_force: Float[np.ndarray, " samples"]
    fitted_contact_parts: Float[np.ndarray, "contacts samples"]
    stops: tuple[Stops | None, ...]
    stiffness_n_per_m: Float[np.ndarray, " contacts"]


def restoring_force(equation: ModalEquation, force_n: Samples) -> Samples:
    """Restoring force r = shape_at_force F - q'' of a modal equation, N / sqrt(kg)."""
    return equation.shape_at_force * force_n - equation.acceleration


def fit_surface(
    equation: ModalEquation,
    force_n: Samples,
    eta_m: Float[np.ndarray, "contacts samples"],
    decimation: int,
    start_stops: tuple[Stops | None, ...],
) -> Surface:
    """Least squares of the restoring force on q', q and a dead zone for each visible contact with starting stops.

    The stops are nonlinear parameters, found by nonlinear least squares around the linear regression; their standard
    errors are sandwich estimates, which allow for residuals correlated within a sixteenth of the record. Both sides are
    low-passed alike and decimated by `decimation`, as the modal transformation fails at high frequencies.
    """
    stop_visibility = zip(start_stops, equation.is_visible, strict=True)
    starts = {j: start for j, (start, is_visible) in enumerate(stop_visibility) if is_visible and start}
    measured = decimated(restoring_force(equation, force_n), decimation)
    linear_columns = decimated(np.stack([equation.velocity, equation.displacement]), decimation)

    def columns_of(stops: Float[np.ndarray, " stops"]) -> Float[np.ndarray, "samples columns"]:
        depths_m = (penetration_m(eta_m[j], *stops[2 * i : 2 * i + 2]) for i, j in enumerate(starts))
        dead_zones = (
            equation.shape_at_contacts[j] * decimated(x, decimation) for j, x in zip(starts, depths_m, strict=True)
        )
        return np.stack([*linear_columns, *dead_zones], axis=1)

    def residual(stops: Float[np.ndarray, " stops"]) -> Samples:
        return measured - _projection(columns_of(stops), measured)[0]

    reach_m = np.maximum(np.array([[-eta_m[j].min(), eta_m[j].max()] for j in starts]).ravel(), 1e-12)
    start_clearances_m = np.array([x for start in starts.values() for x in (start.lower_m, start.upper_m)])
    solution = least_squares(
        lambda relative: residual(relative * reach_m),
        np.clip(start_clearances_m / reach_m, 0.0, 0.98),
        bounds=(0, 1),
        xtol=1e-9,
        ftol=1e-12,
    )
    stops_m = solution.x * reach_m
    columns = columns_of(stops_m)
    fitted, column_weights = _projection(columns, measured)
    covariance = _sandwich_covariance(np.concatenate([columns, solution.jac / reach_m], axis=1), measured - fitted)
    fitted_stops: list[Stops | None] = [None] * len(eta_m)
    contact_parts, stiffness_n_per_m = np.zeros((len(eta_m), measured.size)), np.full(len(eta_m), np.nan)
    for i, (j, start) in enumerate(starts.items()):
        stop_row = columns.shape[1] + 2 * i
        stop_covariance = covariance[stop_row : stop_row + 2, stop_row : stop_row + 2]
        stiffness_n_per_m[j] = column_weights[2 + i]
        contact_parts[j] = column_weights[2 + i] * columns[:, 2 + i]
        lower_m, upper_m = stops_m[2 * i : 2 * i + 2].tolist()
        if np.mean((eta_m[j] > upper_m) | (eta_m[j] < -lower_m)) >= MIN_CONTACT_SHARE:
            variances = [stop_covariance[0, 0], stop_covariance[1, 1], stop_covariance.sum() / 4]
            lower_error_m, upper_error_m, mean_error_m = np.sqrt(variances).tolist()
            fitted_stops[j] = Stops(lower_m, upper_m, lower_error_m, upper_error_m, mean_error_m, start.touched)
    return Surface(equation, decimation, measured, fitted, contact_parts, tuple(fitted_stops), stiffness_n_per_m)


def stops_from_eta_density(eta_m: Float[np.ndarray, " samples"]) -> Stops:
    """Stops by maximum likelihood of the density of the relative displacement,

        log p = const - a eta - b eta^2 / 2 - kappa dz(eta; lower, upper)^2 / 2

    a Gaussian within the gap and a narrower one beyond each stop. Standard errors from sixteen parts of the record;
    NaN for a stop that is not reached in each of them.
    """
    bin_edges_m, deviation_m = np.linspace(eta_m.min(), eta_m.max(), 401), float(np.std(eta_m))
    bin_etas = (bin_edges_m[:-1] + bin_edges_m[1:]) / 2 / deviation_m

    def fit_density(sample_m: Samples, start_parameters: list[Parameters]) -> Parameters:
        bin_shares = np.histogram(sample_m, bin_edges_m)[0] / sample_m.size

        def cost(parameters: Parameters) -> tuple[float, Parameters]:
            """Mean of -log p over the sample, and its gradient by a, b, ln kappa and both stops."""
            depth, kappa = penetration_m(bin_etas, *np.abs(parameters[3:])), np.exp(min(parameters[2], MAX_LOG_KAPPA))
            log_density = -parameters[0] * bin_etas - parameters[1] * bin_etas**2 / 2 - kappa * depth**2 / 2
            largest_log_density = log_density.max()
            density = np.exp(log_density - largest_log_density)
            density_sum = density.sum()
            slope_by_log_kappa = -kappa * depth**2 / 2 * (parameters[2] < MAX_LOG_KAPPA)
            slopes_by_stops = kappa * np.sign(parameters[3:, None]) * np.maximum([-depth, depth], 0)
            log_density_slopes = np.array([-bin_etas, -(bin_etas**2) / 2, slope_by_log_kappa, *slopes_by_stops])
            cost = float(-(bin_shares @ log_density) + largest_log_density + np.log(density_sum))
            return cost, log_density_slopes @ (density / density_sum - bin_shares)

        fits = [minimize(cost, start, jac=True, method="BFGS", options={"gtol": 1e-8}) for start in start_parameters]
        return np.asarray(min(fits, key=lambda attempt: attempt.fun).x)

    quantiles = np.quantile(np.abs(eta_m), [0.5, 0.7, 0.85, 0.95]) / deviation_m
    likeliest = fit_density(eta_m, [np.array([0.0, 0.5, 3.0, quantile, quantile]) for quantile in quantiles])
    parts_m = np.array_split(eta_m, PART_COUNT)
    part_stops_m = np.array([np.abs(fit_density(part_m, [likeliest])[3:]) for part_m in parts_m]) * deviation_m
    part_stops_m[part_stops_m > [[-part_m.min(), part_m.max()] for part_m in parts_m]] = np.nan
    lower_m, upper_m = np.abs(likeliest[3:]) * deviation_m
    lower_error_m, upper_error_m, mean_error_m = (
        float(np.std(stops_m, ddof=1) / np.sqrt(PART_COUNT))
        for stops_m in (part_stops_m[:, 0], part_stops_m[:, 1], part_stops_m.mean(axis=1))
    )
    return Stops(float(lower_m), float(upper_m), lower_error_m, upper_error_m, mean_error_m)


def _projection(
    columns: Float[np.ndarray, "samples columns"], target: Samples
) -> tuple[Samples, Float[np.ndarray, " columns"]]:
    """Projection of the target on the columns, and their weights, by normal equations of scaled columns."""
    norms = _column_norms(columns)
    normal_matrix = (columns.T @ columns) / np.outer(norms, norms)
    column_weights = np.linalg.pinv(normal_matrix, rcond=1e-14, hermitian=True) @ (columns.T @ target / norms) / norms
    return columns @ column_weights, column_weights


def _sandwich_covariance(
    jacobian: Float[np.ndarray, "samples parameters"], residual: Samples
) -> Float[np.ndarray, "parameters parameters"]:
    """Sandwich covariance of a least-squares estimate whose residuals are correlated within parts of the record."""
    norms = _column_norms(jacobian)
    unit_columns = jacobian / norms
    inverse_normal = np.linalg.pinv(unit_columns.T @ unit_columns, rcond=1e-12, hermitian=True)
    scores = cluster_scores(unit_columns @ inverse_normal, residual) / norms
    return np.asarray(scores.T @ scores * PART_COUNT / (PART_COUNT - 1))


def _column_norms(columns: Float[np.ndarray, "samples columns"]) -> Float[np.ndarray, " columns"]:
    """Norm of each column, 1 of a column of zeros."""
    norms = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    return np.where(norms == 0, 1.0, norms)
