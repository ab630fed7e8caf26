"""Clearances by the restoring force surface, and by the histogram of the relative displacement."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares, minimize

from identify.linear.modal import ModalEquation
from identify.signals.scores import PARTS, part_scores
from identify.signals.spectra import decimated
from rig.model.contact_laws import penetration_m

LEAST_CONTACT_SHARE = 2e-3
"""Share of the time for which a contact must be closed to determine its clearance."""
LARGEST_LOG_KAPPA = 20.0
"""Largest ln kappa of the density of a relative displacement, of one standard deviation: a rigid stop."""


@dataclass(frozen=True)
class Stops:
    """Clearances of a contact to its lower and upper stop, with standard errors; half_error_m is that of their mean.

    clearance_m is their mean, or the clearance of the only stop that is touched.
    """

    lower_m: float
    upper_m: float
    lower_error_m: float
    upper_error_m: float
    half_error_m: float
    touched: tuple[bool, bool] = (True, True)

    @property
    def clearance_m(self) -> float:
        return self._of_touched(self.lower_m, self.upper_m, (self.lower_m + self.upper_m) / 2)

    @property
    def clearance_error_m(self) -> float:
        return self._of_touched(self.lower_error_m, self.upper_error_m, self.half_error_m)

    def _of_touched(self, lower: float, upper: float, both: float) -> float:
        return both if all(self.touched) else lower if self.touched[0] else upper


@dataclass(frozen=True)
class Surface:
    """Restoring force of a modal equation, measured and fitted, at every `factor`-th sample of the record.

    measured = shape_at_force F - q'' (N / sqrt(kg)); fitted = damping q' + stiffness q + sum_j shape_j k_j dz_j(eta_j).
    contact_share is the part of each contact in the fitted force.
    """

    equation: ModalEquation
    factor: int
    measured: Float[np.ndarray, " samples"]
    fitted: Float[np.ndarray, " samples"]
    contact_share: Float[np.ndarray, "contacts samples"]
    stops: tuple[Stops | None, ...]
    stiffness_n_per_m: Float[np.ndarray, " contacts"]


def restoring_force(equation: ModalEquation, force_n: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
    """Restoring force r = shape_at_force F - q'' of a modal equation, N / sqrt(kg)."""
    return equation.shape_at_force * force_n - equation.acceleration


def fit_surface(
    equation: ModalEquation,
    force_n: Float[np.ndarray, " samples"],
    eta_m: Float[np.ndarray, "contacts samples"],
    factor: int,
    start: tuple[Stops | None, ...],
) -> Surface:
    """Least squares of the restoring force on q', q and a dead zone for each visible contact with starting stops.

    The stops are nonlinear parameters, found by nonlinear least squares around the linear regression; their standard
    errors are sandwich estimates, which allow for residuals correlated within a sixteenth of the record. Both sides are
    low-passed alike and decimated by `factor`, as the modal transformation fails at high frequencies.
    """
    started = [(j, s) for j, (s, visible) in enumerate(zip(start, equation.visible, strict=True)) if visible and s]
    indices = [j for j, _ in started]
    measured = decimated(restoring_force(equation, force_n), factor)
    linear = decimated(np.stack([equation.velocity, equation.displacement]), factor)

    def columns(stops: Float[np.ndarray, " stops"]) -> Float[np.ndarray, "samples columns"]:
        zones = [
            equation.shape_at_contacts[j] * decimated(penetration_m(eta_m[j], stops[2 * i], stops[2 * i + 1]), factor)
            for i, j in enumerate(indices)
        ]
        return np.stack([*linear, *zones], axis=1)

    def remainder(stops: Float[np.ndarray, " stops"]) -> Float[np.ndarray, " samples"]:
        return measured - _projection(columns(stops), measured)[0]

    largest = np.array([[-eta_m[j].min(), eta_m[j].max()] for j in indices]).ravel()
    scale = np.maximum(largest, 1e-12)
    start_m = np.array([x for _, s in started for x in (s.lower_m, s.upper_m)])
    solution = least_squares(
        lambda s: remainder(s * scale), np.clip(start_m / scale, 0.0, 0.98), bounds=(0, 1), xtol=1e-9, ftol=1e-12
    )
    stops = solution.x * scale
    fitted, weights = _projection(columns(stops), measured)
    covariance = _sandwich(np.concatenate([columns(stops), solution.jac / scale], axis=1), measured - fitted)
    fitted_stops: list[Stops | None] = [None] * len(eta_m)
    share = np.zeros((len(eta_m), measured.size))
    stiffness = np.full(len(eta_m), np.nan)
    first_stop = len(linear) + len(indices)
    for i, j in enumerate(indices):
        of_stops = slice(first_stop + 2 * i, first_stop + 2 * i + 2)
        stop_covariance = covariance[of_stops, of_stops]
        stiffness[j] = weights[2 + i]
        share[j] = weights[2 + i] * columns(stops)[:, 2 + i]
        closed = np.mean((eta_m[j] > stops[2 * i + 1]) | (eta_m[j] < -stops[2 * i]))
        if closed >= LEAST_CONTACT_SHARE:
            variances = [stop_covariance[0, 0], stop_covariance[1, 1], stop_covariance.sum() / 4]
            lower_error_m, upper_error_m, half_error_m = np.sqrt(variances).tolist()
            lower_m, upper_m = stops[2 * i : 2 * i + 2].tolist()
            touched = started[i][1].touched
            fitted_stops[j] = Stops(lower_m, upper_m, lower_error_m, upper_error_m, half_error_m, touched)
    return Surface(equation, factor, measured, fitted, share, tuple(fitted_stops), stiffness)


def clearance_from_occurrence(eta_m: Float[np.ndarray, " samples"]) -> Stops:
    """Stops by maximum likelihood of the density of the relative displacement,

        log p = const - a eta - b eta^2 / 2 - kappa dz(eta; lower, upper)^2 / 2

    a Gaussian within the gap and a narrower one beyond each stop. Standard errors from sixteen parts of the record;
    NaN for a stop that is not reached in each of them.
    """
    edges = np.linspace(eta_m.min(), eta_m.max(), 401)
    scale = float(np.std(eta_m))
    x = (edges[:-1] + edges[1:]) / 2 / scale

    def fit(
        sample: Float[np.ndarray, " samples"], starts: list[Float[np.ndarray, " parameters"]]
    ) -> Float[np.ndarray, " parameters"]:
        counts = np.histogram(sample, edges)[0] / sample.size

        def cost(p: Float[np.ndarray, " parameters"]) -> tuple[float, Float[np.ndarray, " parameters"]]:
            """Mean of -log p over the sample, and its gradient by a, b, ln kappa and both stops."""
            depth, kappa = penetration_m(x, *np.abs(p[3:])), np.exp(min(p[2], LARGEST_LOG_KAPPA))
            exponent = -p[0] * x - p[1] * x**2 / 2 - kappa * depth**2 / 2
            top = exponent.max()
            density = np.exp(exponent - top)
            total = density.sum()
            by_log_kappa = -kappa * depth**2 / 2 * (p[2] < LARGEST_LOG_KAPPA)
            by_stops = kappa * np.sign(p[3:, None]) * np.maximum([-depth, depth], 0)
            gradient = np.array([-x, -(x**2) / 2, by_log_kappa, *by_stops]) @ (density / total - counts)
            return float(-(counts @ exponent) + top + np.log(total)), gradient

        attempts = [minimize(cost, s, jac=True, method="BFGS", options={"gtol": 1e-8}) for s in starts]
        return np.asarray(min(attempts, key=lambda attempt: attempt.fun).x)

    quantiles = np.quantile(np.abs(eta_m), [0.5, 0.7, 0.85, 0.95]) / scale
    best = fit(eta_m, [np.array([0.0, 0.5, 3.0, q, q]) for q in quantiles])
    parts_m = np.array_split(eta_m, PARTS)
    part_stops_m = np.array([np.abs(fit(part_m, [best])[3:]) for part_m in parts_m]) * scale
    part_stops_m[part_stops_m > [[-part_m.min(), part_m.max()] for part_m in parts_m]] = np.nan
    lower, upper = np.abs(best[3:]) * scale
    lower_error_m, upper_error_m, half_error_m = (
        float(np.std(x, ddof=1) / np.sqrt(PARTS))
        for x in (part_stops_m[:, 0], part_stops_m[:, 1], part_stops_m.mean(axis=1))
    )
    return Stops(float(lower), float(upper), lower_error_m, upper_error_m, half_error_m)


def _projection(
    columns: Float[np.ndarray, "samples columns"], target: Float[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " columns"]]:
    """Projection of the target on the columns, and their weights, by normal equations of scaled columns."""
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    scale[scale == 0] = 1.0
    normal = (columns.T @ columns) / np.outer(scale, scale)
    weights = np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ (columns.T @ target / scale) / scale
    return columns @ weights, weights


def _sandwich(
    jacobian: Float[np.ndarray, "samples parameters"], residual: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, "parameters parameters"]:
    """Sandwich covariance of a least-squares estimate whose residuals are correlated within parts of the record."""
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    scale[scale == 0] = 1.0
    scaled = jacobian / scale
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    scores = part_scores(scaled @ inverse, residual) / scale
    return np.asarray(scores.T @ scores * PARTS / (PARTS - 1))
