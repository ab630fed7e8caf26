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
from identify.contacts.law_form import FormName, LawForm, Touched
from identify.contacts.linearization import (
    BorderedEquations,
    Guess,
    Jacobian,
    Pulls,
    State,
    corrected_motion,
    jacobian,
    normal_equations,
    state_at,
)
from identify.contacts.refusals import ContactRefusedError, RefusalCode, refused
from identify.signals.drift import Spline
from identify.signals.gauss_newton import Step, gauss_newton
from identify.signals.refit import refit_until_settled
from identify.signals.scores import PARTS, part_scores

MOST_STEPS, WEIGHT_ROUNDS, COST_TOLERANCE = 30, 3, 1e-7
EXPONENT_STEP = 0.1

Weights = Float[np.ndarray, " fewer"]


@dataclass(frozen=True)
class LawFit:
    """Fit of a record: its final state and weights. `tie` maps the free parameters of a dead zone to the laws."""

    record: ContactRecord
    curve: Spline
    tie: Float[np.ndarray, "laws free"]
    state: State
    weights: Weights

    @property
    def squares(self) -> Float[np.ndarray, " fewer"]:
        """Squares of the weighted residuals."""
        return np.asarray((self.weights * self.state.residual) ** 2)

    @property
    def linearized(self) -> tuple[Jacobian, BorderedEquations, Float[np.ndarray, "numbers sizes"]]:
        """Jacobian and normal equations at the final state, and the matrix from their free parameters to the law."""
        to_law = _to_law(self.state, self.tie)
        derivatives = jacobian(self.record, self.curve, self.state)
        equations, *_ = normal_equations(self.record, self.state, derivatives, self.curve, to_law, self.weights)
        return derivatives, equations, to_law

    @property
    def settled(self) -> "LawFit":
        """Fit with weights renewed from the scatter of the residuals until they settle."""

        def refit(fit: LawFit) -> LawFit:
            state = _minimum(fit.record, fit.curve, fit.state, fit.tie, fit.weights)
            return replace(fit, state=state, weights=weights_of(fit.record, state, _scatter(state)))

        def weights_agree(before: LawFit, after: LawFit) -> bool:
            return np.allclose(after.weights, before.weights, rtol=0.1)

        first = replace(self, weights=weights_of(self.record, self.state, _scatter(self.state)))
        return refit_until_settled(first, refit, weights_agree, rounds=WEIGHT_ROUNDS)

    def with_form(self, form: LawForm) -> "LawFit":
        """Fit of another form with the same weights, from this state and an exponent of one."""
        contact_values = self.state.form.contacts(self.state.law_parameters).ravel()
        law_parameters = np.concatenate([contact_values, np.ones(form.shapes)])
        start = state_at(self.record, self.curve, form, law_parameters, self.state.knots, self.state.pulls)
        return replace(self, state=_minimum(self.record, self.curve, start, self.tie, self.weights))


def tie_of(touched: Touched, sides_known: bool) -> Float[np.ndarray, "laws free"]:
    """Matrix from the free parameters to the laws: stops that are not touched have none, nor has a spring. Where the
    zero of the relative displacement is unknown, it is the middle of the first contact's play."""
    free = np.column_stack([touched, np.ones_like(touched)]).ravel()
    tie = np.eye(free.size)[:, free]
    return tie if sides_known or not touched[0].any() else np.column_stack([tie[:, 0] + tie[:, 1], tie[:, 2:]])


def first_fit(
    record: ContactRecord,
    curve: Spline,
    tie: Float[np.ndarray, "laws free"],
    guesses: list[Guess],
    pulls: Pulls,
    form: LawForm,
) -> LawFit:
    """Fit of a dead zone or a spring: the best of the minima from each guess, with settled weights.

    Raises ContactRefusedError if no guess leads to a minimum.
    """
    rough_n = 0.02 * float(np.std(record.force_n))
    states, refusal = list[State](), refused(RefusalCode.NO_LAW)
    for law, knots in guesses:
        start = state_at(record, curve, form, law, knots, pulls)
        try:
            states.append(_minimum(record, curve, start, tie, weights_of(record, start, rough_n)))
        except ContactRefusedError as error:
            refusal = error
    if not states:
        raise refusal
    state = min(states, key=lambda state: float(np.sum(state.residual**2)))
    return LawFit(record, curve, tie, state, np.ones_like(state.residual)).settled


def _minimum(
    record: ContactRecord, curve: Spline, state: State, tie: Float[np.ndarray, "laws free"], weights: Weights
) -> State:
    """State of least cost for these weights, by Gauss-Newton."""

    def step_from(current: State) -> Step[State]:
        to_law = _to_law(current, tie)
        equations, *right_hand_side = normal_equations(
            record, current, jacobian(record, curve, current), curve, to_law, weights
        )
        knots, dense = equations.solved(*right_hand_side)

        def state_after(share: float) -> State | None:
            law = current.law_parameters + share * to_law @ dense[current.pulls.size :, 0]
            if not current.form.is_possible(law):
                return None
            pulls = current.pulls + share * dense[: current.pulls.size, 0]
            return _with_cost(
                record,
                curve,
                state_at(record, curve, current.form, law, current.knots + share * knots[:, 0], pulls),
                weights,
            )

        return Step(state_after, float(np.sum(right_hand_side[0] * knots) + np.sum(right_hand_side[1] * dense)))

    return gauss_newton(
        _with_cost(record, curve, state, weights), step_from, lambda current: COST_TOLERANCE * current.cost, MOST_STEPS
    )[0]


def _with_cost(record: ContactRecord, curve: Spline, state: State, weights: Weights) -> State:
    """State with its cost: weighted squares of residuals and of the priors."""
    prior = curve.curvature @ state.knots - curve.target
    squares = np.sum((weights * state.residual) ** 2) + np.sum(prior**2) + record.sample_ratio * np.sum(state.pulls**2)
    return replace(state, cost=float(squares))


def _to_law(state: State, tie: Float[np.ndarray, "laws free"]) -> Float[np.ndarray, "numbers sizes"]:
    """Matrix from the free parameters, scaled to condition the normal equations, to the law; an exponent is free."""
    lower, upper, stiffness, _ = state.form.contacts(state.law_parameters).T
    gap = np.maximum(np.minimum(lower, upper), 1e-9)
    sizes = np.stack([gap, gap, stiffness, 1e-3 * stiffness], axis=1).ravel()
    scaled = tie * np.max(tie * sizes[:, None], axis=0)
    return np.asarray(block_diag(scaled, EXPONENT_STEP * np.eye(state.form.shapes)) if state.form.shapes else scaled)


def _scatter(state: State) -> float:
    """Standard deviation of the residual while all stops are open; of the whole residual if they never are."""
    of_stops_n_per_m = np.abs(state.by_eta - state.springs_n_per_m)
    open_residual = state.residual[of_stops_n_per_m < 1e-3 * state.stiffness_n_per_m]
    return float(np.std(open_residual)) if np.any(open_residual) else float(np.std(state.residual))


def weights_of(record: ContactRecord, state: State, open_n: float) -> Weights:
    """Weights 1 / standard deviation of each residual: of the force while open, of the share of it that no law
    explains, and of the displacement's noise, where the drift's knots do not follow it, times the stiffness."""
    unfollowed_m = np.hypot(record.noise_m, 0.0 if record.drift is None else record.drift.unfollowed_m)
    unmodelled_n = record.unmodelled * np.hypot(record.force_n, np.std(record.force_n))
    return np.asarray(1 / np.sqrt(open_n**2 + (state.by_eta * unfollowed_m) ** 2 + unmodelled_n**2))


FORMS: tuple[FormName, ...] = ("power law", "cannot pull")
ODDS = 1000.0
CONSISTENCY_LIMIT = 3.0
CONFIDENCE = 0.99
BANDS, LOWEST_LINE = 24, 8
"""Number of bands, and lines in the lowest one: bands widen with frequency."""
LEAST_SAMPLES = 10 * PARTS
"""Samples that either half of a split needs."""


def chosen_form(fit: LawFit, names: Sequence[FormName]) -> LawFit:
    """Fit of the preferred form, settled; the fit of the dead zone if no form is preferred."""
    if not names:
        return fit
    form = LawForm(reference_depth_m=_typical_depth_m(fit))
    if not form.reference_depth_m:
        return fit
    chosen, least_squares = None, np.inf
    for name in names:
        try:
            alternative = fit.with_form(replace(form, name=name))
        except ContactRefusedError:
            continue
        if is_preferred(fit, alternative) and alternative.squares.sum() < least_squares:
            chosen, least_squares = alternative, float(alternative.squares.sum())
    try:
        return chosen.settled if chosen else fit
    except ContactRefusedError:
        return fit


def is_preferred(simple: LawFit, alternative: LawFit) -> bool:
    """True if the alternative form meets both criteria against the dead zone."""
    samples = max(2.0, simple.weights.size / simple.record.sample_ratio)
    likelihood_gain, consistency = evidence(simple, alternative, samples)
    return bool(
        likelihood_gain > alternative.state.form.shapes * np.log(samples) + 2 * np.log(ODDS)
        and consistency > CONSISTENCY_LIMIT
    )


def evidence(simple: LawFit, alternative: LawFit, samples: float) -> tuple[float, float]:
    """Left-hand sides of both criteria, the second divided by std_i(d_i) / sqrt(16)."""
    spectrum_before, spectrum_after = (np.fft.rfft(fit.weights * fit.state.residual) for fit in (simple, alternative))
    edges = np.geomspace(LOWEST_LINE, spectrum_before.size, BANDS + 1).astype(int)
    band_starts = np.unique(np.r_[0, edges[1:-1]])
    count = np.diff(np.r_[band_starts, spectrum_before.size])
    squares_before, squares_after = (
        np.add.reduceat(np.abs(spectrum) ** 2, band_starts) for spectrum in (spectrum_before, spectrum_after)
    )
    if not np.all((squares_before > 0) & (squares_after > 0)):
        return 0.0, 0.0
    likelihood_gain = samples * float(count @ np.log(squares_before / squares_after)) / spectrum_before.size
    usual_amplitude = np.repeat(np.sqrt(squares_before / count), count)
    squares = [
        np.fft.irfft(spectrum / usual_amplitude, simple.weights.size) ** 2
        for spectrum in (spectrum_before, spectrum_after)
    ]
    part_gains = np.array([segment.sum() for segment in np.array_split(squares[0] - squares[1], PARTS)])
    scatter = float(part_gains.std(ddof=1)) / np.sqrt(PARTS)
    return likelihood_gain, float(part_gains.mean()) / scatter if scatter > 0 else 0.0


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
    law_parameters = fit.state.law_parameters
    covariance = np.zeros((law_parameters.size, law_parameters.size))
    to_law = fit.linearized[2]
    for halves in _splits(fit):
        half_scores = [_half_scores(fit, derivatives.by_law @ to_law, samples, part_starts) for samples in halves]
        if any(scores is None for scores in half_scores):
            continue
        first, second = (scores for scores in half_scores if scores is not None)
        difference, excess = excess_of(first - second)
        law_error = to_law @ difference / 2
        covariance += excess * np.outer(law_error, law_error)
    return covariance


def excess_of(scores: Float[np.ndarray, "parts free"]) -> tuple[Float[np.ndarray, " free"], float]:
    """Sum D of the parts' scores of a split, and the excess max(0, 1 - T0^2 / T^2)."""
    count, free = scores.shape
    difference = scores.sum(axis=0)
    scale = np.maximum(np.sqrt(np.sum(scores**2, axis=0)), 1e-300)
    scatter = (scores - scores.mean(axis=0)) / scale
    covariance = count / (count - 1) * scatter.T @ scatter
    t_square = float((difference / scale) @ np.linalg.pinv(covariance, hermitian=True) @ (difference / scale))
    bound = free * (count - 1) / (count - free) * float(f.ppf(CONFIDENCE, free, count - free))
    return difference, max(0.0, 1 - bound / max(t_square, 1e-300))


def _splits(fit: LawFit) -> list[tuple[Bool[np.ndarray, " fewer"], Bool[np.ndarray, " fewer"]]]:
    """Splits of the closed samples, as masks: (deep, shallow), and (growing depth, falling depth)."""
    record, state = fit.record, fit.state
    eta, rate = (row[:: record.factor][: state.residual.size] for row in _motion(fit))
    depth = _depth_m(fit, eta)
    closed = state.form.slopes(state.law_parameters, eta, rate)[0] > 0
    deep = np.abs(depth) > np.median(np.abs(depth[closed])) if closed.any() else closed
    grows = depth * rate > 0
    return [(closed & deep, closed & ~deep), (closed & grows, closed & ~grows)]


def _half_scores(
    fit: LawFit,
    by_free: Float[np.ndarray, "fewer free"],
    samples: Bool[np.ndarray, " fewer"],
    part_starts: Int[np.ndarray, " parts"],
) -> Float[np.ndarray, "parts free"] | None:
    """Change of the free parameters by these samples alone, part by part of the record; None if undetermined."""
    if samples.sum() < LEAST_SAMPLES:
        return None
    weights = np.where(samples, fit.weights, 0.0)[:, None] ** 2
    normal = by_free.T @ (weights * by_free)
    if not np.linalg.cond(normal) < 1e10:
        return None
    influence = weights * by_free @ np.linalg.inv(normal)
    return part_scores(influence, fit.state.residual, part_starts)


def _typical_depth_m(fit: LawFit) -> float:
    """Root mean square of the depth while the contact is closed, m, rounded to 1, 2 or 5 times a power of ten, so that
    all records of a machine have the same."""
    depth = _depth_m(fit, _motion(fit)[0])
    if not depth.any():
        return 0.0
    typical_m = float(np.sqrt(np.mean(depth[depth != 0] ** 2)))
    power = float(10 ** np.floor(np.log10(typical_m)))
    return min(
        (round_number * power for round_number in (1.0, 2.0, 5.0, 10.0)), key=lambda d: abs(np.log(d / typical_m))
    )


def _motion(fit: LawFit) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    return corrected_motion(fit.record, fit.curve, fit.state.knots, fit.state.pulls)


def _depth_m(fit: LawFit, eta_m: Float[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
    lower, upper, _, _ = fit.state.form.contacts(fit.state.law_parameters)[0]
    return np.asarray(eta_m - np.clip(eta_m, -lower, upper))
