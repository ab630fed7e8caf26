"""Contact laws f(eta) fitted to a low-passed contact force: polynomial, straight pieces, friction behind a backlash.

Every law is evaluated finely along the relative displacement eta and low-passed as the force is before it is compared.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, partial
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from identify.contacts.joint_fit import small_sample_factor
from identify.pages.wording import COVERED
from identify.signals.law_evaluation import evaluated_law, interpolated, low_passed
from identify.signals.scores import PART_COUNT, cluster_scores

HAT_COUNT, HAT_GROUP_COUNT = 81, 9
MAX_KNEE_COUNT = 8
BEND_PENALTY = 1e-3
END_SHARE = 0.01
"""Share of the range of eta at either end in which no knee is told from the end."""
DROPPED_KNEE_RATIO = 1.02
"""A knee is dropped if the error of the fit without it is at most this multiple."""
ERROR_RESOLUTION = 1e-3
"""Resolution of errors, as a share of the force's standard deviation."""

REVERSAL_SPEED_M_PER_S, TRAVEL_SHARE, BACKLASH_SHARE = 0.01, 0.05, 0.1
PRIOR_LOG_DEVIATION = float(np.log(10))
"""Priors of a reversal: the speed at which friction turns, and over the range of eta the travel of its spring and the
backlash, each uncertain by a factor of ten. Set by hand; they hold a number that the record does not determine."""
START_LOG_SPEEDS, START_LOG_TRAVELS, START_LOG_BACKLASHES = (-2.0, 0.0, 2.0), (-1.4, 0.0, 1.2), (-1.6, 0.0, 1.1, 1.8)
"""Logarithms of starting values over these."""
RIGID_LOG_TRAVEL = -6.0
MATERIAL_RATIO = 1.005
"""A part of friction is material if without it more than this multiple of the error is left."""
ROUGH_START_COUNT, ROUGH_TOLERANCE, TRIAL_TOLERANCE = 3, 1e-2, 1e-3
"""Count of starts that are fitted roughly, and the relative fall of the sum of squares that ends it; the best is then
fitted to the end. Fits without a part are less rough."""
LOG_STEP = 1e-3
"""Step of numerical derivatives by the logarithms of the parameters."""

Signal = Float[np.ndarray, "*shape"]
LawFunction = Callable[..., Signal]
AnyLaw: TypeAlias = "LawFunction | Friction"
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

    Displacement and velocity have the sample rate, the force every `decimation`-th sample of it. The low-pass falsifies
    the force at both ends of the record: choose rows that leave these out.
    """

    eta_m: Float[np.ndarray, " more"]
    velocity_m_per_s: Float[np.ndarray, " more"]
    force_n: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    decimation: int

    @property
    def eta_at_force_m(self) -> Float[np.ndarray, " samples"]:
        """Relative displacement at the force's samples."""
        return self.eta_m[:: self.decimation][: self.force_n.size]

    @property
    def velocity_at_force_m_per_s(self) -> Float[np.ndarray, " samples"]:
        """Relative velocity there."""
        return self.velocity_m_per_s[:: self.decimation][: self.force_n.size]

    @property
    def turning_m_per_s2(self) -> float:
        """Acceleration about the turns of a sinusoidal motion with this rms, which tells what a sample resolves."""
        return float(np.sqrt(2) * np.std(np.gradient(self.velocity_m_per_s))) * self.sample_rate_hz

    @property
    def force_step_s(self) -> float:
        return self.decimation / self.sample_rate_hz

    @property
    def slider_known_from(self) -> int:
        """First sample of the force by which eta has covered half its range: the slider's start is forgotten then."""
        eta_m = self.eta_at_force_m
        covered_m = np.maximum.accumulate(eta_m) - np.minimum.accumulate(eta_m)
        return int(np.argmax(covered_m >= covered_m[-1] / 2))

    @cached_property
    def interpolated_motion(self) -> tuple[MonotonicRuns, Float[np.ndarray, " fine"]]:
        """Course of the interpolated displacement, and the interpolated velocity, for friction."""
        eta_m, velocity_m_per_s = (interpolated(x, self.sample_rate_hz) for x in (self.eta_m, self.velocity_m_per_s))
        return monotonic_runs(eta_m), velocity_m_per_s

    @cached_property
    def linear_forces(self) -> Float[np.ndarray, "3 samples"]:
        """Low-passed forces of a unit each: constant, damper and spring."""

        def unit_forces_n(eta_m: Signal, velocity_m_per_s: Signal) -> Signal:
            return np.stack([np.ones_like(eta_m), velocity_m_per_s, eta_m])

        return self.low_passed(unit_forces_n, self.velocity_m_per_s)

    def low_passed(self, law: AnyLaw, *arguments: Float[np.ndarray, " more"]) -> Float[np.ndarray, "*rows samples"]:
        """Force law(eta, *arguments), evaluated without aliasing and low-passed as the measured force is."""
        if isinstance(law, Friction):
            linear_n = np.array([law.constant_n, law.viscous_n_s_per_m, law.elastic_n_per_m]) @ self.linear_forces
            if not (law.upper_n or law.lower_n):
                return np.asarray(linear_n)
            slider_n = low_passed(law.slider_n(*self.interpolated_motion), self.sample_rate_hz, self.decimation)
            return np.asarray(linear_n + slider_n[: self.force_n.size])
        force_n = evaluated_law(law, np.stack([self.eta_m, *arguments]), self.sample_rate_hz, self.decimation)
        return force_n[..., : self.force_n.size]

    def residual_n(self, law: AnyLaw, rows: Rows) -> Float[np.ndarray, " rows"]:
        """Force less the low-passed law over some rows, N."""
        return (self.force_n - self.low_passed(law))[rows]

    def error_n(self, law: AnyLaw, rows: Rows) -> float:
        """Rms of the force less the low-passed law over some rows, N."""
        return float(np.sqrt(np.mean(self.residual_n(law, rows) ** 2)))


def standard_errors(
    samples: ForceSamples,
    rows: Rows,
    law: AnyLaw,
    influence: Float[np.ndarray, "rows values"],
    changed: Iterable[ForceSamples],
) -> Float[np.ndarray, " values"]:
    """Standard errors of the values of a law, which change by influence' residual.

    Sandwich estimates: the larger one of residuals that are alike within a sixteenth of the record, which is scatter,
    and of residuals that are alike within a sixteenth of the phase of the motion (eta, eta'), which also is what the
    law misses, the same in every cycle. To it comes what one standard deviation of each tolerance would do: `changed`
    are the samples with it.
    """
    residual_n, eta_m = samples.residual_n(law, rows), samples.eta_at_force_m[rows]
    velocity_m_per_s = samples.velocity_at_force_m_per_s[rows]
    phase = np.arctan2(velocity_m_per_s * np.std(eta_m), (eta_m - eta_m.mean()) * np.std(velocity_m_per_s))
    order = np.argsort(phase, kind="stable")
    phase_starts = np.searchsorted(phase[order], np.linspace(-np.pi, np.pi, PART_COUNT, endpoint=False))
    scores_by_time = cluster_scores(influence, residual_n)
    scores_by_phase = cluster_scores(influence[order], residual_n[order], phase_starts)
    scatter = np.maximum(np.linalg.norm(scores_by_time, axis=0), np.linalg.norm(scores_by_phase, axis=0))
    shifts = [influence.T @ (one.residual_n(law, rows) - residual_n) for one in changed]
    factor = small_sample_factor(min(influence.shape[1], PART_COUNT // 2))
    return np.asarray(np.hypot(factor * scatter, np.linalg.norm([np.zeros_like(scatter), *shifts], axis=0)))


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


def fitted_piecewise_linear(
    samples: ForceSamples, rows: Rows, knees_m: Float[np.ndarray, " knees"], changed: Iterable[ForceSamples] = ()
) -> PiecewiseLinear:
    """Continuous piecewise-linear law fitted under the low-pass from these knees; knees that do not help are dropped,
    as those that end at an end of the range.

    The knees are found by nonlinear least squares, the slopes by linear ones within; `standard_errors` with `changed`.
    """
    pieces, error_n = _pieces_and_error_n(samples, rows, np.sort(knees_m))
    low_m, high_m = float(samples.eta_m.min()), float(samples.eta_m.max())
    margin_m = END_SHARE * (high_m - low_m)
    while (is_inside := (pieces.knees_m > low_m + margin_m) & (pieces.knees_m < high_m - margin_m)).size:
        if not is_inside.all():
            pieces, error_n = _pieces_and_error_n(samples, rows, pieces.knees_m[is_inside])
            continue
        weakest_index = int(np.argmin(np.abs(np.diff(pieces.slopes_n_per_m))))
        reduced_law, reduced_error_n = _pieces_and_error_n(samples, rows, np.delete(pieces.knees_m, weakest_index))
        if reduced_error_n > DROPPED_KNEE_RATIO * error_n + ERROR_RESOLUTION * float(np.std(samples.force_n[rows])):
            break
        pieces, error_n = reduced_law, reduced_error_n
    return _with_standard_errors(samples, rows, pieces, changed)


def _with_standard_errors(
    samples: ForceSamples, rows: Rows, pieces: PiecewiseLinear, changed: Iterable[ForceSamples]
) -> PiecewiseLinear:
    jumps_n_per_m, knees_m = np.diff(pieces.slopes_n_per_m), pieces.knees_m

    def derivatives(eta_m: Signal) -> Signal:
        beyond_knees = [eta_m - knee_m for knee_m in knees_m]
        by_slope = [np.ones_like(eta_m), eta_m, *(np.maximum(beyond_m, 0.0) for beyond_m in beyond_knees)]
        steps = zip(jumps_n_per_m, beyond_knees, strict=True)
        return np.stack([*by_slope, *(-jump * (beyond_m > 0) for jump, beyond_m in steps)])

    columns = samples.low_passed(derivatives)[:, rows].T
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    influence = np.linalg.pinv(columns / sizes).T / sizes
    slope_influence = np.cumsum(influence[:, 1 : pieces.slopes_n_per_m.size + 1], axis=1)
    knee_influence = influence[:, pieces.slopes_n_per_m.size + 1 :]
    errors = standard_errors(samples, rows, pieces, np.concatenate([knee_influence, slope_influence], axis=1), changed)
    knee_errors_m, slope_errors_n_per_m = np.split(errors, [knees_m.size])
    return replace(pieces, knee_errors_m=knee_errors_m, slope_errors_n_per_m=slope_errors_n_per_m)


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
    _, coefficients, residual = linear_fit(knees)
    law = PiecewiseLinear(
        offset_n=float(coefficients[0]),
        knees_m=knees * span_m,
        slopes_n_per_m=np.cumsum(coefficients[1:]) / span_m,
        knee_errors_m=np.zeros(knees.size),
        slope_errors_n_per_m=np.zeros(knees.size + 1),
    )
    return law, float(np.sqrt(np.mean(residual**2)))


def hysteresis_share(samples: ForceSamples, law: PiecewiseLinear, rows: Rows) -> float:
    """Share of the unexplained variance that a damper in proportion to the law's local slope explains."""
    slope_sizes = np.abs(law.slopes_n_per_m)

    def slope_weighted_rate(eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        return slope_sizes[np.searchsorted(law.knees_m, eta_m)] / slope_sizes.max() * rate_m_per_s

    damper_n = samples.low_passed(slope_weighted_rate, samples.velocity_m_per_s)[rows]
    residual_n = samples.residual_n(law, rows)
    return float((damper_n @ residual_n) ** 2 / ((damper_n @ damper_n) * (residual_n @ residual_n)))


@dataclass(frozen=True)
class Friction:
    """Dry friction beside a constant force, a damper and a spring, any of which may be absent (zero)::

        f = constant + viscous eta' + elastic eta + slider

    The slider's force is `upper_n` once eta has grown for long enough, and `-lower_n` once it has fallen. Without a
    reversal speed v0 it is reached through a backlash B by a spring k and depends on the course of eta::

        s' = eta' while -B/2 - lower / k <= s <= B/2 + upper / k, which s never leaves
        slider = k (s - B/2)  for s > B/2,   k (s + B/2)  for s < -B/2,   0 between

    s is the position of eta in the backlash, from its middle, and starts at 0. With a reversal speed both forces are
    one, and slider = upper tanh(eta' / v0).
    """

    upper_n: float = 0.0
    lower_n: float = 0.0
    backlash_m: float = 0.0
    stiffness_n_per_m: float = 1.0
    reversal_speed_m_per_s: float = 0.0
    constant_n: float = 0.0
    viscous_n_s_per_m: float = 0.0
    elastic_n_per_m: float = 0.0

    def slider_n(
        self, course: MonotonicRuns, velocity_m_per_s: Float[np.ndarray, " more"]
    ) -> Float[np.ndarray, " more"]:
        """Force of the slider at every sample of a course, with the velocity there."""
        if self.reversal_speed_m_per_s:
            return np.asarray(self.upper_n * np.tanh(velocity_m_per_s / self.reversal_speed_m_per_s))
        half_backlash_m, k = self.backlash_m / 2, self.stiffness_n_per_m
        low_m, high_m = -half_backlash_m - self.lower_n / k, half_backlash_m + self.upper_n / k
        slider_turns_m = [0.0]
        for run_m in course.run_lengths_m:
            slider_turns_m.append(min(max(slider_turns_m[-1] + run_m, low_m), high_m))
        slider_m = np.clip(np.array(slider_turns_m)[course.run_indices] + course.eta_since_turn_m, low_m, high_m)
        return np.asarray(k * (slider_m - np.clip(slider_m, -half_backlash_m, half_backlash_m)))


class Part(StrEnum):
    """Parts of friction, each with one number; the force is linear in the first four."""

    FRICTION = "friction"
    CONSTANT = "constant"
    VISCOUS = "viscous"
    ELASTIC = "elastic"
    REVERSAL = "reversal"
    BACKLASH = "backlash"
    ASYMMETRY = "asymmetry"


PART_BY_FIELD = {
    "upper_n": Part.FRICTION,
    "lower_n": Part.FRICTION,
    "backlash_m": Part.BACKLASH,
    "stiffness_n_per_m": Part.REVERSAL,
    "reversal_speed_m_per_s": Part.REVERSAL,
    "constant_n": Part.CONSTANT,
    "viscous_n_s_per_m": Part.VISCOUS,
    "elastic_n_per_m": Part.ELASTIC,
}
"""Part by the field of `Friction` that its number gives."""
LINEAR_PARTS = (Part.FRICTION, Part.CONSTANT, Part.VISCOUS, Part.ELASTIC)
LOG_PARTS = (Part.REVERSAL, Part.BACKLASH)


@dataclass(frozen=True)
class FrictionFit:
    """Friction of some parts with the least squared error over the rows.

    numbers are those of the parts: half the sum of both sliding forces, constant, viscous and elastic coefficient;
    logarithms of the reversal (its speed, or the travel of the spring up to sliding) and of the backlash over their
    scales; and the artanh of the asymmetry (upper - lower) / (upper + lower). The last three have priors, whose
    standard deviation weighs as much as an error of prior_error_n in one sample.
    """

    samples: ForceSamples
    rows: Rows
    by_speed: bool
    parts: tuple[Part, ...]
    numbers: Float[np.ndarray, " parts"]
    prior_error_n: float

    @property
    def law(self) -> Friction:
        return self._law_of(self.numbers)

    @property
    def error_n(self) -> float:
        return self.samples.error_n(self.law, self.rows)

    @property
    def linear_count(self) -> int:
        """Count of the parts in which the force is linear; they come first."""
        return sum(part in LINEAR_PARTS for part in self.parts)

    def _law_of(self, numbers: Float[np.ndarray, " parts"]) -> Friction:
        number_by_part = dict(zip(self.parts, numbers.tolist(), strict=True))
        friction_n = number_by_part.get(Part.FRICTION, 0.0)
        asymmetry = float(np.tanh(number_by_part.get(Part.ASYMMETRY, 0.0)))
        span_m, log_backlash = float(np.ptp(self.samples.eta_m)), number_by_part.get(Part.BACKLASH)
        reversal = float(np.exp(number_by_part.get(Part.REVERSAL, RIGID_LOG_TRAVEL)))
        return Friction(
            upper_n=friction_n * (1 + asymmetry),
            lower_n=friction_n * (1 - asymmetry),
            backlash_m=0.0 if log_backlash is None else BACKLASH_SHARE * span_m * float(np.exp(log_backlash)),
            stiffness_n_per_m=friction_n / (TRAVEL_SHARE * span_m * reversal),
            reversal_speed_m_per_s=REVERSAL_SPEED_M_PER_S * reversal if self.by_speed else 0.0,
            constant_n=number_by_part.get(Part.CONSTANT, 0.0),
            viscous_n_s_per_m=number_by_part.get(Part.VISCOUS, 0.0),
            elastic_n_per_m=number_by_part.get(Part.ELASTIC, 0.0),
        )

    def _unit_force_n(self, linear_index: int, shape: Float[np.ndarray, " shapes"]) -> Float[np.ndarray, " rows"]:
        """Force of one unit of a linear part."""
        unit_numbers = np.concatenate([np.eye(self.linear_count)[linear_index], shape])
        return self.samples.low_passed(self._law_of(unit_numbers))[self.rows]

    def _linear_fit(
        self, shape: Float[np.ndarray, " shapes"], columns: Float[np.ndarray, "rows linear"]
    ) -> tuple[Float[np.ndarray, " linear"], Float[np.ndarray, " rows"]]:
        """Numbers of the linear parts by least squares, and the residual; columns are their forces of one unit."""
        if shape.size:
            columns = np.concatenate([self._unit_force_n(0, shape)[:, None], columns[:, 1:]], axis=1)
        sizes, force_n = np.maximum(np.linalg.norm(columns, axis=0), 1e-300), self.samples.force_n[self.rows]
        numbers = np.linalg.lstsq(columns / sizes, force_n, rcond=None)[0] / sizes
        return numbers, force_n - columns @ numbers

    def fitted(self, relative_tolerance: float = 1e-8, max_evaluation_count: int = 30) -> "FrictionFit":
        """Fit from these numbers: the shape by nonlinear least squares, the linear parts by linear ones within."""
        shape, force_deviation_n = self.numbers[self.linear_count :], float(np.std(self.samples.force_n[self.rows]))
        columns = np.stack([self._unit_force_n(i, shape) for i in range(self.linear_count)], axis=1)

        def weighted_residual(shape: np.ndarray) -> np.ndarray:
            prior_n = self.prior_error_n * shape / PRIOR_LOG_DEVIATION
            return np.append(self._linear_fit(shape, columns)[1], prior_n) / force_deviation_n

        if shape.size and max_evaluation_count:
            tolerances = {"ftol": relative_tolerance, "max_nfev": max_evaluation_count}
            shape = least_squares(weighted_residual, shape, diff_step=LOG_STEP, **tolerances).x
        return replace(self, numbers=np.concatenate([self._linear_fit(shape, columns)[0], shape]))

    def without(self, part: Part) -> "FrictionFit":
        """Rough fit without a part and what belongs to it: no slider has no shape, no backlash no asymmetry."""
        removed = {part, *{Part.FRICTION: (*LOG_PARTS, Part.ASYMMETRY), Part.BACKLASH: (Part.ASYMMETRY,)}.get(part, ())}
        kept = [i for i, other in enumerate(self.parts) if other not in removed]
        smaller = replace(self, parts=tuple(self.parts[i] for i in kept), numbers=self.numbers[kept])
        return smaller.fitted(TRIAL_TOLERANCE)

    @property
    def reduced(self) -> "FrictionFit":
        """Fit without the parts that the rows do not demand.

        One after the other the part is taken away without which the error grows least, as long as it grows by less than
        `MATERIAL_RATIO`, or the part is doubtful.
        """
        fit, resolution_n = self, ERROR_RESOLUTION * float(np.std(self.samples.force_n[self.rows]))
        while fit.linear_count > 1:
            smaller_fits = {part: fit.without(part) for part in fit.parts}
            weakest_part = min(smaller_fits, key=lambda part: smaller_fits[part].error_n)
            max_error_n = MATERIAL_RATIO * fit.error_n + resolution_n
            removable = [weakest_part] if smaller_fits[weakest_part].error_n <= max_error_n else fit.doubtful_parts
            if not removable:
                break
            fit = smaller_fits[min(removable, key=lambda part: smaller_fits[part].error_n)].fitted()
        return fit

    @property
    def doubtful_parts(self) -> list[Part]:
        """Parts whose 95 % interval holds zero, and negative friction."""
        errors = self._errors(lambda numbers: numbers, ())
        sizes = [1.0 if p in LOG_PARTS else abs(x) for p, x in zip(self.parts, self.numbers, strict=True)]
        parts_sizes_errors = zip(self.parts, sizes, errors, strict=True)
        parts = [part for part, size, error in parts_sizes_errors if COVERED * error > size]
        return [Part.FRICTION, *parts] if Part.FRICTION in self.parts and self.numbers[0] < 0 else parts

    @property
    def least_travel_m(self) -> float:
        """Travel of the motion in the first sample after a turn, doubled: less of a reversal is not seen."""
        return self.samples.turning_m_per_s2 * self.samples.force_step_s**2

    @property
    def is_reversal_seen(self) -> bool:
        """True if the sliding force takes longer than a sample to turn round."""
        if self.by_speed:
            return self.law.reversal_speed_m_per_s > self.least_travel_m / self.samples.force_step_s
        return Part.REVERSAL in self.parts and self.law.upper_n / self.law.stiffness_n_per_m > self.least_travel_m

    def estimates(self, changed: Iterable[ForceSamples] = ()) -> dict[str, tuple[float, float]]:
        """Value and standard error by field of the law, of the fields that its parts give; of both sliding forces."""
        reversal_field = "reversal_speed_m_per_s" if self.by_speed else "stiffness_n_per_m"
        fields = [
            field
            for field, part in PART_BY_FIELD.items()
            if part in self.parts and (part != Part.REVERSAL or field == reversal_field)
        ]

        def values(numbers: np.ndarray) -> np.ndarray:
            law = self._law_of(numbers)
            return np.array([getattr(law, field) for field in fields])

        errors = self._errors(values, changed)
        return dict(zip(fields, zip(values(self.numbers).tolist(), errors.tolist(), strict=True), strict=True))

    def _errors(
        self, function: Callable[[np.ndarray], np.ndarray], changed: Iterable[ForceSamples]
    ) -> Float[np.ndarray, " values"]:
        """Standard errors of values that are a function of the numbers."""
        linear_count, (linear_numbers, shape) = self.linear_count, np.split(self.numbers, [self.linear_count])
        steps = LOG_STEP * np.diag([*np.maximum(np.abs(linear_numbers), 1e-300), *np.ones_like(shape)])

        def relative_derivatives(of: Callable[[np.ndarray], np.ndarray], some_steps: np.ndarray) -> np.ndarray:
            differences = [of(self.numbers + step) - of(self.numbers - step) for step in some_steps]
            return np.stack(differences, axis=1) / (2 * LOG_STEP)

        def force_n(numbers: np.ndarray) -> np.ndarray:
            return self.samples.low_passed(self._law_of(numbers))[self.rows]

        linear_columns = [abs(x) * self._unit_force_n(i, shape) for i, x in enumerate(linear_numbers)]
        derivatives = np.stack(linear_columns, axis=1)
        if shape.size:
            derivatives = np.append(derivatives, relative_derivatives(force_n, steps[linear_count:]), axis=1)
        prior_n = self.prior_error_n / PRIOR_LOG_DEVIATION * np.eye(self.numbers.size)[linear_count:]
        inverse = np.linalg.pinv(np.concatenate([derivatives, prior_n]))[:, : len(derivatives)]
        influence = (relative_derivatives(function, steps) @ inverse).T
        return standard_errors(self.samples, self.rows, self.law, influence, changed)


def fitted_friction(
    samples: ForceSamples, rows: Rows, by_speed: bool, max_refined_error_n: float = np.inf
) -> FrictionFit:
    """Friction with the parts that the rows demand, of all that the samples can show.

    Friction that leaves more than max_refined_error_n when it is roughly fitted keeps all parts. Without a reversal the
    slider is rigid. Rows before the slider's start is forgotten are left out.
    """
    shape_parts: tuple[Part, ...] = (Part.REVERSAL,)
    starts: Iterable[tuple[float, ...]] = ((log_speed,) for log_speed in START_LOG_SPEEDS)
    if not by_speed:
        shape_parts = (Part.REVERSAL, Part.BACKLASH, Part.ASYMMETRY)
        starts = product(START_LOG_TRAVELS, START_LOG_BACKLASHES, (0.0,))
    rows = slice(max(rows.start, samples.slider_known_from), rows.stop)
    force_deviation_n = float(np.std(samples.force_n[rows]))
    unshaped = FrictionFit(samples, rows, by_speed, (*LINEAR_PARTS, *shape_parts), np.empty(0), force_deviation_n)
    start_fits = [
        replace(unshaped, numbers=np.array([*np.ones(len(LINEAR_PARTS)), *start])).fitted(max_evaluation_count=0)
        for start in starts
    ]
    start_fits.sort(key=lambda start_fit: start_fit.error_n)
    rough_fits = [start_fit.fitted(ROUGH_TOLERANCE) for start_fit in start_fits[:ROUGH_START_COUNT]]
    rough_fit = min(rough_fits, key=lambda fit: fit.error_n)
    if rough_fit.error_n > max_refined_error_n:
        return rough_fit
    fit = replace(rough_fit, prior_error_n=rough_fit.error_n).fitted()
    # what is shorter than the spring's travel may as well be a rounded onset, than a sample's nothing at all
    if fit.law.backlash_m < max(2 * fit.least_travel_m, fit.law.upper_n / fit.law.stiffness_n_per_m):
        fit = fit.without(Part.BACKLASH).fitted()
    return fit.reduced
