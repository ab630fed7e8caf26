"""Modes from measured frequency response functions (FRFs): LSCF, a stabilisation diagram, a nonlinear refinement."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from rig.errors import RigError

ORDERS = range(6, 62, 2)
"""Orders of the polynomials whose poles are compared."""
FREQUENCY_TOLERANCE, DAMPING_TOLERANCE = 5e-3, 0.4
"""Relative differences below which poles of two orders are the same; closer modes are not separated."""
MIN_STABLE_SHARE = 0.15
"""Least share of the orders in which the pole of a mode is stable."""
MAX_DAMPING = 0.2
REFINEMENT_RANGE = (0.02, 1.5)
"""Largest changes of ln(frequency) and ln(damping ratio) by the refinement."""
NEAREST_LINES, MIN_HEIGHT_TO_ERROR = 8, 2.0
"""A mode is significant if, in one FRF, its median over the nearest lines exceeds the rms error this many times."""
MAX_LINES = 4000
"""Largest number of lines in the search for poles; the refinement uses every line."""


@dataclass(frozen=True)
class ModalFit:
    """Modes of n FRFs a_o(w) = -w^2 (sum_k r_ok / (w_k^2 - w^2 + 2 i z_k w_k w) + u_o) + l_o, in the accelerance.

    The residues r_ok (1/kg) are real: normal modes. u_o and l_o stand for the modes above and below the band. The
    misfits are rms errors over the rms of the FRF, with u_o and l_o, and by the modes alone.
    """

    frequencies_hz: Float[np.ndarray, " modes"]
    ratios: Float[np.ndarray, " modes"]
    residues: Float[np.ndarray, "frfs modes"]
    misfit: Float[np.ndarray, " frfs"]
    misfit_of_modes: Float[np.ndarray, " frfs"]


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
    lines = frequency_hz > 0
    frequency_hz, accelerance = frequency_hz[lines], accelerance[:, lines]
    with np.errstate(over="ignore"):
        scale = np.sqrt(np.mean(np.abs(accelerance) ** 2, axis=1))
    if not (np.isfinite(scale) & (scale > 0)).all():
        raise RigError("an FRF is zero or too large for a number; leave its node out")
    if frequency_hz.size < 3 * ORDERS[0]:
        raise RigError(f"{frequency_hz.size} lines above 0 Hz are too few; give {3 * ORDERS[0]} or more")
    measured = accelerance / scale[:, None]
    thin = max(1, frequency_hz.size // MAX_LINES)
    modes = _stable_modes(frequency_hz[::thin], measured[:, ::thin])
    if not modes.size:
        raise RigError("no mode is found in the FRFs; check their band and noise")
    modes = _pruned(frequency_hz, measured, modes)
    while True:
        modes = _refined(frequency_hz, measured, modes)
        basis = _basis(frequency_hz, modes)
        coefficients = _least_squares(basis, measured)
        significant = _significant(
            frequency_hz, basis, modes, coefficients, np.abs(measured - coefficients.T @ basis.T), driving_index
        )
        if significant.all():
            break
        if not significant.any():
            raise RigError(
                "no mode stands out with a positive residue at the driving point; check its FRF's sign and direction"
            )
        modes = modes[significant]
    errors = [np.abs(measured - terms.T @ basis[:, : terms.shape[0]].T) for terms in (coefficients, coefficients[:-2])]
    misfit, of_modes = (np.sqrt(np.mean(error**2, axis=1)) for error in errors)
    residues = coefficients[:-2].T * scale[:, None]
    return ModalFit(np.exp(modes[:, 0]), np.exp(modes[:, 1]), residues, misfit, of_modes)


def _stable_modes(
    frequency_hz: Float[np.ndarray, " lines"], measured: Complex[np.ndarray, "frfs lines"]
) -> Float[np.ndarray, "modes 2"]:
    """(ln f, ln z) of the poles that are stable from order to order."""
    stable, previous, orders = [], np.zeros((0, 2)), 0
    squares, projected = _equations(frequency_hz, measured)
    for order in ORDERS:
        if 3 * order > frequency_hz.size:
            break
        leading = slice(order + 1)
        rows = projected[:, leading, leading].reshape(-1, order + 1)
        poles = _poles(frequency_hz, squares[leading, leading] - rows.conj().T @ rows)
        is_stable = np.abs(poles[:, None] - previous[None]) < (FREQUENCY_TOLERANCE, DAMPING_TOLERANCE)
        stable.append(poles[np.any(np.all(is_stable, axis=2), axis=1)])
        previous, orders = poles, orders + 1
    all_poles = np.concatenate(stable)
    all_poles = all_poles[np.argsort(all_poles[:, 0])]
    groups = np.split(all_poles, np.flatnonzero(np.diff(all_poles[:, 0]) > FREQUENCY_TOLERANCE) + 1)
    medians = [np.median(group, axis=0) for group in groups if len(group) >= MIN_STABLE_SHARE * orders]
    return np.array(medians).reshape(-1, 2)


def _equations(
    frequency_hz: Float[np.ndarray, " lines"], measured: Complex[np.ndarray, "frfs lines"]
) -> tuple[Complex[np.ndarray, "n n"], Complex[np.ndarray, "frfs n n"]]:
    """Equations sum_r b_or z^r - a_o sum_r d_r z^r = 0 with z = exp(-i pi (f - f0) / (1.02 band)), in least squares:
    the products of the a_o z^r, summed over the FRFs, and their projections on an orthonormal basis of the z^r.

    The leading columns of both are those of a lower order; b is eliminated by the difference of their squares.
    """
    first, band = frequency_hz[0], 1.02 * (frequency_hz[-1] - frequency_hz[0])
    powers = np.exp(-1j * np.pi * (frequency_hz - first)[:, None] / band * np.arange(ORDERS[-1] + 1))
    orthonormal = np.linalg.qr(powers)[0].conj().T
    squares, projected = np.zeros((powers.shape[1],) * 2, dtype=complex), []
    for row in measured:
        weighted = row[:, None] * powers
        squares += weighted.conj().T @ weighted
        projected.append(orthonormal @ weighted)
    return squares, np.array(projected)


def _poles(
    frequency_hz: Float[np.ndarray, " lines"], normal: Complex[np.ndarray, "n n"]
) -> Float[np.ndarray, "poles 2"]:
    """(ln f, ln z) of the damped poles in the band, from the normal equations of one order."""
    first, band = frequency_hz[0], 1.02 * (frequency_hz[-1] - frequency_hz[0])
    denominator = np.append(1.0, np.linalg.lstsq(normal[1:, 1:], -normal[1:, 0], rcond=None)[0])
    roots = np.roots(denominator[::-1])
    roots = roots[np.abs(roots) > 0]
    poles = -np.log(roots) * 2 * band + 2j * np.pi * first
    inside = (poles.imag > 2 * np.pi * first) & (poles.imag < 2 * np.pi * frequency_hz[-1])
    poles = poles[inside]
    ratios = -poles.real / np.abs(poles)
    damped = (ratios > 0) & (ratios < MAX_DAMPING)
    return np.log(np.stack([np.abs(poles[damped]) / (2 * np.pi), ratios[damped]], axis=1))


def _pruned(
    frequency_hz: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, "frfs lines"],
    modes: Float[np.ndarray, "modes 2"],
) -> Float[np.ndarray, "fewer 2"]:
    """Modes after removing, one by one, those without which N log(sum of squares) + parameters log(N) is lower."""

    def criterion(candidate: Float[np.ndarray, "some 2"]) -> float:
        basis = _basis(frequency_hz, candidate)
        squares = float(np.sum(np.abs(measured - _least_squares(basis, measured).T @ basis.T) ** 2))
        data = 2 * measured.size
        return data * np.log(max(squares, 1e-300)) + len(candidate) * (len(measured) + 2) * np.log(data)

    best = criterion(modes)
    while len(modes) > 1:
        candidates = [np.delete(modes, k, axis=0) for k in range(len(modes))]
        criteria = [criterion(candidate) for candidate in candidates]
        if min(criteria) >= best:
            break
        best, modes = min(criteria), candidates[int(np.argmin(criteria))]
    return modes


def _significant(
    frequency_hz: Float[np.ndarray, " lines"],
    basis: Complex[np.ndarray, "lines terms"],
    modes: Float[np.ndarray, "modes 2"],
    coefficients: Float[np.ndarray, "terms frfs"],
    errors: Float[np.ndarray, "frfs lines"],
    driving_index: int,
) -> Bool[np.ndarray, " modes"]:
    """Mask of modes with a positive residue at the driving point, in the band, and above the rms error."""
    natural_hz = np.exp(modes[:, 0])
    nearest = np.argsort(np.abs(frequency_hz[:, None] - natural_hz), axis=0)[:NEAREST_LINES]
    heights = np.median(np.abs(np.take_along_axis(basis[:, : len(modes)], nearest, axis=0)), axis=0)
    height_to_error = np.abs(coefficients[:-2]) * heights[:, None] / np.sqrt(np.mean(errors**2, axis=1))
    inside = (natural_hz > frequency_hz[0]) & (natural_hz < frequency_hz[-1])
    return np.asarray(
        (coefficients[:-2, driving_index] > 0) & inside & (height_to_error.max(axis=1) > MIN_HEIGHT_TO_ERROR)
    )


def _refined(
    frequency_hz: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, "frfs lines"],
    modes: Float[np.ndarray, "modes 2"],
) -> Float[np.ndarray, "modes 2"]:
    """Modes (ln f, ln z) that minimise the sum of squares near the given ones."""

    def residual(unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        basis = _basis(frequency_hz, unknowns.reshape(-1, 2))
        error = measured - _least_squares(basis, measured).T @ basis.T
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    half_widths, scales = np.tile(REFINEMENT_RANGE, len(modes)), np.tile([1e-3, 1e-1], len(modes))
    start = modes.ravel()
    solution = scipy.optimize.least_squares(
        residual, start, bounds=(start - half_widths, start + half_widths), x_scale=scales, max_nfev=30
    )
    refined = solution.x.reshape(-1, 2)
    return np.asarray(refined[np.argsort(refined[:, 0])])


def _basis(
    frequency_hz: Float[np.ndarray, " lines"], modes: Float[np.ndarray, "modes 2"]
) -> Complex[np.ndarray, "lines terms"]:
    """Accelerance of a unit residue of each mode, of unit u and of unit l."""
    omega, natural, ratio = 2 * np.pi * frequency_hz[:, None], 2 * np.pi * np.exp(modes[:, 0]), np.exp(modes[:, 1])
    terms = -(omega**2) / (natural**2 - omega**2 + 2j * ratio * natural * omega)
    return np.concatenate([terms, -(omega**2) / natural.max() ** 2, np.ones_like(omega)], axis=1)


def _least_squares(
    basis: Complex[np.ndarray, "lines terms"], measured: Complex[np.ndarray, "frfs lines"]
) -> Float[np.ndarray, "terms frfs"]:
    """Real least-squares coefficients of the basis."""
    matrix, data = np.concatenate([basis.real, basis.imag]), np.concatenate([measured.real, measured.imag], axis=1).T
    return np.asarray(np.linalg.lstsq(matrix, data, rcond=None)[0])
