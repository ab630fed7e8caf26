"""Excitation of a user's rig from its rig.json, for `rig record FILE.json`."""

from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig, Station
from rig.model.modes import mode_count, modes_of
from rig.simulation.excitation import Excitation, excitation_of

MIN_STEP_RATE_HZ = 2.0**14
"""Least rate of a plant's steps, Hz; the rate is the next multiple of the sampling rate."""
BAND_TO_SAMPLE_RATE = 1 / 40
"""Upper end of the excited band over the sampling rate, as in the reference rigs."""
RMS_TO_CLEARANCE = 4.0
"""Rms motion of the least moved contact, without its stops, over its clearance; 2.6 to 6 in the reference rigs."""
MODES, LINES, MIN_DAMPING_RATIO = 16, 20_001, 1e-3


class Drive(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a recording of a user's rig; None stands for a value that follows from the rig."""

    duration_s: float = 60.0
    step_s: float | None = None
    excitation: str = "gaussian"
    rms_n: float | None = None
    low_hz: float = 0.5
    high_hz: float | None = None
    seed: int = 1


@dataclass(frozen=True)
class OwnRig:
    """A user's rig with force, duration and step; the interface is that of the reference rigs."""

    machine: Rig
    drive: Drive

    @property
    def duration_s(self) -> float:
        return self.drive.duration_s

    @property
    def step_s(self) -> float:
        rate = self.machine.sample_rate_hz
        return self.drive.step_s or 1 / (rate * max(1, int(np.ceil(MIN_STEP_RATE_HZ / rate))))

    def rig(self) -> Rig:
        return self.machine

    def force(self) -> Excitation:
        drive, rate = self.drive, self.machine.sample_rate_hz
        high_hz = drive.high_hz or BAND_TO_SAMPLE_RATE * rate
        unit_free = excitation_of(drive.excitation, rms_n=0.0, low_hz=drive.low_hz, high_hz=high_hz, seed=drive.seed)
        rms_n = rattling_n(self.machine, drive.low_hz, high_hz) if drive.rms_n is None else drive.rms_n
        return msgspec.structs.replace(unit_free, rms_n=rms_n)


def own_rig(rig: Rig, settings: dict[str, str]) -> OwnRig:
    """User's rig with settings given as text; raises RigError for an unknown setting or an invalid value."""
    if unknown := sorted(set(settings) - set(Drive.__struct_fields__)):
        raise RigError(
            f"no setting {unknown[0]!r} for a rig of one's own, only {', '.join(Drive.__struct_fields__)}; change the "
            "rest in its file"
        )
    try:
        return OwnRig(rig, msgspec.convert(settings, Drive, strict=False))
    except msgspec.ValidationError as error:
        raise RigError(f"{error}; see `rig record --help` for the settings") from error


def plant_for(rig: Rig) -> str:
    """Name of the default plant: `ancf`, or `modal` if a body is a structure, which `ancf` cannot mesh."""
    return "ancf" if all(b.is_mass or b in rig.beams for b in rig.bodies) else "modal"


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
