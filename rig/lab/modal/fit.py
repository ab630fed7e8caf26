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
Modes = Float[np.ndarray, "modes 2"]


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


def lines_in_band(frequency_hz: Float[np.ndarray, " lines"], band_hz: tuple[float, ...]) -> Bool[np.ndarray, " lines"]:
    """Mask of the lines in a band LOW,HIGH, of all without one; raise RigError if it has not two ends."""
    if len(band_hz) not in (0, 2):
        raise RigError(f"band_hz has {len(band_hz)} numbers; give LOW,HIGH")
    low_hz, high_hz = band_hz or (-np.inf, np.inf)
    return np.asarray((frequency_hz >= low_hz) & (frequency_hz <= high_hz))


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
    above_zero = frequency_hz > 0
    hz, accelerance = frequency_hz[above_zero], accelerance[:, above_zero]
    with np.errstate(over="ignore"):
        frf_rms = np.sqrt(np.mean(np.abs(accelerance) ** 2, axis=1))
    if not (np.isfinite(frf_rms) & (frf_rms > 0)).all():
        raise RigError("an FRF is zero or too large for a number; leave its node out")
    if hz.size < 3 * POLYNOMIAL_ORDERS[0]:
        raise RigError(f"{hz.size} lines above 0 Hz are too few; give {3 * POLYNOMIAL_ORDERS[0]} or more")
    frfs = accelerance / frf_rms[:, None]
    step = max(1, hz.size // MAX_LINES)
    modes = _stable_modes(hz[::step], frfs[:, ::step])
    if not modes.size:
        raise RigError("no mode is found in the FRFs; check their band and noise")
    modes = _pruned_modes(hz, frfs, modes)
    while True:
        modes = _refined_modes(hz, frfs, modes)
        basis = _modal_basis(hz, modes)
        coefficients = basis_coefficients(basis, frfs)
        errors = np.abs(frfs - coefficients.T @ basis.T)
        is_significant = _significant_mask(hz, basis, modes, coefficients, errors, driving_index)
        if is_significant.all():
            break
        if not is_significant.any():
            raise RigError(
                "no mode stands out with a positive residue at the driving point; check its FRF's sign and direction"
            )
        modes = modes[is_significant]
    errors_of_modes = np.abs(frfs - coefficients[:-2].T @ basis[:, :-2].T)
    misfits, misfits_of_modes = (np.sqrt(np.mean(error**2, axis=1)) for error in (errors, errors_of_modes))
    residues = coefficients[:-2].T * frf_rms[:, None]
    return ModalFit(np.exp(modes[:, 0]), np.exp(modes[:, 1]), residues, misfits, misfits_of_modes)


def _stable_modes(frequency_hz: Lines, frfs: Frfs) -> Modes:
    """(ln f, ln z) of the poles that are stable from order to order."""
    stable, previous, order_count = [], np.zeros((0, 2)), 0
    products, projections = _denominator_equations(frequency_hz, frfs)
    for order in POLYNOMIAL_ORDERS:
        if 3 * order > frequency_hz.size:
            break
        leading = slice(order + 1)
        projection = projections[:, leading, leading].reshape(-1, order + 1)
        poles = _poles(frequency_hz, products[leading, leading] - projection.conj().T @ projection)
        is_stable = np.abs(poles[:, None] - previous[None]) < (FREQUENCY_TOLERANCE, DAMPING_TOLERANCE)
        stable.append(poles[np.any(np.all(is_stable, axis=2), axis=1)])
        previous, order_count = poles, order_count + 1
    all_poles = np.concatenate(stable)
    all_poles = all_poles[np.argsort(all_poles[:, 0])]
    poles_by_mode = np.split(all_poles, np.flatnonzero(np.diff(all_poles[:, 0]) > FREQUENCY_TOLERANCE) + 1)
    medians = [np.median(group, axis=0) for group in poles_by_mode if len(group) >= MIN_STABLE_SHARE * order_count]
    return np.array(medians).reshape(-1, 2)


def _denominator_equations(
    frequency_hz: Lines, frfs: Frfs
) -> tuple[Complex[np.ndarray, "n n"], Complex[np.ndarray, "frfs n n"]]:
    """Equations sum_r b_or z^r - a_o sum_r d_r z^r = 0 with z = exp(-i pi (f - f0) / (1.02 band)), in least squares:
    the products of the a_o z^r, summed over the FRFs, and their projections on an orthonormal basis of the z^r.

    The leading columns of both are those of a lower order; b is eliminated by the difference of their squares.
    """
    first_hz, alias_hz = frequency_hz[0], 1.02 * (frequency_hz[-1] - frequency_hz[0])
    exponents = np.arange(POLYNOMIAL_ORDERS[-1] + 1)
    powers = np.exp(-1j * np.pi * (frequency_hz - first_hz)[:, None] / alias_hz * exponents)
    orthonormal_basis = np.linalg.qr(powers)[0].conj().T
    products, projections = np.zeros((powers.shape[1],) * 2, dtype=complex), []
    for frf in frfs:
        frf_powers = frf[:, None] * powers
        products += frf_powers.conj().T @ frf_powers
        projections.append(orthonormal_basis @ frf_powers)
    return products, np.array(projections)


def _poles(frequency_hz: Lines, normal_matrix: Complex[np.ndarray, "n n"]) -> Float[np.ndarray, "poles 2"]:
    """(ln f, ln z) of the damped poles in the band, from the normal equations of one order."""
    first_hz, alias_hz = frequency_hz[0], 1.02 * (frequency_hz[-1] - frequency_hz[0])
    higher_coefficients = np.linalg.lstsq(normal_matrix[1:, 1:], -normal_matrix[1:, 0], rcond=None)[0]
    roots = np.roots(np.append(1.0, higher_coefficients)[::-1])
    roots = roots[np.abs(roots) > 0]
    poles = -np.log(roots) * 2 * alias_hz + 2j * np.pi * first_hz
    in_band = (poles.imag > 2 * np.pi * first_hz) & (poles.imag < 2 * np.pi * frequency_hz[-1])
    poles = poles[in_band]
    ratios = -poles.real / np.abs(poles)
    is_damped = (ratios > 0) & (ratios < MAX_DAMPING_RATIO)
    return np.log(np.stack([np.abs(poles[is_damped]) / (2 * np.pi), ratios[is_damped]], axis=1))


def _pruned_modes(frequency_hz: Lines, frfs: Frfs, modes: Modes) -> Float[np.ndarray, "fewer 2"]:
    """Modes after removing, one by one, those without which N log(sum of squares) + parameters log(N) is lower."""

    def information_criterion(candidate: Float[np.ndarray, "some 2"]) -> float:
        basis = _modal_basis(frequency_hz, candidate)
        square_sum = float(np.sum(np.abs(frfs - basis_coefficients(basis, frfs).T @ basis.T) ** 2))
        data_count = 2 * frfs.size
        return data_count * np.log(max(square_sum, 1e-300)) + len(candidate) * (len(frfs) + 2) * np.log(data_count)

    least_criterion = information_criterion(modes)
    while len(modes) > 1:
        candidates = [np.delete(modes, k, axis=0) for k in range(len(modes))]
        criteria = [information_criterion(candidate) for candidate in candidates]
        if min(criteria) >= least_criterion:
            break
        least_criterion, modes = min(criteria), candidates[int(np.argmin(criteria))]
    return modes


def _significant_mask(
    frequency_hz: Lines,
    basis: Complex[np.ndarray, "lines terms"],
    modes: Modes,
    coefficients: Float[np.ndarray, "terms frfs"],
    errors: Float[np.ndarray, "frfs lines"],
    driving_index: int,
) -> Bool[np.ndarray, " modes"]:
    """Mask of modes with a positive residue at the driving point, in the band, and above the rms error."""
    natural_hz = np.exp(modes[:, 0])
    nearest = np.argsort(np.abs(frequency_hz[:, None] - natural_hz), axis=0)[:NEAREST_LINE_COUNT]
    peak_heights = np.median(np.abs(np.take_along_axis(basis[:, : len(modes)], nearest, axis=0)), axis=0)
    height_to_error = np.abs(coefficients[:-2]) * peak_heights[:, None] / np.sqrt(np.mean(errors**2, axis=1))
    in_band = (natural_hz > frequency_hz[0]) & (natural_hz < frequency_hz[-1])
    is_high = height_to_error.max(axis=1) > MIN_HEIGHT_TO_ERROR
    return np.asarray((coefficients[:-2, driving_index] > 0) & in_band & is_high)


def _refined_modes(frequency_hz: Lines, frfs: Frfs, modes: Modes) -> Modes:
    """Modes (ln f, ln z) that minimise the sum of squares near the given ones."""

    def residual(unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        basis = _modal_basis(frequency_hz, unknowns.reshape(-1, 2))
        error = frfs - basis_coefficients(basis, frfs).T @ basis.T
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    half_widths, scales = np.tile(REFINEMENT_RANGE, len(modes)), np.tile([1e-3, 1e-1], len(modes))
    start = modes.ravel()
    bounds = (start - half_widths, start + half_widths)
    solution = scipy.optimize.least_squares(residual, start, bounds=bounds, x_scale=scales, max_nfev=30)
    refined = solution.x.reshape(-1, 2)
    return np.asarray(refined[np.argsort(refined[:, 0])])


def _modal_basis(frequency_hz: Lines, modes: Modes) -> Complex[np.ndarray, "lines terms"]:
    """Accelerance of a unit residue of each mode, of unit u and of unit l."""
    omega, omega_k, ratios = (2 * np.pi * frequency_hz[:, None], 2 * np.pi * np.exp(modes[:, 0]), np.exp(modes[:, 1]))
    mode_accelerance = -(omega**2) / (omega_k**2 - omega**2 + 2j * ratios * omega_k * omega)
    return np.concatenate([mode_accelerance, -(omega**2) / omega_k.max() ** 2, np.ones_like(omega)], axis=1)


def basis_coefficients(
    basis: Complex[np.ndarray, "lines terms"], frfs: Complex[np.ndarray, "frfs lines"]
) -> Float[np.ndarray, "terms frfs"]:
    """Real least-squares coefficients of the basis."""
    real_basis, real_frfs = np.concatenate([basis.real, basis.imag]), np.concatenate([frfs.real, frfs.imag], axis=1).T
    return np.asarray(np.linalg.lstsq(real_basis, real_frfs, rcond=None)[0])
