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
from identify.signals.drift import DriftSpline
from identify.signals.law_evaluation import evaluated_law, evaluated_on_batches, finer_signal_batches
from identify.signals.spectra import at_force_rate

CHUNK_SAMPLES = 1 << 14
"""Samples of single precision that are converted to double at once."""

Knots = Float[np.ndarray, " knots"]
Pulls = Float[np.ndarray, " nuisances"]
LawGuess = tuple[LawParameters, Knots]
"""Start of a fit: the law, and the drift's knots."""


@runtime_checkable
class WeighedRecord(Protocol):
    """Record of a fit: `samples_per_error` and the prior of the slow motion as those of a
    `ContactRecord`."""

    @property
    def samples_per_error(self) -> float: ...

    @property
    def drift_spline(self) -> DriftSpline: ...


@runtime_checkable
class LinearizedState(Protocol):
    """Parameters of a fit with the residual there."""

    @property
    def knots(self) -> Knots: ...

    @property
    def pulls(self) -> Pulls: ...

    @property
    def residual_n(self) -> Float[np.ndarray, " fewer"]: ...


@dataclass(frozen=True)
class FitState:
    """Parameters of a fit with residual and cost there; tangent_n_per_m is the law's low-passed stiffness.

    pulls are those of the record's nuisance parameters, and behind them the onset of the damping.
    """

    law_parameters: LawParameters
    knots: Knots
    pulls: Pulls
    residual_n: Float[np.ndarray, " fewer"]
    tangent_n_per_m: Float[np.ndarray, " fewer"]
    form: LawForm
    cost: float = np.inf

    @property
    def onset(self) -> float:
        return float(self.pulls[-1])

    @property
    def nuisance_pulls(self) -> Pulls:
        return self.pulls[:-1]

    @property
    def stiffness_n_per_m(self) -> float:
        """Stiffness of the stop that closes first, N/m; of a spring without stops, its own."""
        law_values = self.form.contact_parameters(self.law_parameters)
        stop_values = np.delete(law_values, self.form.spring_indices, axis=0)
        lower_m, upper_m, stiffness, _ = (stop_values if len(stop_values) else law_values).T
        return float(stiffness[np.argmin(np.minimum(lower_m, upper_m))])

    @property
    def spring_n_per_m(self) -> float:
        """Stiffness of the springs beside stops, N/m; zero of a spring without stops."""
        spring_values = self.form.contact_parameters(self.law_parameters)[list(self.form.spring_indices)]
        return float(spring_values[:, 2].sum()) if self.form.name != "spring" else 0.0


@dataclass(frozen=True)
class Jacobian:
    """Jacobian of the fitted force by the drift's knots, the nuisance parameters, and the law's.

    The low-pass acts on the derivatives of the law, as the drift is slow against them.
    """

    by_knots: csr_matrix
    by_pulls: Float[np.ndarray, "fewer nuisances"]
    by_law: Float[np.ndarray, "fewer laws"]

    def times_columns(
        self, knots: Float[np.ndarray, "knots columns"], pulls_and_laws: Float[np.ndarray, "free columns"]
    ) -> Float[np.ndarray, "fewer columns"]:
        """Jacobian times columns of knots and of free parameters: the nuisance parameters, then the law's."""
        pull_count, chunks = self.by_pulls.shape[1], sample_chunks(len(self.by_law))
        pull_columns = np.concatenate([self.by_pulls[chunk] @ pulls_and_laws[:pull_count] for chunk in chunks])
        return np.asarray(self.by_knots @ knots + pull_columns + self.by_law @ pulls_and_laws[pull_count:])


def sample_chunks(sample_count: int) -> Iterator[slice]:
    """Slices of `CHUNK_SAMPLES` samples."""
    return (slice(first, first + CHUNK_SAMPLES) for first in range(0, sample_count, CHUNK_SAMPLES))


def state_at(
    record: ContactRecord, form: LawForm, law_parameters: LawParameters, knots: Knots, pulls: Pulls
) -> FitState:
    """State at some parameters; its cost, which needs weights, is left infinite."""
    nuisance_pulls, onset = pulls[:-1], float(pulls[-1])
    eta, velocity = corrected_motion(record, knots, nuisance_pulls)
    law_force_n = evaluated_law(
        partial(form.force_n, law_parameters, onset=onset),
        np.stack([eta, velocity]),
        record.sample_rate_hz,
        record.decimation,
    )
    unexplained_n = record.force_n - _weighted_sum(nuisance_pulls, record.nuisance_n)
    unexplained_n -= law_force_n[: record.force_n.size]
    force_residual_n = unexplained_n / (1 - nuisance_pulls @ record.force_noise_multiple)
    residual_n = force_residual_n - ground_n_per_m(record) @ knots
    tangent_n_per_m = _low_passed(record, form.tangent_n_per_m(law_parameters, eta, velocity))
    return FitState(law_parameters, knots, pulls, residual_n, tangent_n_per_m, form)


def corrected_motion(
    record: ContactRecord, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Relative displacement with drift and nuisance signals, m, and its rate, m/s."""
    drift_m, drift_m_per_s = drift_and_nuisance_motion(record, knots, pulls)
    return record.eta_m + drift_m, record.velocity_m_per_s + drift_m_per_s


def drift_and_nuisance_motion(
    record: ContactRecord, knots: Knots, pulls: Pulls
) -> tuple[Float[np.ndarray, " samples"], Float[np.ndarray, " samples"]]:
    """Drift signals h b - theta' nuisance_m, m, and their rate, m/s, with h = 1 - theta' eta_noise_multiple."""
    eta_pulls, spline = pulls[record.shifts_eta], record.drift_spline
    gain, nuisance_m = 1 - eta_pulls @ record.eta_noise_multiple, _weighted_sum(eta_pulls, record.nuisance_m)
    return gain * (spline.value @ knots) - nuisance_m, gain * (spline.rate @ knots) - record.velocity_of(nuisance_m)


def _weighted_sum(
    factors: Float[np.ndarray, " rows"], rows: Float[np.ndarray, "rows samples"]
) -> Float[np.ndarray, " samples"]:
    """Product factors @ rows, without converting all rows to double precision at once."""
    weighted_sum = np.zeros(rows.shape[1])
    for factor, row in zip(factors, rows, strict=True):
        weighted_sum += factor * row
    return weighted_sum


def jacobian(record: ContactRecord, state: FitState) -> Jacobian:
    """Jacobian of the fitted force at a state."""
    eta, velocity = corrected_motion(record, state.knots, state.nuisance_pulls)
    law = partial(state.form.derivatives, state.law_parameters, onset=state.onset)
    batches = finer_signal_batches(np.stack([eta, velocity]), record.sample_rate_hz)
    by_displacement, by_velocity, *by_law = evaluated_on_batches(law, batches, eta.size, record.sample_rate_hz)
    by_onset_n, *by_law = (_low_passed(record, derivative) for derivative in by_law)
    law_by_knots = diags(_low_passed(record, by_displacement)) @ record.at_force_samples(record.drift_spline.value)
    ground_matrix, drift_force_n = ground_n_per_m(record), law_by_knots @ state.knots
    force_residual_n = state.residual_n + ground_matrix @ state.knots
    by_pulls = np.concatenate([record.nuisance_n, by_onset_n[None]], dtype=np.float32, casting="same_kind")
    for k, noise_multiple in enumerate(record.force_noise_multiple):
        by_pulls[k] -= noise_multiple * force_residual_n
    for pull_index, nuisance_m, noise_multiple in zip(
        np.flatnonzero(record.shifts_eta), record.nuisance_m, record.eta_noise_multiple, strict=True
    ):
        force_change_n = by_displacement * nuisance_m + by_velocity * record.velocity_of(nuisance_m)
        by_pulls[pull_index] -= _low_passed(record, force_change_n) + noise_multiple * drift_force_n
    force_gain = 1 - state.nuisance_pulls @ record.force_noise_multiple
    by_pulls /= np.float32(force_gain)
    motion_gain = 1 - state.nuisance_pulls[record.shifts_eta] @ record.eta_noise_multiple
    return Jacobian(
        by_knots=motion_gain / force_gain * law_by_knots + ground_matrix,
        by_pulls=by_pulls.T,
        by_law=np.stack(by_law, axis=1) / force_gain,
    )


def ground_n_per_m(record: ContactRecord) -> csr_matrix:
    """Force of the spring and the damper to the ground, and the slow force, by the drift's knots, samples x knots."""
    spline = record.drift_spline
    knot_forces_n = record.at_force_samples(spline.force_n)
    if not (record.spring_n_per_m or record.damper_n_s_per_m):
        return knot_forces_n
    knot_values, knot_rates = record.at_force_samples(spline.value), record.at_force_samples(spline.rate)
    return record.spring_n_per_m * knot_values + record.damper_n_s_per_m * knot_rates + knot_forces_n


def _low_passed(record: ContactRecord, signal: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " fewer"]:
    """Signal low-passed and decimated like the separated force."""
    return at_force_rate(signal, record.decimation)[: record.force_n.size]


@dataclass(frozen=True)
class BorderedEquations:
    """Normal equations [A B; B' C] [knots; free] = right-hand side, solved by elimination of the knots.

    `knot_cholesky` is the factor of the banded A, `border` is B, `eliminated_border` A^-1 B, `schur_inverse`
    (C - B' A^-1 B)^-1, and the gradients are the right-hand side of a Gauss-Newton step.
    """

    knot_cholesky: Float[np.ndarray, "band knots"]
    border: Float[np.ndarray, "knots free"]
    eliminated_border: Float[np.ndarray, "knots free"]
    schur_inverse: Float[np.ndarray, "free free"]
    knot_gradient: Float[np.ndarray, "knots 1"]
    free_gradient: Float[np.ndarray, "free 1"]

    def solved(
        self, knot_right_side: Float[np.ndarray, "knots columns"], free_right_side: Float[np.ndarray, "free columns"]
    ) -> tuple[Float[np.ndarray, "knots columns"], Float[np.ndarray, "free columns"]]:
        """Solution for a right-hand side: knots, and free parameters."""
        knots_alone = knot_right_side
        if knot_right_side.size:
            knots_alone = cho_solve_banded((self.knot_cholesky, False), knot_right_side)
        free_solution = self.schur_inverse @ (free_right_side - self.border.T @ knots_alone)
        return knots_alone - self.eliminated_border @ free_solution, free_solution


def normal_equations(
    record: WeighedRecord,
    state: LinearizedState,
    derivatives: Jacobian,
    scaled_to_laws: Float[np.ndarray, "laws free"],
    weights: Float[np.ndarray, " fewer"],
) -> BorderedEquations:
    """Normal equations for the knots and for the nuisance and the law's free parameters.

    Raises ContactRefusedError if they are singular.
    """
    pull_count, free_count = state.pulls.size, scaled_to_laws.shape[1]
    free_block = np.diag(np.r_[np.full(pull_count, record.samples_per_error), np.zeros(free_count)])
    free_gradient = np.r_[-record.samples_per_error * state.pulls, np.zeros(free_count)]
    spline, weighted_residual = record.drift_spline, weights * state.residual_n
    border = np.zeros((spline.knot_count, pull_count + free_count))
    by_knots = csr_matrix(diags(weights) @ derivatives.by_knots)
    for chunk in sample_chunks(weighted_residual.size):
        free_rows = np.concatenate([derivatives.by_pulls[chunk], derivatives.by_law[chunk] @ scaled_to_laws], axis=1)
        free_rows *= weights[chunk, None]
        free_block += free_rows.T @ free_rows
        free_gradient += free_rows.T @ weighted_residual[chunk]
        if spline.knot_count:
            border += by_knots[chunk].T @ free_rows
    prior_residual = spline.curvature_target - spline.curvature @ state.knots
    knot_gradient = by_knots.T @ weighted_residual + spline.curvature.T @ prior_residual
    try:
        knot_cholesky = _banded_cholesky(by_knots.T @ by_knots + spline.curvature.T @ spline.curvature)
        eliminated_border = cho_solve_banded((knot_cholesky, False), border) if spline.knot_count else border
        schur_inverse = np.linalg.inv(free_block - border.T @ eliminated_border)
    except LinAlgError as error:
        raise refused(RefusalCode.NO_LAW) from error
    gradients = knot_gradient[:, None], free_gradient[:, None]
    return BorderedEquations(knot_cholesky, border, eliminated_border, schur_inverse, *gradients)


def _banded_cholesky(symmetric_matrix: spmatrix) -> Float[np.ndarray, "band knots"]:
    """Cholesky factor of a symmetric matrix with few diagonals."""
    entries, knot_count = symmetric_matrix.tocoo(), symmetric_matrix.shape[0]
    bandwidth = int(np.max(entries.col - entries.row, initial=0))
    band = np.zeros((bandwidth + 1, knot_count))
    for diagonal in range(bandwidth + 1):
        band[bandwidth - diagonal, diagonal:] = symmetric_matrix.diagonal(diagonal)
    return np.asarray(cholesky_banded(band)) if knot_count else band
