"""Modes with the least output error, with one mode each for all those below and above the band."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.lab.modal.fit import ModalFit

START_BELOW, START_ABOVE = 0.5, 1.6
"""Initial frequencies of the modes outside the band, relative to its ends."""
REACH = (0.05, 4.0)
"""Limits of their frequencies, relative to the ends of the band."""
MAX_LOG_SHIFT = 0.1
"""Largest change of ln(frequency) of a mode in the band."""
RATIO_RANGE = (1e-4, 0.5)
OUTSIDE_RATIO = 0.05
"""Initial damping ratio of the modes outside the band."""
MAX_STEPS = 100
MIN_DRIVING_RESIDUE = 1e-3
"""Least initial residue at the driving point of a mode outside the band, relative to its largest."""


def accelerances(
    hz: Float[np.ndarray, " lines"], natural_hz: Float[np.ndarray, " modes"], ratios: Float[np.ndarray, " modes"]
) -> Complex[np.ndarray, "modes lines"]:
    """Accelerances of modes with unit residue, -w^2 / (w_k^2 - w^2 + 2 i z_k w_k w)."""
    return np.asarray(_accelerance_and_slopes(2 * np.pi * hz, 2 * np.pi * natural_hz[:, None], ratios[:, None])[0])


def refined_by_frfs(
    hz: Float[np.ndarray, " lines"],
    accelerance: Complex[np.ndarray, "sensors lines"],
    weights: Float[np.ndarray, " lines"],
    start: ModalFit,
    driving_index: int,
) -> ModalFit:
    """Modes w_k, z_k, phi_k that minimise the sum over sensors o and lines of

        | weight (H_o - sum_k phi_ok phi_dk A_k) |^2 / mean square of weight H_o

    d is the driving point; with the force's amplitude as the weight this is the output error. A mode below the band
    and one above it, which represent all those there, are added where they lower the Bayesian information criterion.
    """
    initial = _as_rows(start, driving_index)
    error = _Error(weights * accelerance, lambda unit: weights * unit, 2 * np.pi * hz, driving_index)
    data = 2 * accelerance.size
    best, least = initial, np.inf
    for below, above in product((False, True), repeat=2):
        outside = [hz[0] * START_BELOW] * below + [hz[-1] * START_ABOVE] * above
        candidate = _minimised(error, np.concatenate([initial, error.outside_modes(initial, outside)]), (hz[0], hz[-1]))
        criterion = data * np.log(np.sum(error.of(candidate.ravel()) ** 2)) + candidate.size * np.log(data)
        if criterion < least:
            best, least = candidate, criterion
    return _as_fit(best, start, driving_index)


def refined_by_output(
    data: Complex[np.ndarray, "sensors lines"],
    through: Callable[[Complex[np.ndarray, "parts all"]], Complex[np.ndarray, "parts lines"]],
    hz: Float[np.ndarray, " all"],
    band_hz: tuple[float, float],
    start: ModalFit,
    driving_index: int,
) -> ModalFit:
    """Modes near `start` that minimise the free-run error data_o - through(sum_k phi_ok phi_dk A_k(hz)).

    data are the spectra of the responses; `through` maps an accelerance to that of its response to the measured force.
    """
    initial = _as_rows(start, driving_index)
    return _as_fit(
        _minimised(_Error(data, through, 2 * np.pi * hz, driving_index), initial, band_hz), start, driving_index
    )


class _Error:
    """Error of modes, relative to the rms of each sensor, and its Jacobian; modes are rows (ln f, ln z, phi_1, ...)."""

    def __init__(
        self,
        data: Complex[np.ndarray, "sensors lines"],
        through: Callable[[Complex[np.ndarray, "parts all"]], Complex[np.ndarray, "parts lines"]],
        omega: Float[np.ndarray, " all"],
        driving_index: int,
    ) -> None:
        self.scale = np.sqrt(np.mean(np.abs(data) ** 2, axis=1))[:, None]
        self.data, self.through, self.omega, self.driving_index = data / self.scale, through, omega, driving_index

    def of(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        modes = self._modes(unknowns)
        error = self.data - self._residues(modes) @ self.through(self._accelerance_and_slopes(modes)[0])
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    def slope(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "data unknowns"]:
        modes = self._modes(unknowns)
        unit, by_frequency, by_damping = (self.through(basis) for basis in self._accelerance_and_slopes(modes))
        sensor_count, line_count = self.data.shape
        jacobian = np.zeros((sensor_count, line_count, *modes.shape), dtype=complex)
        residues, at_force = self._residues(modes), modes[:, 2 + self.driving_index]
        jacobian[..., 0] = residues[:, None, :] * by_frequency.T
        jacobian[..., 1] = residues[:, None, :] * by_damping.T
        for sensor in range(sensor_count):
            scale = self.scale[sensor]
            jacobian[sensor, :, :, 2 + sensor] += (at_force[:, None] * unit).T / scale
            jacobian[sensor, :, :, 2 + self.driving_index] += (modes[:, [2 + sensor]] * unit).T / scale
        flat = -jacobian.reshape(sensor_count * line_count, -1)
        return np.concatenate([flat.real, flat.imag])

    def outside_modes(
        self, modes: Float[np.ndarray, "modes columns"], outside_hz: list[float]
    ) -> Float[np.ndarray, "outside columns"]:
        """Initial modes outside the band, with least-squares residues of the remaining error."""
        if not outside_hz:
            return np.zeros((0, modes.shape[1]))
        residual = self.scale * (
            self.data - self._residues(modes) @ self.through(self._accelerance_and_slopes(modes)[0])
        )
        logs = np.column_stack([np.log(outside_hz), np.full(len(outside_hz), np.log(OUTSIDE_RATIO))])
        unit = self.through(self._accelerance_and_slopes(logs)[0])
        rows = np.concatenate([unit.real, unit.imag], axis=1).T
        residues = np.linalg.lstsq(rows, np.concatenate([residual.real, residual.imag], axis=1).T, rcond=None)[0]
        at_force = np.sqrt(
            np.maximum(residues[:, self.driving_index], MIN_DRIVING_RESIDUE * np.abs(residues).max(axis=1))
        )
        shapes = residues / at_force[:, None]
        shapes[:, self.driving_index] = at_force
        return np.column_stack([logs, shapes])

    def _modes(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "modes columns"]:
        return unknowns.reshape(-1, 2 + len(self.data))

    def _residues(self, modes: Float[np.ndarray, "modes columns"]) -> Float[np.ndarray, "sensors modes"]:
        """Residues in units of the rms of each sensor."""
        return (modes[:, 2:] * modes[:, [2 + self.driving_index]]).T / self.scale

    def _accelerance_and_slopes(
        self, modes: Float[np.ndarray, "modes columns"]
    ) -> list[Complex[np.ndarray, "modes all"]]:
        return _accelerance_and_slopes(self.omega, 2 * np.pi * np.exp(modes[:, [0]]), np.exp(modes[:, [1]]))


def _accelerance_and_slopes(
    omega: Float[np.ndarray, " lines"],
    natural: Float[np.ndarray, "modes 1"],
    ratios: Float[np.ndarray, "modes 1"],
) -> list[Complex[np.ndarray, "modes lines"]]:
    """Accelerance of each mode with unit residue, and its derivatives by ln(frequency) and ln(damping ratio)."""
    loss = 2j * ratios * natural * omega
    denominator = natural**2 - omega**2 + loss
    unit = -(omega**2) / denominator
    return [unit, -unit * (2 * natural**2 + loss) / denominator, -unit * loss / denominator]


def _minimised(
    error: _Error, modes: Float[np.ndarray, "modes columns"], band_hz: tuple[float, float]
) -> Float[np.ndarray, "modes columns"]:
    """Modes of least error: those in the band stay near their start, those outside stay outside."""
    low, high = np.full(modes.shape, -np.inf), np.full(modes.shape, np.inf)
    first, last = np.log(band_hz)
    below, above = modes[:, 0] < first, modes[:, 0] > last
    low[:, 0] = np.where(below, first + np.log(REACH[0]), np.where(above, last, modes[:, 0] - MAX_LOG_SHIFT))
    high[:, 0] = np.where(below, first, np.where(above, last + np.log(REACH[1]), modes[:, 0] + MAX_LOG_SHIFT))
    low[:, 1], high[:, 1] = np.log(RATIO_RANGE)
    initial = np.clip(modes, low + 1e-9, high - 1e-9)
    solution = scipy.optimize.least_squares(
        error.of, initial.ravel(), error.slope, bounds=(low.ravel(), high.ravel()), x_scale="jac", max_nfev=MAX_STEPS
    )
    return np.asarray(solution.x.reshape(modes.shape))


def _as_rows(fit: ModalFit, driving_index: int) -> Float[np.ndarray, "modes columns"]:
    """Rows (ln f, ln z, phi at every sensor) of a fit's modes, phi_o = r_o / sqrt(r_d)."""
    return np.column_stack(
        [np.log(fit.frequencies_hz), np.log(fit.ratios), (fit.residues / np.sqrt(fit.residues[driving_index])).T]
    )


def _as_fit(modes: Float[np.ndarray, "modes columns"], start: ModalFit, driving_index: int) -> ModalFit:
    ordered = modes[np.argsort(modes[:, 0])]
    return replace(
        start,
        frequencies_hz=np.exp(ordered[:, 0]),
        ratios=np.exp(ordered[:, 1]),
        residues=ordered[:, 2:].T * ordered[:, 2 + driving_index],
    )
