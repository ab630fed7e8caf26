"""Clearances, stiffness and damping of one contact, the slow drift of its relative displacement, and the tolerances
of rig.json, together."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.sparse import block_array, csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import SuperLU, splu
from scipy.stats import norm, t

from identify.contacts.start import LAW, STIFFNESS, ContactRecord, Law, clearly_closed, regressed, touched_stops
from identify.signals.descent import Step, descended
from identify.signals.drift import Spline, spline
from identify.signals.finely import finely
from identify.signals.scores import PARTS, part_scores
from identify.signals.spectra import decimated
from rig.errors import RigError
from rig.model.contact_laws import DeadZone

STEPS, ROUNDS, SETTLED = 30, 3, 1e-7
FINE_HZ = 16384.0
"""The contact force is evaluated at this rate at least, so that its kinks do not alias."""
MOST_PULL = 25.0
"""A drift whose curvature is on average more than the root of this away from what was measured is no drift."""
LOST = 3.0
"""If between two closures the noise, integrated twice, wanders by more than this multiple of the median penetration,
the fit cannot tell which closure belongs where."""
PAUSES = 0.05
"""So large a share of the times between closures, the longest ones, may be longer: a pause parts the record in two."""

Weights = Float[np.ndarray, " fewer"]


@dataclass(frozen=True)
class Joint:
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


def _clearance(touched: tuple[bool, bool]) -> Law:
    lower, upper = np.array(touched) / sum(touched)
    return LAW.vector({"lower_clearance_m": lower, "upper_clearance_m": upper})


def law_force_n(
    law: Law, eta_m: Float[np.ndarray, "*samples"], rate_m_per_s: Float[np.ndarray, "*samples"]
) -> Float[np.ndarray, "*samples"]:
    """Stiffness and damping times what a `DeadZone` makes of one of each; the damping may have any sign."""
    _, _, stiffness, damping = law
    by_stiffness, by_damping = _by_stiffness_and_damping(law, eta_m, rate_m_per_s)
    return np.asarray(stiffness * by_stiffness + damping * by_damping)


def _by_stiffness_and_damping(
    law: Law, eta_m: Float[np.ndarray, "*samples"], rate: Float[np.ndarray, "*samples"]
) -> tuple[Float[np.ndarray, "*samples"], Float[np.ndarray, "*samples"]]:
    lower, upper, _, _ = law.tolist()
    spring, damper = (
        DeadZone(lower_clearance_m=lower, upper_clearance_m=upper, stiffness_n_per_m=k, damping_n_s_per_m=c)
        for k, c in ((1.0, 0.0), (0.0, 1.0))
    )
    return spring.force_n(eta_m), damper.force_n(eta_m, rate)


def fit_joint(seen: ContactRecord) -> Joint:
    """Gauss-Newton on the low-passed residual, with a cubic spline b(t) for the drift, a spring to the ground, and
    nuisance parameters theta with a prior of one:

        residual = (force - theta' nuisance_n
                    - low-pass[k dz(eta + h b - theta' nuisance_m; lower, upper) + c (eta' + h b') beyond the gap]) / g
                   - spring b - damper b',  g = 1 - theta' noise_in_n, h = 1 - theta' noise_in_m

    b'' is held to what the accelerometers saw of it, within their noise. Where nothing holds the zero of the relative
    displacement, lower = upper = half the total play. g and h keep gains from being fitted to the noise, which
    shrinks as the signals do. The start is a linear regression of eta on the force over the samples at which the
    contact is clearly closed.

    The covariance is a sandwich estimate over sixteenths of the record (residuals may be coloured), plus what an error
    of one in each row of the priors does; it holds whatever the residuals were weighed by.

    Raises RigError if the contact is hardly ever closed or the fit does not converge.
    """
    curve = spline(seen.eta_m.size, seen.sample_rate_hz, seen.drift)
    touched = touched_stops(seen)
    tie = np.eye(len(LAW))[:, [*touched, True, True]]
    if not seen.sides_known:
        tie = np.column_stack([2 * _clearance(touched), tie[:, 2:]])
    law, knots = regressed(seen, curve)
    none = np.zeros(len(seen.nuisance_n))
    begun = (knots, np.zeros_like(knots)) if curve.knots else (knots,)  # rarely, the regression's drift leads astray
    state, weights = _fitted(seen, curve, tie, [_linearised(seen, curve, law, begin, none) for begin in begun])
    if _curvature_pull(curve, state) > MOST_PULL:
        raise RigError(
            "the drift that would explain it is larger than the noise of the accelerometers allows; check their noise "
            "and gains, or excite the rig more strongly"
        )
    _check_bridged(seen, state)
    to_law = tie * _scales(state, tie)
    hessian, _ = _normal(seen, state, curve, to_law, weights)
    free, pulls = tie.shape[1], slice(curve.knots, curve.knots + state.pulls.size)
    inverse = _factorised(hessian).solve(np.eye(hessian.shape[0], free, -pulls.stop))
    by_knots, by_others = _jacobian(state, to_law)
    fitted = by_knots @ inverse[: curve.knots] + by_others @ inverse[curve.knots :]
    influence = fitted * weights[:, None] ** 2  # of residuals on parameters
    left = PARTS - free  # parts are few: Student's t, so that 1.96 standard errors cover 95 %
    few = np.sqrt(PARTS / left) * t.ppf(0.975, left) / norm.ppf(0.975)
    by_parts = part_scores(influence, state.residual)
    of_rows = (
        few * by_parts,
        seen.sample_ratio * inverse[pulls],
        curve.curvature @ inverse[: curve.knots],
    )
    of_scatter, of_tolerances, of_drift = (to_law @ (x.T @ x) @ to_law.T for x in of_rows)
    drift_m, drift_m_per_s = _drift(seen, curve, state.knots, state.pulls)
    return Joint(
        values=state.law,
        covariance=of_scatter + of_tolerances + of_drift,
        of_tolerances=of_tolerances,
        of_drift=of_drift,
        sides_known=seen.sides_known,
        touched=touched,
        drift_m=drift_m,
        drift_m_per_s=drift_m_per_s,
        pulls=state.pulls,
        unexplained=float(np.std(state.residual) / np.std(seen.force_n)),
        halves=_halves(by_parts @ to_law.T, (_clearance(touched), STIFFNESS)),
    )


def _halves(by_parts: Float[np.ndarray, "parts 4"], of: tuple[Law, Law]) -> tuple[float, float]:
    """What the parts of the first half do to estimates less what those of the second do, over their scatter."""
    told = by_parts @ np.stack(of, axis=1)
    scatter = np.maximum(np.sqrt(np.sum(told**2, axis=0)), 1e-300)
    first, second = told[: len(told) // 2].sum(axis=0), told[len(told) // 2 :].sum(axis=0)
    clearance, stiffness = (first - second) / scatter
    return float(clearance), float(stiffness)


@dataclass(frozen=True)
class _State:
    law: Law
    knots: Float[np.ndarray, " knots"]
    pulls: Float[np.ndarray, " nuisances"]
    residual: Float[np.ndarray, " fewer"]
    by_law: Float[np.ndarray, "fewer 4"]
    by_pulls: Float[np.ndarray, "fewer nuisances"]
    by_eta: Float[np.ndarray, " fewer"]
    by_knots: csr_matrix

    @property
    def stiffness_n_per_m(self) -> float:
        return float(STIFFNESS @ self.law)


def _curvature_pull(curve: Spline, state: _State) -> float:
    """Mean square of the drift's curvature less what was measured of it, in its standard deviations; about 1 to 2."""
    return float(np.mean((curve.curvature @ state.knots - curve.target) ** 2)) if curve.knots else 0.0


def _check_bridged(seen: ContactRecord, state: _State) -> None:
    """Raises RigError if between closures the integrated noise wanders too far for them to be put in their places."""
    if seen.drift is None or seen.drift.spring_n_per_m > 0:
        return
    closed = clearly_closed(seen)
    between_s = np.diff(np.flatnonzero(np.diff(closed.astype(int)) == 1)) * seen.factor / seen.sample_rate_hz
    between_s = np.sort(between_s)[: round((1 - PAUSES) * between_s.size)]
    wander_m = seen.drift.noise_density * np.sqrt(np.mean(between_s**3) / 6) if between_s.size else np.inf
    depth_m = float(np.median(np.abs(seen.force_n[closed]))) / state.stiffness_n_per_m
    if wander_m > LOST * depth_m:
        raise RigError(
            "it closes too rarely for accelerometers to bridge the time between (their noise wanders by "
            f"{1e6 * wander_m:.0f} um, the penetration is {1e6 * depth_m:.0f} um); excite the rig more strongly, or "
            "measure displacements"
        )


def _linearised(
    seen: ContactRecord,
    curve: Spline,
    law: Law,
    knots: Float[np.ndarray, " knots"],
    pulls: Float[np.ndarray, " nuisances"],
) -> _State:
    lower, upper, stiffness, damping = law
    drift, drift_rate = _drift(seen, curve, knots, pulls)
    eta, velocity = seen.eta_m + drift, seen.velocity_m_per_s + drift_rate
    above, below = eta > upper, eta < -lower
    outside = (above | below).astype(float)
    by_stiffness, by_damping = _by_stiffness_and_damping(law, eta, velocity)
    parts = np.stack([stiffness * below, -stiffness * above, by_stiffness, by_damping, stiffness * outside])
    *by_law, tangent = decimated(parts, seen.factor)[:, : seen.force_n.size]
    fine = max(1, round(FINE_HZ / seen.sample_rate_hz))
    fitted = finely(partial(law_force_n, law), np.stack([eta, velocity]), fine)
    fitted = decimated(fitted, seen.factor)[: seen.force_n.size]
    at_force = curve.value[:: seen.factor][: seen.force_n.size]
    held = seen.spring_n_per_m * at_force + seen.damper_n_s_per_m * curve.rate[:: seen.factor][: seen.force_n.size]
    kept, drift_kept = 1 - pulls @ seen.noise_in_n, 1 - pulls[seen.moving] @ seen.noise_in_m
    fast = (seen.force_n - pulls @ seen.nuisance_n - fitted) / kept
    by_drift = diags(tangent) @ at_force
    by_pulls = seen.nuisance_n.T - np.outer(fast, seen.noise_in_n).astype(np.float32)
    moved = outside * (stiffness * seen.nuisance_m + damping * seen.nuisance_m_per_s)
    by_pulls[:, seen.moving] -= decimated(moved, seen.factor)[:, : seen.force_n.size].T
    by_pulls[:, seen.moving] -= np.outer(by_drift @ knots, seen.noise_in_m)
    return _State(
        law=law,
        knots=knots,
        pulls=pulls,
        residual=fast - held @ knots,
        by_law=np.stack(by_law, axis=1) / kept,
        by_pulls=by_pulls / np.float32(kept),
        by_eta=tangent,
        by_knots=drift_kept / kept * by_drift + held,
    )


def _drift(
    seen: ContactRecord, curve: Spline, knots: Float[np.ndarray, " knots"], pulls: Float[np.ndarray, " nuisances"]
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """What the knots and the nuisance parameters add to the relative displacement, and to its rate."""
    moving = pulls[seen.moving]
    kept = 1 - moving @ seen.noise_in_m
    return (
        np.asarray(kept * (curve.value @ knots) - moving @ seen.nuisance_m),
        np.asarray(kept * (curve.rate @ knots) - moving @ seen.nuisance_m_per_s),
    )


def _fitted(
    seen: ContactRecord, curve: Spline, tie: Float[np.ndarray, "4 free"], starts: list[_State]
) -> tuple[_State, Weights]:
    """Descends from each start, and from the best again with the weights renewed from the scatter that is left, until
    they stand."""
    rough_n = 0.02 * float(np.std(seen.force_n))
    ends = [_descended(seen, curve, start, tie, _weights(seen, start, rough_n)) for start in starts]
    state = min(ends, key=lambda end: float(np.sum(end.residual**2)))
    weights = _weights(seen, state, _scatter(state))
    for _ in range(ROUNDS):
        state = _descended(seen, curve, state, tie, weights)
        before, weights = weights, _weights(seen, state, _scatter(state))
        if np.allclose(weights, before, rtol=0.1):
            break
    return state, weights


@dataclass(frozen=True)
class _Weighed:
    state: _State
    cost: float


def _descended(
    seen: ContactRecord, curve: Spline, state: _State, mapped: Float[np.ndarray, "4 free"], weights: Weights
) -> _State:
    """The state of least cost under some weights."""

    def step_from(at: _Weighed) -> Step[_Weighed]:
        to_law = mapped * _scales(at.state, mapped)
        hessian, gradient = _normal(seen, at.state, curve, to_law, weights)
        whole = _factorised(hessian).solve(gradient)

        def after(share: float) -> _Weighed | None:
            law = at.state.law + share * to_law @ whole[-to_law.shape[1] :]
            if np.any(law < LAW.bounds[0]) or STIFFNESS @ law == 0:
                return None
            knots, pulls = at.state.knots, at.state.pulls
            more = share * whole
            there = _linearised(
                seen, curve, law, knots + more[: knots.size], pulls + more[knots.size : knots.size + pulls.size]
            )
            return _Weighed(there, _cost(seen, there, curve, weights))

        return Step(after, float(gradient @ whole))

    start = _Weighed(state, _cost(seen, state, curve, weights))
    return descended(start, step_from, lambda at: SETTLED * at.cost, STEPS)[0].state


def _factorised(hessian: csc_matrix) -> SuperLU:
    try:
        return splu(hessian)
    except RuntimeError as error:  # exactly singular
        raise RigError("its closures tell no law of it; excite the rig more strongly") from error


def _scales(state: _State, tie: Float[np.ndarray, "4 free"]) -> Float[np.ndarray, " free"]:
    """Sizes of the free parameters, so that the normal equations are well conditioned."""
    lower, upper, stiffness, _ = state.law
    gap = max(min(lower, upper), 1e-9)
    return np.asarray(np.max(tie * np.array([gap, gap, stiffness, 1e-3 * stiffness])[:, None], axis=0))


def _scatter(state: _State) -> float:
    """Standard deviation of the residual while the contact is open; of all of it where that is larger."""
    free = state.residual[np.abs(state.by_eta) < 1e-3 * state.stiffness_n_per_m]
    return float(np.std(free)) if np.any(free) else float(np.std(state.residual))


def _weights(seen: ContactRecord, state: _State, open_n: float) -> Weights:
    """One over the standard deviation of each residual: that of the force, the share of it that no law explains, and
    what the relative displacement's noise, where the drift's knots do not follow it, does through the stiffness."""
    fast_m = 0.0 if seen.drift is None else seen.drift.unfollowed_m
    unmodelled_n = seen.unmodelled * np.hypot(seen.force_n, np.std(seen.force_n))
    return np.asarray(1 / np.sqrt(open_n**2 + (state.by_eta * fast_m) ** 2 + unmodelled_n**2))


def _cost(seen: ContactRecord, state: _State, curve: Spline, weights: Weights) -> float:
    prior = curve.curvature @ state.knots - curve.target
    return float(
        np.sum((weights * state.residual) ** 2) + np.sum(prior**2) + seen.sample_ratio * np.sum(state.pulls**2)
    )


def _jacobian(state: _State, to_law: Float[np.ndarray, "4 free"]) -> tuple[csr_matrix, Float[np.ndarray, "fewer more"]]:
    """Of the fitted force: by the drift's knots; by the nuisance parameters, then the free parameters of the law.

    The low-pass acts on the slope of the law; the drift is slow against it.
    """
    return state.by_knots, np.concatenate([state.by_pulls, state.by_law @ to_law], axis=1)


def _normal(
    seen: ContactRecord, state: _State, curve: Spline, to_law: Float[np.ndarray, "4 free"], weights: Weights
) -> tuple[csc_matrix, Float[np.ndarray, " unknowns"]]:
    by_knots, by_others = _jacobian(state, to_law)
    by_others *= weights[:, None]
    by_knots, left = diags(weights) @ by_knots, weights * state.residual
    prior = np.r_[np.full(state.pulls.size, seen.sample_ratio), np.zeros(to_law.shape[1])]
    of_others = by_others.T @ by_others + np.diag(prior)
    gradient = by_others.T @ left
    gradient[: state.pulls.size] -= seen.sample_ratio * state.pulls
    if not curve.knots:
        return csc_matrix(of_others), gradient
    mixed = by_knots.T @ by_others
    matrix = block_array([[by_knots.T @ by_knots + curve.curvature.T @ curve.curvature, mixed], [mixed.T, of_others]])
    of_knots = by_knots.T @ left + curve.curvature.T @ (curve.target - curve.curvature @ state.knots)
    return csc_matrix(matrix), np.concatenate([of_knots, gradient])
