"""Time history of a located force and of the motion at its place, with the regression of the force on other forces."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from identify.gaps.unmeasured_force.evidence import interleaved_real_imaginary, nuisance_equations, residual_squares
from identify.gaps.unmeasured_force.location import LocatedForce
from identify.signals.kinematics import omega_power
from rig.model.description import Station

LAW_OVERSAMPLING = 4
"""Rate at which laws are evaluated, over the residual's: their kinks widen the band. Set by hand."""
LAW_ERROR_SHARE = 0.03
"""Share of the force that even the true law may miss, which keeps strong lines from deciding alone. Set by hand."""
KNOT_SPACING_S = 0.25
"""Knots of the spline of the slow motion, which integration loses. Derived: eight knots a period of the 0.5 Hz
corner."""


@dataclass(frozen=True)
class ForceAndMotionHistory:
    """Located force and the motion at its place over time, and the normal equations for forces in its direction.

    displacement_m and velocity_m_per_s are oversampled along the whole transform, of a pair relative. free_force_n is
    the likeliest one without a law (a Wiener filter). line_weights are n over the variance at a line of the projected
    residual u^H r; projected_columns are u^H D, and normal_matrix and right_side the normal equations of the nuisance
    parameters at these weights, without a force.
    """

    located_force: LocatedForce
    displacement_m: Float[np.ndarray, " fine"]
    velocity_m_per_s: Float[np.ndarray, " fine"]
    free_force_n: Float[np.ndarray, " alltimes"]
    line_weights: Float[np.ndarray, " lines"]
    projected_residual: Complex[np.ndarray, " lines"]
    projected_columns: Complex[np.ndarray, "columns lines"]
    normal_matrix: Float[np.ndarray, "columns columns"]
    right_side: Float[np.ndarray, " columns"]

    @property
    def residual_rate_hz(self) -> float:
        return self.located_force.whitened_record.record.residual_rate_hz

    @property
    def fine_times_s(self) -> Float[np.ndarray, " fine"]:
        return np.arange(self.displacement_m.size) / (LAW_OVERSAMPLING * self.residual_rate_hz)

    @property
    def time_gate(self) -> Float[np.ndarray, " alltimes"]:
        return self.located_force.whitened_record.time_gate

    @cached_property
    def nuisance_cholesky(self) -> tuple[Float[np.ndarray, "columns columns"], bool]:
        cholesky_factor, is_lower = cho_factor(self.normal_matrix)
        return cholesky_factor, bool(is_lower)

    @cached_property
    def free_force_gain(self) -> float:
        """Gain in -2 ln L of a force that is free at every line, less what noise alone would gain."""
        weighted_columns = interleaved_real_imaginary(self.projected_columns * np.sqrt(self.line_weights))
        weighted_residual = interleaved_real_imaginary(self.projected_residual * np.sqrt(self.line_weights))
        free_matrix = self.normal_matrix - weighted_columns @ weighted_columns.T
        free_right_side = self.right_side - weighted_columns @ weighted_residual
        nuisance_gain = float(self.right_side @ cho_solve(self.nuisance_cholesky, self.right_side))
        free_nuisance_gain = float(free_right_side @ np.linalg.solve(free_matrix, free_right_side))
        noise_gain = float(self.line_weights @ self.located_force.noise_by_line)
        return float(weighted_residual @ weighted_residual) - nuisance_gain + free_nuisance_gain - noise_gain

    def gated_spectra(self, fine_forces_n: Float[np.ndarray, "*rows fine"]) -> Complex[np.ndarray, "*rows lines"]:
        """Projected residual spectra of oversampled forces (N), low-passed, through the gate."""
        record = self.located_force.whitened_record.record
        force_spectra = np.fft.rfft(fine_forces_n)[..., : record.omega.size] / LAW_OVERSAMPLING
        forces_n = np.fft.irfft(force_spectra, record.transform_length // record.decimation)
        return self.spectra_of_samples(forces_n)

    def spectra_of_samples(self, forces_n: Float[np.ndarray, "*rows alltimes"]) -> Complex[np.ndarray, "*rows lines"]:
        """Projected residual spectra of forces (N) at the residual's rate, through the gate."""
        whitened = self.located_force.whitened_record
        force_spectra = np.fft.rfft(forces_n * self.time_gate)[..., whitened.line_slice] * whitened.record.decimation
        return np.asarray(force_spectra * self.located_force.with_force.response_norm)

    def reduced_equations(
        self, force_columns: Complex[np.ndarray, "columns lines"]
    ) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, " columns"]]:
        """Normal equations of the amounts of some forces, with the nuisance parameters eliminated."""
        weighted_columns = interleaved_real_imaginary(force_columns * self.line_weights)
        coupling = weighted_columns @ interleaved_real_imaginary(self.projected_columns).T
        force_matrix = weighted_columns @ interleaved_real_imaginary(force_columns).T - coupling @ cho_solve(
            self.nuisance_cholesky, coupling.T
        )
        right_side = weighted_columns @ interleaved_real_imaginary(self.projected_residual)
        return force_matrix, right_side - coupling @ cho_solve(self.nuisance_cholesky, self.right_side)

    def minus_two_log_decrease(self, force_projection: Complex[np.ndarray, " lines"]) -> float:
        """Fall of -2 ln L by a given force."""
        normal_matrix, right_side = self.reduced_equations(force_projection[None])
        return float(2 * right_side[0] - normal_matrix[0, 0])

    @cached_property
    def slow_basis(self) -> Float[np.ndarray, "alltimes knots"]:
        """Cubic B-splines over the record, zero beyond its end."""
        record = self.located_force.whitened_record.record
        sample_count = record.counted_slice.stop
        end_s = sample_count / self.residual_rate_hz
        inner_knots_s = np.linspace(0, end_s, max(2, round(end_s / KNOT_SPACING_S) + 1))
        knots_s = np.concatenate([[0.0] * 3, inner_knots_s, [end_s] * 3])
        times_s = np.minimum(np.arange(sample_count) / self.residual_rate_hz, end_s)
        basis = np.zeros((record.transform_length // record.decimation, knots_s.size - 4))
        basis[:sample_count] = BSpline.design_matrix(times_s, knots_s, 3).toarray()
        return basis

    def oversampled(self, values_at_samples: Float[np.ndarray, " alltimes"]) -> Float[np.ndarray, " fine"]:
        """Linear interpolation to the oversampled rate."""
        fine_positions = np.arange(values_at_samples.size * LAW_OVERSAMPLING) / LAW_OVERSAMPLING
        return np.asarray(np.interp(fine_positions, np.arange(values_at_samples.size), values_at_samples))


def force_spectrum(located: LocatedForce) -> Complex[np.ndarray, " alllines"]:
    """Likeliest spectrum of the force, or of a sensor's own signal: S |g| t / (s + S |g|^2), a Wiener filter."""
    whitened, response_norm = located.whitened_record, located.with_force.response_norm
    noise, density = located.noise_by_line, located.spectrum_by_line
    spectrum = np.zeros(whitened.record.omega.size, dtype=complex)
    spectrum[whitened.line_slice] = (
        density * response_norm * located.with_force.projection / (noise + density * response_norm**2)
    )
    return spectrum


def force_and_motion_history(located: LocatedForce) -> ForceAndMotionHistory:
    """Time history of a force or a pair, weighted for laws that may miss `LAW_ERROR_SHARE` of it."""
    whitened, spectrum, record = located.whitened_record, force_spectrum(located), located.whitened_record.record
    sample_count = record.transform_length // record.decimation
    acceleration = np.zeros(record.omega.size, dtype=complex)
    for station, sign in zip(located.force_place.stations, (1.0, -1.0), strict=False):
        unobserved_accelerance = _unobserved_accelerance(located, station)
        acceleration += sign * (whitened.acceleration_at(station) + sign * unobserved_accelerance * spectrum)
    displacement_m, velocity_m_per_s = (
        _oversampled_history(acceleration * omega_power(record.omega, order, record.corner_hz), sample_count)
        / record.decimation
        for order in (-2, -1)
    )
    direction = located.residual_per_force.conj() / np.maximum(located.with_force.response_norm, 1e-300)[:, None]
    normal_matrix, right_side = nuisance_equations(whitened, located.with_force.noise_variance)
    history = ForceAndMotionHistory(
        located_force=located,
        displacement_m=displacement_m,
        velocity_m_per_s=velocity_m_per_s,
        free_force_n=np.fft.irfft(spectrum, sample_count) / record.decimation,
        line_weights=whitened.reals_per_line / located.noise_by_line,
        projected_residual=np.einsum("lr,lr->l", direction, whitened.whitened_residual),
        projected_columns=np.einsum("lr,clr->cl", direction, whitened.nuisance_columns),
        normal_matrix=normal_matrix,
        right_side=right_side,
    )
    return reweighted_for_law_error(history, LAW_ERROR_SHARE)


def reweighted_for_law_error(history: ForceAndMotionHistory, law_error_share: float) -> ForceAndMotionHistory:
    """History weighted for a law that may miss a share e of the force: n / (s + e^2 S |g|^2) at each line."""
    located = history.located_force
    line_weights = located.whitened_record.reals_per_line / (
        located.noise_by_line + law_error_share**2 * located.spectrum_by_line * located.with_force.response_norm**2
    )
    lost_columns = interleaved_real_imaginary(history.projected_columns * (history.line_weights - line_weights))
    return replace(
        history,
        line_weights=line_weights,
        normal_matrix=history.normal_matrix - lost_columns @ interleaved_real_imaginary(history.projected_columns).T,
        right_side=history.right_side - lost_columns @ interleaved_real_imaginary(history.projected_residual),
    )


def explained_share(located: LocatedForce) -> float:
    """Share that the force takes off the sum of squares of the linear residual, after the nuisance parameters."""
    whitened, with_force, noise_by_line = located.whitened_record, located.with_force, located.noise_by_line
    total_by_line = noise_by_line + located.spectrum_by_line * with_force.response_norm**2
    explained_by_line = 1 - (noise_by_line / total_by_line) ** 2
    theta = np.zeros(len(whitened.nuisance_parameters))  # a drift has columns of its own
    theta[: located.without_force.theta.size] = located.without_force.theta
    squares_without = float(np.sum(residual_squares(whitened, theta)))
    explained_squares = float(np.abs(with_force.projection) ** 2 @ explained_by_line)
    squares_with = float(np.sum(residual_squares(whitened, with_force.theta))) - explained_squares
    return 1 - squares_with / squares_without


def _unobserved_accelerance(located: LocatedForce, station: Station) -> Complex[np.ndarray, " alllines"]:
    """Driving-point accelerance of the modes that the sensors do not observe."""
    whitened = located.whitened_record
    observed_count = len(whitened.record.motion_sensor_indices_on(station.body))
    for response in whitened.model.responses:
        if response.body.name == station.body:
            shapes = response.shapes([station])[0, observed_count:]
            return np.asarray(shapes**2 @ response.accelerance[observed_count:])
    raise KeyError(station.body)


def _oversampled_history(spectrum: Complex[np.ndarray, " alllines"], padded_samples: int) -> Float[np.ndarray, " fine"]:
    return np.asarray(LAW_OVERSAMPLING * np.fft.irfft(spectrum, LAW_OVERSAMPLING * padded_samples))
