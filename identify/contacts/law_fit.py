"""The fit of one separated force by Gauss-Newton, with weights that the scatter left asks for."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from identify.contacts.contact_record import ContactRecord, Touched
from identify.contacts.initial_guess import Start
from identify.contacts.law_form import DEAD_ZONE, LawForm
from identify.contacts.linearization import Jacobian, Normal, Pulls, State, jacobian, normal_equations, state_at
from identify.contacts.refusals import ContactRefusedError, RefusalCode, refused
from identify.signals.descent import Step, descended
from identify.signals.drift import Spline
from identify.signals.refit import refit_until_settled

STEPS, ROUNDS, SETTLED = 30, 3, 1e-7
EXPONENT_STEP = 0.1

Weights = Float[np.ndarray, " fewer"]


@dataclass(frozen=True)
class LawFit:
    """A record, where its fit ended, and by what the residuals were weighed. tie are the laws by the free parameters of
    a dead zone."""

    record: ContactRecord
    curve: Spline
    tie: Float[np.ndarray, "laws free"]
    state: State
    weights: Weights

    @property
    def squares(self) -> Float[np.ndarray, " fewer"]:
        """Sum of squares of the weighted residuals."""
        return np.asarray((self.weights * self.state.residual) ** 2)

    @property
    def linearized(self) -> tuple[Jacobian, Normal, Float[np.ndarray, "numbers sizes"]]:
        """Derivatives at the end, the normal equations there, and the law by what they solve for."""
        to_law = _to_law(self.state, self.tie)
        derivatives = jacobian(self.record, self.curve, self.state)
        equations, *_ = normal_equations(self.record, self.state, derivatives, self.curve, to_law, self.weights)
        return derivatives, equations, to_law

    @property
    def settled(self) -> "LawFit":
        """The fit with the weights renewed from the scatter that is left, until they stand."""

        def refit(fit: LawFit) -> LawFit:
            state = _descended(fit.record, fit.curve, fit.state, fit.tie, fit.weights)
            return replace(fit, state=state, weights=weights_of(fit.record, state, _scatter(state)))

        def stand(before: LawFit, after: LawFit) -> bool:
            return np.allclose(after.weights, before.weights, rtol=0.1)

        first = replace(self, weights=weights_of(self.record, self.state, _scatter(self.state)))
        return refit_until_settled(first, refit, stand, rounds=ROUNDS)

    def by_form(self, form: LawForm) -> "LawFit":
        """The fit of another form with the same weights, from where this one ended: from an exponent of one."""
        numbers = self.state.form.contacts(self.state.law).ravel()
        law = np.concatenate([numbers, np.ones(form.shapes)])
        start = state_at(self.record, self.curve, form, law, self.state.knots, self.state.pulls)
        return replace(self, state=_descended(self.record, self.curve, start, self.tie, self.weights))


def tie_of(touched: Touched, sides_known: bool) -> Float[np.ndarray, "laws free"]:
    """The laws by their free parameters: without the stops that are not touched. Where nothing tells the zero of the
    relative displacement, it is in the middle of the first contact's play."""
    free = np.column_stack([touched, np.ones_like(touched)]).ravel()
    tie = np.eye(free.size)[:, free]
    return tie if sides_known else np.column_stack([tie[:, 0] + tie[:, 1], tie[:, 2:]])


def fitted(
    record: ContactRecord, curve: Spline, tie: Float[np.ndarray, "laws free"], starts: list[Start], pulls: Pulls
) -> LawFit:
    """A dead zone by descents from each start, the best of which settles.

    Raises ContactRefusedError if no start leads anywhere.
    """
    rough_n = 0.02 * float(np.std(record.force_n))
    ends, why = list[State](), refused(RefusalCode.NO_LAW)
    for law, knots in starts:
        start = state_at(record, curve, DEAD_ZONE, law, knots, pulls)
        try:
            ends.append(_descended(record, curve, start, tie, weights_of(record, start, rough_n)))
        except ContactRefusedError as error:
            why = error
    if not ends:
        raise why
    state = min(ends, key=lambda end: float(np.sum(end.residual**2)))
    return LawFit(record, curve, tie, state, np.ones_like(state.residual)).settled


def _descended(
    record: ContactRecord, curve: Spline, state: State, tie: Float[np.ndarray, "laws free"], weights: Weights
) -> State:
    """The state of least cost under some weights."""

    def step_from(at: State) -> Step[State]:
        to_law = _to_law(at, tie)
        equations, *down = normal_equations(record, at, jacobian(record, curve, at), curve, to_law, weights)
        knots, others = equations.solved(*down)

        def after(share: float) -> State | None:
            law = at.law + share * to_law @ others[at.pulls.size :, 0]
            if not at.form.is_possible(law):
                return None
            pulls = at.pulls + share * others[: at.pulls.size, 0]
            return _weighed(
                record, curve, state_at(record, curve, at.form, law, at.knots + share * knots[:, 0], pulls), weights
            )

        return Step(after, float(np.sum(down[0] * knots) + np.sum(down[1] * others)))

    return descended(_weighed(record, curve, state, weights), step_from, lambda at: SETTLED * at.cost, STEPS)[0]


def _weighed(record: ContactRecord, curve: Spline, state: State, weights: Weights) -> State:
    """The state with its cost."""
    prior = curve.curvature @ state.knots - curve.target
    squares = np.sum((weights * state.residual) ** 2) + np.sum(prior**2) + record.sample_ratio * np.sum(state.pulls**2)
    return replace(state, cost=float(squares))


def _to_law(state: State, tie: Float[np.ndarray, "laws free"]) -> Float[np.ndarray, "numbers sizes"]:
    """The law by its free parameters, of sizes that condition the normal equations well; an exponent is free."""
    lower, upper, stiffness, _ = state.form.contacts(state.law).T
    gap = np.maximum(np.minimum(lower, upper), 1e-9)
    sizes = np.stack([gap, gap, stiffness, 1e-3 * stiffness], axis=1).ravel()
    scaled = tie * np.max(tie * sizes[:, None], axis=0)
    return np.asarray(block_diag(scaled, EXPONENT_STEP * np.eye(state.form.shapes)) if state.form.shapes else scaled)


def _scatter(state: State) -> float:
    """Standard deviation of the residual while the contact is open; of all of it where that is larger."""
    free = state.residual[np.abs(state.by_eta) < 1e-3 * state.stiffness_n_per_m]
    return float(np.std(free)) if np.any(free) else float(np.std(state.residual))


def weights_of(record: ContactRecord, state: State, open_n: float) -> Weights:
    """One over the standard deviation of each residual: that of the force, the share of it that no law explains, and
    what the relative displacement's noise, where the drift's knots do not follow it, does through the stiffness."""
    fast_m = 0.0 if record.drift is None else record.drift.unfollowed_m
    unmodelled_n = record.unmodelled * np.hypot(record.force_n, np.std(record.force_n))
    return np.asarray(1 / np.sqrt(open_n**2 + (state.by_eta * fast_m) ** 2 + unmodelled_n**2))
