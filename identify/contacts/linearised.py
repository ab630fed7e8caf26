"""The residual of one separated force at some parameters, and its derivatives."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_matrix, diags

from identify.contacts.start import LAW, ContactRecord, Law
from identify.signals.drift import Spline
from identify.signals.law_evaluation import evaluated
from identify.signals.spectra import decimated
from rig.model.contact_laws import DeadZone

AT_ONCE = 1 << 14
"""So many samples of single precision are taken in double at once."""

Knots = Float[np.ndarray, " knots"]
Pulls = Float[np.ndarray, " nuisances"]


@dataclass(frozen=True)
class State:
    """Parameters, the residual there and its cost; by_eta is the low-passed slope of the law."""

    law: Law
    knots: Knots
    pulls: Pulls
    residual: Float[np.ndarray, " fewer"]
    by_eta: Float[np.ndarray, " fewer"]
    cost: float = np.inf

    @property
    def stiffness_n_per_m(self) -> float:
        """Of the contact that closes first."""
        lower, upper, stiffness, _ = self.law.reshape(-1, len(LAW)).T
        return float(stiffness[np.argmin(np.minimum(lower, upper))])


@dataclass(frozen=True)
class Jacobian:
    """Of the fitted force: by the drift's knots, the nuisance parameters, and the law.

    The low-pass acts on the slope of the law; the drift is slow against it.
    """

    by_knots: csr_matrix
    by_pulls: Float[np.ndarray, "fewer nuisances"]
    by_law: Float[np.ndarray, "fewer laws"]

    def times(
        self, knots: Float[np.ndarray, "knots columns"], others: Float[np.ndarray, "others columns"]
    ) -> Float[np.ndarray, "fewer columns"]:
        """others are the nuisance parameters, then the law's."""
        pulls = self.by_pulls.shape[1]
        of_pulls = np.concatenate([self.by_pulls[part] @ others[:pulls] for part in parts(len(self.by_law))])
        return np.asarray(self.by_knots @ knots + of_pulls + self.by_law @ others[pulls:])


def parts(samples: int) -> Iterator[slice]:
    return (slice(first, first + AT_ONCE) for first in range(0, samples, AT_ONCE))


def law_force_n(
    law: Law, eta_m: Float[np.ndarray, "*samples"], rate_m_per_s: Float[np.ndarray, "*samples"]
) -> Float[np.ndarray, "*samples"]:
    """The sum over the contacts: stiffness and damping, of any sign, times what a `DeadZone` makes of one of each."""
    force = np.zeros_like(eta_m)
    for one in law.reshape(-1, len(LAW)):
        _, _, stiffness, damping = one
        by_stiffness, by_damping = by_stiffness_and_damping(one, eta_m, rate_m_per_s)
        force += stiffness * by_stiffness + damping * by_damping
    return force


def by_stiffness_and_damping(
    law: Law, eta_m: Float[np.ndarray, "*samples"], rate: Float[np.ndarray, "*samples"]
) -> tuple[Float[np.ndarray, "*samples"], Float[np.ndarray, "*samples"]]:
    lower, upper, _, _ = law.tolist()
    spring, damper = (
        DeadZone(lower_clearance_m=lower, upper_clearance_m=upper, stiffness_n_per_m=k, damping_n_s_per_m=c)
        for k, c in ((1.0, 0.0), (0.0, 1.0))
    )
    return spring.force_n(eta_m), damper.force_n(eta_m, rate)


def state_at(seen: ContactRecord, curve: Spline, law: Law, knots: Knots, pulls: Pulls) -> State:
    """Without a cost, which takes weights."""
    eta, velocity = moved(seen, curve, knots, pulls)
    fitted = evaluated(partial(law_force_n, law), np.stack([eta, velocity]), seen.sample_rate_hz, seen.factor)
    unfitted = seen.force_n - _summed(pulls, seen.nuisance_n) - fitted[: seen.force_n.size]
    fast = unfitted / (1 - pulls @ seen.noise_in_n)
    stiffness, _ = _slopes(law, eta)
    return State(law, knots, pulls, fast - held_n(seen, curve) @ knots, _fewer(seen, stiffness))


def moved(
    seen: ContactRecord, curve: Spline, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """The relative displacement with drift and nuisance parameters, and its rate."""
    drift, rate = drift_of(seen, curve, knots, pulls)
    return seen.eta_m + drift, seen.velocity_m_per_s + rate


def drift_of(
    seen: ContactRecord, curve: Spline, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """What the knots and the nuisance parameters add to the relative displacement, and to its rate."""
    moving = pulls[seen.moving]
    kept, nuisance_m = 1 - moving @ seen.noise_in_m, _summed(moving, seen.nuisance_m)
    return kept * (curve.value @ knots) - nuisance_m, kept * (curve.rate @ knots) - seen.rate_of(nuisance_m)


def _summed(
    shares: Float[np.ndarray, " rows"], rows: Float[np.ndarray, "rows samples"]
) -> Float[np.ndarray, " samples"]:
    """Their product, without taking all rows in double precision at once."""
    total = np.zeros(rows.shape[1])
    for share, row in zip(shares, rows, strict=True):
        total += share * row
    return total


def jacobian(seen: ContactRecord, curve: Spline, state: State) -> Jacobian:
    """At a state."""
    eta, velocity = moved(seen, curve, state.knots, state.pulls)
    by_stiffness, by_damping = _slopes(state.law, eta)
    by_law = []
    for one in state.law.reshape(-1, len(LAW)):
        lower, upper, stiffness, _ = one
        by_law += [
            stiffness * (eta < -lower),
            -stiffness * (eta > upper),
            *by_stiffness_and_damping(one, eta, velocity),
        ]
    by_drift = diags(state.by_eta) @ curve.value[:: seen.factor][: seen.force_n.size]
    fast, slow_n = state.residual + held_n(seen, curve) @ state.knots, by_drift @ state.knots
    by_pulls = seen.nuisance_n.astype(np.float32)  # a copy
    for index, noise in enumerate(seen.noise_in_n):
        by_pulls[index] -= noise * fast
    for row, nuisance_m, noise in zip(np.flatnonzero(seen.moving), seen.nuisance_m, seen.noise_in_m, strict=True):
        pushed = by_stiffness * nuisance_m + by_damping * seen.rate_of(nuisance_m)
        by_pulls[row] -= _fewer(seen, pushed) + noise * slow_n
    kept = 1 - state.pulls @ seen.noise_in_n
    by_pulls /= np.float32(kept)
    drift_kept = 1 - state.pulls[seen.moving] @ seen.noise_in_m
    return Jacobian(
        by_knots=drift_kept / kept * by_drift + held_n(seen, curve),
        by_pulls=by_pulls.T,
        by_law=np.stack([_fewer(seen, row) for row in by_law], axis=1) / kept,
    )


def _slopes(
    law: Law, eta_m: Float[np.ndarray, " samples"]
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Stiffness and damping of the contacts that are closed."""
    by_stiffness, by_damping = np.zeros_like(eta_m), np.zeros_like(eta_m)
    for lower, upper, stiffness, damping in law.reshape(-1, len(LAW)):
        closed = (eta_m > upper) | (eta_m < -lower)
        by_stiffness += stiffness * closed
        by_damping += damping * closed
    return by_stiffness, by_damping


def held_n(seen: ContactRecord, curve: Spline) -> csr_matrix:
    """The force of the spring and the damper to the ground, by the knots."""
    if not (seen.spring_n_per_m or seen.damper_n_s_per_m):
        return csr_matrix((seen.force_n.size, curve.knots))
    value, rate = (rows[:: seen.factor][: seen.force_n.size] for rows in (curve.value, curve.rate))
    return seen.spring_n_per_m * value + seen.damper_n_s_per_m * rate


def _fewer(seen: ContactRecord, signal: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " fewer"]:
    """As the separated force was low-passed."""
    return decimated(signal, seen.factor)[: seen.force_n.size]
