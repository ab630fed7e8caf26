"""Modes from measured frequency response functions (FRFs): LSCF, a stabilisation diagram, a nonlinear refinement."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from rig.errors import RigError

POLYNOMIAL_ORDERS = range(6, 62, 2)
"""Orders of the polynomials whose poles are compared."""
FREQUENCY_TOLERANCE, DAMPING_TOLERANCE = 5e-3, 0.4
"""Relative differences below which poles of two orders are the same; closer modes are not separated."""
MIN_STABLE_SHARE = 0.15
"""Least share of the orders in which the pole of a mode is stable."""
MAX_DAMPING_RATIO = 0.2
REFINEMENT_RANGE = (0.02, 1.5)
"""Largest changes of ln(frequency) and ln(damping ratio) by the refinement."""
NEAREST_LINE_COUNT, MIN_HEIGHT_TO_ERROR = 8, 2.0
"""A mode is significant if, in one FRF, its median over the nearest lines exceeds the rms error this many times."""
MAX_LINES = 4000
"""Largest number of lines in the search for poles; the refinement uses every line."""


Lines = Float[np.ndarray, " lines"]
Frfs = Complex[np.ndarray, "frfs lines"]
LogModes = Float[np.ndarray, "modes 2"]


@dataclass(frozen=True)
class ModalFit:
    """Modes of n FRFs a_o(w) = -w^2 (sum_k r_ok / (w_k^2 - w^2 + 2 i z_k w_k w) + u_o) + l_o, in the accelerance.

    The residues r_ok (1/kg) are real: normal modes. u_o and l_o stand for the modes above and below the band. The
    misfits are rms errors over the rms of the FRF, with u_o and l_o, and by the modes alone.
    """

    frequencies_hz: Float[np.ndarray, " modes"]
    damping_ratios: Float[np.ndarray, " modes"]
    residues: Float[np.ndarray, "frfs modes"]
    misfits: Float[np.ndarray, " frfs"]
    misfits_of_modes: Float[np.ndarray, " frfs"]

    def shapes(self, driving_index: int) -> Float[np.ndarray, "frfs modes"]:
        """Mass-normalised shapes r_ok / sqrt(r_dk) with the driving point d, 1/sqrt(kg)."""
        return np.asarray(self.residues / np.sqrt(self.residues[driving_index]))


def lines_in_band(line_hz: Float[np.ndarray, " lines"], band_hz: tuple[float, ...]) -> Bool[np.ndarray, " lines"]:
    """Mask of the lines in a band LOW,HIGH, of all without one; raise RigError if it has not two ends."""
    if len(band_hz) not in (0, 2):
        raise RigError(f"band_hz has {len(band_hz)} numbers; give LOW,HIGH")
    low_hz, high_hz = band_hz or (-np.inf, np.inf)
    return np.asarray((line_hz >= low_hz) & (line_hz <= high_hz))


def fit_modes(
    frequency_hz: Float[np.ndarray, " lines"], accelerance: Complex[np.ndarray, "frfs lines"], driving_index: int
) -> ModalFit:
    """Modes in the band of accelerance FRFs, (m/s^2)/N; FRF number `driving_index` is that of the driving point.

    Poles come from the least-squares complex frequency-domain method (LSCF; Guillaume, Verboven and Vanlanduit, ISMA
    23, 1998): the common denominator of all FRFs at orders 6 to 60, of which stable poles are kept. Modes that
    do not lower the Bayesian information criterion are removed. Frequencies and damping ratios are then refined with
    residues eliminated (variable projection), and modes removed that are no normal modes, outside the band, or
    insignificant. Raises RigError if no mode remains.
    """
    is_above_zero = frequency_hz > 0
    line_hz, accelerance = frequency_hz[is_above_zero], accelerance[:, is_above_zero]
    with np.errstate(over="ignore"):
        frf_rms = np.sqrt(np.mean(np.abs(accelerance) ** 2, axis=1))
    if not (np.isfinite(frf_rms) & (frf_rms > 0)).all():
        raise RigError("an FRF is zero or too large for a number; leave its node out")
    if line_hz.size < 3 * POLYNOMIAL_ORDERS[0]:
        raise RigError(f"{line_hz.size} lines above 0 Hz are too few; give {3 * POLYNOMIAL_ORDERS[0]} or more")
    scaled_frfs = accelerance / frf_rms[:, None]
    line_step = max(1, line_hz.size // MAX_LINES)
    log_modes = _stable_modes(line_hz[::line_step], scaled_frfs[:, ::line_step])
    if not log_modes.size:
        raise RigError("no mode is found in the FRFs; check their band and noise")
    log_modes = _modes_pruned_by_bic(line_hz, scaled_frfs, log_modes)
    while True:
        log_modes = _refined_modes(line_hz, scaled_frfs, log_modes)
        modal_basis = _modal_basis(line_hz, log_modes)
        coefficients = real_least_squares_coefficients(modal_basis, scaled_frfs)
        frf_errors = np.abs(scaled_frfs - coefficients.T @ modal_basis.T)
        is_significant = _significant_mask(line_hz, modal_basis, log_modes, coefficients, frf_errors, driving_index)
        if is_significant.all():
            break
        if not is_significant.any():
            raise RigError(
                "no mode stands out with a positive residue at the driving point; check its FRF's sign and direction"
            )
        log_modes = log_modes[is_significant]
    errors_of_modes = np.abs(scaled_frfs - coefficients[:-2].T @ modal_basis[:, :-2].T)
    misfits, misfits_of_modes = (np.sqrt(np.mean(frf_error**2, axis=1)) for frf_error in (frf_errors, errors_of_modes))
    residues = coefficients[:-2].T * frf_rms[:, None]
    return ModalFit(np.exp(log_modes[:, 0]), np.exp(log_modes[:, 1]), residues, misfits, misfits_of_modes)


def _stable_modes(line_hz: Lines, frfs: Frfs) -> LogModes:
    """(ln f, ln z) of the poles that are stable from order to order."""
    stable_poles, previous_poles, order_count = [], np.zeros((0, 2)), 0
    products, projections = _lscf_products_and_projections(line_hz, frfs)
    for order in POLYNOMIAL_ORDERS:
        if 3 * order > line_hz.size:
            break
        leading_columns = slice(order + 1)
        projection = projections[:, leading_columns, leading_columns].reshape(-1, order + 1)
        poles = _pole_log_frequency_and_damping(
            line_hz, products[leading_columns, leading_columns] - projection.conj().T @ projection
        )
        is_stable = np.abs(poles[:, None] - previous_poles[None]) < (FREQUENCY_TOLERANCE, DAMPING_TOLERANCE)
        stable_poles.append(poles[np.any(np.all(is_stable, axis=2), axis=1)])
        previous_poles, order_count = poles, order_count + 1
    all_poles = np.concatenate(stable_poles)
    all_poles = all_poles[np.argsort(all_poles[:, 0])]
    poles_by_mode = np.split(all_poles, np.flatnonzero(np.diff(all_poles[:, 0]) > FREQUENCY_TOLERANCE) + 1)
    median_modes = [np.median(group, axis=0) for group in poles_by_mode if len(group) >= MIN_STABLE_SHARE * order_count]
    return np.array(median_modes).reshape(-1, 2)


def _lscf_products_and_projections(
    line_hz: Lines, frfs: Frfs
) -> tuple[Complex[np.ndarray, "n n"], Complex[np.ndarray, "frfs n n"]]:
    """Equations sum_r b_or z^r - a_o sum_r d_r z^r = 0 with z = exp(-i pi (f - f0) / (1.02 band)), in least squares:
    the products of the a_o z^r, summed over the FRFs, and their projections on an orthonormal basis of the z^r.

    The leading columns of both are those of a lower order; b is eliminated by the difference of their squares.
    """
    first_hz, alias_hz = line_hz[0], 1.02 * (line_hz[-1] - line_hz[0])
    exponents = np.arange(POLYNOMIAL_ORDERS[-1] + 1)
    z_powers = np.exp(-1j * np.pi * (line_hz - first_hz)[:, None] / alias_hz * exponents)
    orthonormal_basis = np.linalg.qr(z_powers)[0].conj().T
    product_matrix, projections = np.zeros((z_powers.shape[1],) * 2, dtype=complex), []
    for frf in frfs:
        frf_powers = frf[:, None] * z_powers
        product_matrix += frf_powers.conj().T @ frf_powers
        projections.append(orthonormal_basis @ frf_powers)
    return product_matrix, np.array(projections)


def _pole_log_frequency_and_damping(
    line_hz: Lines, normal_matrix: Complex[np.ndarray, "n n"]
) -> Float[np.ndarray, "poles 2"]:
    """(ln f, ln z) of the damped poles in the band, from the normal equations of one order."""
    first_hz, alias_hz = line_hz[0], 1.02 * (line_hz[-1] - line_hz[0])
    higher_coefficients = np.linalg.lstsq(normal_matrix[1:, 1:], -normal_matrix[1:, 0], rcond=None)[0]
    polynomial_roots = np.roots(np.append(1.0, higher_coefficients)[::-1])
    polynomial_roots = polynomial_roots[np.abs(polynomial_roots) > 0]
    poles = -np.log(polynomial_roots) * 2 * alias_hz + 2j * np.pi * first_hz
    is_in_band = (poles.imag > 2 * np.pi * first_hz) & (poles.imag < 2 * np.pi * line_hz[-1])
    poles = poles[is_in_band]
    damping_ratios = -poles.real / np.abs(poles)
    is_damped = (damping_ratios > 0) & (damping_ratios < MAX_DAMPING_RATIO)
    return np.log(np.stack([np.abs(poles[is_damped]) / (2 * np.pi), damping_ratios[is_damped]], axis=1))


def _modes_pruned_by_bic(line_hz: Lines, frfs: Frfs, log_modes: LogModes) -> Float[np.ndarray, "fewer 2"]:
    """Modes after removing, one by one, those without which N log(sum of squares) + parameters log(N) is lower."""

    def information_criterion(fewer_modes: Float[np.ndarray, "some 2"]) -> float:
        basis = _modal_basis(line_hz, fewer_modes)
        square_sum = float(np.sum(np.abs(frfs - real_least_squares_coefficients(basis, frfs).T @ basis.T) ** 2))
        data_count = 2 * frfs.size
        return data_count * np.log(max(square_sum, 1e-300)) + len(fewer_modes) * (len(frfs) + 2) * np.log(data_count)

    least_criterion = information_criterion(log_modes)
    while len(log_modes) > 1:
        candidates = [np.delete(log_modes, k, axis=0) for k in range(len(log_modes))]
        criteria = [information_criterion(fewer_modes) for fewer_modes in candidates]
        if min(criteria) >= least_criterion:
            break
        least_criterion, log_modes = min(criteria), candidates[int(np.argmin(criteria))]
    return log_modes


def _significant_mask(
    line_hz: Lines,
    mode_basis: Complex[np.ndarray, "lines terms"],
    log_modes: LogModes,
    coefficients: Float[np.ndarray, "terms frfs"],
    errors: Float[np.ndarray, "frfs lines"],
    driving_index: int,
) -> Bool[np.ndarray, " modes"]:
    """Mask of modes with a positive residue at the driving point, in the band, and above the rms error."""
    natural_hz = np.exp(log_modes[:, 0])
    nearest_lines = np.argsort(np.abs(line_hz[:, None] - natural_hz), axis=0)[:NEAREST_LINE_COUNT]
    peak_heights = np.median(np.abs(np.take_along_axis(mode_basis[:, : len(log_modes)], nearest_lines, axis=0)), axis=0)
    height_to_error = np.abs(coefficients[:-2]) * peak_heights[:, None] / np.sqrt(np.mean(errors**2, axis=1))
    is_in_band = (natural_hz > line_hz[0]) & (natural_hz < line_hz[-1])
    is_high = height_to_error.max(axis=1) > MIN_HEIGHT_TO_ERROR
    return np.asarray((coefficients[:-2, driving_index] > 0) & is_in_band & is_high)


def _refined_modes(line_hz: Lines, frfs: Frfs, log_modes: LogModes) -> LogModes:
    """Modes (ln f, ln z) that minimise the sum of squares near the given ones."""

    def real_errors(unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        basis = _modal_basis(line_hz, unknowns.reshape(-1, 2))
        error = frfs - real_least_squares_coefficients(basis, frfs).T @ basis.T
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    log_half_widths, unknown_scales = np.tile(REFINEMENT_RANGE, len(log_modes)), np.tile([1e-3, 1e-1], len(log_modes))
    log_start = log_modes.ravel()
    bounds = (log_start - log_half_widths, log_start + log_half_widths)
    solution = scipy.optimize.least_squares(real_errors, log_start, bounds=bounds, x_scale=unknown_scales, max_nfev=30)
    refined_modes = solution.x.reshape(-1, 2)
    return np.asarray(refined_modes[np.argsort(refined_modes[:, 0])])


def _modal_basis(line_hz: Lines, modes: LogModes) -> Complex[np.ndarray, "lines terms"]:
    """Accelerance of a unit residue of each mode, of unit u and of unit l."""
    omega, natural_omega, ratios = (2 * np.pi * line_hz[:, None], 2 * np.pi * np.exp(modes[:, 0]), np.exp(modes[:, 1]))
    mode_accelerance = -(omega**2) / (natural_omega**2 - omega**2 + 2j * ratios * natural_omega * omega)
    return np.concatenate([mode_accelerance, -(omega**2) / natural_omega.max() ** 2, np.ones_like(omega)], axis=1)


def real_least_squares_coefficients(
    basis: Complex[np.ndarray, "lines terms"], frfs: Complex[np.ndarray, "frfs lines"]
) -> Float[np.ndarray, "terms frfs"]:
    """Real least-squares coefficients of the basis."""
    real_basis, real_frfs = np.concatenate([basis.real, basis.imag]), np.concatenate([frfs.real, frfs.imag], axis=1).T
    return np.asarray(np.linalg.lstsq(real_basis, real_frfs, rcond=None)[0])
