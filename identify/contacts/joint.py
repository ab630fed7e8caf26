"""Clearances, stiffness and damping of one contact, or of several that share a relative displacement, its slow drift,
and the tolerances of rig.json, together."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, t

from identify.contacts.first_pulls import contact_alone, first_pulls
from identify.contacts.joint_fit import fitted, scales
from identify.contacts.linearised import State, drift_of, jacobian
from identify.contacts.normal_equations import normal_equations
from identify.contacts.progressive import Believed, Touched, check_told, starts
from identify.contacts.start import LAW, STIFFNESS, ContactRecord, Law, clearly_closed
from identify.signals.drift import Spline, spline
from identify.signals.scores import PARTS, part_scores
from rig.errors import RigError

MOST_PULL = 25.0
"""A drift whose curvature is on average more than the root of this away from what was measured is no drift."""
LOST = 3.0
"""If between two closures the noise, integrated twice, wanders by more than this multiple of the median penetration,
the fit cannot tell which closure belongs where."""
PAUSES = 0.05
"""So large a share of the times between closures, the longest ones, may be longer: a pause parts the record in two."""


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

    @property
    def reversed(self) -> "Joint":
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


def fit_joint(seen: ContactRecord, believed: Believed, touched: Touched) -> tuple[Joint, ...]:
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

    Raises RigError if the contact is hardly ever closed, the fit does not converge, or several cannot be told apart.
    """
    curve = spline(seen.eta_m.size, seen.sample_rate_hz, seen.drift)
    tie, first = _tie(touched, seen.sides_known), first_pulls(seen)
    begun = starts(contact_alone(seen, first), curve, believed, touched)
    state, weights = fitted(seen, curve, tie, begun, first)
    if _curvature_pull(curve, state) > MOST_PULL:
        raise RigError(
            "the drift that would explain it is larger than the noise of the accelerometers allows; check their noise "
            "and gains, or excite the rig more strongly"
        )
    _check_bridged(seen, state)
    to_law = tie * scales(state, tie)
    derivatives = jacobian(seen, curve, state)
    equations, *_ = normal_equations(seen, state, derivatives, curve, to_law, weights)
    pulls, free = state.pulls.size, tie.shape[1]
    by_knots, by_others = equations.solved(np.zeros((curve.knots, free)), np.eye(pulls + free, free, -pulls))
    in_law = np.concatenate([by_others[:pulls], to_law @ by_others[pulls:]])
    influence = derivatives.times(by_knots, in_law) * weights[:, None] ** 2  # of residuals on parameters
    left = PARTS - free  # parts are few: Student's t, so that 1.96 standard errors cover 95 %
    few = np.sqrt(PARTS / left) * t.ppf(0.975, left) / norm.ppf(0.975)
    by_parts = part_scores(influence, state.residual)
    of_rows = (
        few * by_parts,
        seen.sample_ratio * by_others[:pulls],
        curve.curvature @ by_knots,
    )
    of_scatter, of_tolerances, of_drift = (to_law @ (x.T @ x) @ to_law.T for x in of_rows)
    covariance = of_scatter + of_tolerances + of_drift
    drift_m, drift_m_per_s = drift_of(seen, curve, state.knots, state.pulls)
    if len(touched) > 1:
        check_told(state.law, covariance, touched, seen.eta_m + drift_m)

    def joint(first: int, lower: bool, upper: bool) -> Joint:
        own = slice(first, first + len(LAW))
        return Joint(
            values=state.law[own],
            covariance=covariance[own, own],
            of_tolerances=of_tolerances[own, own],
            of_drift=of_drift[own, own],
            sides_known=seen.sides_known,
            touched=(lower, upper),
            drift_m=drift_m,
            drift_m_per_s=drift_m_per_s,
            pulls=state.pulls,
            unexplained=float(np.std(state.residual) / np.std(seen.force_n)),
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


def _check_bridged(seen: ContactRecord, state: State) -> None:
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
