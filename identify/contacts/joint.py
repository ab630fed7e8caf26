"""Clearances, stiffness and damping of one contact, and the slow drift of its relative displacement, together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import csc_matrix, csr_matrix, diags, hstack, vstack
from scipy.sparse.linalg import splu, spsolve
from scipy.stats import norm, t

from identify.signals.descent import Step, descended
from identify.signals.drift import Drift, Spline, spline
from identify.signals.scores import PARTS, part_scores
from identify.signals.spectra import decimated, oversampled
from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.parameters import Parameter, ParameterSet

STEPS, SETTLED = 30, 1e-7
FINE_HZ = 16384.0
"""The contact force is evaluated at this rate at least, so that its kinks do not alias."""
CLEAR_SHARE = 0.1
"""A contact counts as clearly closed where its force exceeds this share of the force's 99.5 % quantile."""
ABOVE_NOISE = 8.0
"""... and this many standard deviations of the force in the quiet seconds before the excitation."""
STAGES = ((0.5, 30.0), (0.2, 30.0), (0.1, 10.0), (0.03, 3.0), (0.01, 1.0))
"""Where a contact is clearly closed, its displacement is known to a share of its own standard deviation, and the
drift's curvature so many times better than measured: in turn, so that at first no drift can follow the closures."""
OUTSIDE = 3.0
"""So many of those shares off, a force of either sign that rings weighs little in the next turn (Geman, McClure)."""
LEAST_CLOSED = 1e-3
"""A stop that is clearly touched for a smaller share of the record is not told by it."""
MOST_PULL = 25.0
"""A drift whose curvature is on average more than the root of this away from what was measured is no drift."""
LOST = 3.0
"""If between two closures the noise, integrated twice, wanders by more than this multiple of the median penetration,
the fit cannot tell which closure belongs where."""

LAW = ParameterSet(
    (
        Parameter("m", 0.0, np.inf, name="lower_clearance_m"),
        Parameter("m", 0.0, np.inf, name="upper_clearance_m"),
        Parameter("N/m", 0.0, np.inf, name="stiffness_n_per_m"),
        Parameter("N s/m", -np.inf, np.inf, name="damping_n_s_per_m"),
    )
)
"""What is estimated of a `DeadZone`; its damping may have any sign."""
CLEARANCE = LAW.vector({"lower_clearance_m": 0.5, "upper_clearance_m": 0.5})
STIFFNESS = LAW.vector({"stiffness_n_per_m": 1.0})
"""Linear functions of the parameters: half the total play, and the stiffness."""

Law = Float[np.ndarray, "4"]
Weights = Float[np.ndarray, " fewer"]
NuisanceSignal = tuple[Float[np.ndarray, " fewer"], Float[np.ndarray, " samples"]]
"""What one standard deviation of an uncertain thing would add to the force and to the relative displacement."""


@dataclass(frozen=True)
class ContactRecord:
    """One contact as seen: relative displacement and velocity (m, m/s) and the separated force (N).

    The force has been low-passed and is that of every `factor`-th sample; quiet_n is its standard deviation where there
    is no contact. drift is None where nothing was lost.
    """

    eta_m: Float[np.ndarray, " samples"]
    velocity_m_per_s: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    force_n: Float[np.ndarray, " fewer"]
    factor: int
    quiet_n: float
    drift: Drift | None

    @property
    def spring_n_per_m(self) -> float:
        return 0.0 if self.drift is None else self.drift.spring_n_per_m

    @property
    def sides_known(self) -> bool:
        return self.drift is None or self.drift.spring_n_per_m > 0


@dataclass(frozen=True)
class Joint:
    """The estimate: values of the parameters of `LAW`, with covariance.

    of_tolerances and of_drift are the parts of the covariance that come from what rig.json may have wrong and from the
    slow motion that accelerometers miss; the rest is the record's own scatter. sides_known says whether lower and upper
    are told apart; drift_m and drift_m_per_s are what was added to the relative displacement and velocity.
    """

    values: Law
    covariance: Float[np.ndarray, "4 4"]
    of_tolerances: Float[np.ndarray, "4 4"]
    of_drift: Float[np.ndarray, "4 4"]
    sides_known: bool
    drift_m: Float[np.ndarray, " samples"]
    drift_m_per_s: Float[np.ndarray, " samples"]

    @property
    def clearance_m(self) -> float:
        return float(CLEARANCE @ self.values)

    @property
    def clearance_error_m(self) -> float:
        return self.error(CLEARANCE)

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


def law_force_n(
    law: Law, eta_m: Float[np.ndarray, " samples"], rate_m_per_s: Float[np.ndarray, " samples"]
) -> Float[np.ndarray, " samples"]:
    """Stiffness and damping times what a `DeadZone` makes of one of each; the damping may have any sign."""
    _, _, stiffness, damping = law
    by_stiffness, by_damping = _by_stiffness_and_damping(law, eta_m, rate_m_per_s)
    return np.asarray(stiffness * by_stiffness + damping * by_damping)


def _by_stiffness_and_damping(
    law: Law, eta_m: Float[np.ndarray, " samples"], rate: Float[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    lower, upper, _, _ = law.tolist()
    spring, damper = (
        DeadZone(lower_clearance_m=lower, upper_clearance_m=upper, stiffness_n_per_m=k, damping_n_s_per_m=c)
        for k, c in ((1.0, 0.0), (0.0, 1.0))
    )
    return spring.force_n(eta_m), damper.force_n(eta_m, rate)


def fit_joint(seen: ContactRecord, nuisance_signals: Sequence[NuisanceSignal] = ()) -> Joint:
    """Gauss-Newton on the low-passed residual, with a cubic spline b(t) for the drift and a spring to the ground:

        residual = force - spring b - low-pass[k dz(eta + b; lower, upper) + c (eta' + b') beyond the gap]

    b'' is held to what the accelerometers saw of it, within their noise. Where nothing holds the zero of the relative
    displacement, lower = upper = half the total play. The start is a linear regression of eta on the force over the
    samples at which the contact is clearly closed.

    The covariance is a sandwich estimate over sixteenths of the record (residuals may be coloured), plus the square of
    what each tolerance would do.

    Raises RigError if the contact is hardly ever closed or the fit does not converge.
    """
    curve = spline(seen.eta_m.size, seen.sample_rate_hz, seen.drift)
    tie = np.eye(len(LAW))
    if not seen.sides_known:
        tie = np.column_stack([2 * CLEARANCE, tie[:, 2:]])
    law, knots = regressed(seen, curve)
    for begin in (knots, np.zeros_like(knots)):  # rarely, the regression's drift leads astray
        state, weights = _fitted(seen, curve, tie, _linearised(seen, curve, law, begin))
        if _curvature_pull(curve, state) <= MOST_PULL:
            break
    else:
        raise RigError(
            "the drift that would explain it is larger than the noise of the accelerometers allows; check their noise "
            "and gains, or excite the rig more strongly"
        )
    _check_bridged(seen, state)
    scale = _scales(state, tie)
    hessian, _ = _normal(state, curve, tie * scale, weights)
    free = tie.shape[1]
    chosen = np.eye(hessian.shape[0], free, -curve.knots)
    inverse = splu(hessian).solve(chosen)
    influence = (_jacobian(state, curve, tie * scale) @ inverse) * weights[:, None] ** 2  # of residuals on parameters
    left = PARTS - free  # parts are few: Student's t, so that 1.96 standard errors cover 95 %
    few = np.sqrt(PARTS / left) * t.ppf(0.975, left) / norm.ppf(0.975)
    scatter = few * part_scores(influence, state.residual)
    by_tolerance = [force - state.by_eta * eta[:: seen.factor][: force.size] for force, eta in nuisance_signals]
    of_each = np.array([influence.T @ m for m in by_tolerance]).reshape(-1, free)
    drifted = curve.curvature @ inverse[: curve.knots]  # each row of the prior is uncertain by one
    to_law = tie * scale
    of_scatter, of_tolerances, of_drift = (to_law @ (x.T @ x) @ to_law.T for x in (scatter, of_each, drifted))
    return Joint(
        values=state.law,
        covariance=of_scatter + of_tolerances + of_drift,
        of_tolerances=of_tolerances,
        of_drift=of_drift,
        sides_known=seen.sides_known,
        drift_m=curve.value @ state.knots,
        drift_m_per_s=curve.rate @ state.knots,
    )


@dataclass(frozen=True)
class _State:
    law: Law
    knots: Float[np.ndarray, " knots"]
    residual: Float[np.ndarray, " fewer"]
    by_law: Float[np.ndarray, "fewer 4"]
    by_eta: Float[np.ndarray, " fewer"]
    at_force: csr_matrix

    @property
    def stiffness_n_per_m(self) -> float:
        return float(STIFFNESS @ self.law)


def _closed(seen: ContactRecord) -> Bool[np.ndarray, " fewer"]:
    """Where the contact is clearly closed."""
    size = np.abs(seen.force_n)
    return size > max(CLEAR_SHARE * float(np.quantile(size, 0.995)), ABOVE_NOISE * seen.quiet_n)


def _curvature_pull(curve: Spline, state: _State) -> float:
    """Mean square of the drift's curvature less what was measured of it, in its standard deviations; about 1 to 2."""
    return float(np.mean((curve.curvature @ state.knots - curve.target) ** 2)) if curve.knots else 0.0


def _check_bridged(seen: ContactRecord, state: _State) -> None:
    """Raises RigError if between closures the integrated noise wanders too far for them to be put in their places."""
    if seen.drift is None or seen.drift.spring_n_per_m > 0:
        return
    closed = _closed(seen)
    between_s = np.diff(np.flatnonzero(np.diff(closed.astype(int)) == 1)) * seen.factor / seen.sample_rate_hz
    wander_m = seen.drift.noise_density * np.sqrt(np.mean(between_s**3) / 6) if between_s.size else np.inf
    depth_m = float(np.median(np.abs(seen.force_n[closed]))) / state.stiffness_n_per_m
    if wander_m > LOST * depth_m:
        raise RigError(
            "it closes too rarely for accelerometers to bridge the time between (their noise wanders by "
            f"{1e6 * wander_m:.0f} um, the penetration is {1e6 * depth_m:.0f} um); excite the rig more strongly, or "
            "measure displacements"
        )


def regressed(seen: ContactRecord, curve: Spline) -> tuple[Law, Float[np.ndarray, " knots"]]:
    """Where the contact is clearly closed, eta + b = +-clearance + force / k: linear in clearance, 1/k and b."""
    size = np.abs(seen.force_n)
    at_force = curve.value[:: seen.factor][: size.size]
    force = seen.force_n
    closed = _closed(seen)
    if seen.spring_n_per_m:  # the drift's own force is in the measured one: leave it to Gauss-Newton
        at_force = csr_matrix(at_force.shape)
    touched = [float(np.mean(closed & side)) for side in (force < 0, force > 0)]
    if max(touched) < LEAST_CLOSED:
        raise RigError("it hardly ever closes in this record; excite the rig more strongly")
    if min(touched) < LEAST_CLOSED:
        raise RigError(
            "only one of its stops is ever touched, so its play cannot be told; excite the rig more strongly"
        )
    eta = seen.eta_m[:: seen.factor][: size.size][closed]
    columns = hstack([-at_force[closed], np.stack([np.sign(force[closed]), force[closed]], axis=1)]).tocsr()
    bent = hstack([curve.curvature, csr_matrix((curve.target.size, 2))])
    weights = np.ones(eta.size)
    for share, stiffer in STAGES:
        fuzz_m = share * float(np.std(eta))
        rows = vstack([diags(weights / fuzz_m) @ columns, stiffer * bent]).tocsc()
        target = np.concatenate([weights * eta / fuzz_m, stiffer * curve.target])
        ridge = diags(np.r_[np.full(curve.knots, 1e-12 * (rows.T @ rows).diagonal().max()), np.zeros(2)])
        found = spsolve((rows.T @ rows + ridge).tocsc(), rows.T @ target)
        weights = 1 / (1 + ((eta - columns @ found) / (OUTSIDE * fuzz_m)) ** 2)
    *knots, clearance, softness = found
    if not (np.isfinite(clearance) and softness > 0):
        raise RigError(
            "no force grows with this relative displacement; excite the rig more strongly, or check rig.json"
        )
    return np.array([max(clearance, 0.0), max(clearance, 0.0), 1 / softness, 0.0]), np.array(knots)


def _linearised(seen: ContactRecord, curve: Spline, law: Law, knots: Float[np.ndarray, " knots"]) -> _State:
    lower, upper, stiffness, _ = law
    eta, velocity = seen.eta_m + curve.value @ knots, seen.velocity_m_per_s + curve.rate @ knots
    above, below = eta > upper, eta < -lower
    outside = (above | below).astype(float)
    by_stiffness, by_damping = _by_stiffness_and_damping(law, eta, velocity)
    parts = np.stack([stiffness * below, -stiffness * above, by_stiffness, by_damping, stiffness * outside])
    low_passed = decimated(parts, seen.factor)[:, : seen.force_n.size]
    fine = max(1, round(FINE_HZ / seen.sample_rate_hz))
    finer = oversampled(np.stack([eta, velocity]), fine)
    fitted = decimated(law_force_n(law, *finer), fine * seen.factor)[: seen.force_n.size]
    at_force = curve.value[:: seen.factor][: seen.force_n.size]
    residual = seen.force_n - fitted - seen.spring_n_per_m * (at_force @ knots)
    return _State(law, knots, residual, low_passed[:4].T, low_passed[4] + seen.spring_n_per_m, at_force)


def _fitted(
    seen: ContactRecord, curve: Spline, tie: Float[np.ndarray, "4 free"], state: _State
) -> tuple[_State, Weights]:
    """Descends, with the weights renewed from the scatter that is left until they stand."""
    weights = _weights(seen, state, 0.02 * float(np.std(seen.force_n)))
    for _ in range(4):
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
        hessian, gradient = _normal(at.state, curve, to_law, weights)
        whole = spsolve(hessian, gradient)

        def after(share: float) -> _Weighed | None:
            law = at.state.law + share * to_law @ whole[curve.knots :]
            if np.any(law < LAW.bounds[0]) or STIFFNESS @ law == 0:
                return None
            there = _linearised(seen, curve, law, at.state.knots + share * whole[: curve.knots])
            return _Weighed(there, _cost(there, curve, weights))

        return Step(after, float(gradient @ whole))

    start = _Weighed(state, _cost(state, curve, weights))
    return descended(start, step_from, lambda at: SETTLED * at.cost, STEPS)[0].state


def _scales(state: _State, tie: Float[np.ndarray, "4 free"]) -> Float[np.ndarray, " free"]:
    """Sizes of the free parameters, so that the normal equations are well conditioned."""
    gap, stiffness = max(float(CLEARANCE @ state.law), 1e-9), state.stiffness_n_per_m
    return np.asarray(np.max(tie * np.array([gap, gap, stiffness, 1e-3 * stiffness])[:, None], axis=0))


def _scatter(state: _State) -> float:
    """Standard deviation of the residual while the contact is open; of all of it where that is larger."""
    open_n = np.std(state.residual[np.abs(state.by_eta) < 1e-3 * state.stiffness_n_per_m])
    return float(open_n) if np.isfinite(open_n) and open_n > 0 else float(np.std(state.residual))


def _weights(seen: ContactRecord, state: _State, open_n: float) -> Weights:
    """One over the standard deviation of each residual: that of the force, and while the contact is closed also what
    the relative displacement's noise, where the drift's knots do not follow it, does through the stiffness."""
    fast_m = 0.0 if seen.drift is None else seen.drift.unfollowed_m
    return np.asarray(1 / np.hypot(open_n, state.by_eta * fast_m))


def _cost(state: _State, curve: Spline, weights: Weights) -> float:
    prior = curve.curvature @ state.knots - curve.target
    return float(np.sum((weights * state.residual) ** 2) + np.sum(prior**2))


def _jacobian(state: _State, curve: Spline, to_law: Float[np.ndarray, "4 free"]) -> csr_matrix:
    """Of the fitted force, by the drift's knots and then by the free parameters of the law.

    The low-pass acts on the slope of the law; the drift is slow against it.
    """
    by_knots = diags(state.by_eta) @ state.at_force
    return (
        hstack([by_knots, csr_matrix(state.by_law @ to_law)]).tocsr()
        if curve.knots
        else csr_matrix(state.by_law @ to_law)
    )


def _normal(
    state: _State, curve: Spline, to_law: Float[np.ndarray, "4 free"], weights: Weights
) -> tuple[csc_matrix, Float[np.ndarray, " unknowns"]]:
    jacobian = diags(weights) @ _jacobian(state, curve, to_law)
    rest = csr_matrix((curve.target.size, to_law.shape[1]))
    prior = hstack([curve.curvature, rest]).tocsr() if curve.knots else rest
    gradient = jacobian.T @ (weights * state.residual) + prior.T @ (curve.target - curve.curvature @ state.knots)
    return csc_matrix(jacobian.T @ jacobian + prior.T @ prior), gradient
