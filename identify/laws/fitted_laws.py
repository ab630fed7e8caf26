"""Contact laws f(eta) fitted to a low-passed contact force: polynomial, straight pieces, friction behind a backlash.

Every law is evaluated finely along the relative displacement eta and low-passed as the force is before it is compared.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from identify.signals.law_evaluation import evaluated_law, interpolated, low_passed
from identify.signals.scores import cluster_scores

HAT_COUNT, HAT_GROUP_COUNT = 81, 9
MAX_KNEE_COUNT = 8
BEND_PENALTY = 1e-3
DROPPED_KNEE_RATIO = 1.02
"""A knee is dropped if the error of the fit without it is at most this multiple."""
ERROR_RESOLUTION = 1e-3
"""Resolution of errors, as a share of the force's standard deviation."""

START_BACKLASH_SHARES, START_STIFFNESS_RATIOS = (0.02, 0.1, 0.3, 0.6), (3.0, 10.0, 40.0)
"""Starting values: backlash over the range of eta, and stiffness over the range of force by that of eta."""
ROUGH_START_COUNT, ROUGH_TOLERANCE = 3, 1e-2
"""Count of starts that are fitted roughly, and the relative fall of the sum of squares that ends it; the best is then
fitted to the end."""
SLIDING_QUANTILE = 0.85
"""Quantile of the force in either direction that is the starting value of the sliding force."""
LOG_STEP = 1e-3
"""Step of numerical derivatives by the logarithms of the parameters."""

Signal = Float[np.ndarray, "*shape"]
LawFunction = Callable[..., Signal]
Rows = slice


@dataclass(frozen=True)
class MonotonicRuns:
    """Relative displacement as monotonic runs between its turning points."""

    run_lengths_m: tuple[float, ...]
    """Displacement from each turning point to the next."""
    run_indices: Int[np.ndarray, " more"]
    """Index of the run of each sample."""
    eta_since_turn_m: Float[np.ndarray, " more"]


def monotonic_runs(eta_m: Float[np.ndarray, " more"]) -> MonotonicRuns:
    """Monotonic runs of a relative displacement, from turning point to turning point."""
    turn_indices = np.flatnonzero(np.diff(np.sign(np.diff(eta_m)))) + 1
    run_starts = np.concatenate([[0], turn_indices])
    run_indices = np.repeat(np.arange(run_starts.size), np.diff(run_starts, append=eta_m.size))
    run_lengths_m = tuple(np.diff(eta_m[run_starts]).tolist())
    return MonotonicRuns(run_lengths_m, run_indices, eta_m - eta_m[run_starts][run_indices])


@dataclass(frozen=True)
class ForceSamples:
    """Low-passed contact force (N) and the relative displacement (m) that causes it.

    The displacement has the sample rate, the force every `decimation`-th sample of it. The low-pass falsifies the force
    at both ends of the record: choose rows that leave these out.
    """

    eta_m: Float[np.ndarray, " more"]
    force_n: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    decimation: int

    @property
    def eta_at_force_m(self) -> Float[np.ndarray, " samples"]:
        """Relative displacement at the force's samples."""
        return self.eta_m[:: self.decimation][: self.force_n.size]

    @cached_property
    def course(self) -> MonotonicRuns:
        """Course of the interpolated displacement, for friction."""
        return monotonic_runs(interpolated(self.eta_m, self.sample_rate_hz))

    def low_passed(
        self, law: LawFunction, *arguments: Float[np.ndarray, " more"]
    ) -> Float[np.ndarray, "*rows samples"]:
        """Force law(eta, *arguments), evaluated without aliasing and low-passed as the measured force is."""
        if isinstance(law, BacklashFriction):
            force_n = low_passed(law.force_n(self.course), self.sample_rate_hz, self.decimation)
        else:
            force_n = evaluated_law(law, np.stack([self.eta_m, *arguments]), self.sample_rate_hz, self.decimation)
        return force_n[..., : self.force_n.size]

    def error_n(self, law: LawFunction, rows: Rows) -> float:
        """Rms of the force less the low-passed law over some rows, N."""
        return float(np.sqrt(np.mean((self.force_n - self.low_passed(law))[rows] ** 2)))


def force_without_low_pass(samples: ForceSamples, rows: Rows) -> Float[np.ndarray, " fewer"]:
    """Force as it would be without the low-pass, scatter included, if it is a function of eta; no law is assumed.

    A curve of 81 straight pieces is fitted under the low-pass by linear least squares with a weak penalty of its bends;
    the effect of the low-pass on that curve is subtracted from the force.
    """
    centres_m = np.linspace(samples.eta_m.min(), samples.eta_m.max(), HAT_COUNT)
    hat_width_m = centres_m[1] - centres_m[0]
    centre_groups = np.split(centres_m, HAT_GROUP_COUNT)
    smooth_hats = np.concatenate([samples.low_passed(partial(_hats, group, hat_width_m)) for group in centre_groups]).T
    penalty = BEND_PENALTY * np.sqrt(np.sum(smooth_hats[rows] ** 2) / HAT_COUNT) * np.diff(np.eye(HAT_COUNT), 2, axis=0)
    target_n = np.concatenate([samples.force_n[rows], np.zeros(HAT_COUNT - 2)])
    heights_n = np.linalg.lstsq(np.concatenate([smooth_hats[rows], penalty]), target_n, rcond=None)[0]
    return (samples.force_n - smooth_hats @ heights_n + np.interp(samples.eta_at_force_m, centres_m, heights_n))[rows]


def _hats(centres_m: Float[np.ndarray, " places"], width_m: float, eta_m: Signal) -> Float[np.ndarray, "places *shape"]:
    """Triangular functions of height one about each centre."""
    return np.stack([np.clip(1 - np.abs(eta_m - centre_m) / width_m, 0, None) for centre_m in centres_m])


def polynomial(samples: ForceSamples, rows: Rows, degree: int) -> LawFunction:
    """Polynomial in eta fitted to the rows under the low-pass."""
    largest_eta_m = float(np.abs(samples.eta_m).max())
    power_columns = samples.low_passed(lambda eta: np.stack([(eta / largest_eta_m) ** n for n in range(degree + 1)]))
    coefficients = np.linalg.lstsq(power_columns[:, rows].T, samples.force_n[rows], rcond=None)[0]
    return lambda eta: np.polynomial.polynomial.polyval(eta / largest_eta_m, coefficients)


@dataclass(frozen=True)
class PiecewiseLinear:
    """f = offset + slope[0] eta + sum_i (slope[i + 1] - slope[i]) max(eta - knee[i], 0), with standard errors."""

    offset_n: float
    knees_m: Float[np.ndarray, " knees"]
    slopes_n_per_m: Float[np.ndarray, " pieces"]
    knee_errors_m: Float[np.ndarray, " knees"]
    slope_errors_n_per_m: Float[np.ndarray, " pieces"]

    def __call__(self, eta_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        force_n = self.offset_n + self.slopes_n_per_m[0] * eta_m
        for knee_m, slope_jump_n_per_m in zip(self.knees_m, np.diff(self.slopes_n_per_m), strict=True):
            force_n = force_n + slope_jump_n_per_m * np.maximum(eta_m - knee_m, 0.0)
        return force_n


def law_knees_m(law: LawFunction, low_m: float, high_m: float, jump_share: float = 0.03) -> Float[np.ndarray, " knees"]:
    """Knees of a law: places where its slope changes within some thousandths of the range by more than a share of the
    slope's own range.

    Of many the largest are kept: the slope of a law that is nearly constant is all rounding.
    """
    eta_m = np.linspace(low_m, high_m, 4001)
    local_slopes = np.gradient(law(eta_m), eta_m)
    window_count = 8
    slope_changes = np.abs(local_slopes[window_count:] - local_slopes[:-window_count])
    is_jump = slope_changes > jump_share * max(float(np.ptp(local_slopes)), 1e-9 * float(np.abs(local_slopes).max()))
    run_edges = np.flatnonzero(np.diff(np.concatenate([[0], is_jump.astype(int), [0]])))
    change_positions_m = eta_m[window_count // 2 : -window_count // 2]
    jump_runs = [(a, b) for a, b in zip(run_edges[::2], run_edges[1::2], strict=True) if b - a <= 3 * window_count]
    jump_runs = sorted(sorted(jump_runs, key=lambda run: -float(slope_changes[slice(*run)].sum()))[:MAX_KNEE_COUNT])
    return np.array([np.average(change_positions_m[a:b], weights=slope_changes[a:b]) for a, b in jump_runs])


def mean_slopes_n_per_m(
    law: LawFunction, knees_m: Float[np.ndarray, " knees"], low_m: float, high_m: float
) -> tuple[float, ...]:
    """Mean slope (N/m) of a law on each piece between knees, a tenth of the piece away from them."""
    piece_ends_m = np.concatenate([[low_m], knees_m, [high_m]])
    margins_m = 0.1 * np.diff(piece_ends_m)
    left_m, right_m = piece_ends_m[:-1] + margins_m, piece_ends_m[1:] - margins_m
    return tuple(float(slope) for slope in (law(right_m) - law(left_m)) / (right_m - left_m))


def fitted_piecewise_linear(samples: ForceSamples, rows: Rows, knees_m: Float[np.ndarray, " knees"]) -> PiecewiseLinear:
    """Continuous piecewise-linear law fitted under the low-pass from these knees; knees that do not help are dropped.

    The knees are found by nonlinear least squares, the slopes by linear ones within. Standard errors are sandwich
    estimates over sixteenths of the rows: of the scatter alone, not of errors of the rig's description.
    """
    pieces, error_n = _pieces_and_error_n(samples, rows, np.sort(knees_m))
    while pieces.knees_m.size:
        weakest_index = int(np.argmin(np.abs(np.diff(pieces.slopes_n_per_m))))
        reduced_law, reduced_error_n = _pieces_and_error_n(samples, rows, np.delete(pieces.knees_m, weakest_index))
        if reduced_error_n > DROPPED_KNEE_RATIO * error_n + ERROR_RESOLUTION * float(np.std(samples.force_n[rows])):
            break
        pieces, error_n = reduced_law, reduced_error_n
    return pieces


def _pieces_and_error_n(
    samples: ForceSamples, rows: Rows, start_knees_m: Float[np.ndarray, " knees"]
) -> tuple[PiecewiseLinear, float]:
    """Piecewise-linear law with as many knees as the start has, and its rms error (N)."""
    force_n = samples.force_n[rows]
    low_m, high_m = float(samples.eta_m.min()), float(samples.eta_m.max())
    span_m = high_m - low_m

    def linear_fit(knees: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        def pieces(eta: Signal) -> Signal:
            return np.stack(
                [np.ones_like(eta), eta / span_m, *(np.maximum(eta / span_m - knee, 0.0) for knee in knees)]
            )

        piece_columns = samples.low_passed(pieces)[:, rows].T
        coefficients = np.linalg.lstsq(piece_columns, force_n, rcond=None)[0]
        return piece_columns, coefficients, force_n - piece_columns @ coefficients

    def knee_derivatives(knees: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        knee_steps = samples.low_passed(lambda eta: np.stack([(eta / span_m > knee).astype(float) for knee in knees]))
        return (coefficients[2:, None] * knee_steps[:, rows]).T

    def jacobian(knees: np.ndarray) -> np.ndarray:
        piece_columns, coefficients, _ = linear_fit(knees)
        knee_columns = knee_derivatives(knees, coefficients)
        coefficient_derivatives = np.linalg.lstsq(piece_columns, knee_columns, rcond=None)[0]  # the slopes follow
        return knee_columns - piece_columns @ coefficient_derivatives

    knees = np.clip(start_knees_m / span_m, low_m / span_m + 0.01, high_m / span_m - 0.01)
    if knees.size:
        inverse_error_per_n = 1 / max(float(np.std(linear_fit(knees)[2])), 1e-12)
        optimum = least_squares(
            lambda knees: inverse_error_per_n * linear_fit(knees)[2],
            knees,
            lambda knees: inverse_error_per_n * jacobian(knees),
            bounds=(low_m / span_m, high_m / span_m),
            x_scale=0.05,
            max_nfev=30,
        )
        knees = np.sort(optimum.x)
    piece_columns, coefficients, residual = linear_fit(knees)
    if knees.size:
        piece_columns = np.concatenate([piece_columns, knee_derivatives(knees, coefficients)], axis=1)
    parameter_scores = cluster_scores(piece_columns @ np.linalg.pinv(piece_columns.T @ piece_columns), residual)
    slope_scores = np.cumsum(parameter_scores[:, 1 : coefficients.size], axis=1)
    law = PiecewiseLinear(
        offset_n=float(coefficients[0]),
        knees_m=knees * span_m,
        slopes_n_per_m=np.cumsum(coefficients[1:]) / span_m,
        knee_errors_m=span_m * np.sqrt(np.sum(parameter_scores[:, coefficients.size :] ** 2, axis=0)),
        slope_errors_n_per_m=np.sqrt(np.sum(slope_scores**2, axis=0)) / span_m,
    )
    return law, float(np.sqrt(np.mean(residual**2)))


def hysteresis_share(
    samples: ForceSamples, velocity_m_per_s: Float[np.ndarray, " more"], law: PiecewiseLinear, rows: slice
) -> float:
    """Share of the unexplained variance that a damper in proportion to the law's local slope explains."""
    slope_sizes = np.abs(law.slopes_n_per_m)

    def slope_weighted_rate(eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        return slope_sizes[np.searchsorted(law.knees_m, eta_m)] / slope_sizes.max() * rate_m_per_s

    damper_n = samples.low_passed(slope_weighted_rate, velocity_m_per_s)[rows]
    residual_n = (samples.force_n - samples.low_passed(law))[rows]
    return float((damper_n @ residual_n) ** 2 / ((damper_n @ damper_n) * (residual_n @ residual_n)))


@dataclass(frozen=True)
class BacklashFriction:
    """Dry friction reached through a backlash B by a spring k, which depends on the course of eta::

        s' = eta' while -B/2 - F_lower / k <= s <= B/2 + F_upper / k, which s never leaves
        f = k (s - B/2)  for s > B/2,   k (s + B/2)  for s < -B/2,   0 between

    s is the position of eta in the backlash, from its middle, and starts at 0. So f is F_upper once eta has grown for
    long enough, -F_lower once it has fallen, and after a reversal zero while the backlash is crossed. standard_errors
    are in the order of the fields.
    """

    upper_n: float
    lower_n: float
    backlash_m: float
    stiffness_n_per_m: float
    standard_errors: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def __call__(self, eta_m: Float[np.ndarray, " more"]) -> Float[np.ndarray, " more"]:
        """Force (N) along a relative displacement, all samples from the first on."""
        return self.force_n(monotonic_runs(eta_m))

    def force_n(self, course: MonotonicRuns) -> Float[np.ndarray, " more"]:
        """Force at every sample of a course."""
        half_backlash_m, k = self.backlash_m / 2, self.stiffness_n_per_m
        low_m, high_m = -half_backlash_m - self.lower_n / k, half_backlash_m + self.upper_n / k
        slider_turns_m = [0.0]
        for run_m in course.run_lengths_m:
            slider_turns_m.append(min(max(slider_turns_m[-1] + run_m, low_m), high_m))
        slider_m = np.clip(np.array(slider_turns_m)[course.run_indices] + course.eta_since_turn_m, low_m, high_m)
        return np.asarray(k * (slider_m - np.clip(slider_m, -half_backlash_m, half_backlash_m)))


def fitted_backlash_friction(samples: ForceSamples, rows: Rows) -> BacklashFriction:
    """Friction fitted to the rows under the low-pass; standard errors are sandwich estimates as of straight pieces."""
    force_n = samples.force_n[rows]
    upper_n, lower_n = (
        max(float(np.quantile(sign * force_n, SLIDING_QUANTILE)), 1e-9 * np.ptp(force_n)) for sign in (1, -1)
    )
    eta_span_m, force_span_n = float(np.ptp(samples.eta_m)), upper_n + lower_n
    log_scales = np.log([upper_n, lower_n, eta_span_m, force_span_n / eta_span_m])

    def law_of_logarithms(logarithms: Float[np.ndarray, " parameters"]) -> BacklashFriction:
        return BacklashFriction(*np.exp(log_scales + logarithms).tolist())

    def relative_residual(logarithms: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " rows"]:
        return (force_n - samples.low_passed(law_of_logarithms(logarithms))[rows]) / force_span_n

    log_starts = [np.log([1.0, 1.0, b, k]) for b, k in product(START_BACKLASH_SHARES, START_STIFFNESS_RATIOS)]
    log_starts.sort(key=lambda log_start: float(np.sum(relative_residual(log_start) ** 2)))
    bounds = (np.full(4, -12.0), np.full(4, 8.0))
    fit_from = partial(least_squares, relative_residual, bounds=bounds, diff_step=LOG_STEP, max_nfev=30)
    rough_fits = (fit_from(log_start, ftol=ROUGH_TOLERANCE) for log_start in log_starts[:ROUGH_START_COUNT])
    optimum = fit_from(min(rough_fits, key=lambda fit: float(fit.cost)).x).x
    log_steps = LOG_STEP * np.eye(optimum.size)
    residual_differences = [relative_residual(optimum + step) - relative_residual(optimum - step) for step in log_steps]
    derivatives = np.stack(residual_differences, axis=1) / (2 * LOG_STEP)
    scores = cluster_scores(derivatives @ np.linalg.pinv(derivatives.T @ derivatives), -relative_residual(optimum))
    standard_errors = np.exp(log_scales + optimum) * np.sqrt(np.sum(scores**2, axis=0))
    return replace(law_of_logarithms(optimum), standard_errors=tuple(standard_errors.tolist()))
