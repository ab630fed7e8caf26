"""Linearization of the fit of one separated force: residual, Jacobian, and normal equations, which are banded in the
drift's knots and dense in the nuisance parameters and the law's."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_matrix, diags, spmatrix

from identify.contacts.contact_record import ContactRecord
from identify.contacts.law_form import LawForm, LawParameters
from identify.contacts.refusals import RefusalCode, refused
from identify.signals.drift import Spline
from identify.signals.law_evaluation import evaluated
from identify.signals.spectra import decimated

CHUNK_SAMPLES = 1 << 14
"""Samples of single precision that are converted to double at once."""
BAND = 3
"""Knots further apart than this share no sample."""

Knots = Float[np.ndarray, " knots"]
Pulls = Float[np.ndarray, " nuisances"]
Guess = tuple[LawParameters, Knots]
"""Start of a fit: the law, and the drift's knots."""


@runtime_checkable
class Weighed(Protocol):
    """Record of a fit: `sample_ratio` as that of a `ContactRecord`."""

    @property
    def sample_ratio(self) -> float: ...


@runtime_checkable
class Linearized(Protocol):
    """Parameters of a fit with the residual there."""

    @property
    def knots(self) -> Knots: ...

    @property
    def pulls(self) -> Pulls: ...

    @property
    def residual(self) -> Float[np.ndarray, " fewer"]: ...


@dataclass(frozen=True)
class State:
    """Parameters of a fit with residual and cost there; by_eta is the low-passed stiffness of the law, N/m."""

    law_parameters: LawParameters
    knots: Knots
    pulls: Pulls
    residual: Float[np.ndarray, " fewer"]
    by_eta: Float[np.ndarray, " fewer"]
    form: LawForm
    cost: float = np.inf

    @property
    def stiffness_n_per_m(self) -> float:
        """Stiffness of the stop that closes first, N/m; of a spring without stops, its own."""
        contacts = self.form.contacts(self.law_parameters)
        stops = np.delete(contacts, self.form.springs, axis=0)
        lower, upper, stiffness, _ = (stops if len(stops) else contacts).T
        return float(stiffness[np.argmin(np.minimum(lower, upper))])

    @property
    def springs_n_per_m(self) -> float:
        """Stiffness of the springs beside stops, N/m; zero of a spring without stops."""
        springs = self.form.contacts(self.law_parameters)[list(self.form.springs), 2]
        return float(springs.sum()) if self.form.name != "spring" else 0.0


@dataclass(frozen=True)
class Jacobian:
    """Jacobian of the fitted force by the drift's knots, the nuisance parameters, and the law's.

    The low-pass acts on the derivatives of the law, as the drift is slow against them.
    """

    by_knots: csr_matrix
    by_pulls: Float[np.ndarray, "fewer nuisances"]
    by_law: Float[np.ndarray, "fewer laws"]

    def times(
        self, knots: Float[np.ndarray, "knots columns"], dense: Float[np.ndarray, "dense columns"]
    ) -> Float[np.ndarray, "fewer columns"]:
        """Jacobian times columns of knots and dense parameters: the nuisance parameters, then the law's."""
        pull_count = self.by_pulls.shape[1]
        of_pulls = np.concatenate([self.by_pulls[chunk] @ dense[:pull_count] for chunk in chunks(len(self.by_law))])
        return np.asarray(self.by_knots @ knots + of_pulls + self.by_law @ dense[pull_count:])


def chunks(samples: int) -> Iterator[slice]:
    """Slices of `CHUNK_SAMPLES` samples."""
    return (slice(first, first + CHUNK_SAMPLES) for first in range(0, samples, CHUNK_SAMPLES))


def state_at(
    record: ContactRecord, curve: Spline, form: LawForm, law_parameters: LawParameters, knots: Knots, pulls: Pulls
) -> State:
    """State at some parameters; its cost, which needs weights, is left infinite."""
    eta, velocity = corrected_motion(record, curve, knots, pulls)
    fitted = evaluated(
        partial(form.force_n, law_parameters), np.stack([eta, velocity]), record.sample_rate_hz, record.factor
    )
    unfitted = record.force_n - _weighted_sum(pulls, record.nuisance_n) - fitted[: record.force_n.size]
    force_residual = unfitted / (1 - pulls @ record.noise_in_n)
    stiffness, _ = form.slopes(law_parameters, eta, velocity)
    return State(
        law_parameters,
        knots,
        pulls,
        force_residual - ground_force_n(record, curve) @ knots,
        _low_passed(record, stiffness),
        form,
    )


def corrected_motion(
    record: ContactRecord, curve: Spline, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Relative displacement with drift and nuisance signals, m, and its rate, m/s."""
    drift, rate = drift_signals(record, curve, knots, pulls)
    return record.eta_m + drift, record.velocity_m_per_s + rate


def drift_signals(
    record: ContactRecord, curve: Spline, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Drift signals h b - theta' nuisance_m, m, and their rate, m/s, with h = 1 - theta' noise_in_m."""
    moving = pulls[record.moving]
    motion_gain, nuisance_m = 1 - moving @ record.noise_in_m, _weighted_sum(moving, record.nuisance_m)
    nuisance_m_per_s = record.velocity_of(nuisance_m)
    return motion_gain * (curve.value @ knots) - nuisance_m, motion_gain * (curve.rate @ knots) - nuisance_m_per_s


def _weighted_sum(
    shares: Float[np.ndarray, " rows"], rows: Float[np.ndarray, "rows samples"]
) -> Float[np.ndarray, " samples"]:
    """Product shares @ rows, without converting all rows to double precision at once."""
    total = np.zeros(rows.shape[1])
    for share, row in zip(shares, rows, strict=True):
        total += share * row
    return total


def jacobian(record: ContactRecord, curve: Spline, state: State) -> Jacobian:
    """Jacobian of the fitted force at a state."""
    eta, velocity = corrected_motion(record, curve, state.knots, state.pulls)
    by_stiffness, by_damping = state.form.slopes(state.law_parameters, eta, velocity)
    by_law = state.form.derivatives(state.law_parameters, eta, velocity)
    by_drift = diags(state.by_eta) @ curve.value[:: record.factor][: record.force_n.size]
    force_residual, slow_n = state.residual + ground_force_n(record, curve) @ state.knots, by_drift @ state.knots
    by_pulls = record.nuisance_n.astype(np.float32)  # a copy
    for index, noise in enumerate(record.noise_in_n):
        by_pulls[index] -= noise * force_residual
    for row, nuisance_m, noise in zip(np.flatnonzero(record.moving), record.nuisance_m, record.noise_in_m, strict=True):
        force_change = by_stiffness * nuisance_m + by_damping * record.velocity_of(nuisance_m)
        by_pulls[row] -= _low_passed(record, force_change) + noise * slow_n
    force_gain = 1 - state.pulls @ record.noise_in_n
    by_pulls /= np.float32(force_gain)
    motion_gain = 1 - state.pulls[record.moving] @ record.noise_in_m
    return Jacobian(
        by_knots=motion_gain / force_gain * by_drift + ground_force_n(record, curve),
        by_pulls=by_pulls.T,
        by_law=np.stack([_low_passed(record, row) for row in by_law], axis=1) / force_gain,
    )


def ground_force_n(record: ContactRecord, curve: Spline) -> csr_matrix:
    """Force of the spring and the damper to the ground by the drift's knots, samples x knots."""
    if not (record.spring_n_per_m or record.damper_n_s_per_m):
        return csr_matrix((record.force_n.size, curve.knots))
    value, rate = (rows[:: record.factor][: record.force_n.size] for rows in (curve.value, curve.rate))
    return record.spring_n_per_m * value + record.damper_n_s_per_m * rate


def _low_passed(record: ContactRecord, signal: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " fewer"]:
    """Signal low-passed and decimated like the separated force."""
    return decimated(signal, record.factor)[: record.force_n.size]


@dataclass(frozen=True)
class BorderedEquations:
    """Normal equations [A B; B' C] [knots; dense] = right-hand side, solved by elimination of the knots.

    `cholesky` is the factor of the banded A, `mixed` is B, `eliminated` A^-1 B, `schur_inverse` (C - B' A^-1 B)^-1.
    """

    cholesky: Float[np.ndarray, "band knots"]
    mixed: Float[np.ndarray, "knots dense"]
    eliminated: Float[np.ndarray, "knots dense"]
    schur_inverse: Float[np.ndarray, "dense dense"]

    def solved(
        self, knots: Float[np.ndarray, "knots columns"], dense: Float[np.ndarray, "dense columns"]
    ) -> tuple[Float[np.ndarray, "knots columns"], Float[np.ndarray, "dense columns"]]:
        """Solution for a right-hand side: knots, and dense parameters."""
        by_knots = cho_solve_banded((self.cholesky, False), knots) if knots.size else knots
        dense_solution = self.schur_inverse @ (dense - self.mixed.T @ by_knots)
        return by_knots - self.eliminated @ dense_solution, dense_solution


def normal_equations(
    record: Weighed,
    state: Linearized,
    derivatives: Jacobian,
    curve: Spline,
    to_law: Float[np.ndarray, "laws free"],
    weights: Float[np.ndarray, " fewer"],
    band: int = BAND,
) -> tuple[BorderedEquations, Float[np.ndarray, "knots 1"], Float[np.ndarray, "dense 1"]]:
    """Normal equations and their right-hand side, for the knots and for the nuisance and the law's free parameters.

    Raises ContactRefusedError if they are singular.
    """
    pull_count, free = state.pulls.size, to_law.shape[1]
    dense_block = np.diag(np.r_[np.full(pull_count, record.sample_ratio), np.zeros(free)])
    gradient = np.r_[-record.sample_ratio * state.pulls, np.zeros(free)]
    mixed, weighted_residual = np.zeros((curve.knots, pull_count + free)), weights * state.residual
    by_knots = csr_matrix(diags(weights) @ derivatives.by_knots)
    for chunk in chunks(weighted_residual.size):
        rows = np.concatenate([derivatives.by_pulls[chunk], derivatives.by_law[chunk] @ to_law], axis=1)
        rows *= weights[chunk, None]
        dense_block += rows.T @ rows
        gradient += rows.T @ weighted_residual[chunk]
        if curve.knots:
            mixed += by_knots[chunk].T @ rows
    of_knots = by_knots.T @ weighted_residual + curve.curvature.T @ (curve.target - curve.curvature @ state.knots)
    try:
        cholesky = _banded(by_knots.T @ by_knots + curve.curvature.T @ curve.curvature, band)
        eliminated = cho_solve_banded((cholesky, False), mixed) if curve.knots else mixed
        schur_inverse = np.linalg.inv(dense_block - mixed.T @ eliminated)
    except LinAlgError as error:
        raise refused(RefusalCode.NO_LAW) from error
    return BorderedEquations(cholesky, mixed, eliminated, schur_inverse), of_knots[:, None], gradient[:, None]


def _banded(matrix: spmatrix, band: int) -> Float[np.ndarray, "band knots"]:
    """Cholesky factor of a symmetric matrix with `band` diagonals on either side."""
    knot_count = matrix.shape[0]
    upper = np.zeros((band + 1, knot_count))
    for diagonal in range(min(band + 1, knot_count)):
        upper[band - diagonal, diagonal:] = matrix.diagonal(diagonal)
    return np.asarray(cholesky_banded(upper)) if knot_count else upper
