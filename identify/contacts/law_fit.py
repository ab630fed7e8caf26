"""Fit of a contact's law to one separated force by weighted Gauss-Newton, and the choice of the law's form.

A form is preferred to the dead zone where its fit, with the same weights, leaves less by Schwarz's criterion, and does
so in one sixteenth of the record after the other (the statistic of Vuong, Econometrica 57, 1989):

    N / L sum_b n_b ln(S_0b / S_b) > m ln N + 2 ln 1000,    mean_i(d_i) > 3 std_i(d_i) / sqrt(16)

with the weighted squares S_b in bands of n_b of the L lines of the spectrum, m parameters more than the dead zone, N
samples, 20 a second, and d_i the squares that the form saves in a sixteenth of the record, every band divided by its
S_0b / n_b. In bands, because noise where the law does not act would drown what the law leaves elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag
from scipy.stats import f

from identify.contacts.contact_record import ContactRecord
from identify.contacts.law_form import FormName, LawForm, TouchedStops
from identify.contacts.linearization import (
    BorderedEquations,
    FitState,
    Jacobian,
    LawGuess,
    Pulls,
    corrected_motion,
    jacobian,
    normal_equations,
    state_at,
)
from identify.contacts.refusals import ContactRefusedError, RefusalCode, refused
from identify.signals.gauss_newton import Step, gauss_newton
from identify.signals.law_evaluation import law_step_s
from identify.signals.refit import refit_until_settled
from identify.signals.scores import PART_COUNT, cluster_scores

MOST_STEPS, WEIGHT_ROUNDS, COST_TOLERANCE, ROUGH_COST_TOLERANCE = 30, 3, 1e-7, 1e-3
SETTLED_COST_FALL = 0.01
"""Fall of the cost of one independent residual that ends the fit: it moves a parameter by a tenth of its standard
error."""
EXPONENT_SCALE = 0.1

Weights = Float[np.ndarray, " fewer"]


@dataclass(frozen=True)
class LawFit:
    """Fit of a record: its state and weights. free_to_laws maps the free parameters of a dead zone to the laws."""

    record: ContactRecord
    free_to_laws: Float[np.ndarray, "laws free"]
    state: FitState
    weights: Weights

    @property
    def squared_weighted_residuals(self) -> Float[np.ndarray, " fewer"]:
        """Squares of the weighted residuals."""
        return np.asarray((self.weights * self.state.residual_n) ** 2)

    @property
    def scaled_to_laws(self) -> Float[np.ndarray, "numbers sizes"]:
        """Matrix from the free parameters, scaled to condition the normal equations, to the law; an exponent is
        free."""
        form = self.state.form
        lower_m, upper_m, stiffness_n_per_m, _ = form.contact_parameters(self.state.law_parameters).T
        clearance_m = np.maximum(np.minimum(lower_m, upper_m), 1e-9)
        law_scales = np.stack([clearance_m, clearance_m, stiffness_n_per_m, 1e-3 * stiffness_n_per_m], axis=1).ravel()
        scaled_matrix = self.free_to_laws * np.max(self.free_to_laws * law_scales[:, None], axis=0)
        if not form.exponent_count:
            return scaled_matrix
        return np.asarray(block_diag(scaled_matrix, EXPONENT_SCALE * np.eye(form.exponent_count)))

    @property
    def linearized(self) -> tuple[Jacobian, BorderedEquations]:
        """Jacobian and normal equations at the state."""
        derivatives = jacobian(self.record, self.state)
        return derivatives, normal_equations(self.record, self.state, derivatives, self.scaled_to_laws, self.weights)

    def minimum_cost_fit(self, cost_tolerance: float = COST_TOLERANCE) -> "LawFit":
        """Fit at the state of least cost for its weights, by Gauss-Newton."""

        def negligible_decrease(current: FitState) -> float:
            return max(SETTLED_COST_FALL * self.record.samples_per_error, cost_tolerance * current.cost)

        state, *_ = gauss_newton(self._with_cost(self.state), self._step_from, negligible_decrease, MOST_STEPS)
        return replace(self, state=state)

    def _step_from(self, state: FitState) -> Step[FitState]:
        fit = replace(self, state=state)
        free_to_laws, (_, equations), pull_count = fit.scaled_to_laws, fit.linearized, state.pulls.size
        knot_step, free_step = equations.solved(equations.knot_gradient, equations.free_gradient)
        cost_decrease = np.sum(equations.knot_gradient * knot_step) + np.sum(equations.free_gradient * free_step)

        def state_after(share: float) -> FitState | None:
            law_parameters = state.law_parameters + share * free_to_laws @ free_step[pull_count:, 0]
            if not state.form.is_within_bounds(law_parameters):
                return None
            knots, pulls = state.knots + share * knot_step[:, 0], state.pulls + share * free_step[:pull_count, 0]
            return self._with_cost(state_at(self.record, state.form, law_parameters, knots, pulls))

        return Step(state_after, float(cost_decrease))

    def _with_cost(self, state: FitState) -> FitState:
        """State with its cost: weighted squares of residuals and of the priors."""
        drift_spline, residual_cost = self.record.drift_spline, np.sum((self.weights * state.residual_n) ** 2)
        curvature_cost = np.sum((drift_spline.curvature @ state.knots - drift_spline.curvature_target) ** 2)
        pull_cost = self.record.samples_per_error * np.sum(state.pulls**2)
        return replace(state, cost=float(residual_cost + curvature_cost + pull_cost))

    @property
    def reweighted(self) -> "LawFit":
        """Fit with weights from the scatter of the residuals."""
        return replace(self, weights=residual_weights(self.record, self.state, _open_residual_deviation_n(self.state)))

    @property
    def settled(self) -> "LawFit":
        """Fit with weights renewed from the scatter of the residuals until they settle."""

        def weights_agree(before: LawFit, after: LawFit) -> bool:
            return np.allclose(after.weights, before.weights, rtol=0.1)

        return refit_until_settled(
            self.reweighted, lambda fit: fit.minimum_cost_fit().reweighted, weights_agree, max_rounds=WEIGHT_ROUNDS
        )

    def with_form(self, form: LawForm) -> "LawFit":
        """Fit of another form, with an exponent of one, at this state and with these weights; not fitted again."""
        law_values = self.state.form.contact_parameters(self.state.law_parameters).ravel()
        law_parameters = np.concatenate([law_values, np.ones(form.exponent_count)])
        return replace(self, state=state_at(self.record, form, law_parameters, self.state.knots, self.state.pulls))

    @property
    def motion(self) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
        """Relative displacement with drift and nuisance signals, m, and its rate, m/s."""
        return corrected_motion(self.record, self.state.knots, self.state.nuisance_pulls)

    def depth_m(self, eta_m: Float[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
        """Penetration of the first contact's stops, m."""
        lower_m, upper_m, _, _ = self.state.form.contact_parameters(self.state.law_parameters)[0]
        return np.asarray(eta_m - np.clip(eta_m, -lower_m, upper_m))


def free_to_law_map(touched: TouchedStops, sides_known: bool) -> Float[np.ndarray, "laws free"]:
    """Matrix from the free parameters to the laws: stops that are not touched have none, nor has a spring. Where the
    zero of the relative displacement is unknown, it is the middle of the first contact's play."""
    is_free = np.column_stack([touched, np.ones_like(touched)]).ravel()
    free_to_laws = np.eye(is_free.size)[:, is_free]
    if sides_known or not touched[0].any():
        return free_to_laws
    return np.column_stack([free_to_laws[:, 0] + free_to_laws[:, 1], free_to_laws[:, 2:]])


def first_fit(
    record: ContactRecord,
    free_to_laws: Float[np.ndarray, "laws free"],
    guesses: list[LawGuess],
    nuisance_pulls: Pulls,
    form: LawForm,
) -> LawFit:
    """Fit of a dead zone or a spring: the best of the minima from each guess, with settled weights. The damping begins
    as in rig.json, and the moments of contact are followed from that minimum on.

    Raises ContactRefusedError if no guess leads to a minimum.
    """
    initial_noise_n = 0.02 * float(np.std(record.force_n))
    fits, latest_refusal = list[LawFit](), refused(RefusalCode.NO_LAW)
    for law_parameters, knots in guesses:
        start_state = state_at(record, form, law_parameters, knots, np.append(nuisance_pulls, 0.0))
        weights = residual_weights(record, start_state, initial_noise_n)
        try:
            fits.append(LawFit(record, free_to_laws, start_state, weights).minimum_cost_fit(ROUGH_COST_TOLERANCE))
        except ContactRefusedError as error:
            latest_refusal = error
    if not fits:
        raise latest_refusal
    best_fit = min(fits, key=lambda fit: float(np.sum(fit.state.residual_n**2)))
    return best_fit.with_form(replace(form, step_s=law_step_s(record.sample_rate_hz))).settled


def is_open(state: FitState) -> Bool[np.ndarray, " fewer"]:
    """Samples at which all stops are open."""
    return np.asarray(np.abs(state.tangent_n_per_m - state.spring_n_per_m) < 1e-3 * state.stiffness_n_per_m)


def _open_residual_deviation_n(state: FitState) -> float:
    """Standard deviation of the residual while all stops are open; of the whole residual if they never are."""
    open_residual_n = state.residual_n[is_open(state)]
    return float(np.std(open_residual_n)) if np.any(open_residual_n) else float(np.std(state.residual_n))


def residual_weights(record: ContactRecord, state: FitState, open_deviation_n: float) -> Weights:
    """Weights 1 / standard deviation of each residual: of the force while open, of the share of it that no law
    explains, and of the displacement's noise, where the drift's knots do not follow it, times the stiffness."""
    unfollowed_m = np.hypot(record.eta_noise_m, 0.0 if record.drift is None else record.drift.noise_above_knot_band_m)
    unmodelled_n = record.unmodelled_share * np.hypot(record.force_n, np.std(record.force_n))
    return np.asarray(1 / np.sqrt(open_deviation_n**2 + (state.tangent_n_per_m * unfollowed_m) ** 2 + unmodelled_n**2))


FORMS_BESIDE_DEAD_ZONE: tuple[FormName, ...] = ("power law", "cannot pull")
LEAST_ODDS = 1000.0
CONSISTENCY_LIMIT = 3.0
MISFIT_CONFIDENCE = 0.99
BAND_COUNT, LOWEST_BAND_LINES = 24, 8
"""Number of bands, and lines in the lowest one: bands widen with frequency."""
LEAST_HALF_SAMPLES = 10 * PART_COUNT
"""Samples that either half of a split needs."""


def fit_of_chosen_form(fit: LawFit, form_names: Sequence[FormName]) -> LawFit:
    """Fit of the preferred form, settled; the fit of the dead zone if no form is preferred."""
    if not form_names:
        return fit
    base_form = LawForm(reference_depth_m=_rounded_rms_depth_m(fit), step_s=fit.state.form.step_s)
    if not base_form.reference_depth_m:
        return fit
    preferred_fit, least_square_sum = None, np.inf
    for name in form_names:
        try:
            alternative_fit = fit.with_form(replace(base_form, name=name)).minimum_cost_fit()
        except ContactRefusedError:
            continue
        if (
            is_preferred_form(fit, alternative_fit)
            and alternative_fit.squared_weighted_residuals.sum() < least_square_sum
        ):
            preferred_fit, least_square_sum = alternative_fit, float(alternative_fit.squared_weighted_residuals.sum())
    try:
        return preferred_fit.settled if preferred_fit else fit
    except ContactRefusedError:
        return fit


def is_preferred_form(dead_zone_fit: LawFit, alternative_fit: LawFit) -> bool:
    """True if the alternative form meets both criteria against the dead zone."""
    independent_count = max(2.0, dead_zone_fit.weights.size / dead_zone_fit.record.samples_per_error)
    likelihood_gain, consistency = likelihood_gain_and_consistency(dead_zone_fit, alternative_fit, independent_count)
    least_gain = alternative_fit.state.form.exponent_count * np.log(independent_count) + 2 * np.log(LEAST_ODDS)
    return bool(likelihood_gain > least_gain and consistency > CONSISTENCY_LIMIT)


def likelihood_gain_and_consistency(
    dead_zone_fit: LawFit, alternative_fit: LawFit, independent_count: float
) -> tuple[float, float]:
    """Left-hand sides of both criteria, the second divided by std_i(d_i) / sqrt(16)."""
    residual_spectra = [np.fft.rfft(fit.weights * fit.state.residual_n) for fit in (dead_zone_fit, alternative_fit)]
    line_count = residual_spectra[0].size
    band_edges = np.geomspace(LOWEST_BAND_LINES, line_count, BAND_COUNT + 1).astype(int)
    band_starts = np.unique(np.r_[0, band_edges[1:-1]])
    band_line_counts = np.diff(np.r_[band_starts, line_count])
    dead_zone_power, form_power = (np.add.reduceat(np.abs(spectrum) ** 2, band_starts) for spectrum in residual_spectra)
    if not np.all((dead_zone_power > 0) & (form_power > 0)):
        return 0.0, 0.0
    likelihood_gain = independent_count * float(band_line_counts @ np.log(dead_zone_power / form_power)) / line_count
    amplitude = np.repeat(np.sqrt(dead_zone_power / band_line_counts), band_line_counts)
    squares = [np.fft.irfft(spectrum / amplitude, dead_zone_fit.weights.size) ** 2 for spectrum in residual_spectra]
    part_gains = np.array([part_saving.sum() for part_saving in np.array_split(squares[0] - squares[1], PART_COUNT)])
    gain_error = float(part_gains.std(ddof=1)) / np.sqrt(PART_COUNT)
    return likelihood_gain, float(part_gains.mean()) / gain_error if gain_error > 0 else 0.0


def misfit_covariance(
    fit: LawFit, derivatives: Jacobian, part_starts: Int[np.ndarray, " parts"]
) -> Float[np.ndarray, "laws laws"]:
    """Covariance of a law's parameters from the misfit of its form.

    The closed samples are split in two ways: into deep and shallow ones, and into those of growing and of falling
    depth. Were the form right, the parameters by either half, all else as fitted, would differ by the record's scatter
    C alone, and with the difference D of f parameters T^2 = D' C^-1 D would follow Hotelling's distribution of 16
    parts. With its 99 % quantile T0^2, each split adds

        D D' / 4 max(0, 1 - T0^2 / T^2).
    """
    parameter_count = fit.state.law_parameters.size
    covariance = np.zeros((parameter_count, parameter_count))
    force_by_free = derivatives.by_law @ fit.scaled_to_laws
    for halves in _closed_splits(fit):
        first_scores, second_scores = (
            _parameter_change_by_segment(fit, force_by_free, half, part_starts) for half in halves
        )
        if first_scores is None or second_scores is None:
            continue
        free_difference, excess_share = halves_difference_and_t2_excess(first_scores - second_scores)
        law_error = fit.scaled_to_laws @ free_difference / 2
        covariance += excess_share * np.outer(law_error, law_error)
    return covariance


def halves_difference_and_t2_excess(
    score_differences: Float[np.ndarray, "parts free"],
) -> tuple[Float[np.ndarray, " free"], float]:
    """Difference D of the parameters by both halves of a split, and the excess max(0, 1 - T0^2 / T^2)."""
    part_count, parameter_count = score_differences.shape
    free_difference = score_differences.sum(axis=0)
    score_norms = np.maximum(np.sqrt(np.sum(score_differences**2, axis=0)), 1e-300)
    scaled_scatter = (score_differences - score_differences.mean(axis=0)) / score_norms
    scaled_covariance = part_count / (part_count - 1) * scaled_scatter.T @ scaled_scatter
    scaled_difference = free_difference / score_norms
    t_square = float(scaled_difference @ np.linalg.pinv(scaled_covariance, hermitian=True) @ scaled_difference)
    degrees_of_freedom = part_count - parameter_count
    f_quantile = float(f.ppf(MISFIT_CONFIDENCE, parameter_count, degrees_of_freedom))
    t_square_limit = parameter_count * (part_count - 1) / degrees_of_freedom * f_quantile
    return free_difference, max(0.0, 1 - t_square_limit / max(t_square, 1e-300))


def _closed_splits(fit: LawFit) -> list[tuple[Bool[np.ndarray, " fewer"], Bool[np.ndarray, " fewer"]]]:
    """Splits of the closed samples, as masks: (deep, shallow), and (growing depth, falling depth)."""
    record, state = fit.record, fit.state
    eta, rate = (record.at_force_samples(signal) for signal in fit.motion)
    depth_m, is_closed = fit.depth_m(eta), state.form.tangent_n_per_m(state.law_parameters, eta, rate) > 0
    is_deep = np.abs(depth_m) > np.median(np.abs(depth_m[is_closed])) if is_closed.any() else is_closed
    is_growing = depth_m * rate > 0
    return [(is_closed & is_deep, is_closed & ~is_deep), (is_closed & is_growing, is_closed & ~is_growing)]


def _parameter_change_by_segment(
    fit: LawFit,
    force_by_free: Float[np.ndarray, "fewer free"],
    is_in_half: Bool[np.ndarray, " fewer"],
    part_starts: Int[np.ndarray, " parts"],
) -> Float[np.ndarray, "parts free"] | None:
    """Change of the free parameters by these samples alone, part by part of the record; None if undetermined."""
    if is_in_half.sum() < LEAST_HALF_SAMPLES:
        return None
    squared_weights = np.where(is_in_half, fit.weights, 0.0)[:, None] ** 2
    normal_matrix = force_by_free.T @ (squared_weights * force_by_free)
    if not np.linalg.cond(normal_matrix) < 1e10:
        return None
    influence = squared_weights * force_by_free @ np.linalg.inv(normal_matrix)
    return cluster_scores(influence, fit.state.residual_n, part_starts)


def _rounded_rms_depth_m(fit: LawFit) -> float:
    """Root mean square of the depth while the contact is closed, m, rounded to 1, 2 or 5 times a power of ten, so that
    all records of a machine have the same."""
    depths_m = fit.depth_m(fit.motion[0])
    if not depths_m.any():
        return 0.0
    rms_depth_m = float(np.sqrt(np.mean(depths_m[depths_m != 0] ** 2)))
    power_of_ten = float(10 ** np.floor(np.log10(rms_depth_m)))
    rounded_depths_m = [mantissa * power_of_ten for mantissa in (1.0, 2.0, 5.0, 10.0)]
    return min(rounded_depths_m, key=lambda depth_m: abs(np.log(depth_m / rms_depth_m)))
