"""Level and band of a force, or of a base, that makes the contacts of a rig rattle, by its linear modes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from rig.model.contact_laws import ContactLaw, stop_positions_m_and_sides
from rig.model.description import Rig, Station
from rig.model.modes import mode_count, modes_of, participation
from rig.model.space import plane_rigs

LOWEST_HZ = 0.5
"""Lower end of the excited band, Hz, as in the reference rigs."""
BAND_TO_SAMPLE_RATE = 1 / 40
"""Upper end of the excited band over the sampling rate, as in the reference rigs."""
RMS_TO_CLEARANCE = 4.0
"""Rms motion of the least moved contact, without its stops, over its clearance; 2.6 to 6 in the reference rigs."""
FARTHEST_STOP_M = 0.1
"""A stop farther away counts as out of reach: even shakers of long stroke (APS 113, 158 mm) move by some 80 mm only to
either side."""
FAR_STOP_RATIO = 10.0
"""So does the farther stop of a contact whose nearer one is so many times nearer, and met long before."""
MODE_COUNT, LINE_COUNT, MIN_DAMPING_RATIO = 16, 20_001, 1e-3


@dataclass(frozen=True)
class ForceLevel:
    """Level of a force, N rms, or of the inertial force on each kilogram by a base, N/kg, and why it was chosen."""

    rms_n: float
    reason: str


def rattling_level(rig: Rig, low_hz: float, high_hz: float) -> ForceLevel:
    """Force (N rms, flat from low to high) that would move the least moved contact, without stops, by 4 clearances rms.

    With several forces, the rms of each of them, independent of one another. The motion follows from the modes,
    eta = sum_m b_m p_m F / (w_m^2 - w^2 + 2 i z_m w_m w), with the springs between bodies. Rounded to one significant
    digit; 1 N if no contact has a clearance in reach or none responds to the force. The clearance of a contact is the
    mean over its stops in reach. In space, the larger of the forces of both directions. On a base that shakes, whose
    motion the ground and its stops share, the inertial force acts: its level is that of the base's acceleration.
    """
    if rig.in_space:
        driven_directions = {station.direction for station in rig.forces}
        planes = (plane_rig for direction, plane_rig in plane_rigs(rig).items() if direction in driven_directions)
        return max((rattling_level(plane_rig, low_hz, high_hz) for plane_rig in planes), key=lambda level: level.rms_n)
    omega = 2 * np.pi * np.linspace(max(low_hz, high_hz * 1e-3), high_hz, LINE_COUNT)
    mean_square_receptances = np.sum(
        [_contact_mean_square_receptances(rig, station, omega) for station in rig.forces], axis=0
    )
    contact_levels: list[tuple[float, str, float]] = []
    for contact, mean_square_m2_per_n2 in zip(rig.contacts, mean_square_receptances, strict=True):
        rms_m_per_n, clearance_m = float(np.sqrt(mean_square_m2_per_n2)), mean_reachable_clearance_m(contact.law)
        if rms_m_per_n > 0 and clearance_m:
            contact_levels.append((RMS_TO_CLEARANCE * clearance_m / rms_m_per_n, contact.name, clearance_m))
    highest_level_n, contact_name, clearance_m = max(contact_levels, default=(np.inf, "", 0.0))
    if not np.isfinite(highest_level_n):
        reason = f"as no contact has a clearance of at most {FARTHEST_STOP_M:g} m that the force moves it through"
        return ForceLevel(1.0, reason if rig.contacts else "as there is no contact")
    least_moved_clause = ", which moves least," if len(contact_levels) > 1 else ""
    motion_words = f"{RMS_TO_CLEARANCE:g} clearances of {1e3 * clearance_m:.3g} mm rms without its stops"
    reason = f"by which {contact_name!r}{least_moved_clause} would move by {motion_words}"
    return ForceLevel(float(f"{highest_level_n:.1g}"), reason)


def mean_reachable_clearance_m(law: ContactLaw) -> float:
    """Mean clearance, m, of the stops of a contact that a laboratory's force can reach; zero if there are none."""
    clearances_m = sorted(abs(wall_m) for wall_m, _ in stop_positions_m_and_sides(law))
    farthest_reachable_m = FARTHEST_STOP_M
    if clearances_m and clearances_m[0]:
        farthest_reachable_m = min(farthest_reachable_m, FAR_STOP_RATIO * clearances_m[0])
    reachable_clearances_m = [clearance_m for clearance_m in clearances_m if clearance_m <= farthest_reachable_m]
    return sum(reachable_clearances_m) / len(reachable_clearances_m) if reachable_clearances_m else 0.0


def _contact_mean_square_receptances(
    rig: Rig, force_at: Station, omega: Float[np.ndarray, " lines"]
) -> Float[np.ndarray, " contacts"]:
    """Mean square receptance over the lines from a force at a station to every relative displacement, m^2/N^2.

    With G the receptances of the bodies without contacts, to the relative displacements eta from a force F and from the
    forces D eta of the springs, D = k + i w c, the springs hold eta = (1 + G D)^-1 G_F F.
    """
    station_pairs = [(force_at, None), *((contact.at, contact.against) for contact in rig.contacts)]
    receptances = np.zeros((len(station_pairs), len(station_pairs), omega.size), dtype=complex)
    for body in rig.bodies:
        modes, body_mode_count = modes_of(rig, body), mode_count(body, MODE_COUNT)
        natural_rad_per_s = 2 * np.pi * modes.frequencies_hz(body_mode_count)[:, None]
        damping_ratios = np.maximum(modes.damping_ratios(body_mode_count), MIN_DAMPING_RATIO)[:, None]
        shapes = np.zeros((len(station_pairs), body_mode_count))
        if rig.is_on_ground(force_at):
            shapes[0] = participation(rig, body, modes, body_mode_count)
        for i, station_pair in enumerate(station_pairs):
            for sign, station in zip((1, -1), station_pair, strict=True):
                if station is not None and station.body == body.name:
                    shapes[i] += sign * modes.shapes(np.array([station.position_m]), body_mode_count)[0]
        modal_receptances = 1 / (natural_rad_per_s**2 - omega**2 + 2j * damping_ratios * natural_rad_per_s * omega)
        receptances += np.einsum("pm,qm,ml->pql", shapes, shapes, modal_receptances)
    spring_indices = [j for j, contact in enumerate(rig.contacts) if not contact.law.has_stops]
    eta_by_force, eta_by_springs = receptances[1:, 0], receptances[1:, 1:][:, spring_indices]
    if spring_indices:
        laws = [rig.contacts[spring].law for spring in spring_indices]
        dynamic_stiffness = np.array([law.stiffness_n_per_m + 1j * omega * law.damping_n_s_per_m for law in laws])
        feedback = np.eye(len(spring_indices)) + (eta_by_springs[spring_indices] * dynamic_stiffness).transpose(2, 0, 1)
        spring_eta = np.linalg.solve(feedback, eta_by_force[spring_indices].T[..., None])
        eta_by_force = eta_by_force - np.einsum("csl,sl,ls->cl", eta_by_springs, dynamic_stiffness, spring_eta[..., 0])
    return np.asarray(np.mean(np.abs(eta_by_force) ** 2, axis=1))
