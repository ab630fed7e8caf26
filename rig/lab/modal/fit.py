"""Modes from measured frequency response functions (FRFs): LSCF, a stabilisation diagram, a nonlinear refinement."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Complex, Float

from rig.errors import RigError

ORDERS = range(6, 62, 2)
"""Of the polynomials whose poles are compared."""
SAME_FREQUENCY, SAME_DAMPING = 5e-3, 0.4
"""Poles of two orders that differ by less, relatively, are one; modes nearer to each other are not told apart."""
LASTING = 0.15
"""A pole of at least this share of the orders is a mode."""
MOST_DAMPING = 0.2
REFINED = (0.02, 1.5)
"""How far the refinement may move the logarithms of a frequency and of a damping ratio."""
NEAREST, STANDS_OUT = 8, 2.0
"""At the median of so many lines about it a mode is so far above the rms error of the fit, in one FRF at least."""
MOST_LINES = 4000
"""A finer grid is thinned to so many lines for the search of poles; the refinement uses every line."""


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
    frequency_hz: Float[np.ndarray, " lines"], accelerance: Complex[np.ndarray, "frfs lines"], driving: int
) -> ModalFit:
    """The modes in the band of the FRFs, (m/s^2)/N, of which the one numbered `driving` is that of the driving point.

    Poles come from the least-squares complex frequency-domain method (LSCF; Guillaume, Verboven and Vanlanduit, ISMA
    23, 1998): the common denominator of all FRFs at orders 6 to 60, of which the poles that last are kept. Modes that
    do not lower the Bayesian information criterion are left out again. Frequencies and dampings are then refined with
    residues eliminated (variable projection), and modes left out that are no normal modes, outside the band, or do not
    stand out. Raises RigError if no mode lasts.
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
    thin = max(1, frequency_hz.size // MOST_LINES)
    modes = _lasting(frequency_hz[::thin], measured[:, ::thin])
    if not modes.size:
        raise RigError("no mode is found in the FRFs; check their band and noise")
    modes = _told_apart(frequency_hz, measured, modes)
    while True:
        modes = _refined(frequency_hz, measured, modes)
        basis = _basis(frequency_hz, modes)
        found = _solved(basis, measured)
        real = _believed(frequency_hz, basis, modes, found, np.abs(measured - found.T @ basis.T), driving)
        if real.all():
            break
        if not real.any():
            raise RigError(
                "no mode stands out with a positive residue at the driving point; check its FRF's sign and direction"
            )
        modes = modes[real]
    errors = [np.abs(measured - part.T @ basis[:, : part.shape[0]].T) for part in (found, found[:-2])]
    misfit, of_modes = (np.sqrt(np.mean(error**2, axis=1)) for error in errors)
    residues = found[:-2].T * scale[:, None]
    return ModalFit(np.exp(modes[:, 0]), np.exp(modes[:, 1]), residues, misfit, of_modes)


def _lasting(
    frequency_hz: Float[np.ndarray, " lines"], measured: Complex[np.ndarray, "frfs lines"]
) -> Float[np.ndarray, "modes 2"]:
    """Logarithms of frequency and damping ratio of the poles that stay from order to order."""
    stable, before, orders = [], np.zeros((0, 2)), 0
    squares, projected = _equations(frequency_hz, measured)
    for order in ORDERS:
        if 3 * order > frequency_hz.size:
            break
        some = slice(order + 1)
        rows = projected[:, some, some].reshape(-1, order + 1)
        poles = _poles(frequency_hz, squares[some, some] - rows.conj().T @ rows)
        away = np.abs(poles[:, None] - before[None]) < (SAME_FREQUENCY, SAME_DAMPING)
        stable.append(poles[np.any(np.all(away, axis=2), axis=1)])
        before, orders = poles, orders + 1
    every = np.concatenate(stable)
    every = every[np.argsort(every[:, 0])]
    groups = np.split(every, np.flatnonzero(np.diff(every[:, 0]) > SAME_FREQUENCY) + 1)
    kept = [np.median(group, axis=0) for group in groups if len(group) >= LASTING * orders]
    return np.array(kept).reshape(-1, 2)


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
    """Logarithms of frequency and damping ratio of the damped poles in the band, from the equations of one order."""
    first, band = frequency_hz[0], 1.02 * (frequency_hz[-1] - frequency_hz[0])
    denominator = np.append(1.0, np.linalg.lstsq(normal[1:, 1:], -normal[1:, 0], rcond=None)[0])
    roots = np.roots(denominator[::-1])
    roots = roots[np.abs(roots) > 0]
    poles = -np.log(roots) * 2 * band + 2j * np.pi * first
    inside = (poles.imag > 2 * np.pi * first) & (poles.imag < 2 * np.pi * frequency_hz[-1])
    poles = poles[inside]
    ratios = -poles.real / np.abs(poles)
    damped = (ratios > 0) & (ratios < MOST_DAMPING)
    return np.log(np.stack([np.abs(poles[damped]) / (2 * np.pi), ratios[damped]], axis=1))


def _told_apart(
    frequency_hz: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, "frfs lines"],
    modes: Float[np.ndarray, "modes 2"],
) -> Float[np.ndarray, "fewer 2"]:
    """Modes without those whose leaving out lowers N log(sum of squares) + parameters log(N)."""

    def criterion(some: Float[np.ndarray, "some 2"]) -> float:
        basis = _basis(frequency_hz, some)
        squares = float(np.sum(np.abs(measured - _solved(basis, measured).T @ basis.T) ** 2))
        data = 2 * measured.size
        return data * np.log(max(squares, 1e-300)) + len(some) * (len(measured) + 2) * np.log(data)

    best = criterion(modes)
    while len(modes) > 1:
        fewer = [np.delete(modes, k, axis=0) for k in range(len(modes))]
        found = [criterion(some) for some in fewer]
        if min(found) >= best:
            break
        best, modes = min(found), fewer[int(np.argmin(found))]
    return modes


def _believed(
    frequency_hz: Float[np.ndarray, " lines"],
    basis: Complex[np.ndarray, "lines terms"],
    modes: Float[np.ndarray, "modes 2"],
    found: Float[np.ndarray, "terms frfs"],
    errors: Float[np.ndarray, "frfs lines"],
    driving: int,
) -> Bool[np.ndarray, " modes"]:
    """Mask of normal modes (positive at the driving point) in the band that stand out of the errors."""
    natural_hz = np.exp(modes[:, 0])
    nearest = np.argsort(np.abs(frequency_hz[:, None] - natural_hz), axis=0)[:NEAREST]
    heights = np.median(np.abs(np.take_along_axis(basis[:, : len(modes)], nearest, axis=0)), axis=0)
    seen = np.abs(found[:-2]) * heights[:, None] / np.sqrt(np.mean(errors**2, axis=1))
    inside = (natural_hz > frequency_hz[0]) & (natural_hz < frequency_hz[-1])
    return np.asarray((found[:-2, driving] > 0) & inside & (seen.max(axis=1) > STANDS_OUT))


def _refined(
    frequency_hz: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, "frfs lines"],
    modes: Float[np.ndarray, "modes 2"],
) -> Float[np.ndarray, "modes 2"]:
    """The frequencies and dampings of the least sum of squares near those given."""

    def residual(unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        basis = _basis(frequency_hz, unknowns.reshape(-1, 2))
        error = measured - _solved(basis, measured).T @ basis.T
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    near, scales = np.tile(REFINED, len(modes)), np.tile([1e-3, 1e-1], len(modes))
    start = modes.ravel()
    found = scipy.optimize.least_squares(
        residual, start, bounds=(start - near, start + near), x_scale=scales, max_nfev=30
    )
    refined = found.x.reshape(-1, 2)
    return np.asarray(refined[np.argsort(refined[:, 0])])


def _basis(
    frequency_hz: Float[np.ndarray, " lines"], modes: Float[np.ndarray, "modes 2"]
) -> Complex[np.ndarray, "lines terms"]:
    """Accelerance by a unit residue of each mode, a unit of u and a unit of l."""
    omega, natural, ratio = 2 * np.pi * frequency_hz[:, None], 2 * np.pi * np.exp(modes[:, 0]), np.exp(modes[:, 1])
    terms = -(omega**2) / (natural**2 - omega**2 + 2j * ratio * natural * omega)
    return np.concatenate([terms, -(omega**2) / natural.max() ** 2, np.ones_like(omega)], axis=1)


def _solved(
    basis: Complex[np.ndarray, "lines terms"], measured: Complex[np.ndarray, "frfs lines"]
) -> Float[np.ndarray, "terms frfs"]:
    """Real coefficients of least squares."""
    left, right = np.concatenate([basis.real, basis.imag]), np.concatenate([measured.real, measured.imag], axis=1).T
    return np.asarray(np.linalg.lstsq(left, right, rcond=None)[0])
