"""The modal transformation (equations 21 and 22 of the paper): from stations to modal coordinates."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import next_fast_len

from identify.signals.kinematics import Kinematics
from rig.errors import RigError
from rig.model.description import Body, Rig, Station, contact_stations

INVISIBLE = 1e-3
NEARLY_INVISIBLE = 0.15
"""Shares of a shape's largest value; where it is smaller, the equation tells nothing, or little, of a contact."""


@dataclass(frozen=True)
class Transformation:
    """Station displacements to modal coordinates of one body: q = inverse @ u (kg^1/2 m).

    lost is, per mode, the rms share of the coordinate that the higher modes falsify when the contact forces and the
    exciting force shake the body with a white spectrum up to the highest fitted frequency.
    """

    body: Body
    rows: tuple[int, ...]
    inverse: Float[np.ndarray, "modes stations"]
    condition: float
    lost: Float[np.ndarray, " modes"]


@dataclass(frozen=True)
class ModalEquation:
    """One decoupled equation: q'' + 2 zeta omega q' + omega^2 q = shape_at_force F - sum_j shape_at_contacts_j f_j.

    shape_at_force and shape_at_contacts are mass-normalised (1/sqrt(kg)); the latter carry the sign with which the
    body's displacement enters the relative displacement. visibility is their size as a share of the shape's largest.
    """

    body: str
    index: int
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
        return f"{self.body} {self.index}"

    @property
    def visible(self) -> tuple[bool, ...]:
        return tuple(v >= INVISIBLE for v in self.visibility)


def transformation(rig: Rig, body: Body, motion: Kinematics) -> Transformation:
    """The least-squares inverse of the shapes at the stations, with as many modes as there are stations.

    Raises RigError if a body has no station, or if they cannot tell the modes apart.
    """
    rows = tuple(i for i, s in enumerate(motion.stations) if s.body == body.name)
    if not rows:
        raise RigError(f"body {body.name!r} has no measured station; put a sensor on it")
    places = np.array([motion.stations[i].position_m for i in rows])
    modes = min(len(rows), body.max_modes)
    shapes = body.shapes(places, modes)
    condition = float(np.linalg.cond(shapes))
    if condition > 1e3:
        raise RigError(
            f"the stations of {body.name!r} do not tell {modes} modes apart (condition number {condition:.2g}); "
            "spread them over the body"
        )
    inverse = np.linalg.pinv(shapes)
    return Transformation(body, rows, inverse, condition, _lost(rig, body, places, inverse))


def modal_equations(rig: Rig, motion: Kinematics, body: Body, modes: int = 4) -> tuple[ModalEquation, ...]:
    """The first `modes` modal equations of a body, with their coordinates from the measured motion."""
    transform = transformation(rig, body, motion)
    modes = min(modes, transform.inverse.shape[0])
    coordinates = [
        transform.inverse[:modes] @ rows[list(transform.rows)]
        for rows in (motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2)
    ]
    at_force = shape_at(body, rig.force_at, modes)
    at_contacts = np.array([contact_shapes(rig, body, j, modes) for j in range(len(rig.contacts))]).reshape(-1, modes)
    largest = np.abs(body.shapes(np.linspace(0, body.length_m, 101), modes)).max(axis=0)
    return tuple(
        ModalEquation(
            body=body.name,
            index=i + 1,
            frequency_hz=float(body.frequencies_hz(modes)[i]),
            damping_ratio=float(body.damping_ratios(modes)[i]),
            shape_at_force=float(at_force[i]),
            shape_at_contacts=at_contacts[:, i],
            visibility=tuple(float(abs(a) / largest[i]) for a in at_contacts[:, i]),
            displacement=coordinates[0][i],
            velocity=coordinates[1][i],
            acceleration=coordinates[2][i],
        )
        for i in range(modes)
    )


def without_higher_modes(
    rig: Rig, motion: Kinematics, contact_force_n: Float[np.ndarray, "contacts samples"]
) -> Kinematics:
    """The motion less what the modes beyond the fitted ones do under the exciting force and the contact forces.

    Each such mode's response is its receptance, as the rig's description has it, times its modal force. The last
    quarter second is left out, as the contact forces after the record's end are not known. `relative_displacements`
    needs the motion as it was.
    """
    keep = motion.force_n.size - round(0.25 * motion.sample_rate_hz)
    length = next_fast_len(motion.force_n.size, real=True)
    at_hz = np.fft.rfftfreq(length, 1 / motion.sample_rate_hz)
    force, contact = np.fft.rfft(motion.force_n, length), np.fft.rfft(contact_force_n, length)
    rows = [
        np.array(r[:, :keep]) for r in (motion.displacement_m, motion.velocity_m_per_s, motion.acceleration_m_per_s2)
    ]
    for body in rig.bodies:
        stations = [i for i, s in enumerate(motion.stations) if s.body == body.name]
        all_modes = body.max_modes
        if len(stations) >= all_modes:
            continue
        beyond = slice(len(stations), all_modes)
        places = np.array([motion.stations[i].position_m for i in stations])
        shapes = body.shapes(places, all_modes)[:, beyond]
        drive = [shape_at(body, rig.force_at, all_modes)] + [
            -contact_shapes(rig, body, j, all_modes) for j in range(len(rig.contacts))
        ]
        modal_force = np.array(drive)[:, beyond].T @ np.concatenate([force[None, :], contact])
        response = modal_force * receptance(
            body.frequencies_hz(all_modes)[beyond], body.damping_ratios(all_modes)[beyond], at_hz
        )
        for order, row in enumerate(rows):
            row[stations] -= np.fft.irfft(shapes @ response * (2j * np.pi * at_hz) ** order, length)[:, :keep]
    return replace(
        motion,
        force_n=motion.force_n[:keep],
        displacement_m=rows[0],
        velocity_m_per_s=rows[1],
        acceleration_m_per_s2=rows[2],
        lost_m_per_s2=motion.lost_m_per_s2[:, :keep],
    )


def receptance(
    frequency_hz: float | Float[np.ndarray, " modes"],
    damping_ratio: float | Float[np.ndarray, " modes"],
    at_hz: Float[np.ndarray, " lines"],
) -> Complex[np.ndarray, "*modes lines"]:
    """q over the modal force: 1 / (omega_0^2 - omega^2 + 2 i zeta omega_0 omega), s^2; zero at 0 Hz if rigid."""
    natural, omega = 2 * np.pi * np.asarray(frequency_hz)[..., None], 2 * np.pi * at_hz
    stiff = natural**2 - omega**2 + 2j * np.asarray(damping_ratio)[..., None] * natural * omega
    stiff[stiff == 0] = np.inf
    return np.reciprocal(stiff, out=stiff)


def contact_shapes(rig: Rig, body: Body, contact: int, modes: int) -> Float[np.ndarray, " modes"]:
    """How the body's modes enter the relative displacement of a contact: plus at its station, minus against it."""
    both = rig.contacts[contact]
    against = shape_at(body, both.against, modes) if both.against else 0.0
    return np.asarray(shape_at(body, both.at, modes) - against)


def relative_displacements(rig: Rig, motion: Kinematics) -> Float[np.ndarray, "contacts samples"]:
    """The relative displacement of each contact, from the sensors at its stations or, where none is, from the modes."""
    return _relative(rig, motion, motion.displacement_m)


def relative_velocities(rig: Rig, motion: Kinematics) -> Float[np.ndarray, "contacts samples"]:
    """As `relative_displacements`, of the velocities."""
    return _relative(rig, motion, motion.velocity_m_per_s)


def _relative(
    rig: Rig, motion: Kinematics, rows: Float[np.ndarray, "stations samples"]
) -> Float[np.ndarray, "contacts samples"]:
    def at(station: Station) -> Float[np.ndarray, " samples"]:
        row = motion.row(station)
        if row is not None:
            return rows[row]
        body = rig.body(station.body)
        transform = transformation(rig, body, motion)
        shape = shape_at(body, station, transform.inverse.shape[0])
        return np.asarray(shape @ transform.inverse @ rows[list(transform.rows)])

    return np.stack([at(c.at) - (at(c.against) if c.against else 0.0) for c in rig.contacts])


def shape_at(body: Body, station: Station, modes: int) -> Float[np.ndarray, " modes"]:
    """The body's shapes at a station; zero at a station of another body."""
    return body.shapes(np.array([station.position_m]), modes)[0] if station.body == body.name else np.zeros(modes)


def _lost(
    rig: Rig, body: Body, places: Float[np.ndarray, " stations"], inverse: Float[np.ndarray, "modes stations"]
) -> Float[np.ndarray, " modes"]:
    fitted, all_modes = inverse.shape[0], body.max_modes
    if fitted >= all_modes:
        return np.zeros(fitted)
    natural_hz = body.frequencies_hz(all_modes)
    high_hz = natural_hz[fitted - 1] or natural_hz[fitted]
    response = receptance(natural_hz, body.damping_ratios(all_modes), np.linspace(0.01, 1, 500) * high_hz)
    pushed = [s for c in rig.contacts for s in contact_stations(c) if s.body == body.name]
    pushed += [rig.force_at] if rig.force_at.body == body.name else []
    drive = body.shapes(np.array([s.position_m for s in pushed]), all_modes)
    covariance = (response @ response.conj().T).real * (drive.T @ drive)
    error = inverse @ body.shapes(places, all_modes) - np.eye(fitted, all_modes)
    return np.asarray(np.sqrt(np.diag(error @ covariance @ error.T) / np.diag(covariance)[:fitted]))
