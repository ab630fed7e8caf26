"""Fit of laws to an unmeasured force: its time history regressed on laws of the motion at its place.

Most laws are linear in their coefficients and have at most one parameter. Those that depend on the slow motion, which
integration loses, are fitted by Gauss-Newton on coefficients, parameter and a spline of that motion.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from identify.gaps.unmeasured_force.force_laws import FORMS, ForceLaw, Form, Series, tone_form
from identify.gaps.unmeasured_force.time_history import KNOT_SPACING_S, ForceHistory, with_law_error
from identify.signals.gauss_newton import Step, gauss_newton
from identify.signals.kinematics import CORNER_HZ

STEPS, COST_TOLERANCE = 8, 1e-4
"""Gauss-Newton steps of a law at most, and the relative decrease of the cost that ends them. Effort."""
GRID = 14
"""Starting values of a parameter of a law. Effort."""
LAW_ERRORS = (1.0, 0.3, 0.1)
"""Share of the force that the law may miss, from stage to stage: far from the best values, details mislead. Set by
hand."""
EQUIVALENT_SHARE = 0.02
"""A law is as good as the best if its share of the free force's gain is lower by no more than this. Set by hand."""
FULLY_FITTED = 2
"""Count of slow forms whose descent is finished. Effort."""


def fit_laws(history: ForceHistory) -> tuple[ForceLaw, ...]:
    """All laws with their best values, in falling order of their share of the free force's gain.

    Slow forms are fitted only if no other law reaches the free force's gain, and the best of them only to the end.
    """
    fast = [_fit_tone(history), *(fit_form(history, form) for form in FORMS if not form.slow)]
    slow: list[ForceLaw] = []
    if max(law.share for law in fast) < 1 - EQUIVALENT_SHARE:
        started = sorted(
            (_start_descent(history, form) for form in FORMS if form.slow), key=lambda start: -start[2].share
        )
        finished = [_finish_descent(history, descent, iterate) for descent, iterate, _ in started[:FULLY_FITTED]]
        slow = finished + [
            replace(law, share=min(law.share, finished[-1].share)) for _, _, law in started[FULLY_FITTED:]
        ]
    return tuple(sorted(fast + slow, key=lambda law: -law.share))


def shortest_law(laws: tuple[ForceLaw, ...], least_share: float) -> ForceLaw | None:
    """Law of the fewest values among those as good as the best (the first); None if its share is below the least."""
    equivalent = [law for law in laws if law.share >= laws[0].share - EQUIVALENT_SHARE]
    best = min(equivalent, key=lambda law: (law.form.length, -law.share))
    return best if best.share >= least_share else None


def _fit_tone(history: ForceHistory) -> ForceLaw:
    """Harmonic force near the strongest line of the free force, with the frequency refined.

    No law error is allowed for: it would hide the lines beside the tone's.
    """
    history = with_law_error(history, 0.0)
    form = tone_form(history)
    record = history.located.whitened.record
    spectrum = np.abs(np.fft.rfft(history.force_n * history.gate))[: record.omega.size]
    spectrum[: history.located.whitened.lines.start] = 0.0
    peak_line, step_hz = int(np.argmax(spectrum)), record.omega[2] / (4 * np.pi)
    peak_hz = record.omega[peak_line] / (2 * np.pi)
    trial_hz = [peak_hz + k * step_hz / 2 for k in range(-2, 3)]
    best_hz = max(trial_hz, key=lambda hz: solve_form(history, form, hz)[1])
    return fit_form(history, form, (best_hz - step_hz / 2, best_hz + step_hz / 2))


def fit_form(history: ForceHistory, form: Form, bounds: tuple[float, float] | None = None) -> ForceLaw:
    """Law without slow motion: coefficients by least squares, the parameter by bounded minimisation, whose standard
    error follows from the curvature of the gain."""
    low, high = bounds or form.range_share
    parameter, error = 0.0, 0.0
    if form.parameter and low == high:
        parameter = low
    elif form.parameter:
        minimum = minimize_scalar(lambda p: -solve_form(history, form, p)[1], bounds=(low, high), method="bounded")
        parameter = float(minimum.x)
        step = 1e-3 * (high - low)
        gains = [solve_form(history, form, parameter + k * step)[1] for k in (-1, 0, 1)]
        curvature = (2 * gains[1] - gains[0] - gains[2]) / step**2
        error = float(np.sqrt(2 / curvature)) if curvature > 0 else float("inf")
    coefficients, gain, errors = solve_form(history, form, parameter)
    share = gain / max(history.free_gain, 1e-300)
    return ForceLaw(form, tuple((-coefficients).tolist()), tuple(errors.tolist()), parameter, error, 0.0, share)


def solve_form(
    history: ForceHistory, form: Form, parameter: float
) -> tuple[Float[np.ndarray, " coefficients"], float, Float[np.ndarray, " coefficients"]]:
    """Coefficients of the force on the body at a parameter, their gain in -2 ln L, and their standard errors."""
    return _solve_shapes(history, np.stack(form.shapes(history.displacement_m, history.velocity_m_per_s, parameter)))


def _solve_shapes(
    history: ForceHistory, shapes: Float[np.ndarray, "coefficients fine"]
) -> tuple[Float[np.ndarray, " coefficients"], float, Float[np.ndarray, " coefficients"]]:
    """Least squares of the force on its shapes: coefficients, gain and standard errors, by normal equations."""
    normal_matrix, right_side = history.reduced_equations(history.gated_spectra(shapes))
    inverse_normal, scale = _scaled_inverse(normal_matrix)
    scaled_coefficients = inverse_normal @ (right_side / scale)
    return (
        scaled_coefficients / scale,
        float(scaled_coefficients @ (right_side / scale)),
        np.sqrt(np.maximum(np.diag(inverse_normal), 0.0)) / scale,
    )


def _scaled_inverse(
    matrix: Float[np.ndarray, "unknowns unknowns"],
) -> tuple[Float[np.ndarray, "unknowns unknowns"], Float[np.ndarray, " unknowns"]]:
    """Pseudoinverse of a symmetric matrix scaled to a unit diagonal, and the scale d_i = sqrt(M_ii)."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-10, hermitian=True), scale


def _start_descent(history: ForceHistory, form: Form) -> "tuple[Descent, _Iterate, ForceLaw]":
    """Descent of a slow form from the best parameter of a grid without slow motion, at the first two `LAW_ERRORS`."""
    soft_history = with_law_error(history, LAW_ERRORS[0])
    largest_m = float(np.abs(history.displacement_m * (history.oversample(history.gate) > 0)).max())
    low, high = (share * largest_m for share in form.range_share)
    parameter = 0.0
    if form.parameter:
        grid = np.geomspace(low, high, GRID) if low > 0 else np.linspace(low, high, GRID)
        parameter = max((float(p) for p in grid), key=lambda p: solve_form(soft_history, form, p)[1])
    descent = _descent(soft_history, form, largest_m, (low, high))
    iterate, _ = descent.descend(descent.start(parameter))
    descent = replace(descent, history=with_law_error(history, LAW_ERRORS[1]))
    return descent, *descent.descend(iterate)


def _finish_descent(history: ForceHistory, descent: "Descent", iterate: "_Iterate") -> ForceLaw:
    """Law at the end of a descent that is continued at the smaller `LAW_ERRORS`, then at that of the history."""
    for law_error in LAW_ERRORS[2:]:
        iterate, _ = replace(descent, history=with_law_error(history, law_error)).descend(iterate)
    return replace(descent, history=history).descend(iterate)[1]


@dataclass(frozen=True)
class _Iterate:
    """Values of a law: coefficients of the force on the body, the parameter, knots of the slow motion (m), and the
    cost, minus the penalised gain."""

    coefficients: Float[np.ndarray, " coefficients"]
    parameter: float
    knots: Float[np.ndarray, " knots"]
    cost: float


@dataclass(frozen=True)
class _ForceStep(Step[_Iterate]):
    covariance: Float[np.ndarray, "unknowns unknowns"]


def _cost_tolerance(iterate: _Iterate) -> float:
    return COST_TOLERANCE * abs(iterate.cost)


@dataclass(frozen=True)
class Descent:
    """Gauss-Newton fit of one slow form to a time history with one weighting.

    step (m) is that of numerical derivatives, prior the inverse covariance of the slow motion's knots (1/m^2).
    """

    history: ForceHistory
    form: Form
    step: float
    parameter_range: tuple[float, float]
    prior: Float[np.ndarray, "knots knots"]

    def start(self, parameter: float) -> _Iterate:
        """Iterate with the best coefficients at a parameter, without slow motion."""
        coefficients, _, _ = solve_form(self.history, self.form, parameter)
        return self._evaluate(coefficients, parameter, np.zeros(len(self.prior)))

    def shapes(
        self, parameter: float, knots: Float[np.ndarray, " knots"], shift_m: float = 0.0
    ) -> Float[np.ndarray, "coefficients fine"]:
        """Forces per unit coefficient along the motion with the slow motion added, all of it shifted by shift_m."""
        displacement_m = (
            self.history.displacement_m + self.history.oversample(self.history.slow_basis @ knots) + shift_m
        )
        return np.stack(self.form.shapes(displacement_m, self.history.velocity_m_per_s, parameter))

    def penalised_gain(self, force: Series, knots: Float[np.ndarray, " knots"]) -> float:
        """Gain in -2 ln L of a force, less the prior's cost of the slow motion."""
        return self.history.gain(self.history.gated_spectra(force)) - float(knots @ self.prior @ knots)

    def descend(self, start: _Iterate) -> tuple[_Iterate, ForceLaw]:
        """Best iterate from the values of `start`, and its law."""
        start = self._evaluate(start.coefficients, start.parameter, start.knots)
        iterate, last_step = gauss_newton(start, self._step, _cost_tolerance, STEPS)
        coefficient_count, errors = (
            len(self.form.coefficient_units),
            np.sqrt(np.maximum(np.diag(last_step.covariance), 0.0)),
        )
        law = ForceLaw(
            self.form,
            tuple((-iterate.coefficients).tolist()),
            tuple(errors[:coefficient_count].tolist()),
            iterate.parameter,
            float(errors[coefficient_count]) if self.form.parameter else 0.0,
            float(np.mean((self.history.slow_basis @ iterate.knots)[self.history.gate > 0])),
            -iterate.cost / max(self.history.free_gain, 1e-300),
        )
        return iterate, law

    def _evaluate(
        self,
        coefficients: Float[np.ndarray, " coefficients"],
        parameter: float,
        knots: Float[np.ndarray, " knots"],
    ) -> _Iterate:
        cost = -self.penalised_gain(coefficients @ self.shapes(parameter, knots), knots)
        return _Iterate(coefficients, parameter, knots, cost)

    def _step(self, iterate: _Iterate) -> _ForceStep:
        """Gauss-Newton step of coefficients, parameter and knots.

        After a share of the step the coefficients are solved for again at the new parameter and knots.
        """
        history, form, coefficient_count = self.history, self.form, len(self.form.coefficient_units)
        free_count = coefficient_count + bool(form.parameter)
        shapes = self.shapes(iterate.parameter, iterate.knots)
        force = iterate.coefficients @ shapes
        fine_forces = [*shapes]
        if form.parameter:
            fine_forces.append(
                (iterate.coefficients @ self.shapes(iterate.parameter + self.step, iterate.knots) - force) / self.step
            )
        tangent = (iterate.coefficients @ self.shapes(iterate.parameter, iterate.knots, self.step) - force) / self.step
        means = tangent.reshape(len(history.slow_basis), -1).mean(axis=1)
        knot_columns = history.spectra_of_samples((history.slow_basis * means[:, None]).T)
        columns = np.concatenate(
            [history.gated_spectra(np.stack(fine_forces)), knot_columns, history.gated_spectra(force)[None]]
        )
        normal_matrix, right_side = history.reduced_equations(columns)
        gradient, normal_matrix = right_side[:-1] - normal_matrix[:-1, -1], normal_matrix[:-1, :-1]
        normal_matrix[free_count:, free_count:] += self.prior
        gradient[free_count:] -= self.prior @ iterate.knots
        covariance, scale = _scaled_inverse(normal_matrix)
        covariance /= np.outer(scale, scale)
        change = covariance @ gradient

        def iterate_after(share: float) -> _Iterate | None:
            parameter = 0.0
            if form.parameter:
                changed = iterate.parameter + share * change[coefficient_count]
                parameter = float(np.clip(changed, *self.parameter_range))
                if not parameter:
                    return None
            knots = iterate.knots + share * change[free_count:]
            return self._evaluate(_solve_shapes(history, self.shapes(parameter, knots))[0], parameter, knots)

        return _ForceStep(iterate_after, float(gradient @ change), covariance)


def _descent(history: ForceHistory, form: Form, largest_m: float, parameter_range: tuple[float, float]) -> Descent:
    """Descent whose prior holds the slow motion below the corner of integration, and its rms to that of the motion."""
    knot_count = history.slow_basis.shape[1]
    bending = np.diff(np.eye(knot_count), 2, axis=0) / (2 * np.pi * CORNER_HZ * KNOT_SPACING_S) ** 2
    prior = (np.eye(knot_count) + bending.T @ bending) / float(np.std(history.displacement_m)) ** 2
    return Descent(history, form, 1e-4 * largest_m, parameter_range, prior)
