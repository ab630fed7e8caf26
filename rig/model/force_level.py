"""Level and band of a force that makes the contacts of a rig rattle, by its linear modes."""

import numpy as np
from jaxtyping import Float

from rig.model.description import Rig, Station
from rig.model.modes import mode_count, modes_of

LOWEST_HZ, BAND_TO_SAMPLE_RATE = 0.5, 1 / 40
"""Lower end of the excited band, Hz, and its upper end over the sampling rate, as in the reference rigs."""
RMS_TO_CLEARANCE = 4.0
"""Rms motion of the least moved contact, without its stops, over its clearance; 2.6 to 6 in the reference rigs."""
MODES, LINES, MIN_DAMPING_RATIO = 16, 20_001, 1e-3


def rattling_n(rig: Rig, low_hz: float, high_hz: float) -> float:
    """Force (N rms, flat from low to high) that would move the least moved contact, without stops, by 4 clearances rms.

    With several forces, the rms of each of them, independent of one another. The motion follows from the modes,
    eta = sum_m b_m p_m F / (w_m^2 - w^2 + 2 i z_m w_m w). Rounded to one significant digit; 1 N if no contact has a
    clearance or none responds to the force.
    """
    omega = 2 * np.pi * np.linspace(max(low_hz, high_hz * 1e-3), high_hz, LINES)
    squares = np.sum([_squares_by(rig, station, omega) for station in rig.forces], axis=0)
    needed_n = []
    for contact, square in zip(rig.contacts, squares, strict=True):
        rms_m_per_n = float(np.sqrt(square))
        if rms_m_per_n > 0 and contact.law.clearance_m > 0:
            needed_n.append(RMS_TO_CLEARANCE * contact.law.clearance_m / rms_m_per_n)
    return float(f"{max(needed_n):.1g}") if needed_n and np.isfinite(max(needed_n)) else 1.0


def _squares_by(rig: Rig, force_at: Station, omega: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " contacts"]:
    """Mean square receptance over the lines from a force at a station to every relative displacement, m^2/N^2."""
    driven_body = rig.body(force_at.body)
    modes, count = modes_of(rig, driven_body), mode_count(driven_body, MODES)
    natural = 2 * np.pi * modes.frequencies_hz(count)[:, None]
    ratios = np.maximum(modes.damping_ratios(count), MIN_DAMPING_RATIO)[:, None]

    def shape(station: Station | None) -> np.ndarray:
        if station is None or station.body != driven_body.name:
            return np.zeros(count)
        return modes.shapes(np.array([station.position_m]), count)[0]

    receptances = shape(force_at)[:, None] / (natural**2 - omega**2 + 2j * ratios * natural * omega)
    contact_shapes = (shape(contact.at) - shape(contact.against) for contact in rig.contacts)
    return np.array([np.mean(np.abs(row @ receptances) ** 2) for row in contact_shapes])
