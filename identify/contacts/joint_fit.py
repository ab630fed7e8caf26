"""Clearances, stiffness and damping of one contact, or of several that share a relative displacement, its slow drift,
and the tolerances of rig.json, together: Gauss-Newton, with weights that the scatter left asks for."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, t

from identify.contacts.contact_record import (
    LAW,
    LEAST_CLOSED,
    STIFFNESS,
    Believed,
    ContactRecord,
    Law,
    Touched,
    clearly_closed,
)
from identify.contacts.initial_guess import Start, contact_alone, first_pulls, starts
from identify.contacts.linearization import Pulls, State, drift_of, jacobian, normal_equations, state_at
from identify.contacts.refusals import ContactRefusedError, RefusalCode, refused
from identify.pages.wording import COVERED
from identify.signals.descent import Step, descended
from identify.signals.drift import Spline, spline
from identify.signals.refit import refit_until_settled
from identify.signals.scores import PARTS, part_scores

MOST_PULL = 25.0
"""A drift whose curvature is on average more than the root of this away from what was measured is no drift."""
LOST = 3.0
"""If between two closures the noise, integrated twice, wanders by more than this multiple of the median penetration,
the fit cannot tell which closure belongs where."""
PAUSES = 0.05
"""So large a share of the times between closures, the longest ones, may be longer: a pause parts the record in two."""
STEPS, ROUNDS, SETTLED = 30, 3, 1e-7

Weights = Float[np.ndarray, " fewer"]


@dataclass(frozen=True)
class JointEstimate:
    """The estimate: values of the parameters of `LAW`, with covariance.

    of_tolerances and of_drift are the parts of the covariance that come from what rig.json may have wrong and from the
    slow motion that accelerometers miss; the rest is the record's own scatter. sides_known says whether lower and upper
    are told apart, touched which of them the record tells. drift_m and drift_m_per_s are what was added to the relative
    displacement and velocity. pulls are the nuisance parameters in their standard deviations. unexplained is the share
    of the contact force's root mean square that the fit leaves, halves by how many standard errors the clearance and
    the stiffness of the record's halves differ.
    """

    values: Law
    covariance: Float[np.ndarray, "4 4"]
    of_tolerances: Float[np.ndarray, "4 4"]
    of_drift: Float[np.ndarray, "4 4"]
    sides_known: bool
    touched: tuple[bool, bool]
    drift_m: Float[np.ndarray, " samples"]
    drift_m_per_s: Float[np.ndarray, " samples"]
    pulls: Float[np.ndarray, " nuisances"]
    unexplained: float = 0.0
    halves: tuple[float, float] = (0.0, 0.0)

    @property
    def clearance(self) -> Law:
        """As a linear function of the parameters: half the total play, or the clearance of the one stop touched."""
        return _clearance(self.touched)

    @property
    def clearance_m(self) -> float:
        return float(self.clearance @ self.values)

    @property
    def clearance_error_m(self) -> float:
        return self.error(self.clearance)

    @property
    def stiffness_n_per_m(self) -> float:
        return float(STIFFNESS @ self.values)

    @property
    def errors(self) -> Law:
        """The standard error of every parameter."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def error(self, of: Law) -> float:
        """The standard error of a linear function of the parameters, such as `STIFFNESS`."""
        return float(np.sqrt(of @ self.covariance @ of))

    def own_error(self, of: Law) -> float:
        """The part of it that another record does not repeat."""
        return float(np.sqrt(of @ (self.covariance - self.of_tolerances) @ of))

    @property
    def reversed(self) -> "JointEstimate":
        """Of the contact counted the other way round."""
        swapped = np.eye(len(LAW))[[1, 0, 2, 3]]
        lower, upper = self.touched
        return replace(
            self,
            values=swapped @ self.values,
            covariance=swapped @ self.covariance @ swapped,
            of_tolerances=swapped @ self.of_tolerances @ swapped,
            of_drift=swapped @ self.of_drift @ swapped,
            touched=(upper, lower),
            drift_m=-self.drift_m,
            drift_m_per_s=-self.drift_m_per_s,
        )


def _clearance(touched: tuple[bool, bool]) -> Law:
    lower, upper = np.array(touched) / sum(touched)
    return LAW.vector({"lower_clearance_m": lower, "upper_clearance_m": upper})


def _tie(touched: Touched, sides_known: bool) -> Float[np.ndarray, "laws free"]:
    """The laws by their free parameters: without the stops that are not touched. Where nothing tells the zero of the
    relative displacement, it is in the middle of the first contact's play."""
    free = np.column_stack([touched, np.ones_like(touched)]).ravel()
    tie = np.eye(free.size)[:, free]
    return tie if sides_known else np.column_stack([tie[:, 0] + tie[:, 1], tie[:, 2:]])


def fit_joint(record: ContactRecord, believed: Believed, touched: Touched) -> tuple[JointEstimate, ...]:
    """Of every contact that is believed, by one fit.

    Gauss-Newton on the low-passed residual, with a cubic spline b(t) for the drift, a spring to the ground, and
    nuisance parameters theta with a prior of one:

        residual = (force - theta' nuisance_n
                    - low-pass[sum of k dz(eta + h b - theta' nuisance_m; lower, upper) + c (eta' + h b') beyond the
                    gap, over the contacts]) / g
                   - spring b - damper b',  g = 1 - theta' noise_in_n, h = 1 - theta' noise_in_m

    b'' is held to what the accelerometers saw of it, within their noise. Where nothing holds the zero of the relative
    displacement, lower = upper = half the total play. g and h keep gains from being fitted to the noise, which
    shrinks as the signals do. It begins at a linear regression of eta on the force over the samples at which the
    contact is clearly closed (`starts`).

    The covariance is a sandwich estimate over sixteenths of the record (residuals may be coloured), plus what an error
    of one in each row of the priors does; it holds whatever the residuals were weighed by.

    Raises ContactRefusedError if the contact is hardly ever closed, the fit does not converge, or several cannot be
    told apart.
    """
    curve = spline(record.eta_m.size, record.sample_rate_hz, record.drift)
    tie, first = _tie(touched, record.sides_known), first_pulls(record)
    begun = starts(contact_alone(record, first), curve, believed, touched)
    state, weights = fitted(record, curve, tie, begun, first)
    if _curvature_pull(curve, state) > MOST_PULL:
        raise refused(RefusalCode.DRIFT_TOO_LARGE)
    _check_bridged(record, state)
    to_law = tie * scales(state, tie)
    derivatives = jacobian(record, curve, state)
    equations, *_ = normal_equations(record, state, derivatives, curve, to_law, weights)
    pulls, free = state.pulls.size, tie.shape[1]
    by_knots, by_others = equations.solved(np.zeros((curve.knots, free)), np.eye(pulls + free, free, -pulls))
    in_law = np.concatenate([by_others[:pulls], to_law @ by_others[pulls:]])
    influence = derivatives.times(by_knots, in_law) * weights[:, None] ** 2  # of residuals on parameters
    left = PARTS - free  # parts are few: Student's t, so that 1.96 standard errors cover 95 %
    few = np.sqrt(PARTS / left) * t.ppf(0.975, left) / norm.ppf(0.975)
    by_parts = part_scores(influence, state.residual)
    of_rows = (
        few * by_parts,
        record.sample_ratio * by_others[:pulls],
        curve.curvature @ by_knots,
    )
    of_scatter, of_tolerances, of_drift = (to_law @ (x.T @ x) @ to_law.T for x in of_rows)
    covariance = of_scatter + of_tolerances + of_drift
    drift_m, drift_m_per_s = drift_of(record, curve, state.knots, state.pulls)
    if len(touched) > 1:
        _check_separable(state.law, covariance, touched, record.eta_m + drift_m)

    def joint(first: int, lower: bool, upper: bool) -> JointEstimate:
        own = slice(first, first + len(LAW))
        return JointEstimate(
            values=state.law[own],
            covariance=covariance[own, own],
            of_tolerances=of_tolerances[own, own],
            of_drift=of_drift[own, own],
            sides_known=record.sides_known,
            touched=(lower, upper),
            drift_m=drift_m,
            drift_m_per_s=drift_m_per_s,
            pulls=state.pulls,
            unexplained=float(np.std(state.residual) / np.std(record.force_n)),
            halves=_halves(by_parts @ to_law[own].T, (_clearance((lower, upper)), STIFFNESS)),
        )

    return tuple(joint(len(LAW) * i, *sides) for i, sides in enumerate(touched.tolist()))


def _halves(by_parts: Float[np.ndarray, "parts 4"], of: tuple[Law, Law]) -> tuple[float, float]:
    """What the parts of the first half do to estimates less what those of the second do, over their scatter."""
    told = by_parts @ np.stack(of, axis=1)
    scatter = np.maximum(np.sqrt(np.sum(told**2, axis=0)), 1e-300)
    first, second = told[: len(told) // 2].sum(axis=0), told[len(told) // 2 :].sum(axis=0)
    clearance, stiffness = (first - second) / scatter
    return float(clearance), float(stiffness)


def _curvature_pull(curve: Spline, state: State) -> float:
    """Mean square of the drift's curvature less what was measured of it, in its standard deviations; about 1 to 2."""
    return float(np.mean((curve.curvature @ state.knots - curve.target) ** 2)) if curve.knots else 0.0


def _check_bridged(record: ContactRecord, state: State) -> None:
    """Raises ContactRefusedError if between closures the integrated noise wanders too far for them to be put in their
    places."""
    if record.drift is None or record.drift.spring_n_per_m > 0:
        return
    closed = clearly_closed(record)
    between_s = np.diff(np.flatnonzero(np.diff(closed.astype(int)) == 1)) * record.factor / record.sample_rate_hz
    between_s = np.sort(between_s)[: round((1 - PAUSES) * between_s.size)]
    wander_m = record.drift.noise_density * np.sqrt(np.mean(between_s**3) / 6) if between_s.size else np.inf
    depth_m = float(np.median(np.abs(record.force_n[closed]))) / state.stiffness_n_per_m
    if wander_m > LOST * depth_m:
        raise refused(RefusalCode.DRIFT_NOT_BRIDGED, wander_um=float(1e6 * wander_m), penetration_um=1e6 * depth_m)


def _check_separable(
    law: Law, covariance: Float[np.ndarray, "laws laws"], touched: Touched, eta_m: Float[np.ndarray, " samples"]
) -> None:
    """Raises ContactRefusedError if a stop is hardly ever reached, or two knees are no further apart than their 95 %
    interval."""
    laws = law.reshape(-1, len(LAW))
    for side, sign in enumerate((-1, 1)):
        mine = np.flatnonzero(touched[:, side])
        if any(np.mean(sign * eta_m > laws[i, side]) < LEAST_CLOSED for i in mine):
            raise refused(RefusalCode.NOT_SEPARABLE)
        for i, j in combinations(mine, 2):
            apart = np.zeros_like(law)
            apart[[len(LAW) * i + side, len(LAW) * j + side]] = 1, -1
            if abs(apart @ law) < COVERED * np.sqrt(apart @ covariance @ apart):
                raise refused(RefusalCode.NOT_SEPARABLE)


def fitted(
    record: ContactRecord, curve: Spline, tie: Float[np.ndarray, "laws free"], begun: list[Start], pulls: Pulls
) -> tuple[State, Weights]:
    """Descends from each start, and from the best again with the weights renewed from the scatter that is left, until
    they stand.

    Raises ContactRefusedError if no start leads anywhere.
    """
    rough_n = 0.02 * float(np.std(record.force_n))
    ends, why = list[State](), refused(RefusalCode.NO_LAW)
    for law, knots in begun:
        start = state_at(record, curve, law, knots, pulls)
        try:
            ends.append(_descended(record, curve, start, tie, weights_of(record, start, rough_n)))
        except ContactRefusedError as error:
            why = error
    if not ends:
        raise why
    state = min(ends, key=lambda end: float(np.sum(end.residual**2)))

    def refit(estimate: tuple[State, Weights]) -> tuple[State, Weights]:
        state = _descended(record, curve, estimate[0], tie, estimate[1])
        return state, weights_of(record, state, _scatter(state))

    def settled(before: tuple[State, Weights], after: tuple[State, Weights]) -> bool:
        return np.allclose(after[1], before[1], rtol=0.1)

    return refit_until_settled((state, weights_of(record, state, _scatter(state))), refit, settled, rounds=ROUNDS)


def _descended(
    record: ContactRecord, curve: Spline, state: State, tie: Float[np.ndarray, "laws free"], weights: Weights
) -> State:
    """The state of least cost under some weights."""

    def step_from(at: State) -> Step[State]:
        to_law = tie * scales(at, tie)
        equations, *down = normal_equations(record, at, jacobian(record, curve, at), curve, to_law, weights)
        knots, others = equations.solved(*down)

        def after(share: float) -> State | None:
            law = at.law + share * to_law @ others[at.pulls.size :, 0]
            laws = law.reshape(-1, len(LAW))
            if np.any(laws < LAW.bounds[0]) or not np.all(laws @ STIFFNESS):
                return None
            pulls = at.pulls + share * others[: at.pulls.size, 0]
            return _weighed(record, curve, state_at(record, curve, law, at.knots + share * knots[:, 0], pulls), weights)

        return Step(after, float(np.sum(down[0] * knots) + np.sum(down[1] * others)))

    return descended(_weighed(record, curve, state, weights), step_from, lambda at: SETTLED * at.cost, STEPS)[0]


def _weighed(record: ContactRecord, curve: Spline, state: State, weights: Weights) -> State:
    """With its cost."""
    prior = curve.curvature @ state.knots - curve.target
    squares = np.sum((weights * state.residual) ** 2) + np.sum(prior**2) + record.sample_ratio * np.sum(state.pulls**2)
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


def weights_of(record: ContactRecord, state: State, open_n: float) -> Weights:
    """One over the standard deviation of each residual: that of the force, the share of it that no law explains, and
    what the relative displacement's noise, where the drift's knots do not follow it, does through the stiffness."""
    fast_m = 0.0 if record.drift is None else record.drift.unfollowed_m
    unmodelled_n = record.unmodelled * np.hypot(record.force_n, np.std(record.force_n))
    return np.asarray(1 / np.sqrt(open_n**2 + (state.by_eta * fast_m) ** 2 + unmodelled_n**2))
