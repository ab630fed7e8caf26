"""Modes of the least output error, with one mode below and one above the band for all that lie there."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.lab.modal.fit import ModalFit

BELOW, ABOVE = 0.5, 1.6
"""Of the band's ends: where the modes outside start."""
FARTHEST = (0.05, 4.0)
"""Of the band's ends: how far such a mode may lie from the band."""
NEAR = 0.1
"""How far a mode in the band may move, in the logarithm of its frequency."""
RATIOS = (1e-4, 0.5)
OUTSIDE = 0.05
"""Damping ratio with which the modes outside start."""
MOST_STEPS = 100
LEAST = 1e-3
"""Residue at the driving point, of the largest, with which a mode outside starts at least."""


def accelerances(
    hz: Float[np.ndarray, " lines"], natural_hz: Float[np.ndarray, " modes"], ratios: Float[np.ndarray, " modes"]
) -> Complex[np.ndarray, "modes lines"]:
    """-w^2 / (w_k^2 - w^2 + 2 i z_k w_k w)."""
    return np.asarray(_parts(2 * np.pi * hz, 2 * np.pi * natural_hz[:, None], ratios[:, None])[0])


def refined_by_frfs(
    hz: Float[np.ndarray, " lines"],
    accelerance: Complex[np.ndarray, "sensors lines"],
    weights: Float[np.ndarray, " lines"],
    start: ModalFit,
    driving: int,
) -> ModalFit:
    """The modes w_k, z_k, phi_k of the least sum over sensors o and lines of

        | weight (H_o - sum_k phi_ok phi_dk A_k) |^2 / mean square of weight H_o

    d is the driving point; with the force's amplitude as the weight this is the output error. A mode below the band
    and one above it, which stand for all those that lie there, are added where they lower the Bayesian information
    criterion.
    """
    own = np.column_stack(
        [np.log(start.frequencies_hz), np.log(start.ratios), (start.residues / np.sqrt(start.residues[driving])).T]
    )
    error = _Error(weights * accelerance, lambda parts: weights * parts, 2 * np.pi * hz, driving)
    data = 2 * accelerance.size
    best, least = own, np.inf
    for below, above in product((False, True), repeat=2):
        outside = [hz[0] * BELOW] * below + [hz[-1] * ABOVE] * above
        found = _descended(error, np.concatenate([own, error.started(own, outside)]), (hz[0], hz[-1]))
        criterion = data * np.log(np.sum(error.of(found.ravel()) ** 2)) + found.size * np.log(data)
        if criterion < least:
            best, least = found, criterion
    return _as_fit(best, start, driving)


def refined_by_output(
    data: Complex[np.ndarray, "sensors lines"],
    through: Callable[[Complex[np.ndarray, "parts all"]], Complex[np.ndarray, "parts lines"]],
    hz: Float[np.ndarray, " all"],
    band_hz: tuple[float, float],
    start: ModalFit,
    driving: int,
) -> ModalFit:
    """The modes near `start` of the least error of a free run: of data_o - through(sum_k phi_ok phi_dk A_k(hz)).

    `through` leads an accelerance to the spectrum of what it makes of the measured force, as `data` is of the response.
    """
    own = np.column_stack(
        [np.log(start.frequencies_hz), np.log(start.ratios), (start.residues / np.sqrt(start.residues[driving])).T]
    )
    return _as_fit(_descended(_Error(data, through, 2 * np.pi * hz, driving), own, band_hz), start, driving)


class _Error:
    """The error of modes, rows of (ln f, ln z, phi at every sensor), over the rms of each sensor; and its slope."""

    def __init__(
        self,
        data: Complex[np.ndarray, "sensors lines"],
        through: Callable[[Complex[np.ndarray, "parts all"]], Complex[np.ndarray, "parts lines"]],
        omega: Float[np.ndarray, " all"],
        driving: int,
    ) -> None:
        self.scale = np.sqrt(np.mean(np.abs(data) ** 2, axis=1))[:, None]
        self.data, self.through, self.omega, self.driving = data / self.scale, through, omega, driving

    def of(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        modes = self._modes(unknowns)
        error = self.data - self._residues(modes) @ self.through(self._parts(modes)[0])
        return np.concatenate([error.real.ravel(), error.imag.ravel()])

    def slope(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "data unknowns"]:
        modes = self._modes(unknowns)
        unit, by_frequency, by_damping = (self.through(part) for part in self._parts(modes))
        sensors, lines = self.data.shape
        found = np.zeros((sensors, lines, *modes.shape), dtype=complex)
        residues, at_force = self._residues(modes), modes[:, 2 + self.driving]
        found[..., 0] = residues[:, None, :] * by_frequency.T
        found[..., 1] = residues[:, None, :] * by_damping.T
        for sensor in range(sensors):
            scale = self.scale[sensor]
            found[sensor, :, :, 2 + sensor] += (at_force[:, None] * unit).T / scale
            found[sensor, :, :, 2 + self.driving] += (modes[:, [2 + sensor]] * unit).T / scale
        flat = -found.reshape(sensors * lines, -1)
        return np.concatenate([flat.real, flat.imag])

    def started(
        self, modes: Float[np.ndarray, "modes columns"], outside_hz: list[float]
    ) -> Float[np.ndarray, "outside columns"]:
        """Modes outside the band, with residues of least squares of what the others leave."""
        if not outside_hz:
            return np.zeros((0, modes.shape[1]))
        left = self.scale * (self.data - self._residues(modes) @ self.through(self._parts(modes)[0]))
        logs = np.column_stack([np.log(outside_hz), np.full(len(outside_hz), np.log(OUTSIDE))])
        unit = self.through(self._parts(logs)[0])
        rows = np.concatenate([unit.real, unit.imag], axis=1).T
        residues = np.linalg.lstsq(rows, np.concatenate([left.real, left.imag], axis=1).T, rcond=None)[0]
        at_force = np.sqrt(np.maximum(residues[:, self.driving], LEAST * np.abs(residues).max(axis=1)))
        shapes = residues / at_force[:, None]
        shapes[:, self.driving] = at_force
        return np.column_stack([logs, shapes])

    def _modes(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "modes columns"]:
        return unknowns.reshape(-1, 2 + len(self.data))

    def _residues(self, modes: Float[np.ndarray, "modes columns"]) -> Float[np.ndarray, "sensors modes"]:
        """Residues in units of each sensor's rms."""
        return (modes[:, 2:] * modes[:, [2 + self.driving]]).T / self.scale

    def _parts(self, modes: Float[np.ndarray, "modes columns"]) -> list[Complex[np.ndarray, "modes all"]]:
        return _parts(self.omega, 2 * np.pi * np.exp(modes[:, [0]]), np.exp(modes[:, [1]]))


def _parts(
    omega: Float[np.ndarray, " lines"],
    natural: Float[np.ndarray, "modes 1"],
    ratios: Float[np.ndarray, "modes 1"],
) -> list[Complex[np.ndarray, "modes lines"]]:
    """The accelerance of each mode, and its derivatives by the logarithms of frequency and damping ratio."""
    loss = 2j * ratios * natural * omega
    denominator = natural**2 - omega**2 + loss
    unit = -(omega**2) / denominator
    return [unit, -unit * (2 * natural**2 + loss) / denominator, -unit * loss / denominator]


def _descended(
    error: _Error, modes: Float[np.ndarray, "modes columns"], band_hz: tuple[float, float]
) -> Float[np.ndarray, "modes columns"]:
    """Modes in the band stay near where they start; those outside stay outside."""
    low, high = np.full(modes.shape, -np.inf), np.full(modes.shape, np.inf)
    first, last = np.log(band_hz)
    below, above = modes[:, 0] < first, modes[:, 0] > last
    low[:, 0] = np.where(below, first + np.log(FARTHEST[0]), np.where(above, last, modes[:, 0] - NEAR))
    high[:, 0] = np.where(below, first, np.where(above, last + np.log(FARTHEST[1]), modes[:, 0] + NEAR))
    low[:, 1], high[:, 1] = np.log(RATIOS)
    begin = np.clip(modes, low + 1e-9, high - 1e-9)
    found = scipy.optimize.least_squares(
        error.of, begin.ravel(), error.slope, bounds=(low.ravel(), high.ravel()), x_scale="jac", max_nfev=MOST_STEPS
    )
    return np.asarray(found.x.reshape(modes.shape))


def _as_fit(modes: Float[np.ndarray, "modes columns"], start: ModalFit, driving: int) -> ModalFit:
    ordered = modes[np.argsort(modes[:, 0])]
    return replace(
        start,
        frequencies_hz=np.exp(ordered[:, 0]),
        ratios=np.exp(ordered[:, 1]),
        residues=ordered[:, 2:].T * ordered[:, 2 + driving],
    )
