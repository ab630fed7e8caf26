"""Clearances, stiffness and damping of one contact, or of several that share a relative displacement, its slow drift,
and the tolerances of rig.json, together: Gauss-Newton, with weights that the scatter left asks for."""

from collections.abc import Sequence
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
from identify.contacts.initial_guess import contact_alone, first_pulls, starts
from identify.contacts.law_choice import asked_form, misfit_covariance
from identify.contacts.law_fit import fitted, tie_of
from identify.contacts.law_form import DEAD_ZONE, FormName, LawForm, Signal
from identify.contacts.linearization import State, drift_of
from identify.contacts.refusals import RefusalCode, refused
from identify.pages.wording import COVERED
from identify.signals.drift import Spline, spline
from identify.signals.scores import PARTS, part_scores, quietest, telling_parts

MOST_PULL = 25.0
"""A drift whose curvature is on average more than the root of this away from what was measured is no drift."""
LOST = 3.0
"""If between two closures the noise, integrated twice, wanders by more than this multiple of the median penetration,
the fit cannot tell which closure belongs where."""
MOST_NOISE = 1.5
"""The noise of a separated force is no larger multiple of what the sensors' noise makes of it."""
PAUSES = 0.05
"""So large a share of the times between closures, the longest ones, may be longer: a pause parts the record in two."""


@dataclass(frozen=True)
class JointEstimate:
    """The estimate: values of the parameters of `LAW`, with covariance.

    of_tolerances, of_drift and of_misfit are the parts of the covariance that come from what rig.json may have wrong,
    from the slow motion that accelerometers miss, and from what the form of the law does not have; the rest is the
    record's own scatter. sides_known says whether lower and upper are told apart, touched which of them the record
    tells. drift_m and drift_m_per_s are what was added to the relative displacement and velocity. pulls are the
    nuisance parameters in their standard deviations. unexplained is the share of the contact force's root mean square
    that the fit leaves beyond the sensors' noise, halves by how many standard errors the clearance and the stiffness
    of the record's halves differ. form is that of the law; of a power law the stiffness is the force over the depth at
    its reference depth.
    """

    values: Law
    covariance: Float[np.ndarray, "4 4"]
    of_tolerances: Float[np.ndarray, "4 4"]
    of_drift: Float[np.ndarray, "4 4"]
    of_misfit: Float[np.ndarray, "4 4"]
    sides_known: bool
    touched: tuple[bool, bool]
    drift_m: Float[np.ndarray, " samples"]
    drift_m_per_s: Float[np.ndarray, " samples"]
    pulls: Float[np.ndarray, " nuisances"]
    unexplained: float = 0.0
    halves: tuple[float, float] = (0.0, 0.0)
    form: LawForm = DEAD_ZONE
    exponent: float = 1.0
    exponent_error: float = 0.0

    @property
    def law(self) -> Law:
        """The numbers that the form takes: the exponent of a power law behind the others."""
        return np.concatenate([self.values, np.full(self.form.shapes, self.exponent)])

    def force_n(self, eta_m: Signal, rate_m_per_s: Signal) -> Signal:
        return self.form.force_n(self.law, eta_m, rate_m_per_s)

    def spring_m(self, eta_m: Signal) -> Signal:
        """Factor of the stiffness: the depth (m), or what a power law makes of it."""
        unit = np.concatenate([self.values[:2], [1.0, 0.0], self.law[len(LAW) :]])
        return self.form.force_n(unit, eta_m, np.zeros_like(eta_m))

    @property
    def clearance(self) -> Law:
        """Clearance as a linear function of the parameters: half the total play, or that of the one stop touched."""
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
        return float(np.sqrt(of @ (self.covariance - self.of_tolerances - self.of_misfit) @ of))

    @property
    def reversed(self) -> "JointEstimate":
        """Estimate of the contact counted in the other direction."""
        swapped = np.eye(len(LAW))[[1, 0, 2, 3]]
        lower, upper = self.touched
        return replace(
            self,
            values=swapped @ self.values,
            covariance=swapped @ self.covariance @ swapped,
            of_tolerances=swapped @ self.of_tolerances @ swapped,
            of_drift=swapped @ self.of_drift @ swapped,
            of_misfit=swapped @ self.of_misfit @ swapped,
            touched=(upper, lower),
            drift_m=-self.drift_m,
            drift_m_per_s=-self.drift_m_per_s,
        )


def _clearance(touched: tuple[bool, bool]) -> Law:
    lower, upper = np.array(touched) / sum(touched)
    return LAW.vector({"lower_clearance_m": lower, "upper_clearance_m": upper})


def fit_joint(
    record: ContactRecord, believed: Believed, touched: Touched, forms: Sequence[FormName] = ()
) -> tuple[JointEstimate, ...]:
    """Estimates of all nominal contacts by one fit.

    Gauss-Newton on the low-passed residual, with a cubic spline b(t) for the drift, a spring to the ground, and
    nuisance parameters theta with a prior of one:

        residual = (force - theta' nuisance_n
                    - low-pass[sum of k dz(eta + h b - theta' nuisance_m; lower, upper) + c (eta' + h b') beyond the
                    gap, over the contacts]) / g
                   - spring b - damper b',  g = 1 - theta' noise_in_n, h = 1 - theta' noise_in_m

    b'' is held to what the accelerometers saw of it, within their noise. Where nothing holds the zero of the relative
    displacement, lower = upper = half the total play. g and h keep gains from being fitted to the noise, which
    shrinks as the signals do. It begins at a linear regression of eta on the force over the samples at which the
    contact is clearly closed (`starts`). Of a contact by itself the form of its law is then chosen among the dead zone
    and `forms`.

    The covariance is a sandwich estimate over sixteenths of the record (residuals may be coloured), plus what an error
    of one in each row of the priors does; it holds whatever the residuals were weighed by. Where forms are tried, what
    the chosen one leaves is added (`misfit_covariance`).

    Raises ContactRefusedError if the contact is hardly ever closed, the fit does not converge, or several cannot be
    told apart.
    """
    curve = spline(record.eta_m.size, record.sample_rate_hz, record.drift)
    tie, first = tie_of(touched, record.sides_known), first_pulls(record)
    begun = starts(contact_alone(record, first), curve, believed, touched)
    fit = fitted(record, curve, tie, begun, first)
    if _curvature_pull(curve, fit.state) > MOST_PULL:
        raise refused(RefusalCode.DRIFT_TOO_LARGE)
    _check_bridged(record, fit.state)
    alone = len(touched) == 1
    fit = asked_form(fit, forms if alone else ())
    state = fit.state
    derivatives, equations, to_law = fit.linearized
    pulls, free = state.pulls.size, to_law.shape[1]
    by_knots, by_others = equations.solved(np.zeros((curve.knots, free)), np.eye(pulls + free, free, -pulls))
    in_law = np.concatenate([by_others[:pulls], to_law @ by_others[pulls:]])
    influence = derivatives.times(by_knots, in_law) * fit.weights[:, None] ** 2  # of residuals on parameters
    left = PARTS - free  # parts are few: Student's t, so that 1.96 standard errors cover 95 %
    few = np.sqrt(PARTS / left) * t.ppf(0.975, left) / norm.ppf(0.975)
    begins = telling_parts(influence @ to_law[LAW.names.index("stiffness_n_per_m")])
    by_parts = part_scores(influence, state.residual, begins)
    of_rows = (
        few * by_parts,
        record.sample_ratio * by_others[:pulls],
        curve.curvature @ by_knots,
    )
    of_scatter, of_tolerances, of_drift = (to_law @ (x.T @ x) @ to_law.T for x in of_rows)
    of_misfit = misfit_covariance(fit, derivatives, begins) if forms and alone else np.zeros_like(of_scatter)
    covariance = of_scatter + of_tolerances + of_drift + of_misfit
    drift_m, drift_m_per_s = drift_of(record, curve, state.knots, state.pulls)
    if not alone:
        _check_separable(state.law, covariance, touched, record.eta_m + drift_m)

    def joint(first: int, lower: bool, upper: bool) -> JointEstimate:
        own = slice(first, first + len(LAW))
        return JointEstimate(
            values=state.law[own],
            covariance=covariance[own, own],
            of_tolerances=of_tolerances[own, own],
            of_drift=of_drift[own, own],
            of_misfit=of_misfit[own, own],
            sides_known=record.sides_known,
            touched=(lower, upper),
            drift_m=drift_m,
            drift_m_per_s=drift_m_per_s,
            pulls=state.pulls,
            unexplained=_unexplained(record, state),
            halves=_halves(by_parts @ to_law[own].T, (_clearance((lower, upper)), STIFFNESS)),
            form=state.form,
            exponent=state.form.exponent(state.law),
            exponent_error=float(np.sqrt(covariance[-1, -1])) if state.form.shapes else 0.0,
        )

    return tuple(joint(len(LAW) * i, *sides) for i, sides in enumerate(touched.tolist()))


def _unexplained(record: ContactRecord, state: State) -> float:
    """Beyond the sensors' noise, as a share of the force: that of the quietest parts, as far as sensors may make it,
    and three standard deviations of its variance in a part of n samples, sqrt(2 / n) of it."""
    noise_n = min(float(quietest(state.residual)), MOST_NOISE * record.noise_n)
    noise = noise_n**2 * (1 + 3 * np.sqrt(2 * PARTS / state.residual.size))
    left, force = (max(float(np.var(n)) - noise, 0.0) for n in (state.residual, record.force_n))
    return float(np.sqrt(left / force)) if force > 0 else 0.0


def _halves(by_parts: Float[np.ndarray, "parts 4"], of: tuple[Law, Law]) -> tuple[float, float]:
    """Influence of the first half's parts on the estimates less that of the second's, over their scatter."""
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
