"""Contact laws f(eta) fitted to a low-passed contact force: polynomial, straight pieces, friction behind a backlash.

Every law is evaluated finely along the relative displacement eta and low-passed as the force is before it is compared.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from identify.signals.law_evaluation import evaluated, interpolated, low_passed
from identify.signals.scores import part_scores

HATS, HAT_GROUPS = 81, 9
MOST_KNEES = 8
STIFFENING = 1e-3
KNEE_ERROR_RATIO = 1.02
"""A knee is dropped if the error of the fit without it is at most this multiple."""
ERROR_RESOLUTION = 1e-3
"""Resolution of errors, as a share of the force's standard deviation."""

BACKLASHES, STIFFNESSES = (0.02, 0.1, 0.3, 0.6), (3.0, 10.0, 40.0)
"""Starting values: backlash over the range of eta, and stiffness over the range of force by that of eta."""
ROUGH_STARTS, ROUGH_TOLERANCE = 3, 1e-2
"""Count of starts that are fitted roughly, and the relative fall of the sum of squares that ends it; the best is then
fitted to the end."""
SLIDING_QUANTILE = 0.85
"""Quantile of the force in either direction that is the starting value of the sliding force."""
STEP = 1e-3
"""Step of numerical derivatives by the logarithms of the parameters."""

Signal = Float[np.ndarray, "*shape"]
Function = Callable[..., Signal]
Rows = slice


@dataclass(frozen=True)
class Course:
    """Relative displacement as monotonic runs between its turning points."""

    steps_m: tuple[float, ...]
    """Displacement from each turning point to the next."""
    run: Int[np.ndarray, " more"]
    """Index of the run of each sample."""
    since_turn_m: Float[np.ndarray, " more"]


def course_of(eta_m: Float[np.ndarray, " more"]) -> Course:
    """Turning points of a relative displacement."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(eta_m)))) + 1
    run_starts = np.concatenate([[0], turns])
    run = np.repeat(np.arange(run_starts.size), np.diff(run_starts, append=eta_m.size))
    return Course(tuple(np.diff(eta_m[run_starts]).tolist()), run, eta_m - eta_m[run_starts][run])


@dataclass(frozen=True)
class ForceSamples:
    """Low-passed contact force (N) and the relative displacement (m) that causes it.

    The displacement has the sample rate, the force every `factor`-th sample of it. The low-pass falsifies the force at
    both ends of the record: choose rows that leave these out.
    """

    eta_m: Float[np.ndarray, " more"]
    force_n: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    factor: int

    @property
    def eta_at_force_m(self) -> Float[np.ndarray, " samples"]:
        """Relative displacement at the force's samples."""
        return self.eta_m[:: self.factor][: self.force_n.size]

    @cached_property
    def course(self) -> Course:
        """Course of the interpolated displacement, for friction."""
        return course_of(interpolated(self.eta_m, self.sample_rate_hz))

    def low_passed(self, law: Function, *arguments: Float[np.ndarray, " more"]) -> Float[np.ndarray, "*rows samples"]:
        """Force law(eta, *arguments), evaluated without aliasing and low-passed as the measured force is."""
        if isinstance(law, SlidingFriction):
            force = low_passed(law.force_n(self.course), self.sample_rate_hz, self.factor)
        else:
            force = evaluated(law, np.stack([self.eta_m, *arguments]), self.sample_rate_hz, self.factor)
        return force[..., : self.force_n.size]

    def error_n(self, law: Function, rows: Rows) -> float:
        """Rms of the force less the low-passed law over some rows, N."""
        return float(np.sqrt(np.mean((self.force_n - self.low_passed(law))[rows] ** 2)))


def force_without_low_pass(samples: ForceSamples, rows: Rows) -> Float[np.ndarray, " fewer"]:
    """Force as it would be without the low-pass, scatter included, if it is a function of eta; no law is assumed.

    A curve of 81 straight pieces is fitted under the low-pass by linear least squares with a weak penalty of its bends;
    the effect of the low-pass on that curve is subtracted from the force.
    """
    centres_m = np.linspace(samples.eta_m.min(), samples.eta_m.max(), HATS)
    width = centres_m[1] - centres_m[0]
    hats = np.concatenate(
        [samples.low_passed(partial(_hats, group, width)) for group in np.split(centres_m, HAT_GROUPS)]
    ).T
    straightness = STIFFENING * np.sqrt(np.sum(hats[rows] ** 2) / HATS) * np.diff(np.eye(HATS), 2, axis=0)
    system = np.concatenate([hats[rows], straightness])
    heights = np.linalg.lstsq(system, np.concatenate([samples.force_n[rows], np.zeros(HATS - 2)]), rcond=None)[0]
    return (samples.force_n - hats @ heights + np.interp(samples.eta_at_force_m, centres_m, heights))[rows]


def _hats(centres_m: Float[np.ndarray, " places"], width_m: float, eta_m: Signal) -> Float[np.ndarray, "places *shape"]:
    """Triangular functions of height one about each centre."""
    return np.stack([np.clip(1 - np.abs(eta_m - centre_m) / width_m, 0, None) for centre_m in centres_m])


def polynomial(samples: ForceSamples, rows: Rows, degree: int) -> Function:
    """Polynomial in eta fitted to the rows under the low-pass."""
    size = float(np.abs(samples.eta_m).max())
    columns = samples.low_passed(lambda eta: np.stack([(eta / size) ** n for n in range(degree + 1)]))
    coefficients = np.linalg.lstsq(columns[:, rows].T, samples.force_n[rows], rcond=None)[0]
    return lambda eta: np.polynomial.polynomial.polyval(eta / size, coefficients)


@dataclass(frozen=True)
class PiecewiseLinear:
    """f = offset + slope[0] eta + sum_i (slope[i + 1] - slope[i]) max(eta - knee[i], 0), with standard errors."""

    offset_n: float
    knees_m: Float[np.ndarray, " knees"]
    slopes_n_per_m: Float[np.ndarray, " pieces"]
    knee_errors_m: Float[np.ndarray, " knees"]
    slope_errors_n_per_m: Float[np.ndarray, " pieces"]

    def __call__(self, eta: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        force = self.offset_n + self.slopes_n_per_m[0] * eta
        for knee, jump in zip(self.knees_m, np.diff(self.slopes_n_per_m), strict=True):
            force = force + jump * np.maximum(eta - knee, 0.0)
        return force


def slope_jumps(law: Function, low_m: float, high_m: float, share: float = 0.03) -> Float[np.ndarray, " knees"]:
    """Knees of a law: places where its slope changes within some thousandths of the range by more than a share of the
    slope's own range.

    Of many the largest are kept: the slope of a law that is nearly constant is all rounding.
    """
    eta = np.linspace(low_m, high_m, 4001)
    slope = np.gradient(law(eta), eta)
    span = 8
    change = np.abs(slope[span:] - slope[:-span])
    is_jump = change > share * max(float(np.ptp(slope)), 1e-9 * float(np.abs(slope).max()))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_jump.astype(int), [0]])))
    middle = eta[span // 2 : -span // 2]
    runs = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a <= 3 * span]
    runs = sorted(sorted(runs, key=lambda run: -float(change[slice(*run)].sum()))[:MOST_KNEES])
    return np.array([np.average(middle[a:b], weights=change[a:b]) for a, b in runs])


def mean_slopes(law: Function, knees: Float[np.ndarray, " knees"], low: float, high: float) -> tuple[float, ...]:
    """Mean slope (N/m) of a law on each piece between knees, a tenth of the piece away from them."""
    edges_m = np.concatenate([[low], knees, [high]])
    margin = 0.1 * np.diff(edges_m)
    left_m, right_m = edges_m[:-1] + margin, edges_m[1:] - margin
    return tuple(float(s) for s in (law(right_m) - law(left_m)) / (right_m - left_m))


def straight_pieces(samples: ForceSamples, rows: Rows, knees_m: Float[np.ndarray, " knees"]) -> PiecewiseLinear:
    """Continuous piecewise-linear law fitted under the low-pass from these knees; knees that do not help are dropped.

    The knees are found by nonlinear least squares, the slopes by linear ones within. Standard errors are sandwich
    estimates over sixteenths of the rows: of the scatter alone, not of errors of the rig's description.
    """
    law, error = _fit_pieces(samples, rows, np.sort(knees_m))
    while law.knees_m.size:
        weakest = int(np.argmin(np.abs(np.diff(law.slopes_n_per_m))))
        reduced, reduced_error = _fit_pieces(samples, rows, np.delete(law.knees_m, weakest))
        if reduced_error > KNEE_ERROR_RATIO * error + ERROR_RESOLUTION * float(np.std(samples.force_n[rows])):
            break
        law, error = reduced, reduced_error
    return law


def _fit_pieces(
    samples: ForceSamples, rows: Rows, start_m: Float[np.ndarray, " knees"]
) -> tuple[PiecewiseLinear, float]:
    """Piecewise-linear law with as many knees as the start has, and its rms error (N)."""
    force = samples.force_n[rows]
    low, high = float(samples.eta_m.min()), float(samples.eta_m.max())
    size = high - low

    def linear_fit(knees: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        columns = samples.low_passed(
            lambda eta: np.stack([np.ones_like(eta), eta / size, *(np.maximum(eta / size - k, 0.0) for k in knees)])
        )[:, rows].T
        heights = np.linalg.lstsq(columns, force, rcond=None)[0]
        return columns, heights, force - columns @ heights

    def knee_derivatives(knees: np.ndarray, heights: np.ndarray) -> np.ndarray:
        steps = samples.low_passed(lambda eta: np.stack([(eta / size > k).astype(float) for k in knees]))
        return (heights[2:, None] * steps[:, rows]).T

    def jacobian(knees: np.ndarray) -> np.ndarray:
        columns, heights, _ = linear_fit(knees)
        knee_columns = knee_derivatives(knees, heights)
        return knee_columns - columns @ np.linalg.lstsq(columns, knee_columns, rcond=None)[0]  # the slopes follow

    knees = np.clip(start_m / size, low / size + 0.01, high / size - 0.01)
    if knees.size:
        scale = 1 / max(float(np.std(linear_fit(knees)[2])), 1e-12)
        optimum = least_squares(
            lambda k: scale * linear_fit(k)[2],
            knees,
            lambda k: scale * jacobian(k),
            bounds=(low / size, high / size),
            x_scale=0.05,
            max_nfev=30,
        )
        knees = np.sort(optimum.x)
    columns, heights, residual = linear_fit(knees)
    jacobian_columns = np.concatenate([columns, knee_derivatives(knees, heights)], axis=1) if knees.size else columns
    influence = jacobian_columns @ np.linalg.pinv(jacobian_columns.T @ jacobian_columns)
    scores = part_scores(influence, residual)
    count = heights.size
    slope_scores = np.cumsum(scores[:, 1:count], axis=1)
    law = PiecewiseLinear(
        offset_n=float(heights[0]),
        knees_m=knees * size,
        slopes_n_per_m=np.cumsum(heights[1:]) / size,
        knee_errors_m=size * np.sqrt(np.sum(scores[:, count:] ** 2, axis=0)),
        slope_errors_n_per_m=np.sqrt(np.sum(slope_scores**2, axis=0)) / size,
    )
    return law, float(np.sqrt(np.mean(residual**2)))


def hysteresis_share(
    record: ForceSamples, velocity: Float[np.ndarray, " more"], law: PiecewiseLinear, rows: slice
) -> float:
    """Share of the unexplained variance that a damper in proportion to the law's local slope explains."""
    slopes = np.abs(law.slopes_n_per_m)

    def by_slope(eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        return slopes[np.searchsorted(law.knees_m, eta_m)] / slopes.max() * rate_m_per_s

    damper_n = record.low_passed(by_slope, velocity)[rows]
    residual_n = (record.force_n - record.low_passed(law))[rows]
    return float((damper_n @ residual_n) ** 2 / ((damper_n @ damper_n) * (residual_n @ residual_n)))


@dataclass(frozen=True)
class SlidingFriction:
    """Dry friction reached through a backlash B by a spring k, which depends on the course of eta::

        s' = eta' while -B/2 - F_lower / k <= s <= B/2 + F_upper / k, which s never leaves
        f = k (s - B/2)  for s > B/2,   k (s + B/2)  for s < -B/2,   0 between

    s is the position of eta in the backlash, from its middle, and starts at 0. So f is F_upper once eta has grown for
    long enough, -F_lower once it has fallen, and after a reversal zero while the backlash is crossed. errors are
    standard errors in the order of the fields.
    """

    upper_n: float
    lower_n: float
    backlash_m: float
    stiffness_n_per_m: float
    errors: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def __call__(self, eta_m: Float[np.ndarray, " more"]) -> Float[np.ndarray, " more"]:
        """Force (N) along a relative displacement, all samples from the first on."""
        return self.force_n(course_of(eta_m))

    def force_n(self, course: Course) -> Float[np.ndarray, " more"]:
        """Force at every sample of a course."""
        half, k = self.backlash_m / 2, self.stiffness_n_per_m
        low, high = -half - self.lower_n / k, half + self.upper_n / k
        slider_at_turns = [0.0]
        for step in course.steps_m:
            slider_at_turns.append(min(max(slider_at_turns[-1] + step, low), high))
        s = np.clip(np.array(slider_at_turns)[course.run] + course.since_turn_m, low, high)
        return np.asarray(k * (s - np.clip(s, -half, half)))


def sliding_friction(samples: ForceSamples, rows: Rows) -> SlidingFriction:
    """Friction fitted to the rows under the low-pass; standard errors are sandwich estimates as of straight pieces."""
    force = samples.force_n[rows]
    upper_n, lower_n = (
        max(float(np.quantile(sign * force, SLIDING_QUANTILE)), 1e-9 * np.ptp(force)) for sign in (1, -1)
    )
    span_m, span_n = float(np.ptp(samples.eta_m)), upper_n + lower_n
    scale = np.log([upper_n, lower_n, span_m, span_n / span_m])

    def law(logarithms: Float[np.ndarray, " parameters"]) -> SlidingFriction:
        upper, lower, backlash, stiffness = np.exp(scale + logarithms).tolist()
        return SlidingFriction(upper, lower, backlash, stiffness)

    def error(logarithms: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " rows"]:
        return (force - samples.low_passed(law(logarithms))[rows]) / span_n

    starts = [np.log([1.0, 1.0, b, k]) for b, k in product(BACKLASHES, STIFFNESSES)]
    starts.sort(key=lambda start: float(np.sum(error(start) ** 2)))
    fit = partial(least_squares, error, bounds=(np.full(4, -12.0), np.full(4, 8.0)), diff_step=STEP, max_nfev=30)
    rough = min(
        (fit(start, ftol=ROUGH_TOLERANCE) for start in starts[:ROUGH_STARTS]),
        key=lambda fit_result: float(fit_result.cost),
    )
    optimum = fit(rough.x)
    slopes = _slopes(error, optimum.x)
    scores = part_scores(slopes @ np.linalg.pinv(slopes.T @ slopes), -error(optimum.x))
    relative = np.sqrt(np.sum(scores**2, axis=0))
    values = np.exp(scale + optimum.x)
    upper, lower, backlash, stiffness = values.tolist()
    return SlidingFriction(upper, lower, backlash, stiffness, tuple((values * relative).tolist()))


def _slopes(
    error: Callable[[Float[np.ndarray, " parameters"]], Float[np.ndarray, " rows"]],
    logarithms: Float[np.ndarray, " parameters"],
) -> Float[np.ndarray, "rows parameters"]:
    """Central differences of the error by each parameter."""
    return np.stack(
        [(error(logarithms + step) - error(logarithms - step)) / (2 * STEP) for step in STEP * np.eye(logarithms.size)],
        axis=1,
    )
