"""Time history of a located force and of the motion at its place, with the regression of the force on other forces."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve

from identify.gaps.unmeasured_force.evidence import nuisance_equations, real_pairs, residual_squares
from identify.gaps.unmeasured_force.location import LocatedForce
from identify.signals.kinematics import integrated
from rig.model.description import Station

OVERSAMPLING = 4
"""Rate at which laws are evaluated, over the residual's: their kinks widen the band. Set by hand."""
LAW_ERROR = 0.03
"""Share of the force that even the true law may miss, which keeps strong lines from deciding alone. Set by hand."""
KNOT_SPACING_S = 0.25
"""Knots of the spline of the slow motion, which integration loses. Derived: eight knots a period of the 0.5 Hz
corner."""


@dataclass(frozen=True)
class ForceHistory:
    """Located force and the motion at its place over time, and the normal equations for forces in its direction.

    displacement_m and velocity_m_per_s are oversampled along the whole transform, of a pair relative. force_n is the
    free force: the likeliest one without a law (a Wiener filter). weights are n over the variance of each line of the
    projected residual u^H r; projected_columns are u^H D, and normal_matrix and right_side the normal equations of the
    nuisance parameters at these weights, without a force.
    """

    located: LocatedForce
    displacement_m: Float[np.ndarray, " fine"]
    velocity_m_per_s: Float[np.ndarray, " fine"]
    force_n: Float[np.ndarray, " alltimes"]
    weights: Float[np.ndarray, " lines"]
    projected_residual: Complex[np.ndarray, " lines"]
    projected_columns: Complex[np.ndarray, "columns lines"]
    normal_matrix: Float[np.ndarray, "columns columns"]
    right_side: Float[np.ndarray, " columns"]

    @property
    def rate_hz(self) -> float:
        return self.located.whitened.record.rate_hz

    @property
    def fine_s(self) -> Float[np.ndarray, " fine"]:
        return np.arange(self.displacement_m.size) / (OVERSAMPLING * self.rate_hz)

    @property
    def gate(self) -> Float[np.ndarray, " alltimes"]:
        return self.located.whitened.gate

    @cached_property
    def cholesky(self) -> tuple[Float[np.ndarray, "columns columns"], bool]:
        factor, lower = cho_factor(self.normal_matrix)
        return factor, bool(lower)

    @cached_property
    def free_gain(self) -> float:
        """Gain in -2 ln L of a force that is free at every line, less what noise alone would gain."""
        weighted_columns = real_pairs(self.projected_columns * np.sqrt(self.weights))
        weighted_residual = real_pairs(self.projected_residual * np.sqrt(self.weights))
        free_matrix = self.normal_matrix - weighted_columns @ weighted_columns.T
        free_right_side = self.right_side - weighted_columns @ weighted_residual
        nuisance_gain = float(self.right_side @ cho_solve(self.cholesky, self.right_side))
        free_nuisance_gain = float(free_right_side @ np.linalg.solve(free_matrix, free_right_side))
        whitened = self.located.whitened
        noise_gain = float(self.weights @ whitened.on_lines(self.located.with_force.noise))
        return float(weighted_residual @ weighted_residual) - nuisance_gain + free_nuisance_gain - noise_gain

    def gated_spectra(self, fine_n: Float[np.ndarray, "*rows fine"]) -> Complex[np.ndarray, "*rows lines"]:
        """Projected residual spectra of oversampled forces (N), low-passed, through the gate."""
        record = self.located.whitened.record
        spectra = np.fft.rfft(fine_n)[..., : record.omega.size] / OVERSAMPLING
        samples_n = np.fft.irfft(spectra, record.length // record.factor)
        return self.spectra_of_samples(samples_n)

    def spectra_of_samples(self, samples_n: Float[np.ndarray, "*rows alltimes"]) -> Complex[np.ndarray, "*rows lines"]:
        """Projected residual spectra of forces (N) at the residual's rate, through the gate."""
        whitened = self.located.whitened
        spectra = np.fft.rfft(samples_n * self.gate)[..., whitened.lines] * whitened.record.factor
        return np.asarray(spectra * self.located.with_force.response_norm)

    def reduced_equations(
        self, columns: Complex[np.ndarray, "columns lines"]
    ) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, " columns"]]:
        """Normal equations of the amounts of some forces, with the nuisance parameters eliminated."""
        weighted = real_pairs(columns * self.weights)
        coupling = weighted @ real_pairs(self.projected_columns).T
        right_side = weighted @ real_pairs(self.projected_residual)
        right_side = right_side - coupling @ cho_solve(self.cholesky, self.right_side)
        return weighted @ real_pairs(columns).T - coupling @ cho_solve(self.cholesky, coupling.T), right_side

    def gain(self, force: Complex[np.ndarray, " lines"]) -> float:
        """Fall of -2 ln L by a given force."""
        normal_matrix, right_side = self.reduced_equations(force[None])
        return float(2 * right_side[0] - normal_matrix[0, 0])

    @cached_property
    def slow_basis(self) -> Float[np.ndarray, "alltimes knots"]:
        """Cubic B-splines over the record, zero beyond its end."""
        record = self.located.whitened.record
        last_s = record.counted_samples.stop / self.rate_hz
        inner_knots_s = np.linspace(0, last_s, max(2, round(last_s / KNOT_SPACING_S) + 1))
        knots_s = np.concatenate([[0.0] * 3, inner_knots_s, [last_s] * 3])
        sample_s = np.arange(record.counted_samples.stop) / self.rate_hz
        basis = np.zeros((record.length // record.factor, knots_s.size - 4))
        basis[: sample_s.size] = BSpline.design_matrix(np.minimum(sample_s, last_s), knots_s, 3).toarray()
        return basis

    def oversample(self, samples: Float[np.ndarray, " alltimes"]) -> Float[np.ndarray, " fine"]:
        """Linear interpolation to the oversampled rate."""
        position = np.arange(samples.size * OVERSAMPLING) / OVERSAMPLING
        return np.asarray(np.interp(position, np.arange(samples.size), samples))


def force_spectrum(located: LocatedForce) -> Complex[np.ndarray, " alllines"]:
    """Likeliest spectrum of the force, or of a sensor's own signal: S |g| t / (s + S |g|^2), a Wiener filter."""
    whitened, with_force = located.whitened, located.with_force
    noise, spectrum = whitened.on_lines(with_force.noise), whitened.on_lines(with_force.spectrum)
    force = np.zeros(whitened.record.omega.size, dtype=complex)
    force[whitened.lines] = (
        spectrum * with_force.response_norm * with_force.projection / (noise + spectrum * with_force.response_norm**2)
    )
    return force


def force_history(located: LocatedForce) -> ForceHistory:
    """Time history of a force or a pair, weighted for laws that may miss `LAW_ERROR` of it."""
    whitened, with_force = located.whitened, located.with_force
    record, force = whitened.record, force_spectrum(located)
    acceleration = np.zeros(record.omega.size, dtype=complex)
    for station, sign in zip(located.candidate.stations, (1.0, -1.0), strict=False):
        acceleration += sign * (whitened.motion(station) + sign * _unobserved_accelerance(located, station) * force)
    displacement_m, velocity_m_per_s = (
        _oversampled(acceleration * integrated(record.omega, power, record.corner_hz), record.length // record.factor)
        / record.factor
        for power in (-2, -1)
    )
    direction = located.response.conj() / np.maximum(with_force.response_norm, 1e-300)[:, None]
    normal_matrix, right_side = nuisance_equations(whitened, with_force.noise)
    history = ForceHistory(
        located=located,
        displacement_m=displacement_m,
        velocity_m_per_s=velocity_m_per_s,
        force_n=np.fft.irfft(force, record.length // record.factor) / record.factor,
        weights=whitened.reals_per_line / whitened.on_lines(with_force.noise),
        projected_residual=np.einsum("lr,lr->l", direction, whitened.residual),
        projected_columns=np.einsum("lr,clr->cl", direction, whitened.columns),
        normal_matrix=normal_matrix,
        right_side=right_side,
    )
    return with_law_error(history, LAW_ERROR)


def with_law_error(history: ForceHistory, law_error: float) -> ForceHistory:
    """History weighted for a law that may miss a share e of the force: n / (s + e^2 S |g|^2) at each line."""
    whitened, with_force = history.located.whitened, history.located.with_force
    noise, spectrum = whitened.on_lines(with_force.noise), whitened.on_lines(with_force.spectrum)
    weights = whitened.reals_per_line / (noise + law_error**2 * spectrum * with_force.response_norm**2)
    lost_columns = real_pairs(history.projected_columns * (history.weights - weights))
    return replace(
        history,
        weights=weights,
        normal_matrix=history.normal_matrix - lost_columns @ real_pairs(history.projected_columns).T,
        right_side=history.right_side - lost_columns @ real_pairs(history.projected_residual),
    )


def explained_share(located: LocatedForce) -> float:
    """Share that the force takes off the sum of squares of the linear residual, after the nuisance parameters."""
    whitened, with_force = located.whitened, located.with_force
    power = np.abs(with_force.projection) ** 2
    noise, spectrum = whitened.on_lines(with_force.noise), whitened.on_lines(with_force.spectrum)
    explained = 1 - (noise / (noise + spectrum * with_force.response_norm**2)) ** 2
    theta = np.zeros(len(whitened.parameters))  # a drift has columns of its own
    theta[: located.without_force.theta.size] = located.without_force.theta
    squares_without = float(np.sum(residual_squares(whitened, theta)))
    squares_with = float(np.sum(residual_squares(whitened, with_force.theta))) - float(power @ explained)
    return 1 - squares_with / squares_without


def _unobserved_accelerance(located: LocatedForce, station: Station) -> Complex[np.ndarray, " alllines"]:
    """Driving-point accelerance of the modes that the sensors do not observe."""
    whitened = located.whitened
    for response in whitened.model.responses:
        if response.body.name == station.body:
            observed_modes = sum(s.station.body == station.body for s in whitened.record.sensors)
            return np.asarray(
                response.shapes([station])[0, observed_modes:] ** 2 @ response.accelerance[observed_modes:]
            )
    raise KeyError(station.body)


def _oversampled(spectrum: Complex[np.ndarray, " alllines"], length: int) -> Float[np.ndarray, " fine"]:
    return np.asarray(OVERSAMPLING * np.fft.irfft(spectrum, OVERSAMPLING * length))
