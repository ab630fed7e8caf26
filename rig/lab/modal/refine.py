"""Modes with the least output error, with one mode each for all those below and above the band."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.lab.modal.fit import Lines, ModalFit, real_least_squares_coefficients

BELOW_START_RATIO, ABOVE_START_RATIO = 0.5, 1.6
"""Initial frequencies of the modes outside the band, relative to its ends."""
OUTSIDE_REACH = (0.05, 4.0)
"""Limits of their frequencies, relative to the ends of the band."""
MAX_LOG_SHIFT = 0.1
"""Largest change of ln(frequency) of a mode in the band."""
DAMPING_RATIO_RANGE = (1e-4, 0.5)
OUTSIDE_DAMPING_RATIO = 0.05
"""Initial damping ratio of the modes outside the band."""
MAX_EVALUATIONS = 100
MIN_DRIVING_RESIDUE = 1e-3
"""Least initial residue at the driving point of a mode outside the band, relative to its largest."""


ResponseMap = Callable[[Complex[np.ndarray, "parts all"]], Complex[np.ndarray, "parts lines"]]
ModeRows = Float[np.ndarray, "modes columns"]


def unit_residue_accelerances(
    line_hz: Lines, natural_hz: Float[np.ndarray, " modes"], ratios: Float[np.ndarray, " modes"]
) -> Complex[np.ndarray, "modes lines"]:
    """Accelerances of modes with unit residue, -w^2 / (w_k^2 - w^2 + 2 i z_k w_k w)."""
    return np.asarray(_accelerance_and_slopes(2 * np.pi * line_hz, 2 * np.pi * natural_hz[:, None], ratios[:, None])[0])


def refined_by_frfs(
    line_hz: Lines,
    accelerance: Complex[np.ndarray, "sensors lines"],
    weights: Lines,
    initial_fit: ModalFit,
    driving_index: int,
) -> ModalFit:
    """Modes w_k, z_k, phi_k that minimise the sum over sensors o and lines of

        | weight (H_o - sum_k phi_ok phi_dk A_k) |^2 / mean square of weight H_o

    d is the driving point; with the force's amplitude as the weight this is the output error. A mode below the band
    and one above it, which represent all those there, are added where they lower the Bayesian information criterion.
    """
    initial_modes = _mode_rows(initial_fit, driving_index)
    output_error = _OutputResidual(
        weights * accelerance, lambda unit: weights * unit, 2 * np.pi * line_hz, driving_index
    )
    data_count = 2 * accelerance.size
    best_modes, least_criterion = initial_modes, np.inf
    for adds_below, adds_above in product((False, True), repeat=2):
        outside_hz = [line_hz[0] * BELOW_START_RATIO] * adds_below + [line_hz[-1] * ABOVE_START_RATIO] * adds_above
        starting_modes = np.concatenate(
            [initial_modes, output_error.initial_out_of_band_modes(initial_modes, outside_hz)]
        )
        candidate_modes = _least_error_modes(output_error, starting_modes, (line_hz[0], line_hz[-1]))
        error_square_sum = np.sum(output_error.residual(candidate_modes.ravel()) ** 2)
        criterion = data_count * np.log(error_square_sum) + candidate_modes.size * np.log(data_count)
        if criterion < least_criterion:
            best_modes, least_criterion = candidate_modes, criterion
    return _fit_of_rows(best_modes, initial_fit, driving_index)


def refined_by_output_error(
    response_spectra: Complex[np.ndarray, "sensors lines"],
    response_map: ResponseMap,
    line_hz: Float[np.ndarray, " all"],
    band_hz: tuple[float, float],
    initial_fit: ModalFit,
    driving_index: int,
) -> ModalFit:
    """Modes near `initial_fit` with the least free-run error Y_o - response_map(sum_k phi_ok phi_dk A_k(line_hz)).

    Y are the `response_spectra`; `response_map` maps an accelerance to that of its response to the measured force.
    """
    initial_modes = _mode_rows(initial_fit, driving_index)
    output_error = _OutputResidual(response_spectra, response_map, 2 * np.pi * line_hz, driving_index)
    return _fit_of_rows(_least_error_modes(output_error, initial_modes, band_hz), initial_fit, driving_index)


class _OutputResidual:
    """Error of modes, relative to the rms of each sensor, and its Jacobian; modes are rows (ln f, ln z, phi_1, ...)."""

    def __init__(
        self,
        response_spectra: Complex[np.ndarray, "sensors lines"],
        response_map: ResponseMap,
        omega: Float[np.ndarray, " all"],
        driving_index: int,
    ) -> None:
        self.sensor_rms = np.sqrt(np.mean(np.abs(response_spectra) ** 2, axis=1))[:, None]
        self.scaled_spectra, self.response_map = response_spectra / self.sensor_rms, response_map
        self.omega, self.driving_index = omega, driving_index

    def residual(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " data"]:
        relative_error = self._error(self._modes(unknowns))
        return np.concatenate([relative_error.real.ravel(), relative_error.imag.ravel()])

    def jacobian(self, unknowns: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "data unknowns"]:
        modes = self._modes(unknowns)
        unit_spectra, by_frequency, by_damping = map(self.response_map, self._accelerance_and_slopes(modes))
        sensor_count, line_count = self.scaled_spectra.shape
        model_slopes = np.zeros((sensor_count, line_count, *modes.shape), dtype=complex)
        residues, driving_shape = self._residues(modes), modes[:, 2 + self.driving_index]
        model_slopes[..., 0] = residues[:, None, :] * by_frequency.T
        model_slopes[..., 1] = residues[:, None, :] * by_damping.T
        for sensor, row_rms in enumerate(self.sensor_rms):
            model_slopes[sensor, :, :, 2 + sensor] += (driving_shape[:, None] * unit_spectra).T / row_rms
            model_slopes[sensor, :, :, 2 + self.driving_index] += (modes[:, [2 + sensor]] * unit_spectra).T / row_rms
        jacobian_rows = -model_slopes.reshape(sensor_count * line_count, -1)
        return np.concatenate([jacobian_rows.real, jacobian_rows.imag])

    def initial_out_of_band_modes(
        self, modes: ModeRows, outside_hz: list[float]
    ) -> Float[np.ndarray, "outside columns"]:
        """Initial modes outside the band, with least-squares residues of the remaining error."""
        if not outside_hz:
            return np.zeros((0, modes.shape[1]))
        remaining_error = self.sensor_rms * self._error(modes)
        log_hz_damping = np.column_stack([np.log(outside_hz), np.full(len(outside_hz), np.log(OUTSIDE_DAMPING_RATIO))])
        unit_spectra = self.response_map(self._accelerance_and_slopes(log_hz_damping)[0])
        residues = real_least_squares_coefficients(unit_spectra.T, remaining_error)
        min_driving_residues = MIN_DRIVING_RESIDUE * np.abs(residues).max(axis=1)
        driving_shape = np.sqrt(np.maximum(residues[:, self.driving_index], min_driving_residues))
        outside_shapes = residues / driving_shape[:, None]
        outside_shapes[:, self.driving_index] = driving_shape
        return np.column_stack([log_hz_damping, outside_shapes])

    def _error(self, modes: ModeRows) -> Complex[np.ndarray, "sensors lines"]:
        """Spectra that the modes leave unexplained, relative to the rms of each sensor."""
        accelerance = self._accelerance_and_slopes(modes)[0]
        return self.scaled_spectra - self._residues(modes) @ self.response_map(accelerance)

    def _modes(self, unknowns: Float[np.ndarray, " unknowns"]) -> ModeRows:
        return unknowns.reshape(-1, 2 + len(self.scaled_spectra))

    def _residues(self, modes: ModeRows) -> Float[np.ndarray, "sensors modes"]:
        """Residues in units of the rms of each sensor."""
        return (modes[:, 2:] * modes[:, [2 + self.driving_index]]).T / self.sensor_rms

    def _accelerance_and_slopes(self, modes: ModeRows) -> list[Complex[np.ndarray, "modes all"]]:
        return _accelerance_and_slopes(self.omega, 2 * np.pi * np.exp(modes[:, [0]]), np.exp(modes[:, [1]]))


def _accelerance_and_slopes(
    omega: Float[np.ndarray, " lines"], omega_k: Float[np.ndarray, "modes 1"], ratios: Float[np.ndarray, "modes 1"]
) -> list[Complex[np.ndarray, "modes lines"]]:
    """Accelerance of each mode with unit residue, and its derivatives by ln(frequency) and ln(damping ratio)."""
    loss = 2j * ratios * omega_k * omega
    denominator = omega_k**2 - omega**2 + loss
    accelerance = -(omega**2) / denominator
    return [accelerance, -accelerance * (2 * omega_k**2 + loss) / denominator, -accelerance * loss / denominator]


def _least_error_modes(output_error: _OutputResidual, start_modes: ModeRows, band_hz: tuple[float, float]) -> ModeRows:
    """Modes of least error: those in the band stay near their start, those outside stay outside."""
    lower_bounds, upper_bounds = np.full(start_modes.shape, -np.inf), np.full(start_modes.shape, np.inf)
    (log_low_hz, log_high_hz), (log_down, log_up), log_hz = np.log(band_hz), np.log(OUTSIDE_REACH), start_modes[:, 0]
    is_outside = [log_hz < log_low_hz, log_hz > log_high_hz]
    lower_bounds[:, 0] = np.select(is_outside, [log_low_hz + log_down, log_high_hz], log_hz - MAX_LOG_SHIFT)
    upper_bounds[:, 0] = np.select(is_outside, [log_low_hz, log_high_hz + log_up], log_hz + MAX_LOG_SHIFT)
    lower_bounds[:, 1], upper_bounds[:, 1] = np.log(DAMPING_RATIO_RANGE)
    solution = scipy.optimize.least_squares(
        output_error.residual,
        np.clip(start_modes, lower_bounds + 1e-9, upper_bounds - 1e-9).ravel(),
        output_error.jacobian,
        bounds=(lower_bounds.ravel(), upper_bounds.ravel()),
        x_scale="jac",
        max_nfev=MAX_EVALUATIONS,
    )
    return np.asarray(solution.x.reshape(start_modes.shape))


def _mode_rows(fit: ModalFit, driving_index: int) -> ModeRows:
    """Rows (ln f, ln z, phi at every sensor) of a fit's modes, phi_o = r_o / sqrt(r_d)."""
    return np.column_stack([np.log(fit.frequencies_hz), np.log(fit.damping_ratios), fit.shapes(driving_index).T])


def _fit_of_rows(mode_rows: ModeRows, initial_fit: ModalFit, driving_index: int) -> ModalFit:
    sorted_modes = mode_rows[np.argsort(mode_rows[:, 0])]
    return replace(
        initial_fit,
        frequencies_hz=np.exp(sorted_modes[:, 0]),
        damping_ratios=np.exp(sorted_modes[:, 1]),
        residues=sorted_modes[:, 2:].T * sorted_modes[:, 2 + driving_index],
    )
