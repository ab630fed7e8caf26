"""Gauss-Newton for one force: by steps from the normal equations, with weights that the scatter left asks for."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from identify.contacts.linearised import Pulls, State, jacobian, state_at
from identify.contacts.normal_equations import NO_LAW, normal_equations
from identify.contacts.start import LAW, STIFFNESS, ContactRecord, Start
from identify.signals.descent import Step, descended
from identify.signals.drift import Spline
from identify.signals.refit import refit_until_settled
from rig.errors import RigError

STEPS, ROUNDS, SETTLED = 30, 3, 1e-7

Weights = Float[np.ndarray, " fewer"]


def fitted(
    seen: ContactRecord, curve: Spline, tie: Float[np.ndarray, "laws free"], begun: list[Start], pulls: Pulls
) -> tuple[State, Weights]:
    """Descends from each start, and from the best again with the weights renewed from the scatter that is left, until
    they stand.

    Raises RigError if no start leads anywhere.
    """
    rough_n = 0.02 * float(np.std(seen.force_n))
    ends, why = list[State](), RigError(NO_LAW)
    for law, knots in begun:
        start = state_at(seen, curve, law, knots, pulls)
        try:
            ends.append(_descended(seen, curve, start, tie, weights_of(seen, start, rough_n)))
        except RigError as error:
            why = error
    if not ends:
        raise why
    state = min(ends, key=lambda end: float(np.sum(end.residual**2)))

    def refit(estimate: tuple[State, Weights]) -> tuple[State, Weights]:
        state = _descended(seen, curve, estimate[0], tie, estimate[1])
        return state, weights_of(seen, state, _scatter(state))

    def settled(before: tuple[State, Weights], after: tuple[State, Weights]) -> bool:
        return np.allclose(after[1], before[1], rtol=0.1)

    return refit_until_settled((state, weights_of(seen, state, _scatter(state))), refit, settled, rounds=ROUNDS)


def _descended(
    seen: ContactRecord, curve: Spline, state: State, tie: Float[np.ndarray, "laws free"], weights: Weights
) -> State:
    """The state of least cost under some weights."""

    def step_from(at: State) -> Step[State]:
        to_law = tie * scales(at, tie)
        equations, *down = normal_equations(seen, at, jacobian(seen, curve, at), curve, to_law, weights)
        knots, others = equations.solved(*down)

        def after(share: float) -> State | None:
            law = at.law + share * to_law @ others[at.pulls.size :, 0]
            laws = law.reshape(-1, len(LAW))
            if np.any(laws < LAW.bounds[0]) or not np.all(laws @ STIFFNESS):
                return None
            pulls = at.pulls + share * others[: at.pulls.size, 0]
            return _weighed(seen, curve, state_at(seen, curve, law, at.knots + share * knots[:, 0], pulls), weights)

        return Step(after, float(np.sum(down[0] * knots) + np.sum(down[1] * others)))

    return descended(_weighed(seen, curve, state, weights), step_from, lambda at: SETTLED * at.cost, STEPS)[0]


def _weighed(seen: ContactRecord, curve: Spline, state: State, weights: Weights) -> State:
    """With its cost."""
    prior = curve.curvature @ state.knots - curve.target
    squares = np.sum((weights * state.residual) ** 2) + np.sum(prior**2) + seen.sample_ratio * np.sum(state.pulls**2)
    return replace(state, cost=float(squares))


def scales(state: State, tie: Float[np.ndarray, "laws free"]) -> Float[np.ndarray, " free"]:
    """Sizes of the free parameters, so that the normal equations are well conditioned."""
    lower, upper, stiffness, _ = state.law.reshape(-1, len(LAW)).T
    gap = np.maximum(np.minimum(lower, upper), 1e-9)
    sizes = np.stack([gap, gap, stiffness, 1e-3 * stiffness], axis=1)
    return np.asarray(np.max(tie * sizes.reshape(-1, 1), axis=0))


def _scatter(state: State) -> float:
    """Standard deviation of the residual while the contact is open; of all of it where that is larger."""
    free = state.residual[np.abs(state.by_eta) < 1e-3 * state.stiffness_n_per_m]
    return float(np.std(free)) if np.any(free) else float(np.std(state.residual))


def weights_of(seen: ContactRecord, state: State, open_n: float) -> Weights:
    """One over the standard deviation of each residual: that of the force, the share of it that no law explains, and
    what the relative displacement's noise, where the drift's knots do not follow it, does through the stiffness."""
    fast_m = 0.0 if seen.drift is None else seen.drift.unfollowed_m
    unmodelled_n = seen.unmodelled * np.hypot(seen.force_n, np.std(seen.force_n))
    return np.asarray(1 / np.sqrt(open_n**2 + (state.by_eta * fast_m) ** 2 + unmodelled_n**2))
