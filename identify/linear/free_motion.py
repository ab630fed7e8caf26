"""Free motion of modes from a record's start: the part of the linear response that no measured force causes.

A record that does not begin at rest holds, in addition to the response from rest, q_0 u(t) + q_0' v(t) of each mode
(`sampled_motion`). All q_0 and q_0' enter the sensors' signals linearly. Where the record does not fade in, as in a
free decay, they add

    q_0 (i omega + 2 zeta_m omega_m) A_m + q_0' A_m,   A_m = -omega^2 / D_m

to the spectrum of the second derivative, the jump at the first sample included. A velocity sensor misses the jump of
the displacement, i omega q_0 of the above, and an accelerometer also that of the velocity, q_0'.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from identify.linear.model import Response, real_product
from identify.linear.nuisance import Change, Nuisance, NuisanceKind
from identify.linear.projection import Covariances, Projection, residuals_without_free_inputs
from identify.linear.sampled_motion import Sampling, free_motion, sampled_accelerations
from identify.signals.kinematics import Kinematics
from rig.model.description import Station

SHRINKAGE = 10.0
"""Directions about which the record says much less than this multiple of the prior shrink to the prior's mean."""
WIDE_PRIOR = 3.0
"""Prior standard deviation of an initial value, over the one with which its mode alone would make all sensed motion."""
MEASURED_PRIOR = 0.05
"""The same where displacement sensors show all modes of a body."""
MIN_FREQUENCY_HZ = 0.5
"""Slower modes are scaled as modes of this frequency."""
RELATIVE_STEP = 1e-6
"""Relative change of a frequency or a damping ratio for central differences."""


@dataclass(frozen=True)
class FreeMotion:
    """Free motion of one mode per unit of its initial displacement or velocity.

    coordinate_derivatives are its displacement, velocity and acceleration; shape is the mode's at the stations.
    is_held is False if the mode's spring acts on the high-passed displacement: the drift then covers its initial state.
    """

    coordinate_derivatives: Float[np.ndarray, "3 samples"]
    shape: Float[np.ndarray, " stations"]
    is_held: bool


MeansAndDeviations = tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]
"""Means and standard deviations."""


def free_motions_and_priors(
    responses: Sequence[Response], motion: Kinematics, highest_hz: float, sample_count: int
) -> tuple[list[FreeMotion], MeansAndDeviations, MeansAndDeviations]:
    """Free motions of all modes below a frequency, with the priors of the initial values and of those at the end.

    The mean is what the stations show at the first sample, with a small deviation, if displacement sensors show all
    modes of the body; otherwise it is zero, with a wide one. A mode whose spring acts on the high-passed displacement
    moves as a free one: the part that integration loses.
    """
    time_s = np.arange(max(motion.sample_count, sample_count - motion.sample_count)) / motion.sample_rate_hz
    motions, prior_mean, prior_deviation, wide_deviation = list[FreeMotion](), [], [], []
    for response in responses:
        hz, zeta = response.dynamics.natural_hz, response.dynamics.damping_ratios
        shapes = response.shapes(motion.stations)
        station_rows = np.flatnonzero([station.body == response.body.name for station in motion.stations])
        sensed_count = min(station_rows.size, response.mode_count)
        station_signals = np.array([motion.displacement_m[station_rows], motion.velocity_m_per_s[station_rows]])
        mode_coordinates = np.linalg.pinv(shapes[station_rows, :sensed_count]) @ station_signals
        is_measured = sensed_count == response.mode_count and motion.zero_known
        rms_m, rms_m_per_s2 = (
            float(np.max(derivative[station_rows].std(axis=1)))
            for derivative in (motion.displacement_m, motion.acceleration_m_per_s2)
        )
        for mode_index in np.flatnonzero(hz < highest_hz).tolist():
            largest_shape = float(np.max(np.abs(shapes[station_rows, mode_index])))
            omega = 2 * np.pi * max(hz[mode_index], MIN_FREQUENCY_HZ)
            amplitude_m = float(np.hypot(rms_m, rms_m_per_s2 / omega**2)) / max(largest_shape, 1e-9)
            is_held = mode_index not in response.dynamics.slowly_free_modes
            for initial_order in range(2):
                derivatives = free_motion(float(hz[mode_index]), float(zeta[mode_index]), initial_order, time_s)
                motions.append(FreeMotion(derivatives, shapes[:, mode_index], is_held))
                initial_value_size = amplitude_m * omega**initial_order
                prior_mean.append(float(mode_coordinates[initial_order, mode_index, 0]) if is_measured else 0.0)
                prior_deviation.append((MEASURED_PRIOR if is_measured else WIDE_PRIOR) * initial_value_size)
                wide_deviation.append(WIDE_PRIOR * initial_value_size)
    start_prior = np.array(prior_mean), np.array(prior_deviation)
    return motions, start_prior, (np.zeros(len(prior_mean)), np.array(wide_deviation))


@dataclass(frozen=True)
class FreeMotionEstimate:
    """Free motion from a record's start, as the sensors deliver it.

    signals is its estimate; its errors have the independent unit components sum_i spectra_i root_ij, with unit_spectra
    spectra_i per unit of the initial value i, and error_root root_ij.
    """

    signals: Complex[np.ndarray, "stations lines"]
    unit_spectra: Complex[np.ndarray, "values stations lines"]
    error_root: Float[np.ndarray, "values values"]


@dataclass(frozen=True)
class InitialStateEstimate:
    """Initial values and their covariance."""

    initial_values: Float[np.ndarray, " values"]
    covariance: Float[np.ndarray, "values values"]

    def free_motion(
        self, unit_spectra: Complex[np.ndarray, "values stations lines"], indices: Int[np.ndarray, " indices"]
    ) -> FreeMotionEstimate:
        """Free motion by the initial values with these indices; `unit_spectra` are per unit of the first values."""
        value_covariance = self.covariance[np.ix_(indices, indices)]
        deviations = np.sqrt(np.diag(value_covariance))
        eigenvalues, directions = np.linalg.eigh(value_covariance / (deviations[:, None] * deviations))
        error_root = deviations[:, None] * directions * np.sqrt(np.maximum(eigenvalues, 0.0))
        unit_spectra = unit_spectra[indices]
        signals = np.einsum("i,isf->sf", self.initial_values[indices], unit_spectra)
        return FreeMotionEstimate(signals, unit_spectra, error_root)


def spectra_per_initial_value(
    motions: list[FreeMotion],
    derivative_orders: list[int],
    is_in_metres: Bool[np.ndarray, "stations lines"],
    omega: Float[np.ndarray, " lines"],
    spectra_of: Callable[[Float[np.ndarray, "rows samples"]], Complex[np.ndarray, "rows lines"]],
) -> Complex[np.ndarray, "values stations lines"]:
    """Spectra at the stations per unit of every initial value: accelerations, as (i omega)^(2 - order) times the
    spectrum of the derivative that the station's sensor measures, or displacements on the lines in metres."""
    acceleration_factors = {order: (1j * omega) ** (2 - order) for order in range(3)}
    unit_spectra = np.empty((len(motions), *is_in_metres.shape), dtype=complex)
    for unit_spectrum, motion in zip(unit_spectra, motions, strict=True):
        derivative_spectra = spectra_of(motion.coordinate_derivatives)
        for row, (shape, order) in enumerate(zip(motion.shape, derivative_orders, strict=True)):
            acceleration = acceleration_factors[order] * derivative_spectra[order]
            unit_spectrum[row] = shape * np.where(is_in_metres[row], derivative_spectra[0], acceleration)
    return unit_spectra


def estimated_initial_state(
    unit_spectra: Complex[np.ndarray, "values stations lines"],
    prior_mean: Float[np.ndarray, " values"],
    prior_deviation: Float[np.ndarray, " values"],
    unexplained_spectra: Complex[np.ndarray, "stations lines"],
    spectra_by_contact: Complex[np.ndarray, "contacts stations lines"],
    error_covariances: Covariances,
    correlated_line_count: int,
) -> InitialStateEstimate:
    """Initial values theta by generalised least squares, and their covariance.

    unexplained = sum_i theta_i spectra_i + sum_j by_contacts_j f_j + error, with contact forces f_j free at every line
    and the prior mean and deviation of theta. error_covariances are those on the lines used, batch by batch; the errors
    of `correlated_line_count` neighbouring lines count as one. Poorly determined directions shrink to the mean.
    """
    normal_matrix, gradient = np.diag(prior_deviation**-2), np.zeros_like(prior_mean)
    unexplained_spectra = unexplained_spectra - np.einsum("i,isf->sf", prior_mean, unit_spectra)
    unit_and_unexplained = [unit_spectra, unexplained_spectra[None]]
    for residual_rows in residuals_without_free_inputs(unit_and_unexplained, spectra_by_contact, error_covariances):
        real_rows = np.concatenate([residual_rows.real, residual_rows.imag])
        normal_matrix += 2 / correlated_line_count * real_rows[:, :-1].T @ real_rows[:, :-1]
        gradient += 2 / correlated_line_count * real_rows[:, :-1].T @ real_rows[:, -1]
    information, directions = np.linalg.eigh(normal_matrix * prior_deviation[:, None] * prior_deviation)
    directions = prior_deviation[:, None] * directions
    information = np.maximum(information, 1.0)  # less is rounding: the prior alone gives one
    direction_changes = (information - 1) / (information + SHRINKAGE) / information * (directions.T @ gradient)
    return InitialStateEstimate(prior_mean + directions @ direction_changes, (directions / information) @ directions.T)


@dataclass(frozen=True, eq=False)
class FreeMode:
    """Free motion of one mode (counted from 0) of a body, with its shape at the sensors.

    unit_accelerations are its coordinate's per unit of initial displacement and velocity, the sensed ones those that
    sampled sensors show. initial_state holds both initial values times the sample rate, as spectra are sums.
    """

    body_index: int
    mode_index: int
    shape: Float[np.ndarray, " sensors"]
    unit_accelerations: Complex[np.ndarray, "2 lines"]
    sensed_unit_accelerations: Complex[np.ndarray, "2 lines"]
    initial_state: Float[np.ndarray, " 2"]

    @property
    def acceleration(self) -> Complex[np.ndarray, " lines"]:
        return np.asarray(self.initial_state @ self.unit_accelerations)

    @property
    def sensed_acceleration(self) -> Complex[np.ndarray, "sensors lines"]:
        """Acceleration by the free motion that the sensors show."""
        return np.outer(self.shape, self.initial_state @ self.sensed_unit_accelerations)

    @property
    def unsensed_acceleration(self) -> Complex[np.ndarray, "sensors lines"]:
        """Acceleration by the free motion that the sensors miss."""
        return np.outer(self.shape, self.initial_state @ (self.unit_accelerations - self.sensed_unit_accelerations))


def free_modes(
    responses: Sequence[Response],
    indices_by_body: Sequence[Int[np.ndarray, "_"]],
    stations: Sequence[Station | None],
    sampling: Sampling | None,
) -> tuple[FreeMode, ...]:
    """Free modes of each body at zero amplitude; without a sampling the sensors miss nothing of them."""
    modes = []
    for body_index, (response, mode_indices) in enumerate(zip(responses, indices_by_body, strict=True)):
        dynamics, shapes = response.dynamics, response.shapes(stations)
        for mode_index in mode_indices.tolist():
            hz, zeta = float(dynamics.natural_hz[mode_index]), float(dynamics.damping_ratios[mode_index])
            accelerance = response.accelerance[mode_index]
            accelerations = np.stack([(1j * dynamics.omega + 4 * np.pi * hz * zeta) * accelerance, accelerance])
            sensed = sampled_accelerations(hz, zeta, sampling) if sampling and hz else accelerations
            modes.append(FreeMode(body_index, mode_index, shapes[:, mode_index], accelerations, sensed, np.zeros(2)))
    return tuple(modes)


def tuning_derivative(
    mode: FreeMode, response: Response, sampling: Sampling, kind: NuisanceKind
) -> Complex[np.ndarray, "sensors lines"]:
    """Derivative of a mode's sensed acceleration by the logarithm of its frequency or of its damping ratio."""
    dynamics = response.dynamics
    hz, zeta = float(dynamics.natural_hz[mode.mode_index]), float(dynamics.damping_ratios[mode.mode_index])
    if not hz:
        return np.zeros_like(mode.sensed_acceleration)

    def acceleration(factor: float) -> Complex[np.ndarray, " lines"]:
        tuned_hz_and_zeta = (hz * factor, zeta) if kind is NuisanceKind.FREQUENCY else (hz, zeta * factor)
        return np.asarray(mode.initial_state @ sampled_accelerations(*tuned_hz_and_zeta, sampling))

    acceleration_difference = acceleration(1 + RELATIVE_STEP) - acceleration(1 - RELATIVE_STEP)
    return np.outer(mode.shape, acceleration_difference) / (2 * RELATIVE_STEP)


def fitted_free_modes(
    motions: Sequence[FreeMode],
    projection: Projection,
    scaled_response: Complex[np.ndarray, "sensors lines"],
    residual: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMode, ...]:
    """Free modes with the initial states that minimise a linear residual.

    With the sensors' response S to acceleration, in standard deviations (scaled_response), their shapes Phi and the
    projection B T, the accelerations of any two modes are weighted line by line by N = Phi S* (1 - B T) S Phi'.
    """
    shapes = np.array([motion.shape for motion in motions])
    units = np.array([motion.sensed_unit_accelerations for motion in motions])
    shape_products = (shapes[:, None] * shapes).reshape(-1, shapes.shape[1])
    weights = (shape_products @ np.abs(scaled_response) ** 2).reshape(len(shapes), *units.shape[::2]).astype(complex)
    for by_input, to_input in zip(projection.by_input, projection.to_inputs, strict=True):
        input_by_shape = real_product(shapes, scaled_response.conj() * by_input)
        weights -= input_by_shape[:, None] * real_product(shapes, scaled_response * to_input)
    weighted = (weights[:, :, None] * units).reshape(len(units), -1, units.shape[2])
    weighted_residual = real_product(shapes, scaled_response.conj() * residual)[:, None]
    normal_matrix, gradient = (
        np.concatenate([_real_products(rows, columns) for rows, columns in zip(units, right_rows, strict=True)])
        for right_rows in (weighted, weighted_residual)
    )
    norms = np.sqrt(np.diag(normal_matrix))
    inverse_norms = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    pseudo_inverse = np.linalg.pinv(inverse_norms[:, None] * normal_matrix * inverse_norms, hermitian=True)
    initial_states = (inverse_norms * (pseudo_inverse @ (inverse_norms * gradient[:, 0]))).reshape(-1, 2)
    return tuple(replace(motion, initial_state=state) for motion, state in zip(motions, initial_states, strict=True))


def _real_products(
    rows: Complex[np.ndarray, "rows lines"], columns: Complex[np.ndarray, "columns lines"]
) -> Float[np.ndarray, "rows columns"]:
    """Real parts of the scalar products."""
    return np.asarray(rows.view(float) @ np.ascontiguousarray(columns).view(float).T)


def initial_state_changes(
    motions: Sequence[FreeMode],
    body_names: Sequence[str],
    sensor_response: Complex[np.ndarray, "sensors lines"],
    signal_norm: float,
) -> Iterator[Change]:
    """Changes by each mode's initial displacement and velocity, scaled so that the sensors deliver this norm."""
    for motion in motions:
        parameter = Nuisance(NuisanceKind.INITIAL_STATE, body_names[motion.body_index], motion.mode_index + 1)
        for unit_acceleration in motion.sensed_unit_accelerations:
            unit_signals = sensor_response * np.outer(motion.shape, unit_acceleration)
            signal_scale = signal_norm / max(float(np.linalg.norm(unit_signals)), 1e-300)
            yield Change(parameter, list(range(len(unit_signals))), unit_signals * signal_scale)
