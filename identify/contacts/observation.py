"""Observation of a record, the input of the separation: spectra of all stations and strain gauges, the power of their
noise, and the modes that move, by the sensors or by the forces.

A station with an acceleration and a displacement sensor is observed on every line by the quieter of the two: noise of
the density s_x of displacements is one of omega^2 s_x in accelerations.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.fft import next_fast_len

from identify.contacts.gauges import Gauges, gauge_zero_changes
from identify.contacts.slow_motion import with_slow_modes
from identify.contacts.station_spectra import (
    SpectralLines,
    StationRows,
    driven_body_motion,
    observed_body_motion,
    sensed_accelerations,
)
from identify.linear.model import Response
from identify.linear.nuisance import Change, ObservedSignals
from identify.linear.observed_motion import ObservedBase, ObservedTransverse
from identify.linear.slow_stiffness import has_high_passed_springs
from identify.linear.truncation import Truncation, truncations_of
from identify.signals.kinematics import Kinematics
from identify.signals.measured_base import body_force_count
from rig.model.description import Rig
from rig.model.tolerances import Tolerances

RINGING_S = 12.0
"""Time in which the beams' ringing decays."""
NEGLIGIBLE_SHARE = 1e-4
"""Share of a sensor's signal below which modes left out are no nuisance parameter: a twentieth of a usual error of its
gain. Set by hand, for speed and memory."""


@dataclass(frozen=True)
class SeparationInput:
    """Arguments of a separation: rig, motion of the stations, samples per sample of the forces, standard deviation per
    sample of the accelerations' noise (m/s^2) and of that of the sensors of displacements (in their units), tolerances,
    gauges, and whether the record begins at rest."""

    rig: Rig
    motion: Kinematics
    decimation: int
    noise_m_per_s2: Float[np.ndarray, " stations"]
    displacement_noise: Float[np.ndarray, " stations"]
    tolerances: Tolerances
    gauges: Gauges
    begins_at_rest: bool

    @property
    def lines(self) -> SpectralLines:
        """Lines of the record padded with the time in which the beams' ringing decays."""
        rate_hz = self.motion.sample_rate_hz
        padded_samples = -(-(self.motion.sample_count + round(RINGING_S * rate_hz)) // self.decimation)
        return SpectralLines(self.decimation * next_fast_len(padded_samples, real=True), self.decimation, rate_hz)

    @property
    def is_single_mass(self) -> bool:
        """True for one mass with one contact, whose accelerometer alone tells the contact force."""
        return bool(self.rig.bodies[0].is_mass) and len(self.rig.bodies) == len(self.rig.contacts) == 1

    @property
    def eta_signs(self) -> Float[np.ndarray, "contacts stations"]:
        """Signs of the stations' displacements in the relative ones."""
        stations = self.motion.stations
        return np.array([[float(s == c.at) - float(s == c.against) for s in stations] for c in self.rig.contacts])


@dataclass(frozen=True)
class GaugeZeroAndTruncationErrors:
    """Errors of no single sensor or mode: the zeros of gauges, and the modes that a description leaves out."""

    zeros: tuple[Change, ...]
    truncations: tuple[Truncation, ...]

    def changes(self, input_spectra: Complex[np.ndarray, "inputs lines"]) -> tuple[Change, ...]:
        """Changes by one standard deviation of each, given the exciting forces, or these and the contact forces."""
        driven = (truncation for truncation in self.truncations if truncation.input_index < len(input_spectra))
        return (*self.zeros, *(truncation.change(input_spectra) for truncation in driven))

    def without_negligible(
        self, input_spectra: Complex[np.ndarray, "inputs lines"], signals: Complex[np.ndarray, "rows lines"]
    ) -> "GaugeZeroAndTruncationErrors":
        """Errors without the truncations that these forces make less than `NEGLIGIBLE_SHARE` of the signals (rms)."""
        truncations = []
        for truncation in self.truncations:
            change = truncation.change(input_spectra)
            if np.linalg.norm(change.signals) > NEGLIGIBLE_SHARE * np.linalg.norm(signals[change.sensors]):
                truncations.append(truncation)
        return replace(self, truncations=tuple(truncations))


def station_rows(record: SeparationInput, lines: SpectralLines, is_held: Bool[np.ndarray, " stations"]) -> StationRows:
    """Rows of the stations: displacements on slow lines where their zero is known, measured and the body is held, and
    wherever the sensor of the displacement is quieter than that of the acceleration, but on a single mass."""
    motion, omega = record.motion, lines.omega
    sensor_pairs = list(zip(motion.sensors, motion.displacement_sensors, strict=True))
    orders = np.array([[sensor.measures.order, displaced.measures.order] for sensor, displaced in sensor_pairs])
    differentiations, nyquist_omega = np.maximum(0, 2 - orders), np.pi * lines.rate_hz
    noise_colour = (2 * differentiations[:, :1] + 1) * (omega / nyquist_omega) ** (2 * differentiations[:, :1])
    variance_by_acceleration = record.noise_m_per_s2[:, None] ** 2 * noise_colour
    variance_by_displacement = record.displacement_noise[:, None] ** 2 * omega ** (2 * differentiations[:, 1:])
    base_order = motion.base.displacement_sensor.measures.order if motion.base else None
    has_both_sensors = (orders[:, 1] < orders[:, 0]) & (base_order is None or orders[:, 1] == base_order)
    is_quieter = has_both_sensors[:, None] & ~lines.is_slow & (variance_by_displacement < variance_by_acceleration)
    is_quieter &= not record.is_single_mass
    shows_zero = motion.zero_known & is_held & (orders[:, 1] == 0)
    is_in_metres = (shows_zero[:, None] & lines.is_slow) | is_quieter
    scale_per_s2 = np.where(is_quieter.any(axis=1), np.max(omega * is_quieter, axis=1) ** 2, 1.0)
    from_displacement = is_in_metres & has_both_sensors[:, None]
    acceleration_variance = np.where(from_displacement, variance_by_displacement, variance_by_acceleration)
    return StationRows(is_in_metres, scale_per_s2, omega, acceleration_variance)


def observation_of(
    record: SeparationInput,
    lines: SpectralLines,
    responses: tuple[Response, ...],
    stations: StationRows,
    input_accelerations: Complex[np.ndarray, "inputs rows lines"],
) -> tuple[ObservedSignals, GaugeZeroAndTruncationErrors, Float[np.ndarray, "rows lines"]]:
    """Observation by the spectra of the stations' rows and of strain; the further errors; the power of the noise.

    Where springs act on high-passed displacements, gauges tell nothing of the slow motion.
    """
    rig, motion, gauges, sample_count = record.rig, record.motion, record.gauges, record.motion.sample_count
    displacements, accelerations = _station_spectra(record, motion, lines)
    signals, station_response = stations.signals(displacements, accelerations), stations.response
    shows_slow_motion = [not (has_high_passed_springs(responses) or sensor.high_pass_hz) for sensor in gauges.sensors]
    is_gauge_usable = ~lines.is_slow | np.array(shows_slow_motion, bool)[:, None]
    gauge_rows = gauges.rows(lines, float(np.mean(np.abs(accelerations) ** 2)), is_gauge_usable)
    observed_base = None
    if base := motion.base:
        acceleration, displacement = lines.spectra(base.acceleration_m_per_s2), lines.spectra(base.displacement_m)
        base_accelerations = input_accelerations[-1]
        observed_base = ObservedBase(
            base.sensor, base.displacement_sensor, acceleration, displacement, base_accelerations
        )
    zeros = gauge_zero_changes(gauges.sensors, len(signals), gauge_rows.zero_error)
    observed = ObservedSignals(
        sensors=(*motion.sensors, *gauges.sensors),
        displacement_sensors=(*motion.displacement_sensors, *gauges.sensors),
        tolerances=record.tolerances,
        omega=lines.omega,
        sensor_response=np.concatenate([station_response, gauge_rows.response]),
        signals=np.concatenate([signals, gauge_rows.spectra]),
        force_accelerations=input_accelerations[: body_force_count(rig)],
        displacements=np.concatenate([displacements, np.zeros_like(gauge_rows.spectra)]),
        bodies=tuple(observed_body_motion(rig, body, motion, signals / station_response) for body in responses),
        base=observed_base,
        transverse=_observed_transverse(record, lines, stations),
        is_from_displacement=np.concatenate([stations.is_in_metres, np.zeros(gauge_rows.spectra.shape, dtype=bool)]),
    )
    sensor_by_row = dict(enumerate(observed.sensors))
    truncations = truncations_of(
        rig, responses, rig.inputs, sensor_by_row, observed.sensor_response, record.tolerances.truncation
    )
    noise_power = np.concatenate([sample_count * stations.noise_variance, gauge_rows.noise_power])
    return observed, GaugeZeroAndTruncationErrors(zeros, truncations), noise_power


def _station_spectra(
    record: SeparationInput, motion: Kinematics, lines: SpectralLines
) -> tuple[Complex[np.ndarray, "stations lines"], Complex[np.ndarray, "stations lines"]]:
    """Spectra of displacements and accelerations."""
    accelerations = (
        lines.spectra(motion.acceleration_m_per_s2) if record.begins_at_rest else sensed_accelerations(motion, lines)
    )
    return lines.spectra(motion.displacement_m), accelerations


def _observed_transverse(
    record: SeparationInput, lines: SpectralLines, station_rows: StationRows
) -> ObservedTransverse | None:
    """Motion in the other direction at the stations where it is measured too."""
    transverse = record.motion.transverse
    if transverse is None:
        return None
    indices = [k for k, station in enumerate(record.motion.stations) if transverse.row(station) is not None]
    transverse_rows = np.array([transverse.row(record.motion.stations[k]) for k in indices], dtype=int)
    displacements, accelerations = (spectra[transverse_rows] for spectra in _station_spectra(record, transverse, lines))
    signals = station_rows.rows_of(indices).signals(displacements, accelerations)
    return ObservedTransverse(indices, signals, displacements)


def noise_observation(
    rig: Rig, motion: Kinematics, observed: ObservedSignals, noise_spectra: Complex[np.ndarray, "rows lines"]
) -> ObservedSignals:
    """Observation of the sensors' noise alone."""
    station_count = len(motion.stations)
    accelerations = noise_spectra[:station_count] / observed.sensor_response[:station_count]
    displacements = np.zeros_like(observed.displacements)
    displacements[:station_count] = -accelerations / observed.omega**2
    return replace(
        observed,
        signals=noise_spectra,
        force_accelerations=np.zeros_like(observed.force_accelerations),
        displacements=displacements,
        bodies=tuple(observed_body_motion(rig, body.response, motion, accelerations) for body in observed.bodies),
        base=observed.base and observed.base.at_rest,
        transverse=observed.transverse and observed.transverse.at_rest,
    )


def with_driven_modes(
    record: SeparationInput,
    observed: ObservedSignals,
    input_spectra: Complex[np.ndarray, "inputs lines"],
    corner_hz: float,
    further_errors: GaugeZeroAndTruncationErrors,
) -> ObservedSignals:
    """Observation with the hidden modes, all held ones below a corner, and the further errors, driven by the exciting
    and the contact forces."""
    rig, motion = record.rig, record.motion
    station_count, force_count = len(motion.stations), len(rig.inputs)
    accelerations = observed.signals[:station_count] / observed.sensor_response[:station_count]
    exciting_spectra, contact_force_spectra = input_spectra[:force_count], input_spectra[force_count:]
    bodies = tuple(
        driven_body_motion(rig, body.response, motion, accelerations, exciting_spectra, contact_force_spectra)
        for body in observed.bodies
    )
    driven_signals = replace(observed, bodies=bodies, further_changes=further_errors.changes(input_spectra))
    return with_slow_modes(rig, driven_signals, input_spectra, corner_hz) if corner_hz else driven_signals
