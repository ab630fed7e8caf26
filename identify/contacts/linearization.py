"""The residual of one separated force at some parameters, its derivatives, and the normal equations of its fit, banded
in the drift's knots and dense in the other parameters."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix, diags, spmatrix

from identify.contacts.contact_record import ContactRecord, Law
from identify.contacts.law_form import LawForm
from identify.contacts.refusals import RefusalCode, refused
from identify.signals.drift import Spline
from identify.signals.law_evaluation import evaluated
from identify.signals.spectra import decimated

AT_ONCE = 1 << 14
"""So many samples of single precision are taken in double at once."""

BAND = 3
"""Knots further apart share no sample."""

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
    form: LawForm
    cost: float = np.inf

    @property
    def stiffness_n_per_m(self) -> float:
        """Stiffness of the contact that closes first, N/m."""
        lower, upper, stiffness, _ = self.form.contacts(self.law).T
        return float(stiffness[np.argmin(np.minimum(lower, upper))])


@dataclass(frozen=True)
class Jacobian:
    """Jacobian of the fitted force by the drift's knots, the nuisance parameters, and the law.

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


def state_at(record: ContactRecord, curve: Spline, form: LawForm, law: Law, knots: Knots, pulls: Pulls) -> State:
    """State without a cost, which takes weights."""
    eta, velocity = moved(record, curve, knots, pulls)
    fitted = evaluated(partial(form.force_n, law), np.stack([eta, velocity]), record.sample_rate_hz, record.factor)
    unfitted = record.force_n - _summed(pulls, record.nuisance_n) - fitted[: record.force_n.size]
    fast = unfitted / (1 - pulls @ record.noise_in_n)
    stiffness, _ = form.slopes(law, eta, velocity)
    return State(law, knots, pulls, fast - held_n(record, curve) @ knots, _fewer(record, stiffness), form)


def moved(
    record: ContactRecord, curve: Spline, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """The relative displacement with drift and nuisance parameters, and its rate."""
    drift, rate = drift_of(record, curve, knots, pulls)
    return record.eta_m + drift, record.velocity_m_per_s + rate


def drift_of(
    record: ContactRecord, curve: Spline, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Drift: what knots and nuisance parameters add to the relative displacement, and to its rate."""
    moving = pulls[record.moving]
    kept, nuisance_m = 1 - moving @ record.noise_in_m, _summed(moving, record.nuisance_m)
    return kept * (curve.value @ knots) - nuisance_m, kept * (curve.rate @ knots) - record.rate_of(nuisance_m)


def _summed(
    shares: Float[np.ndarray, " rows"], rows: Float[np.ndarray, "rows samples"]
) -> Float[np.ndarray, " samples"]:
    """Their product, without taking all rows in double precision at once."""
    total = np.zeros(rows.shape[1])
    for share, row in zip(shares, rows, strict=True):
        total += share * row
    return total


def jacobian(record: ContactRecord, curve: Spline, state: State) -> Jacobian:
    """Jacobian at a state."""
    eta, velocity = moved(record, curve, state.knots, state.pulls)
    by_stiffness, by_damping = state.form.slopes(state.law, eta, velocity)
    by_law = state.form.derivatives(state.law, eta, velocity)
    by_drift = diags(state.by_eta) @ curve.value[:: record.factor][: record.force_n.size]
    fast, slow_n = state.residual + held_n(record, curve) @ state.knots, by_drift @ state.knots
    by_pulls = record.nuisance_n.astype(np.float32)  # a copy
    for index, noise in enumerate(record.noise_in_n):
        by_pulls[index] -= noise * fast
    for row, nuisance_m, noise in zip(np.flatnonzero(record.moving), record.nuisance_m, record.noise_in_m, strict=True):
        pushed = by_stiffness * nuisance_m + by_damping * record.rate_of(nuisance_m)
        by_pulls[row] -= _fewer(record, pushed) + noise * slow_n
    kept = 1 - state.pulls @ record.noise_in_n
    by_pulls /= np.float32(kept)
    drift_kept = 1 - state.pulls[record.moving] @ record.noise_in_m
    return Jacobian(
        by_knots=drift_kept / kept * by_drift + held_n(record, curve),
        by_pulls=by_pulls.T,
        by_law=np.stack([_fewer(record, row) for row in by_law], axis=1) / kept,
    )


def held_n(record: ContactRecord, curve: Spline) -> csr_matrix:
    """The force of the spring and the damper to the ground, by the knots."""
    if not (record.spring_n_per_m or record.damper_n_s_per_m):
        return csr_matrix((record.force_n.size, curve.knots))
    value, rate = (rows[:: record.factor][: record.force_n.size] for rows in (curve.value, curve.rate))
    return record.spring_n_per_m * value + record.damper_n_s_per_m * rate


def _fewer(record: ContactRecord, signal: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " fewer"]:
    """Rows low-passed as the separated force was."""
    return decimated(signal, record.factor)[: record.force_n.size]


@dataclass(frozen=True)
class Normal:
    """The normal equations [A B; B' C] [knots; others] = right-hand side, by elimination of the knots.

    A is banded (`cholesky` of it), and kept is A^-1 B; rest is the inverse of C - B' A^-1 B.
    """

    cholesky: Float[np.ndarray, "band knots"]
    mixed: Float[np.ndarray, "knots others"]
    kept: Float[np.ndarray, "knots others"]
    rest: Float[np.ndarray, "others others"]

    def solved(
        self, knots: Float[np.ndarray, "knots columns"], others: Float[np.ndarray, "others columns"]
    ) -> tuple[Float[np.ndarray, "knots columns"], Float[np.ndarray, "others columns"]]:
        by_knots = cho_solve_banded((self.cholesky, False), knots) if knots.size else knots
        of_others = self.rest @ (others - self.mixed.T @ by_knots)
        return by_knots - self.kept @ of_others, of_others


def normal_equations(
    record: ContactRecord,
    state: State,
    derivatives: Jacobian,
    curve: Spline,
    to_law: Float[np.ndarray, "laws free"],
    weights: Float[np.ndarray, " fewer"],
) -> tuple[Normal, Float[np.ndarray, "knots 1"], Float[np.ndarray, "others 1"]]:
    """Normal equations with the descent's right-hand side: nuisance parameters, then the law's free ones.

    Raises ContactRefusedError if they are singular.
    """
    pulls, free = state.pulls.size, to_law.shape[1]
    of_others = np.diag(np.r_[np.full(pulls, record.sample_ratio), np.zeros(free)])
    gradient = np.r_[-record.sample_ratio * state.pulls, np.zeros(free)]
    mixed, left = np.zeros((curve.knots, pulls + free)), weights * state.residual
    by_knots = csr_matrix(diags(weights) @ derivatives.by_knots)
    for part in parts(left.size):
        rows = np.concatenate([derivatives.by_pulls[part], derivatives.by_law[part] @ to_law], axis=1)
        rows *= weights[part, None]
        of_others += rows.T @ rows
        gradient += rows.T @ left[part]
        if curve.knots:
            mixed += by_knots[part].T @ rows
    of_knots = by_knots.T @ left + curve.curvature.T @ (curve.target - curve.curvature @ state.knots)
    try:
        cholesky = _banded(by_knots.T @ by_knots + curve.curvature.T @ curve.curvature)
        kept = cho_solve_banded((cholesky, False), mixed) if curve.knots else mixed
        rest = np.linalg.inv(of_others - mixed.T @ kept)
    except LinAlgError as error:
        raise refused(RefusalCode.NO_LAW) from error
    return Normal(cholesky, mixed, kept, rest), of_knots[:, None], gradient[:, None]


def _banded(matrix: spmatrix) -> Float[np.ndarray, "band knots"]:
    """The Cholesky factor of a symmetric matrix with so many diagonals."""
    knots = matrix.shape[0]
    upper = np.zeros((BAND + 1, knots))
    for off in range(min(BAND + 1, knots)):
        upper[BAND - off, off:] = matrix.diagonal(off)
    return np.asarray(cholesky_banded(upper)) if knots else upper
