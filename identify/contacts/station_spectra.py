"""Spectra of the motion at the stations of a record: spectral lines, covariance of the stations' errors, modal
accelerations, and the free motion of a record that does not begin at rest."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.linear.free_motion import (
    FreeMotionEstimate,
    estimated_initial_state,
    free_motions_and_priors,
    spectra_per_initial_value,
)
from identify.linear.modal import transformation
from identify.linear.model import Response, input_shapes, real_product
from identify.linear.nuisance import Change, elastic_mode_indices, mode_count_below_band_margin
from identify.linear.observed_motion import BodyMotion
from identify.linear.projection import free_input_estimator_and_condition
from identify.signals.kinematics import CORNER_HZ, TAPER_S, Kinematics, taper
from identify.signals.spectra import low_pass_edge_gain
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.sensing import PASSBAND

ERROR_SMOOTHING_HZ = 1.0
"""Band over which the stations' errors are averaged."""
ZERO_LINE_NUMBER = 1e-3
CHUNK_LINES = 1024
"""Lines that are processed at once."""
LEAST_VARIANCE_SHARE = 1e-9
"""Least variance of a station's error over the mean variance."""
CONDITION_LIMIT = 1e12
"""Condition number of the normal equations up to which contact forces are separable."""
START_TRANSIENT_S = 0.5
"""Start of a record that does not begin at rest, in which fast modes ring of what was before."""


@dataclass(frozen=True)
class SpectralLines:
    """Spectral lines of a record padded with silence to `padded_samples`, up to the band of forces at every
    `decimation`-th."""

    padded_samples: int
    decimation: int
    rate_hz: float
    is_tapered: bool = True

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        """Angular frequencies, rad/s; the lowest is slightly above zero, as displacements are accelerations /
        -omega^2."""
        line_numbers = np.maximum(np.arange(self.padded_samples // self.decimation // 2 + 1), ZERO_LINE_NUMBER)
        return np.asarray(2 * np.pi * line_numbers * self.rate_hz / self.padded_samples)

    @property
    def is_slow(self) -> Bool[np.ndarray, " lines"]:
        """Lines below the corner frequency of the kinematics."""
        return self.omega < 2 * np.pi * CORNER_HZ

    @property
    def force_gain(self) -> Float[np.ndarray, " lines"]:
        """Gain of the low-pass of forces (`at_force_rate`)."""
        band_end_hz = min(PASSBAND, 0.5 / self.decimation) * self.rate_hz
        return low_pass_edge_gain(self.omega / (2 * np.pi * band_end_hz))

    def spectra(self, signals: Float[np.ndarray, "*rows samples"]) -> Complex[np.ndarray, "*rows lines"]:
        """Spectra of signals with a tapered end and silence behind it, so that ringing does not wrap to the start."""
        if self.is_tapered:
            signals = signals * taper(signals.shape[-1], round(TAPER_S * self.rate_hz))
        return np.asarray(np.fft.rfft(signals, self.padded_samples)[..., : self.omega.size])

    def signals(
        self, spectra: Complex[np.ndarray, "*rows lines"], sample_count: int
    ) -> Float[np.ndarray, "*rows fewer"]:
        """First samples of the signals of spectra, at every `decimation`-th sample."""
        real_at_zero = np.concatenate([spectra[..., :1].real, spectra[..., 1:]], axis=-1)
        decimated_signals = np.fft.irfft(real_at_zero, self.padded_samples // self.decimation)[..., :sample_count]
        return np.asarray(decimated_signals / self.decimation)

    @property
    def correlated_line_count(self) -> int:
        """Number of neighbouring lines over which errors are averaged."""
        return max(1, round(ERROR_SMOOTHING_HZ * self.padded_samples / self.rate_hz))


@dataclass(frozen=True)
class StationRows:
    """Signals of the stations in the separation: accelerations, or on the lines `is_in_metres` displacements times a
    scale in which their noise is near that of the accelerations. acceleration_variance is the variance of the noise as
    accelerations, per sample and line, (m/s^2)^2."""

    is_in_metres: Bool[np.ndarray, "stations lines"]
    scale_per_s2: Float[np.ndarray, " stations"]
    omega: Float[np.ndarray, " lines"]
    acceleration_variance: Float[np.ndarray, "stations lines"]

    @cached_property
    def response(self) -> Complex[np.ndarray, "stations lines"]:
        """Signals per acceleration."""
        return np.where(self.is_in_metres, -self.scale_per_s2[:, None] / self.omega**2, 1.0).astype(complex)

    @property
    def noise_variance(self) -> Float[np.ndarray, "stations lines"]:
        """Variance of the signals' noise per sample on each line."""
        return np.asarray(self.acceleration_variance * np.abs(self.response) ** 2)

    def rows_of(self, stations: list[int]) -> "StationRows":
        """Rows of some stations."""
        return StationRows(
            self.is_in_metres[stations], self.scale_per_s2[stations], self.omega, self.acceleration_variance[stations]
        )

    def signals(
        self,
        displacements: Complex[np.ndarray, "*some stations lines"],
        accelerations: Complex[np.ndarray, "*some stations lines"],
    ) -> Complex[np.ndarray, "*some stations lines"]:
        return np.where(self.is_in_metres, self.scale_per_s2[:, None] * displacements, accelerations)


@dataclass(frozen=True)
class StationErrors:
    """Errors of the stations: variance of the sensors' noise on each line, at least a floor, and the changes by one
    standard deviation of every tolerance at the measured response, averaged over `correlated_line_count`."""

    noise_power: Float[np.ndarray, "stations lines"]
    least_noise_power: float
    changes: tuple[Change, ...]
    correlated_line_count: int

    def covariance(self, first_line: int, stop_line: int) -> Complex[np.ndarray, "some stations stations"]:
        """Covariance of the stations' errors on the lines from `first_line` to before `stop_line`."""
        station_count, line_count = self.noise_power.shape
        line_reach = self.correlated_line_count
        averaged_lines = slice(max(first_line - line_reach, 0), min(stop_line + line_reach, line_count))
        chunk_lines = slice(first_line - averaged_lines.start, stop_line - averaged_lines.start)
        covariance = np.zeros((station_count, station_count, stop_line - first_line), dtype=complex)
        diagonal = np.arange(station_count)
        least_power = max(LEAST_VARIANCE_SHARE * self._mean_variance, self.least_noise_power)
        covariance[diagonal, diagonal] = self.noise_power[:, first_line:stop_line] + least_power
        for change in self.changes:
            sensor_rows, signals = np.array(change.sensors), change.signals[:, averaged_lines]
            products = uniform_filter1d(signals[:, None] * signals[None].conj(), line_reach, axis=-1)
            covariance[sensor_rows[:, None], sensor_rows[None]] += products[..., chunk_lines]
        return np.ascontiguousarray(np.transpose(covariance, (2, 0, 1)))

    @cached_property
    def _mean_variance(self) -> float:
        """Mean variance over stations and lines."""
        tolerance_power = sum(np.linalg.norm(change.signals) ** 2 for change in self.changes)
        return float(np.sum(self.noise_power) + tolerance_power) / self.noise_power.size

    def covariances(self, start_line: int = 0) -> Iterator[tuple[slice, Complex[np.ndarray, "_ stations stations"]]]:
        """Lines from `start_line` on, chunk by chunk, with their covariance."""
        line_count = self.noise_power.shape[1]
        for first_line in range(start_line, line_count, CHUNK_LINES):
            stop_line = min(first_line + CHUNK_LINES, line_count)
            yield slice(first_line, stop_line), self.covariance(first_line, stop_line)


def force_weights(
    contact_accelerances: Complex[np.ndarray, "contacts stations lines"], station_errors: StationErrors
) -> Complex[np.ndarray, "contacts stations lines"]:
    """Weights W of the contact forces f = W (A - G_F F), line by line, from the accelerations by a unit of each force.

    Raises RigError if the stations cannot tell the contact forces apart.
    """
    contact_weights, condition_number = free_input_estimator_and_condition(
        contact_accelerances, station_errors.covariances()
    )
    if not condition_number <= CONDITION_LIMIT:
        raise RigError("the sensors cannot tell the contact forces apart; measure more stations on the bodies")
    return contact_weights


def observed_body_motion(
    rig: Rig, response: Response, motion: Kinematics, accelerations: Complex[np.ndarray, "stations lines"]
) -> BodyMotion:
    """Modal accelerations of a body that its stations determine; those of higher modes are left out."""
    transform = transformation(rig, response.body, motion)
    modal_accelerations = real_product(transform.inverse_shapes, accelerations[list(transform.station_rows)])
    return BodyMotion(response, modal_accelerations, elastic_mode_indices(response, len(modal_accelerations)))


def has_hidden_modes(response: Response, motion: Kinematics) -> bool:
    """True if a body has more modes near the band than stations."""
    return mode_count_below_band_margin(response) > sum(
        station.body == response.body.name for station in motion.stations
    )


def driven_body_motion(
    rig: Rig,
    response: Response,
    motion: Kinematics,
    accelerations: Complex[np.ndarray, "stations lines"],
    force_spectra: Complex[np.ndarray, "forces lines"],
    contact_spectra: Complex[np.ndarray, "contacts lines"],
) -> BodyMotion:
    """Modal accelerations of a body, hidden modes included, which follow from the exciting and the contact forces:

        A_m (sum_k phi_m(x_k) F_k - sum_j phi_mj f_j)

    and are subtracted from the stations' accelerations before the others are determined.
    """
    visible_count = len(transformation(rig, response.body, motion).inverse_shapes)
    input_spectra = np.concatenate([force_spectra, contact_spectra])
    modal_force = real_product(input_shapes(rig, response, rig.inputs).T, input_spectra)
    hidden_accelerations = response.accelerance[visible_count:] * modal_force[visible_count:]
    hidden_shapes = response.shapes(motion.stations)[:, visible_count:]
    visible_accelerations = accelerations - real_product(hidden_shapes, hidden_accelerations)
    body_motion = observed_body_motion(rig, response, motion, visible_accelerations)
    return replace(
        body_motion,
        acceleration=np.concatenate([body_motion.acceleration, hidden_accelerations]),
        elastic_indices=elastic_mode_indices(response, max(visible_count, mode_count_below_band_margin(response))),
    )


def start_transient_s(rig: Rig, slow_n_per_m: Float[np.ndarray, "contacts contacts"]) -> float:
    """Length of the start that is left out of a record that does not begin at rest, s: longer where springs of an
    elastic body act on high-passed displacements, which remember the start."""
    is_start_remembered = np.any(slow_n_per_m) and any(body.length_m for body in rig.bodies)
    return 2 / CORNER_HZ if is_start_remembered else START_TRANSIENT_S


def sensed_accelerations(motion: Kinematics, lines: SpectralLines) -> Complex[np.ndarray, "stations lines"]:
    """Spectra of the accelerations: those of the measured quantity of each sensor times a power of i omega.

    A displacement that does not begin at zero has the spectrum of a step, whose acceleration is no signal over time.
    """
    motion_by_order = (motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2)
    orders = [sensor.measures.order for sensor in motion.sensors]
    spectra = lines.spectra(np.array([motion_by_order[order][row] for row, order in enumerate(orders)]))
    return np.asarray(spectra * (1j * lines.omega) ** (2 - np.array(orders))[:, None])


def start_free_motion(
    responses: tuple[Response, ...],
    motion: Kinematics,
    station_rows: StationRows,
    lines: SpectralLines,
    accelerations_by_input: Complex[np.ndarray, "inputs stations lines"],
    station_errors: StationErrors,
) -> FreeMotionEstimate:
    """Free motion by the initial states of the modes, from the record cut off sharply at both ends.

    Behind the record's end the signals are zero, so the free motion from the unknown states there is estimated, too.
    """
    untapered, omega, force_count = replace(lines, is_tapered=False), lines.omega, len(motion.forces_n)
    sample_count, padding_samples = motion.sample_count, lines.padded_samples - motion.sample_count
    highest_hz = float(omega[-1]) / (2 * np.pi)
    unit_motions, start_prior, end_prior = free_motions_and_priors(responses, motion, highest_hz, lines.padded_samples)
    derivative_orders = [sensor.measures.order for sensor in motion.sensors]

    def unit_spectra(cut_lines: SpectralLines, cut_samples: int) -> Complex[np.ndarray, "states stations lines"]:
        def cut_spectra(signals: Float[np.ndarray, "rows samples"]) -> Complex[np.ndarray, "rows lines"]:
            return cut_lines.spectra(signals[:, :cut_samples])

        spectra = spectra_per_initial_value(
            unit_motions, derivative_orders, station_rows.is_in_metres, omega, cut_spectra
        )
        return station_rows.signals(spectra, spectra)

    start_spectra, end_spectra = unit_spectra(untapered, sample_count), unit_spectra(untapered, padding_samples)
    end_shift = np.exp(-1j * omega * sample_count / lines.rate_hz)
    measured = station_rows.signals(untapered.spectra(motion.displacement_m), sensed_accelerations(motion, untapered))
    signals_by_force = accelerations_by_input[:force_count] * untapered.spectra(motion.forces_n)[:, None]
    first_line = 0 if motion.zero_known else int(np.count_nonzero(omega < 2 * 2 * np.pi * CORNER_HZ))
    prior_mean, prior_deviation = (np.concatenate(ends) for ends in zip(start_prior, end_prior, strict=True))
    state_estimate = estimated_initial_state(
        np.concatenate([start_spectra, end_shift * end_spectra]),
        prior_mean,
        prior_deviation,
        measured - np.sum(signals_by_force, axis=0),
        accelerations_by_input[force_count:],
        station_errors.covariances(first_line),
        correlated_line_count=lines.correlated_line_count,
    )
    held_indices = np.flatnonzero([mode.is_held for mode in unit_motions])
    return state_estimate.free_motion(unit_spectra(lines, sample_count), held_indices)
