"""Each separated contact force against the law that the rig has at its relative displacement: the contact residual.

A law is evaluated without aliasing and low-passed to the band of the force.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace as changed
from scipy.sparse import block_diag, csc_matrix, csr_matrix, vstack
from scipy.sparse.linalg import SuperLU, splu

from identify.contacts.contact_record import CLEAR_SHARE, ContactRecord
from identify.contacts.initial_guess import regressed
from identify.gaps.residual.linear import Linear
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.observation import ContactObservation
from identify.gaps.residual.record import Record
from identify.linear.joined import JoinedLaw
from identify.signals.law_evaluation import evaluated
from rig.errors import RigError
from rig.model.contact_laws import ContactLaw

WALL = 100.0
"""Beyond `LIMIT` standard deviations these weigh so many times more: something else is wrong."""
DEEP, DEPTHS = 3.0, 2000
"""Penetrations at which a law is inverted: up to so many times that of a linear stop, and how many."""

Signal = Float[np.ndarray, "*shape"]
Results = Float[np.ndarray, "..."]


@dataclass(frozen=True)
class ContactSignals:
    """Force (N) of one contact, and its relative displacement and velocity at the recording's rate, as a linear model
    has them.

    factor is how much lower the rate of the force is.
    """

    force_n: Float[np.ndarray, " times"]
    eta_m: Float[np.ndarray, " samples"]
    rate_m_per_s: Float[np.ndarray, " samples"]
    time_s: Float[np.ndarray, " samples"]
    sample_rate_hz: float
    factor: int
    spring_n_per_m: float

    def low_passed(self, law: Callable[..., Results], *signals: Signal) -> Float[np.ndarray, "*rows times"]:
        """Law evaluated on signals at the recording's rate, low-passed to the rate of the force."""
        return evaluated(law, np.stack(signals), self.sample_rate_hz, self.factor)


def contact_signals_of(record: Record, model: Linear) -> tuple[ContactSignals, ...]:
    """Signals of every contact that its law has to explain."""
    eta, rate = record.sampled(model.eta_m), record.sampled(model.eta_m, 1)
    time_s = record.taken.start / record.rate_hz + np.arange(eta.shape[1]) / record.sample_rate_hz
    forces = record.in_time(model.contact_n) + model.holding_n[:, None]
    return tuple(
        ContactSignals(f, e, r, time_s, record.sample_rate_hz, record.factor, s)
        for f, e, r, s in zip(forces, eta, rate, np.diag(model.slow_n_per_m), strict=True)
    )


def start_of(
    signals: ContactSignals, seen: ContactObservation, law: JoinedLaw, rate_hz: float
) -> Float[np.ndarray, " unknowns"]:
    """The drift by the samples at which the contact is clearly closed; zero where they do not tell it.

    Clearance and stiffness are regressed along with it; the law gives its other terms.
    """
    start = np.zeros(seen.curve.knots + len(seen.trusted) * len(law.laws))
    first, (lower, upper) = law.laws[0], law.clearances_m
    eta, rate, time_s = (x[:: signals.factor] for x in (signals.eta_m, signals.rate_m_per_s, signals.time_s))
    force = signals.force_n - law.force_n(np.zeros_like(eta), rate)  # what acts in the gap too
    shifted = (upper - lower) / 2 + np.sign(force) * first.wear_m_per_s * time_s
    depth = _depth_m(law, force)
    if len(law.laws) > 1:  # what rings while they are open would be deep in a soft one
        depth *= np.abs(force) > CLEAR_SHARE * np.quantile(np.abs(force), 0.995)
    observed = ContactRecord(
        eta_m=eta - shifted,
        velocity_m_per_s=rate,
        sample_rate_hz=rate_hz,
        force_n=first.stiffness_n_per_m * depth,
        factor=1,
        quiet_n=0.0,
        noise_n=0.0,
        unmodelled=0.0,
        drift=None,
        nuisance_n=np.zeros((0, force.size)),
        noise_in_n=np.zeros(0),
        moving=np.zeros(0, dtype=bool),
        noise_in_m=np.zeros(0),
        nuisance_m=np.zeros((0, force.size)),
        initial=np.zeros(0, dtype=bool),
    )
    if seen.curve.knots:
        with suppress(RigError):
            start[: seen.curve.knots] = regressed(observed, seen.curve)[1]
    return start


def _depth_m(law: JoinedLaw, force_n: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
    """The penetration at which the law's force at rest is as large; zero for a law without stiffness."""
    slopes = [slope for slope, _ in (one.steepest for one in law.laws) if slope]
    found = np.zeros_like(force_n)
    if slopes:
        deepest = DEEP * np.max(np.abs(force_n)) / np.array(slopes)
        depth = np.sort(np.linspace(0.0, deepest, DEPTHS).ravel())
        for sign, clearance in zip((-1, 1), law.clearances_m, strict=True):
            elastic = np.maximum.accumulate(sign * law.force_n(sign * (clearance + depth)))
            found += sign * np.interp(np.maximum(sign * force_n, 0.0), elastic, depth)
    return found


@dataclass(frozen=True)
class ContactResidual:
    """A contact's law laid against its separated force, with its drift and the law's own tolerances as unknowns.

    unknowns are the drift's knots (m), then clearance, stiffness and damping in their tolerances, of every contact
    between the same places. within is the law with the first two. eta_m is the relative displacement with the drift,
    rate_m_per_s its rate. residual is force less law, in standard deviations, above the residuals of the prior.
    """

    seen: ContactObservation
    signals: ContactSignals
    law: JoinedLaw
    within: JoinedLaw
    unknowns: Float[np.ndarray, " unknowns"]
    eta_m: Float[np.ndarray, " samples"]
    rate_m_per_s: Float[np.ndarray, " samples"]
    residual: Float[np.ndarray, " rows"]

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    @cached_property
    def slopes(self) -> Float[np.ndarray, "3 laws times"]:
        """Slopes of every contact: the law's slope (N/m), the same with the sign of the relative displacement, and the
        force at rest per stiffness (m).
        """
        laws = [changed(law, damping_n_s_per_m=0.0) for law in self.within.laws]

        def of(eta: Signal, *time_s: Signal) -> Results:
            tangents = self._tangents(eta, *time_s)
            per_stiffness = [
                sign * more_n(one, sign * eta, 0.0, *time_s, stiffness_n_per_m=1.0)
                for one, sign in zip(laws, self.within.signs, strict=True)
            ]
            return np.stack([tangents, tangents * np.sign(eta), np.stack(per_stiffness)])

        return self.signals.low_passed(of, self.eta_m, *_times(self.within, self.signals))

    def sloped_n(self, more_m: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " times"]:
        """Change of the law's force by a small relative displacement, by its slope."""

        def of(eta: Signal, more: Signal, *time_s: Signal) -> Signal:
            return np.asarray(self._tangents(eta, *time_s).sum(axis=0) * more)

        return self.signals.low_passed(of, self.eta_m, more_m, *_times(self.within, self.signals))

    def _tangents(self, eta: Signal, *time_s: Signal) -> Float[np.ndarray, "laws *shape"]:
        return np.stack(
            [
                law.by_eta_n_per_m(sign * eta, *time_s)
                for law, sign in zip(self.within.laws, self.within.signs, strict=True)
            ]
        )

    @cached_property
    def damped_n(self) -> Float[np.ndarray, "laws times"]:
        """Change of the force by one tolerance of each damping."""
        *_, damping_s = self.seen.trusted

        def of(eta: Signal, rate: Signal, *time_s: Signal) -> Results:
            each = zip(self.law.signs, self.within.laws, self.law.laws, strict=True)
            return np.stack(
                [
                    sign * more_n(own, sign * eta, sign * rate, *time_s, damping_n_s_per_m=damping_s * k)
                    for sign, own, k in ((sign, own, one.stiffness_n_per_m) for sign, own, one in each)
                ]
            )

        return self.signals.low_passed(of, self.eta_m, self.rate_m_per_s, *_times(self.within, self.signals))

    @property
    def pulls(self) -> Float[np.ndarray, " pulls"]:
        """Pulls of clearance, stiffness and damping of each contact, in tolerances."""
        return self.unknowns[self.seen.tolerances]

    @property
    def believed(self) -> Float[np.ndarray, " unknowns"]:
        """Its unknowns with none of the tolerances used."""
        found = self.unknowns.copy()
        found[self.seen.tolerances] = 0.0
        return found

    @property
    def fitted(self) -> tuple[ContactLaw, ...]:
        """The laws with clearance, stiffness and damping as they were fitted within their tolerances."""
        *_, damping_s = self.seen.trusted
        more = self.pulls[2::3] * damping_s
        return tuple(
            changed(one, damping_n_s_per_m=max(0.0, float(law.damping_n_s_per_m + by * law.stiffness_n_per_m)))
            for one, law, by in zip(self.within.laws, self.law.laws, more, strict=True)
        )

    @property
    def slow_m(self) -> Float[np.ndarray, " times"]:
        return np.asarray(self.seen.curve.value @ self.unknowns[: self.seen.curve.knots])

    @cached_property
    def by_eta(self) -> Float[np.ndarray, " times"]:
        """The law's derivative by slow changes of the relative displacement, N/m."""
        return np.asarray(self.slopes[0].sum(axis=0) + self.signals.spring_n_per_m)

    @cached_property
    def columns(self) -> csr_matrix:
        """Decrease of the residual with each unknown."""
        weights, curve = self.seen.weights, self.seen.curve
        by_clearance, by_stiffness, _ = self.seen.trusted
        rows = []
        for law, sided, per_stiffness, damped in zip(self.law.laws, *self.slopes[1:], self.damped_n, strict=True):
            of_clearance = -by_clearance * law.clearance_m * sided
            rows += [of_clearance, by_stiffness * law.stiffness_n_per_m * per_stiffness, damped]
        by_law = np.stack(rows, axis=1)
        beside = _beside(curve.value, weights * self.by_eta, weights[:, None] * by_law)
        firm = self.seen.firm * (1 + WALL * (_beyond(self.pulls) != 0))
        return vstack([beside, block_diag([curve.curvature, np.diag(firm)], "csr")], "csr")

    def solver(self) -> SuperLU:
        return splu(csc_matrix(self.columns.T @ self.columns))

    @cached_property
    def drift_columns(self) -> csr_matrix:
        """The columns of the slow motion alone."""
        return self.columns[:, : self.seen.curve.knots]

    @cached_property
    def drift_solver(self) -> SuperLU:
        return splu(csc_matrix(self.drift_columns.T @ self.drift_columns))


def contact_residual(
    signals: ContactSignals,
    seen: ContactObservation,
    law: JoinedLaw,
    unknowns: Float[np.ndarray, " unknowns"],
    added_n: float | Float[np.ndarray, " times"] = 0.0,
    added_m: float | Float[np.ndarray, " times"] = 0.0,
) -> ContactResidual:
    """The residual at some drift and tolerances; added_n and added_m come on top of force and relative displacement."""
    curve, knots = seen.curve, unknowns[: seen.curve.knots]
    slow, slow_rate = curve.value @ knots + added_m, curve.rate @ knots
    eta = signals.eta_m + _between(np.broadcast_to(slow, signals.force_n.shape), signals.factor)
    rate = signals.rate_m_per_s + _between(slow_rate, signals.factor)
    pulls = unknowns[seen.tolerances]
    *_, damping_s = seen.trusted
    laws, more_damping = [], []
    for one, own in zip(law.laws, pulls.reshape(-1, len(seen.trusted)), strict=True):
        clearance, stiffness, _ = (own * seen.trusted).tolist()
        more_damping.append(float(own[2] * damping_s * one.stiffness_n_per_m))
        laws.append(
            changed(
                one,
                lower_clearance_m=one.lower_clearance_m * max(0.0, 1 + clearance),
                upper_clearance_m=one.upper_clearance_m * max(0.0, 1 + clearance),
                stiffness_n_per_m=one.stiffness_n_per_m * max(0.01, 1 + stiffness),
            )
        )
    within = JoinedLaw(tuple(laws), law.signs)

    def force_n(eta: Signal, rate: Signal, *time_s: Signal) -> Signal:
        each = zip(within.signs, within.laws, more_damping, strict=True)
        return np.asarray(sum(sign * damped_n(one, more, sign * eta, sign * rate, *time_s) for sign, one, more in each))

    force = signals.low_passed(force_n, eta, rate, *_times(within, signals))
    residual = signals.force_n + added_n - force - signals.spring_n_per_m * slow
    held = -seen.firm * (pulls + WALL * _beyond(pulls))
    return ContactResidual(
        seen=seen,
        signals=signals,
        law=law,
        within=within,
        unknowns=unknowns,
        eta_m=eta,
        rate_m_per_s=rate,
        residual=np.concatenate([seen.weights * residual, curve.target - curve.curvature @ knots, held]),
    )


def damped_n(law: ContactLaw, more: float, eta_m: Signal, rate_m_per_s: Signal, *time_s: Signal) -> Signal:
    """The force with more damping, N s/m, of which it is a linear function and which may so fall below zero."""
    damping = law.damping_n_s_per_m + more
    whole = changed(law, damping_n_s_per_m=abs(damping)).force_n(eta_m, rate_m_per_s, *time_s)
    if damping >= 0:
        return whole
    return 2 * changed(law, damping_n_s_per_m=0.0).force_n(eta_m, rate_m_per_s, *time_s) - whole


def more_n(
    law: ContactLaw, eta_m: Signal, rate_m_per_s: Signal | float, time_s: Signal | float = 0.0, **numbers: float
) -> Signal:
    """Increase of the force where numbers that it is proportional to grow by these shares."""
    more = changed(law, **{name: getattr(law, name) + by for name, by in numbers.items()})
    return more.force_n(eta_m, rate_m_per_s, time_s) - law.force_n(eta_m, rate_m_per_s, time_s)


def _times(law: JoinedLaw, signals: ContactSignals) -> list[Float[np.ndarray, " samples"]]:
    """The time, where a law wears; else it is left out."""
    return [signals.time_s] if any(one.wear_m_per_s for one in law.laws) else []


def _beside(
    sparse: csr_matrix, weights: Float[np.ndarray, " rows"], dense: Float[np.ndarray, "rows columns"]
) -> csr_matrix:
    """Weighted rows of a spline, each with as many values as any other, with dense columns behind: `hstack`, faster."""
    (rows, knots), columns = sparse.shape, dense.shape[1]
    each = sparse.nnz // rows
    values = np.concatenate([sparse.data.reshape(rows, each) * weights[:, None], dense], axis=1)
    behind = np.broadcast_to(knots + np.arange(columns), (rows, columns))
    places = np.concatenate([sparse.indices.reshape(rows, each), behind], axis=1)
    ends = (each + columns) * np.arange(rows + 1)
    return csr_matrix((values.ravel(), places.ravel(), ends), shape=(rows, knots + columns))


def _beyond(pulls: Float[np.ndarray, " pulls"]) -> Float[np.ndarray, " pulls"]:
    """Excess of the law's tolerances beyond their limits."""
    return np.asarray(pulls - np.clip(pulls, -LIMIT, LIMIT))


def _between(values: Float[np.ndarray, " times"], factor: int) -> Float[np.ndarray, " samples"]:
    """Linear between samples, which slow motion is."""
    between = values[:-1, None] + np.diff(values)[:, None] * (np.arange(factor) / factor)
    return np.append(between, values[-1])
