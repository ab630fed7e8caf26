"""Responses and ground forces under the record's window: known forces on held bodies, cubic springs and dampers.

With the window w(t), the force F(t) and the impulse response h(t), a held body rings on where w falls, so that
h * (w F) differs from w (h * F), and weights by frequency spread the difference over seconds before the end of the
record. For a rig without contacts the response is therefore windowed, w (h * F), not the force. Forces of cubic springs
and of friction to the ground are laws of the measured motion itself, as are those of dampers that no linear model
holds: they are evaluated on w x / w and windowed afterwards.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace
from scipy.fft import irfft, rfft

from identify.gaps.residual.extent import is_free_mass
from identify.gaps.residual.record import Record
from identify.linear.model import Place, Response, real_product
from identify.signals.kinematics import omega_power
from identify.signals.law_evaluation import oversampling
from rig.model.description import PointDamper, PointMass, PointSpring, Rig, StaticLoad, Station, contact_stations

LEAST_WINDOW = 1e-2
"""Window below which signals are not restored from windowed ones."""

Spectrum = Complex[np.ndarray, " lines"]
MotionSpectra = Complex[np.ndarray, "sensors lines"]
SensorPlaces = Sequence[Place]


@dataclass(frozen=True, eq=False)
class SensedMotion:
    """Windowed displacements, m, and velocities, m/s, at the sensors."""

    displacements: MotionSpectra
    velocities: MotionSpectra


GroundForceChanges = Callable[[MotionSpectra], list[tuple[Station, Spectrum]]]
"""Stations and changes of forces to the ground, N, as a function of the change of the sensors' displacements, m."""


def known_forces_of(
    record: Record, rig: Rig, responses: tuple[Response, ...], sensor_places: SensorPlaces, motion: SensedMotion
) -> tuple[tuple[Station, Spectrum], ...]:
    """Known forces: measured ones, tones, static loads, and those of ground springs and dampers by measured motion
    (against a shaken base, whose inertial force on each kilogram is the measured one)."""
    if record.base is None:
        lag_factor = np.exp(-1j * record.omega * rig.force_sensor.lag_s)
        measured_forces_n = record.force_spectra * lag_factor / rig.force_sensor.gain
    else:
        measured_forces_n = -record.base.deconvolved(rig, record.omega).acceleration[None]
    tone_forces = [(tone.station, record.spectrum(tone.force_n(record.sample_times_s))) for tone in rig.tones]
    ground_reactions, following_rig = [], with_measured_motion_dampers_only(record, rig)
    if has_ground_forces(following_rig):
        ground_reactions = ground_forces(record, following_rig, responses, sensor_places, motion)
    measured_forces = zip(rig.forces, measured_forces_n, strict=True)
    return (*measured_forces, *tone_forces, *_static_loads_on_free_masses(record, rig), *ground_reactions)


def response_to_force(
    record: Record,
    rig: Rig,
    acceleration_per_newton: Complex[np.ndarray, "sensors lines"],
    force_spectrum: Complex[np.ndarray, " lines"],
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations at the sensors by a windowed force."""
    accelerations = acceleration_per_newton * force_spectrum
    is_ringing_on = np.array([_is_response_windowed(record, rig, sensor.station.body) for sensor in record.sensors])
    if not is_ringing_on.any():
        return accelerations
    unwindowed = acceleration_per_newton * _unwindowed_force(record, force_spectrum)
    windowed = _windowed_accelerations(record, unwindowed, [sensor.measures.order for sensor in record.sensors])
    return np.where(is_ringing_on[:, None], windowed, accelerations)


def modal_response(
    record: Record, rig: Rig, response: Response, modal_force_spectra: Complex[np.ndarray, "modes lines"]
) -> Complex[np.ndarray, "modes lines"]:
    """Modal accelerations of a body by windowed forces, consistent with `response_to_force` at its sensors."""
    body_name = response.body.name
    if not _is_response_windowed(record, rig, body_name):
        return response.modal_accelerations(modal_force_spectra)
    derivative_order = next((sensor.measures.order for sensor in record.sensors if sensor.station.body == body_name), 2)
    unwindowed_response = response.modal_accelerations(_unwindowed_force(record, modal_force_spectra))
    return _windowed_accelerations(record, unwindowed_response, [derivative_order] * len(unwindowed_response))


def _static_loads_on_free_masses(record: Record, rig: Rig) -> list[tuple[Station, Spectrum]]:
    """Windowed static loads that move free bodies from the record's start on, each with its station."""
    spectrum_of_one = record.spectrum(np.ones(record.sample_count)) if rig.loads else np.zeros(0)
    return [
        (load.station, load.force_n * spectrum_of_one)
        for load in _loads_on_contactless_bodies(record, rig)
        if is_free_mass(rig, load.station.body)
    ]


def static_modal_accelerations(record: Record, rig: Rig, response: Response) -> Complex[np.ndarray, "modes lines"]:
    """Modal accelerations of a held body that rests under static loads: second derivatives of its windowed static
    displacements phi F / omega^2 in each mode."""
    body_name = response.body.name
    loads = [load for load in _loads_on_contactless_bodies(record, rig) if load.station.body == body_name]
    if not loads or is_free_mass(rig, body_name):
        return np.zeros((response.mode_count, record.omega.size), dtype=complex)
    modal_load_n = np.array([load.force_n for load in loads]) @ response.shapes([load.station for load in loads])
    displacements = modal_load_n / (2 * np.pi * response.dynamics.natural_hz) ** 2
    return np.outer(displacements, -(record.omega**2) * record.spectrum(np.ones(record.sample_count)))


def _loads_on_contactless_bodies(record: Record, rig: Rig) -> list[StaticLoad]:
    """Static loads on bodies without contacts, where the zero of displacements is known."""
    bodies_in_contact = {station.body for contact in rig.contacts for station in contact_stations(contact)}
    return [load for load in rig.loads if record.zero_known and load.station.body not in bodies_in_contact]


def _is_response_windowed(record: Record, rig: Rig, body_name: str) -> bool:
    """True for a held body in a record whose responses are windowed."""
    return record.responses_windowed and not is_free_mass(rig, body_name)


def _unwindowed_force(
    record: Record, force_spectrum: Complex[np.ndarray, "*rows lines"]
) -> Complex[np.ndarray, "*rows lines"]:
    """Force up to the record's end from the windowed one, F(t) = (w F)(t) / w(t) where w > LEAST_WINDOW."""
    window = _falling_half_window(record)
    windowed = irfft(force_spectrum, window.size)
    return np.asarray(rfft(np.divide(windowed, window, out=np.zeros_like(windowed), where=window > LEAST_WINDOW)))


def _windowed_accelerations(
    record: Record, accelerations: Complex[np.ndarray, "rows lines"], derivative_orders: Sequence[int]
) -> Complex[np.ndarray, "rows lines"]:
    """Windowed accelerations: signals w(t) y(t) of the given derivatives, differentiated to accelerations."""
    window_fall = _falling_half_window(record)
    per_acceleration = np.stack([omega_power(record.omega, 2 - order, 0.0) for order in derivative_orders])
    return np.asarray(rfft(irfft(accelerations / per_acceleration, window_fall.size) * window_fall) * per_acceleration)


def _falling_half_window(record: Record) -> Float[np.ndarray, " padded"]:
    """Falling half of the window over the padded record at `rate_hz`, one before it."""
    window = record.window[:: record.decimation]
    window_fall = np.zeros(record.transform_length // record.decimation)
    window_fall[: window.size] = np.where(np.arange(window.size) < window.size // 2, 1.0, window)
    return window_fall


def ground_forces(
    record: Record, rig: Rig, responses: tuple[Response, ...], sensor_places: SensorPlaces, motion: SensedMotion
) -> list[tuple[Station, Spectrum]]:
    """Windowed forces of ground springs and dampers, -k3 x^3 and -c v - F tanh(v / v0), each with its station."""
    springs, dampers = _cubic_springs(rig), rig.dampers
    spring_displacements = displacements_at_elements(responses, sensor_places, springs, motion.displacements)
    damper_velocities = displacements_at_elements(responses, sensor_places, dampers, motion.velocities)
    ground_reactions = []
    for spring, displacement in zip(springs, spring_displacements, strict=True):
        fine_eta_m, window = _oversampled_with_window(record, 3, displacement)
        force_n = window * spring.law.force_n(fine_eta_m / window)
        ground_reactions.append((spring.station, -_spectrum_on_lines(record, force_n)))
    for damper, velocity in zip(dampers, damper_velocities, strict=True):
        if damper.friction_n:
            fine_velocity_m_per_s, window = _oversampled_with_window(record, _oversampling_factor(record), velocity)
            force_n = window * damper.law.force_n(np.zeros_like(fine_velocity_m_per_s), fine_velocity_m_per_s / window)
            ground_reactions.append((damper.station, -_spectrum_on_lines(record, force_n)))
        else:
            ground_reactions.append((damper.station, -damper.damping_n_s_per_m * velocity))
    return ground_reactions


def ground_force_derivative(
    record: Record, rig: Rig, responses: tuple[Response, ...], sensor_places: SensorPlaces, motion: SensedMotion
) -> GroundForceChanges:
    """Directional derivative of each of the `ground_forces`, as a function of the displacements' change."""
    springs, dampers = _cubic_springs(rig), rig.dampers
    spring_displacements = displacements_at_elements(responses, sensor_places, springs, motion.displacements)
    damper_velocities = displacements_at_elements(responses, sensor_places, dampers, motion.velocities)
    force_slopes: list[Float[np.ndarray, " fine"]] = []
    for spring, displacement in zip(springs, spring_displacements, strict=True):
        fine_eta_m, window = _oversampled_with_window(record, 3, displacement)
        force_slopes.append(spring.law.by_eta_n_per_m(fine_eta_m / window))
    for damper, velocity in zip(dampers, damper_velocities, strict=True):
        if damper.friction_n:
            fine_m_per_s, window = _oversampled_with_window(record, _oversampling_factor(record), velocity)
            force_slopes.append(damper.law.by_rate_n_s_per_m(np.zeros_like(fine_m_per_s), fine_m_per_s / window))
        else:
            force_slopes.append(np.array([damper.damping_n_s_per_m]))

    def force_changes(displacement_changes: MotionSpectra) -> list[tuple[Station, Spectrum]]:
        motion_changes = (
            *displacements_at_elements(responses, sensor_places, springs, displacement_changes),
            *displacements_at_elements(responses, sensor_places, dampers, 1j * record.omega * displacement_changes),
        )
        padded_sample_count = record.transform_length // record.decimation
        force_stations = [*(spring.station for spring in springs), *(damper.station for damper in dampers)]
        changes_by_station = []
        for station, slope, motion_change in zip(force_stations, force_slopes, motion_changes, strict=True):
            if slope.size > 1:
                fine_motion_change = _oversampled_signal(record, slope.size // padded_sample_count, motion_change)
                changes_by_station.append((station, -_spectrum_on_lines(record, slope * fine_motion_change)))
            else:
                changes_by_station.append((station, -slope * motion_change))
        return changes_by_station

    return force_changes


def with_measured_motion_dampers_only(record: Record, rig: Rig) -> Rig:
    """Rig with those dampers alone that follow the measured motion: friction, and the dampers of bodies whose free
    motion is fitted, or whose windowed acceleration is measured."""
    return replace(rig, dampers=tuple(damper for damper in rig.dampers if not _is_linear(record, rig, damper)))


def linear_dampers(record: Record, rig: Rig) -> list[PointDamper]:
    """Dampers that the linear model holds; see `with_measured_motion_dampers_only`."""
    return [damper for damper in rig.dampers if _is_linear(record, rig, damper)]


def _is_linear(record: Record, rig: Rig, damper: PointDamper) -> bool:
    is_moving_freely = record.fits_initial_state or (record.zero_known and is_free_mass(rig, damper.station.body))
    return not (damper.friction_n or is_moving_freely)


def has_ground_forces(rig: Rig) -> bool:
    """True if a rig has forces to the ground that follow from the measured motion."""
    return bool(_cubic_springs(rig) or rig.dampers)


def has_nonlinear_ground_forces(rig: Rig) -> bool:
    """True if forces to the ground are nonlinear, so that they cannot be computed from a selection of lines."""
    return bool(_cubic_springs(rig)) or any(damper.friction_n for damper in rig.dampers)


def _cubic_springs(rig: Rig) -> list[PointSpring]:
    return [spring for spring in rig.springs if spring.cubic_n_per_m3]


def displacements_at_elements(
    responses: tuple[Response, ...],
    sensor_places: SensorPlaces,
    attached_elements: Sequence[PointSpring | PointDamper | PointMass],
    sensor_displacements: MotionSpectra,
) -> Complex[np.ndarray, "attached lines"]:
    """Displacements (or accelerations) at attached elements from those at the sensors."""
    element_stations: list[Station | None] = [element.station for element in attached_elements]
    weights = np.sum([response.sensor_weights(sensor_places, element_stations) for response in responses], axis=0)
    return real_product(weights, sensor_displacements)


def _oversampling_factor(record: Record) -> int:
    """Multiple of the record's rate that resolves a friction force."""
    return max(3, oversampling(record.residual_rate_hz))


def _oversampled_with_window(
    record: Record, rate_multiple: int, spectrum: Spectrum
) -> tuple[Float[np.ndarray, " fine"], Float[np.ndarray, " fine"]]:
    """Signal over the padded record at a multiple of its rate, and its window, bounded below by LEAST_WINDOW."""
    fine_sample_count = rate_multiple * (record.transform_length // record.decimation)
    sample_positions = np.arange(fine_sample_count) * (record.decimation / rate_multiple)
    window = np.interp(sample_positions, np.arange(record.sample_count), record.window, right=0.0)
    return _oversampled_signal(record, rate_multiple, spectrum), np.maximum(window, LEAST_WINDOW)


def _oversampled_signal(record: Record, rate_multiple: int, spectrum: Spectrum) -> Float[np.ndarray, " fine"]:
    """Signal over the padded record at a multiple of its rate."""
    fine_sample_count = rate_multiple * (record.transform_length // record.decimation)
    return rate_multiple * np.fft.irfft(spectrum / record.decimation, fine_sample_count)


def _spectrum_on_lines(record: Record, fine_signal: Float[np.ndarray, " fine"]) -> Spectrum:
    """Spectrum of an oversampled signal on the record's lines, without aliasing."""
    padded_sample_count = record.transform_length // record.decimation
    spectrum = np.fft.rfft(fine_signal)[: padded_sample_count // 2 + 1]
    return np.asarray(spectrum * record.decimation * padded_sample_count / fine_signal.size)
