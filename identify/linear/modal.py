"""Modal transformation (equations 21 and 22 of the paper): from stations to modal coordinates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import next_fast_len

from identify.signals.kinematics import Kinematics
from rig.errors import RigError
from rig.model.description import Body, Rig, Station, contact_stations
from rig.model.modes import participation

INVISIBLE_SHARE = 1e-3
NEARLY_INVISIBLE_SHARE = 0.15
"""Shares of a shape's largest value; below them a modal equation shows nothing, or little, of a contact."""


@dataclass(frozen=True)
class Transformation:
    """Transformation from station displacements to modal coordinates of one body: q = inverse_shapes @ u (kg^1/2 m).

    truncation_shares are, per mode, the rms share of the coordinate that the higher modes contribute when the contact
    forces and the exciting force shake the body with a white spectrum up to the highest fitted frequency.
    """

    body: Body
    station_rows: tuple[int, ...]
    inverse_shapes: Float[np.ndarray, "modes stations"]
    condition_number: float
    truncation_shares: Float[np.ndarray, " modes"]


@dataclass(frozen=True)
class ModalEquation:
    """Decoupled equation q'' + 2 zeta omega q' + omega^2 q = shape_at_force F - sum_j shape_at_contacts_j f_j.

    Of several inputs, shape_at_force is the one of the largest size, and F is `equivalent_force_n`. Both kinds of
    shapes are mass-normalised (1/sqrt(kg)); shape_at_contacts have the sign of the body's displacement in the relative
    displacement. visibility is their size as a share of the shape's largest value.
    """

    body: str
    mode_number: int
    frequency_hz: float
    damping_ratio: float
    shape_at_force: float
    shape_at_contacts: Float[np.ndarray, " contacts"]
    visibility: tuple[float, ...]
    displacement: Float[np.ndarray, " samples"]
    velocity: Float[np.ndarray, " samples"]
    acceleration: Float[np.ndarray, " samples"]

    @property
    def name(self) -> str:
        return f"{self.body} {self.mode_number}"

    @property
    def is_visible(self) -> tuple[bool, ...]:
        return tuple(v >= INVISIBLE_SHARE for v in self.visibility)


def transformation(rig: Rig, body: Body, motion: Kinematics) -> Transformation:
    """Least-squares inverse of the shapes at the stations, with as many modes as there are stations.

    Raises RigError if a body has no station, or if these cannot tell the modes apart.
    """
    station_rows = tuple(i for i, station in enumerate(motion.stations) if station.body == body.name)
    if not station_rows:
        raise RigError(f"body {body.name!r} has no measured station; put a sensor on it")
    positions_m = np.array([motion.stations[row].position_m for row in station_rows])
    mode_count = min(len(station_rows), body.max_modes)
    shapes = body.shapes(positions_m, mode_count)
    condition_number = float(np.linalg.cond(shapes))
    if condition_number > 1e3:
        raise RigError(
            f"the stations of {body.name!r} do not tell {mode_count} modes apart (condition number "
            f"{condition_number:.2g}); spread them over the body"
        )
    inverse_shapes = np.linalg.pinv(shapes)
    truncation_shares = _truncation_shares(rig, body, positions_m, inverse_shapes)
    return Transformation(body, station_rows, inverse_shapes, condition_number, truncation_shares)


def modal_equations(
    rig: Rig,
    motion: Kinematics,
    body: Body,
    mode_count: int = 4,
    contact_force_n: Float[np.ndarray, "contacts samples"] | None = None,
) -> tuple[ModalEquation, ...]:
    """First `mode_count` modal equations of a body, with their coordinates from the measured motion.

    Given the contact forces, the motion by the modes beyond the fitted ones is subtracted from the stations: the
    response of each is its receptance, as the rig's description has it, times its modal force. The last quarter second
    is then left out (`correctable_sample_count`), as the contact forces after the record's end are unknown.
    """
    transform = transformation(rig, body, motion)
    mode_count = min(mode_count, transform.inverse_shapes.shape[0])
    coordinates = [
        transform.inverse_shapes[:mode_count] @ signals[list(transform.station_rows)]
        for signals in (motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2)
    ]
    if contact_force_n is not None:
        coordinates = _without_higher_modes(rig, motion, transform, coordinates, contact_force_n)
    displacement, velocity, acceleration = coordinates
    force_shapes = input_mode_shapes(rig, body, mode_count)
    force_shapes = force_shapes[np.argmax(np.abs(force_shapes), axis=0), np.arange(mode_count)]
    eta_shape_rows = [contact_shapes(rig, body, j, mode_count) for j in range(len(rig.contacts))]
    eta_shapes = np.array(eta_shape_rows).reshape(-1, mode_count)
    largest_shapes = np.abs(body.shapes(np.linspace(0, body.length_m, 101), mode_count)).max(axis=0)
    return tuple(
        ModalEquation(
            body=body.name,
            mode_number=m + 1,
            frequency_hz=float(body.frequencies_hz(mode_count)[m]),
            damping_ratio=float(body.damping_ratios(mode_count)[m]),
            shape_at_force=float(force_shapes[m]),
            shape_at_contacts=eta_shapes[:, m],
            visibility=tuple(float(abs(eta_shape) / largest_shapes[m]) for eta_shape in eta_shapes[:, m]),
            displacement=displacement[m],
            velocity=velocity[m],
            acceleration=acceleration[m],
        )
        for m in range(mode_count)
    )


def equivalent_force_n(
    rig: Rig, equation: ModalEquation, forces_n: Float[np.ndarray, "forces samples"]
) -> Float[np.ndarray, " samples"]:
    """Force F that pushes the mode as all inputs do: sum_k phi(x_k) F_k / shape_at_force."""
    if len(forces_n) == 1 or equation.shape_at_force == 0:
        return forces_n[0]
    body = rig.body(equation.body)
    input_shapes = input_mode_shapes(rig, body, equation.mode_number)[:, -1]
    return input_shapes / equation.shape_at_force @ forces_n


def correctable_sample_count(motion: Kinematics) -> int:
    """Number of samples from whose modal coordinates the higher modes can be subtracted."""
    return motion.sample_count - round(0.25 * motion.sample_rate_hz)


def _without_higher_modes(
    rig: Rig,
    motion: Kinematics,
    transform: Transformation,
    coordinates: list[Float[np.ndarray, "modes samples"]],
    contact_force_n: Float[np.ndarray, "contacts samples"],
) -> list[Float[np.ndarray, "modes fewer"]]:
    """Coordinates without the higher modes, one mode after another, as all responses together take much memory."""
    body, fitted_count, kept_samples = transform.body, len(transform.inverse_shapes), correctable_sample_count(motion)
    padded_length = next_fast_len(motion.sample_count, real=True)
    line_hz = np.fft.rfftfreq(padded_length, 1 / motion.sample_rate_hz)
    force_spectra = np.fft.rfft(np.concatenate([motion.forces_n, -contact_force_n]), padded_length)
    positions_m = np.array([motion.stations[row].position_m for row in transform.station_rows])
    coordinate_shares = transform.inverse_shapes[: len(coordinates[0])] @ body.shapes(positions_m, body.max_modes)
    eta_shapes = [contact_shapes(rig, body, j, body.max_modes) for j in range(len(rig.contacts))]
    input_shapes = np.stack([*input_mode_shapes(rig, body, body.max_modes), *eta_shapes])
    natural_hz, damping_ratios = body.frequencies_hz(body.max_modes), body.damping_ratios(body.max_modes)
    higher_spectra = np.zeros((len(coordinate_shares), line_hz.size), dtype=complex)
    for m in range(fitted_count, body.max_modes):
        modal_force = input_shapes[:, m] @ force_spectra
        mode_response = receptance(float(natural_hz[m]), float(damping_ratios[m]), line_hz) * modal_force
        for i, share in enumerate(coordinate_shares[:, m]):
            higher_spectra[i] += share * mode_response
    corrected_coordinates = []
    for fitted_coordinate in coordinates:
        higher_parts = [np.fft.irfft(spectrum, padded_length)[:kept_samples] for spectrum in higher_spectra]
        corrected_coordinates.append(fitted_coordinate[:, :kept_samples] - np.stack(higher_parts))
        higher_spectra *= 2j * np.pi * line_hz
    return corrected_coordinates


def receptance(
    frequency_hz: float | Float[np.ndarray, " modes"],
    damping_ratio: float | Float[np.ndarray, " modes"],
    line_hz: Float[np.ndarray, " lines"],
) -> Complex[np.ndarray, "*modes lines"]:
    """Receptance of a modal force, 1 / (omega_0^2 - omega^2 + 2 i zeta omega_0 omega), s^2; zero at 0 Hz if rigid."""
    natural_omega, omega = 2 * np.pi * np.asarray(frequency_hz)[..., None], 2 * np.pi * line_hz
    dynamic_stiffness = natural_omega**2 - omega**2 + 2j * np.asarray(damping_ratio)[..., None] * natural_omega * omega
    dynamic_stiffness[dynamic_stiffness == 0] = np.inf
    return np.reciprocal(dynamic_stiffness, out=dynamic_stiffness)


def contact_shapes(rig: Rig, body: Body, contact_index: int, mode_count: int) -> Float[np.ndarray, " modes"]:
    """Mode shapes in the relative displacement of a contact: that at its station minus that against it."""
    contact = rig.contacts[contact_index]
    against_shape = shapes_at(body, contact.against, mode_count) if contact.against else 0.0
    return np.asarray(shapes_at(body, contact.at, mode_count) - against_shape)


def signals_across_contacts(
    rig: Rig, motion: Kinematics, station_signals: Float[np.ndarray, "stations samples"]
) -> Float[np.ndarray, "contacts samples"]:
    """Signals of the stations, such as their displacements, across each contact: from the sensors at its stations or,
    without any, from the modes."""

    def station_signal(station: Station) -> Float[np.ndarray, " samples"]:
        row = motion.row(station)
        if row is not None:
            return station_signals[row]
        body = rig.body(station.body)
        transform = transformation(rig, body, motion)
        shape = shapes_at(body, station, transform.inverse_shapes.shape[0])
        return np.asarray(shape @ transform.inverse_shapes @ station_signals[list(transform.station_rows)])

    return np.stack([station_signal(c.at) - (station_signal(c.against) if c.against else 0.0) for c in rig.contacts])


def input_mode_shapes(rig: Rig, body: Body, mode_count: int) -> Float[np.ndarray, "inputs modes"]:
    """Shapes of a body through which the rig's inputs drive it; of a shaken base the participation of the modes."""
    shapes_by_input = [
        participation(rig, body, body, mode_count) if rig.is_on_ground(place) else shapes_at(body, place, mode_count)
        for place in rig.inputs
    ]
    return np.array(shapes_by_input).reshape(len(shapes_by_input), mode_count)


def force_on_mass(
    rig: Rig, mass_body: Body, forces_n: Float[np.ndarray, "inputs samples"]
) -> Float[np.ndarray, " samples"]:
    """Sum of the forces of all inputs on a mass, N."""
    shapes = input_mode_shapes(rig, mass_body, 1)[:, 0] / mass_body.shapes(np.zeros(1), 1)[0, 0]
    return np.asarray(shapes @ forces_n)


def shapes_at(body: Body, station: Station, mode_count: int) -> Float[np.ndarray, " modes"]:
    """Shapes of a body at a station; zero at a station of another body."""
    if station.body != body.name:
        return np.zeros(mode_count)
    return body.shapes(np.array([station.position_m]), mode_count)[0]


def _truncation_shares(
    rig: Rig,
    body: Body,
    positions_m: Float[np.ndarray, " stations"],
    inverse_shapes: Float[np.ndarray, "modes stations"],
) -> Float[np.ndarray, " modes"]:
    """Share of each fitted coordinate that the higher modes contribute (`Transformation.truncation_shares`)."""
    fitted_count, mode_count = inverse_shapes.shape[0], body.max_modes
    if fitted_count >= mode_count:
        return np.zeros(fitted_count)
    natural_hz = body.frequencies_hz(mode_count)
    highest_hz = natural_hz[fitted_count - 1] or natural_hz[fitted_count]
    receptances = receptance(natural_hz, body.damping_ratios(mode_count), np.linspace(0.01, 1, 500) * highest_hz)
    stations = [station for contact in rig.contacts for station in contact_stations(contact)]
    contact_places_m = np.array([station.position_m for station in stations if station.body == body.name])
    input_shapes = np.concatenate([body.shapes(contact_places_m, mode_count), input_mode_shapes(rig, body, mode_count)])
    modal_covariance = (receptances @ receptances.conj().T).real * (input_shapes.T @ input_shapes)
    error_shapes = inverse_shapes @ body.shapes(positions_m, mode_count) - np.eye(fitted_count, mode_count)
    error_power = np.diag(error_shapes @ modal_covariance @ error_shapes.T)
    return np.asarray(np.sqrt(error_power / np.diag(modal_covariance)[:fitted_count]))
