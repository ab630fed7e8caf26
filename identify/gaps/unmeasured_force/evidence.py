"""Evidence J of a record for an unmeasured force: -2 ln L of the whitened residual with and without the force.

With the direction u = g / |g| of the response g to a unit force, and t = u^H (r - D theta), the residual along it,

    J = n sum over lines [(R - 1) ln s + Q / s + ln(s + S |g|^2) + |t|^2 / (s + S |g|^2) + 2 Re tr' theta]
        + theta' theta

is -2 ln L up to a constant. The force has the spectrum S and the unexplained rest the variance s, both constant in
bands of 2 Hz (s = 1 where a line has one row only, which cannot separate it from S); Q = |r - D theta|^2 - |t|^2, with
R rows and n independent real values a line. J is minimised over s and S in turn with theta.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.linalg import cho_factor, cho_solve

from identify.gaps.unmeasured_force.whitened_record import WhitenedRecord

ROUNDS, SCORINGS = 4, 5
"""Rounds of s and S in turn with theta; steps of Fisher scoring within each. Effort."""
VARIANCE_FLOOR_SHARE = 1e-12
"""Smallest variance of a band, as a share of its squares. Numerical."""


@dataclass(frozen=True)
class ForceEvidence:
    """J at its minimum, with the estimates there; without a force S, |g| and t are zero.

    criterion is J, theta the nuisance parameters in tolerances, noise_variance s and force_spectrum S by band,
    response_norm |g| and projection t by line.
    """

    criterion: float
    theta: Float[np.ndarray, " columns"]
    noise_variance: Float[np.ndarray, " bands"]
    force_spectrum: Float[np.ndarray, " bands"]
    response_norm: Float[np.ndarray, " lines"]
    projection: Complex[np.ndarray, " lines"]


def _solve_positive_definite(
    matrix: Float[np.ndarray, "columns columns"], right_side: Float[np.ndarray, "columns"]
) -> Float[np.ndarray, "columns"]:
    return np.asarray(cho_solve(cho_factor(matrix), right_side))


def residual_squares(whitened: WhitenedRecord, theta: Float[np.ndarray, " columns"]) -> Float[np.ndarray, " bands"]:
    """Squares |r - D theta|^2 of the residual without nuisance, summed over each band."""
    return np.maximum(
        whitened.residual_squares - 2 * whitened.cross_products @ theta + (whitened.column_gram @ theta) @ theta,
        VARIANCE_FLOOR_SHARE * whitened.residual_squares,
    )


def nuisance_equations(
    whitened: WhitenedRecord, noise_variance: Float[np.ndarray, " bands"]
) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, " columns"]]:
    """Matrix and right side of the normal equations of theta at the noise variance s, without a force."""
    inverse_variances, count = 1 / noise_variance, len(whitened.nuisance_parameters)
    normal_matrix = whitened.reals_per_line * np.tensordot(inverse_variances, whitened.column_gram, 1) + np.eye(count)
    right_side = whitened.reals_per_line * (whitened.cross_products.T @ inverse_variances - whitened.trace_terms / 2)
    return normal_matrix, right_side


def evidence_without_force(whitened: WhitenedRecord) -> ForceEvidence:
    """Evidence of the record by nuisance parameters and noise alone: S = 0."""
    value_counts, is_noise_fixed = whitened.band_line_counts * whitened.row_count, whitened.row_count == 1
    theta = np.zeros(len(whitened.nuisance_parameters))
    noise_variance = np.ones(value_counts.size) if is_noise_fixed else whitened.residual_squares / value_counts
    for _ in range(3 * ROUNDS):
        theta = _solve_positive_definite(*nuisance_equations(whitened, noise_variance))
        if not is_noise_fixed:
            noise_variance = residual_squares(whitened, theta) / value_counts
    squares = residual_squares(whitened, theta)
    cost = float(np.sum(value_counts * np.log(noise_variance) + squares / noise_variance))
    criterion = whitened.reals_per_line * cost + _nuisance_penalty(whitened, theta)
    no_response, no_spectrum = np.zeros(whitened.whitened_residual.shape[0]), np.zeros(noise_variance.size)
    return ForceEvidence(criterion, theta, noise_variance, no_spectrum, no_response, no_response.astype(complex))


def evidence_with_force(
    whitened: WhitenedRecord,
    residual_response: Complex[np.ndarray, "lines rows"],
    start_evidence: ForceEvidence,
    cleared_residual: Complex[np.ndarray, "lines rows"] | None = None,
    spectrum_shape: Float[np.ndarray, " bands"] | None = None,
) -> ForceEvidence:
    """Evidence with a force to which the residual responds by g = `residual_response`; it starts from `start_evidence`.

    `cleared_residual` is r - D theta at the theta of `start_evidence`, which then stays fixed: fast, for screening.
    `spectrum_shape` is a spectrum S up to a factor; without one S is free in every band.
    """
    is_nuisance_held = cleared_residual is not None
    reals_per_line, at_lines = whitened.reals_per_line, whitened.at_each_line
    response_norm = np.linalg.norm(residual_response, axis=1)
    direction = residual_response.conj() / np.maximum(response_norm, 1e-300)[:, None]
    residual = whitened.whitened_residual if cleared_residual is None else cleared_residual
    residual_projection = np.einsum("lr,lr->l", direction, residual)
    projected_columns = np.zeros((len(whitened.nuisance_parameters), 0))
    if not is_nuisance_held:
        projected_columns = np.einsum("lr,clr->cl", direction, whitened.nuisance_columns)
    theta, noise_variance = start_evidence.theta, start_evidence.noise_variance
    force_spectrum = start_evidence.force_spectrum if np.any(start_evidence.force_spectrum) else None
    response_squares = response_norm**2
    for round_number in range(1 if is_nuisance_held else ROUNDS):
        projection = residual_projection if is_nuisance_held else residual_projection - theta @ projected_columns
        projection_power, total_squares = np.abs(projection) ** 2, residual_squares(whitened, theta)
        noise_variance, force_spectrum = _fisher_scored_noise_and_spectrum(
            whitened, response_squares, projection_power, total_squares, noise_variance, force_spectrum, spectrum_shape
        )
        line_variance = at_lines(noise_variance) + at_lines(force_spectrum) * response_squares
        if is_nuisance_held or round_number == ROUNDS - 1:
            break
        weight_loss = at_lines(1 / noise_variance) - 1 / line_variance
        normal_matrix, right_side = nuisance_equations(whitened, noise_variance)
        lost_columns = interleaved_real_imaginary(weight_loss * projected_columns)
        normal_matrix -= reals_per_line * (lost_columns @ interleaved_real_imaginary(projected_columns).T)
        right_side -= reals_per_line * (lost_columns @ interleaved_real_imaginary(residual_projection))
        theta = _solve_positive_definite(normal_matrix, right_side)
    assert force_spectrum is not None
    unexplained_squares = np.maximum(total_squares - _band_sums(whitened, projection_power), 0.0)
    unexplained_counts = whitened.band_line_counts * (whitened.row_count - 1)
    cost = float(
        np.sum(unexplained_counts * np.log(noise_variance) + unexplained_squares / noise_variance)
        + np.sum(np.log(line_variance) + projection_power / line_variance)
    )
    criterion = reals_per_line * cost + _nuisance_penalty(whitened, theta)
    return ForceEvidence(criterion, theta, noise_variance, force_spectrum, response_norm, projection)


def residual_without_nuisance(
    whitened: WhitenedRecord, theta: Float[np.ndarray, " columns"]
) -> Complex[np.ndarray, "lines rows"]:
    """Residual r - D theta, computed one column at a time to spare memory."""
    residual = whitened.whitened_residual.copy()
    for pull, column in zip(theta, whitened.nuisance_columns, strict=True):
        residual -= pull * column
    return residual


def _nuisance_penalty(whitened: WhitenedRecord, theta: Float[np.ndarray, " columns"]) -> float:
    """Terms of J in theta alone: the prior theta' theta, and n 2 Re tr' theta, as D is made from measured data."""
    return float(theta @ theta) + whitened.reals_per_line * float(whitened.trace_terms @ theta)


def interleaved_real_imaginary(complex_values: Complex[np.ndarray, "*rows lines"]) -> Float[np.ndarray, "*rows twice"]:
    """Real and imaginary parts, interleaved along the last axis."""
    return np.ascontiguousarray(complex_values).view(float)


def _band_sums(whitened: WhitenedRecord, line_values: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " bands"]:
    return np.asarray(np.add.reduceat(line_values, whitened.band_first_lines))


def _fisher_scored_noise_and_spectrum(
    whitened: WhitenedRecord,
    response_squares: Float[np.ndarray, " lines"],
    projection_power: Float[np.ndarray, " lines"],
    total_squares: Float[np.ndarray, " bands"],
    noise_variance: Float[np.ndarray, " bands"],
    force_spectrum: Float[np.ndarray, " bands"] | None,
    spectrum_shape: Float[np.ndarray, " bands"] | None,
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """Noise variance s and spectrum S by Fisher scoring, one in turn with the other, at a fixed theta.

    total_squares is |r - D theta|^2 by band and projection_power |t|^2 by line; without a spectrum, S starts from the
    excess of |t|^2 over s.
    """
    at_lines, is_noise_fixed = whitened.at_each_line, whitened.row_count == 1
    unexplained_squares = np.maximum(total_squares - _band_sums(whitened, projection_power), 0.0)
    unexplained_counts = whitened.band_line_counts * (whitened.row_count - 1)
    if force_spectrum is None:
        if not is_noise_fixed:
            noise_variance = np.maximum(unexplained_squares / unexplained_counts, VARIANCE_FLOOR_SHARE * noise_variance)
        excess_power = _band_sums(whitened, projection_power) - noise_variance * whitened.band_line_counts
        force_spectrum = np.maximum(excess_power, 0.0) / np.maximum(_band_sums(whitened, response_squares), 1e-300)
    for _ in range(SCORINGS):
        force_power = at_lines(force_spectrum) * response_squares
        if not is_noise_fixed:
            line_weights = 1 / (at_lines(noise_variance) + force_power) ** 2
            excess_power = _band_sums(whitened, line_weights * (projection_power - force_power))
            weighted_squares = unexplained_squares / noise_variance**2 + excess_power
            weighted_count = unexplained_counts / noise_variance**2 + _band_sums(whitened, line_weights)
            noise_variance = np.maximum(weighted_squares / weighted_count, VARIANCE_FLOOR_SHARE * noise_variance)
        line_noise = at_lines(noise_variance)
        line_weights = response_squares / (line_noise + force_power) ** 2
        if spectrum_shape is None:
            excess_power = np.maximum(_band_sums(whitened, line_weights * (projection_power - line_noise)), 0.0)
            power_per_spectrum = _band_sums(whitened, line_weights * response_squares)
            force_spectrum = excess_power / np.maximum(power_per_spectrum, 1e-300)
        else:
            line_shape = at_lines(spectrum_shape)
            shaped_excess = np.sum(line_weights * line_shape * (projection_power - line_noise))
            power_per_shape = float(np.sum(line_weights * response_squares * line_shape**2))
            force_spectrum = max(float(shaped_excess / max(power_per_shape, 1e-300)), 0.0) * spectrum_shape
    return noise_variance, force_spectrum
