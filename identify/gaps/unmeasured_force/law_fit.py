"""Fit of laws to an unmeasured force: its time history regressed on laws of the motion at its place.

Most laws are linear in their coefficients and have at most one parameter. Those that depend on the slow motion, which
integration loses, are fitted by Gauss-Newton on coefficients, parameter and a spline of that motion.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from identify.gaps.unmeasured_force.force_laws import LAW_FORMS, ForceLaw, ForceLawForm, Series, tone_form
from identify.gaps.unmeasured_force.time_history import KNOT_SPACING_S, ForceAndMotionHistory, reweighted_for_law_error
from identify.signals.gauss_newton import Step, gauss_newton
from identify.signals.kinematics import CORNER_HZ

MAX_STEPS, COST_TOLERANCE = 8, 1e-4
"""Gauss-Newton steps of a law at most, and the relative decrease of the cost that ends them. Effort."""
GRID_VALUE_COUNT = 14
"""Starting values of a parameter of a law. Effort."""
LAW_ERROR_SHARES = (1.0, 0.3, 0.1)
"""Share of the force that the law may miss, from stage to stage: far from the best values, details mislead. Set by
hand."""
EQUIVALENT_GAIN = 0.02
"""A law is as good as the best if its share of the free force's gain is lower by no more than this. Set by hand."""
FULLY_FITTED_LAW_COUNT = 2
"""Count of slow forms whose descent is finished. Effort."""


def fit_laws(history: ForceAndMotionHistory) -> tuple[ForceLaw, ...]:
    """All laws with their best values, in falling order of their share of the free force's gain.

    Slow forms are fitted only if no other law reaches the free force's gain, and the best of them only to the end.
    """
    laws = [
        _fit_tone(history),
        *(fit_law_without_slow_motion(history, form) for form in LAW_FORMS if not form.needs_slow_motion),
    ]
    if max(law.share_of_free_gain for law in laws) < 1 - EQUIVALENT_GAIN:
        started = sorted(
            (_start_descent(history, form) for form in LAW_FORMS if form.needs_slow_motion),
            key=lambda descent_iterate_law: -descent_iterate_law[2].share_of_free_gain,
        )
        laws += [_finish_descent(history, descent, iterate) for descent, iterate, _ in started[:FULLY_FITTED_LAW_COUNT]]
        largest_share = laws[-1].share_of_free_gain
        laws += [
            replace(law, share_of_free_gain=min(law.share_of_free_gain, largest_share))
            for _, _, law in started[FULLY_FITTED_LAW_COUNT:]
        ]
    return tuple(sorted(laws, key=lambda law: -law.share_of_free_gain))


def simplest_adequate_law(laws: tuple[ForceLaw, ...], least_gain_share: float) -> ForceLaw | None:
    """Law of the fewest values among those as good as the best (the first); None if its share is below the least."""
    equivalent_laws = [law for law in laws if law.share_of_free_gain >= laws[0].share_of_free_gain - EQUIVALENT_GAIN]
    best_law = min(equivalent_laws, key=lambda law: (law.form.value_count, -law.share_of_free_gain))
    return best_law if best_law.share_of_free_gain >= least_gain_share else None


def _fit_tone(history: ForceAndMotionHistory) -> ForceLaw:
    """Harmonic force near the strongest line of the free force, with the frequency refined.

    No law error is allowed for: it would hide the lines beside the tone's.
    """
    history = reweighted_for_law_error(history, 0.0)
    form, whitened = tone_form(history), history.located_force.whitened_record
    omega = whitened.record.omega
    amplitudes = np.abs(np.fft.rfft(history.free_force_n * history.time_gate))[: omega.size]
    amplitudes[: whitened.line_slice.start] = 0.0
    step_hz, peak_hz = omega[2] / (4 * np.pi), omega[int(np.argmax(amplitudes))] / (2 * np.pi)
    trial_hz = [peak_hz + half_steps * step_hz / 2 for half_steps in range(-2, 3)]
    best_hz = max(trial_hz, key=lambda tone_hz: solve_coefficients_at(history, form, tone_hz)[1])
    return fit_law_without_slow_motion(history, form, (best_hz - step_hz / 2, best_hz + step_hz / 2))


def fit_law_without_slow_motion(
    history: ForceAndMotionHistory, form: ForceLawForm, parameter_bounds: tuple[float, float] | None = None
) -> ForceLaw:
    """Law without slow motion: coefficients by least squares, the parameter by bounded minimisation, whose standard
    error follows from the curvature of the gain. Errors of the coefficients hold that of the parameter, unless it is
    the frequency of a tone, which turns them into one another."""
    low, high = parameter_bounds or form.parameter_range
    parameter, parameter_error, parameter_step = 0.0, 0.0, 1e-3 * (high - low)

    def gain_at(parameter: float) -> float:
        return solve_coefficients_at(history, form, parameter)[1]

    if form.parameter_name and low == high:
        parameter = low
    elif form.parameter_name:
        parameter = float(minimize_scalar(lambda p: -gain_at(p), bounds=(low, high), method="bounded").x)
        gain_before, gain_at_optimum, gain_after = (gain_at(parameter + count * parameter_step) for count in (-1, 0, 1))
        curvature = (2 * gain_at_optimum - gain_before - gain_after) / parameter_step**2
        parameter_error = float(np.sqrt(2 / curvature)) if curvature > 0 else float("inf")
    coefficients, gain, coefficient_errors = solve_coefficients_at(history, form, parameter)
    if parameter_error and not form.is_tone:
        changes = np.subtract(
            *(solve_coefficients_at(history, form, parameter + sign * parameter_step)[0] for sign in (1, -1))
        )
        coefficient_errors = np.hypot(coefficient_errors, changes / (2 * parameter_step) * parameter_error)
    return ForceLaw(
        form,
        tuple((-coefficients).tolist()),
        tuple(coefficient_errors.tolist()),
        parameter,
        parameter_error,
        mean_displacement_m=0.0,
        share_of_free_gain=gain / max(history.free_force_gain, 1e-300),
    )


def solve_coefficients_at(
    history: ForceAndMotionHistory, form: ForceLawForm, parameter: float
) -> tuple[Float[np.ndarray, " coefficients"], float, Float[np.ndarray, " coefficients"]]:
    """Coefficients of the force on the body at a parameter, their gain in -2 ln L, and their standard errors."""
    unit_forces = form.unit_forces(history.displacement_m, history.velocity_m_per_s, parameter)
    return _solve_unit_forces(history, np.stack(unit_forces))


def _solve_unit_forces(
    history: ForceAndMotionHistory, unit_forces: Float[np.ndarray, "coefficients fine"]
) -> tuple[Float[np.ndarray, " coefficients"], float, Float[np.ndarray, " coefficients"]]:
    """Least squares of the force on its shapes: coefficients, gain and standard errors, by normal equations."""
    normal_matrix, right_side = history.reduced_equations(history.gated_spectra(unit_forces))
    scaled_inverse, diagonal_scale = _scaled_inverse(normal_matrix)
    coefficients = scaled_inverse @ (right_side / diagonal_scale)
    coefficient_errors = np.sqrt(np.maximum(np.diag(scaled_inverse), 0.0)) / diagonal_scale
    return coefficients / diagonal_scale, float(coefficients @ (right_side / diagonal_scale)), coefficient_errors


def _scaled_inverse(
    matrix: Float[np.ndarray, "unknowns unknowns"],
) -> tuple[Float[np.ndarray, "unknowns unknowns"], Float[np.ndarray, " unknowns"]]:
    """Pseudoinverse of a symmetric matrix scaled to a unit diagonal, and the scale d_i = sqrt(M_ii)."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-10, hermitian=True), scale


def _start_descent(history: ForceAndMotionHistory, form: ForceLawForm) -> "tuple[Descent, _Iterate, ForceLaw]":
    """Descent of a slow form from the best parameter of a grid without slow motion, at two `LAW_ERROR_SHARES`."""
    soft_history = reweighted_for_law_error(history, LAW_ERROR_SHARES[0])
    largest_displacement_m = float(np.abs(history.displacement_m * (history.oversampled(history.time_gate) > 0)).max())
    low, high = (share * largest_displacement_m for share in form.parameter_range)
    parameter = 0.0
    if form.parameter_name:
        grid = np.geomspace(low, high, GRID_VALUE_COUNT) if low > 0 else np.linspace(low, high, GRID_VALUE_COUNT)
        parameter = max(grid.tolist(), key=lambda value: solve_coefficients_at(soft_history, form, value)[1])
    descent = _descent_of_form(soft_history, form, largest_displacement_m, (low, high))
    iterate, _ = descent.descend(descent.start_iterate(parameter))
    descent = replace(descent, history=reweighted_for_law_error(history, LAW_ERROR_SHARES[1]))
    return descent, *descent.descend(iterate)


def _finish_descent(history: ForceAndMotionHistory, descent: "Descent", iterate: "_Iterate") -> ForceLaw:
    """Law at the end of a descent that is continued at the smaller `LAW_ERROR_SHARES`, then at that of the history."""
    for law_error in LAW_ERROR_SHARES[2:]:
        iterate, _ = replace(descent, history=reweighted_for_law_error(history, law_error)).descend(iterate)
    return replace(descent, history=history).descend(iterate)[1]


@dataclass(frozen=True)
class _Iterate:
    """Values of a law: coefficients of the force on the body, the parameter, knots of the slow motion (m), and the
    cost, minus the penalised gain."""

    coefficients: Float[np.ndarray, " coefficients"]
    parameter: float
    slow_knots_m: Float[np.ndarray, " knots"]
    cost: float


@dataclass(frozen=True)
class _ForceStep(Step[_Iterate]):
    covariance: Float[np.ndarray, "unknowns unknowns"]


def _negligible_cost_change(iterate: _Iterate) -> float:
    return COST_TOLERANCE * abs(iterate.cost)


@dataclass(frozen=True)
class Descent:
    """Gauss-Newton fit of one slow form to a time history with one weighting.

    displacement_step_m is that of numerical derivatives, knot_precision the inverse covariance of the slow motion's
    knots (1/m^2).
    """

    history: ForceAndMotionHistory
    law_form: ForceLawForm
    displacement_step_m: float
    parameter_range: tuple[float, float]
    knot_precision: Float[np.ndarray, "knots knots"]

    def start_iterate(self, parameter: float) -> _Iterate:
        """Iterate with the best coefficients at a parameter, without slow motion."""
        coefficients, _, _ = solve_coefficients_at(self.history, self.law_form, parameter)
        return self._evaluate(coefficients, parameter, np.zeros(len(self.knot_precision)))

    def unit_forces(
        self, parameter: float, slow_knots_m: Float[np.ndarray, " knots"], shift_m: float = 0.0
    ) -> Float[np.ndarray, "coefficients fine"]:
        """Forces per unit coefficient along the motion with the slow motion added, all of it shifted by shift_m."""
        history = self.history
        displacement_m = history.displacement_m + history.oversampled(history.slow_basis @ slow_knots_m) + shift_m
        return np.stack(self.law_form.unit_forces(displacement_m, history.velocity_m_per_s, parameter))

    def penalised_gain(self, fine_force_n: Series, slow_knots_m: Float[np.ndarray, " knots"]) -> float:
        """Gain in -2 ln L of a force, less the prior's cost of the slow motion."""
        prior_cost = float(slow_knots_m @ self.knot_precision @ slow_knots_m)
        return self.history.minus_two_log_decrease(self.history.gated_spectra(fine_force_n)) - prior_cost

    def descend(self, start: _Iterate) -> tuple[_Iterate, ForceLaw]:
        """Best iterate from the values of another, and its law."""
        start, history = self._evaluate(start.coefficients, start.parameter, start.slow_knots_m), self.history
        best_iterate, last_step = gauss_newton(start, self._step, _negligible_cost_change, MAX_STEPS)
        coefficient_count = len(self.law_form.coefficient_units)
        standard_errors = np.sqrt(np.maximum(np.diag(last_step.covariance), 0.0)).tolist()
        return best_iterate, ForceLaw(
            self.law_form,
            tuple((-best_iterate.coefficients).tolist()),
            tuple(standard_errors[:coefficient_count]),
            best_iterate.parameter,
            standard_errors[coefficient_count] if self.law_form.parameter_name else 0.0,
            mean_displacement_m=float(np.mean((history.slow_basis @ best_iterate.slow_knots_m)[history.time_gate > 0])),
            share_of_free_gain=-best_iterate.cost / max(history.free_force_gain, 1e-300),
        )

    def _evaluate(
        self,
        coefficients: Float[np.ndarray, " coefficients"],
        parameter: float,
        slow_knots_m: Float[np.ndarray, " knots"],
    ) -> _Iterate:
        cost = -self.penalised_gain(coefficients @ self.unit_forces(parameter, slow_knots_m), slow_knots_m)
        return _Iterate(coefficients, parameter, slow_knots_m, cost)

    def _step(self, iterate: _Iterate) -> _ForceStep:
        """Gauss-Newton step of coefficients, parameter and knots.

        After a share of the step the coefficients are solved for again at the new parameter and knots.
        """
        history, form, step_m = self.history, self.law_form, self.displacement_step_m
        coefficients, parameter, knots_m = iterate.coefficients, iterate.parameter, iterate.slow_knots_m
        coefficient_count = len(form.coefficient_units)
        free_count = coefficient_count + bool(form.parameter_name)
        unit_forces = self.unit_forces(parameter, knots_m)
        force_n = coefficients @ unit_forces
        force_derivatives = [*unit_forces]
        if form.parameter_name:
            force_derivatives.append((coefficients @ self.unit_forces(parameter + step_m, knots_m) - force_n) / step_m)
        tangents_n_per_m = (coefficients @ self.unit_forces(parameter, knots_m, step_m) - force_n) / step_m
        mean_tangents = tangents_n_per_m.reshape(len(history.slow_basis), -1).mean(axis=1)
        force_columns = np.concatenate(
            [
                history.gated_spectra(np.stack(force_derivatives)),
                history.spectra_of_samples((history.slow_basis * mean_tangents[:, None]).T),
                history.gated_spectra(force_n)[None],
            ]
        )
        normal_matrix, right_side = history.reduced_equations(force_columns)
        gradient, normal_matrix = right_side[:-1] - normal_matrix[:-1, -1], normal_matrix[:-1, :-1]
        normal_matrix[free_count:, free_count:] += self.knot_precision
        gradient[free_count:] -= self.knot_precision @ knots_m
        covariance, diagonal_scale = _scaled_inverse(normal_matrix)
        covariance /= np.outer(diagonal_scale, diagonal_scale)
        full_step = covariance @ gradient

        def iterate_after(step_share: float) -> _Iterate | None:
            next_shape_parameter = 0.0
            if form.parameter_name:
                stepped_parameter = parameter + step_share * full_step[coefficient_count]
                next_shape_parameter = float(np.clip(stepped_parameter, *self.parameter_range))
                if not next_shape_parameter:
                    return None
            next_knots_m = knots_m + step_share * full_step[free_count:]
            next_coefficients, _, _ = _solve_unit_forces(history, self.unit_forces(next_shape_parameter, next_knots_m))
            return self._evaluate(next_coefficients, next_shape_parameter, next_knots_m)

        return _ForceStep(iterate_after, float(gradient @ full_step), covariance)


def _descent_of_form(
    history: ForceAndMotionHistory,
    form: ForceLawForm,
    largest_displacement_m: float,
    parameter_range: tuple[float, float],
) -> Descent:
    """Descent whose prior holds the slow motion below the corner of integration, and its rms to that of the motion."""
    knot_identity = np.eye(history.slow_basis.shape[1])
    second_differences = np.diff(knot_identity, 2, axis=0) / (2 * np.pi * CORNER_HZ * KNOT_SPACING_S) ** 2
    motion_variance_m2 = float(np.std(history.displacement_m)) ** 2
    knot_precision = (knot_identity + second_differences.T @ second_differences) / motion_variance_m2
    return Descent(history, form, 1e-4 * largest_displacement_m, parameter_range, knot_precision)
