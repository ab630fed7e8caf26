"""A rig of one's own, from its rig.json: how `rig record FILE.json` excites it."""

from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig, Station
from rig.model.modes import modes_of, modes_wanted
from rig.simulation.excitation import Excitation, excitation_of

RATE_HZ = 2.0**14
"""A plant steps so often a second, or a little more often: at a multiple of the sampling rate."""
HIGH = 1 / 40
"""Of the sampling rate: up to where the force excites the rig, as in the reference rigs."""
PLAYS = 4.0
"""So many clearances the least moved contact would move (rms) without its stops; the reference rigs: 2.6 to 6."""
MODES, LINES, LEAST_DAMPING = 16, 20_001, 1e-3


class Drive(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The settings of a recording of one's own rig; None stands for a value that follows from the rig."""

    duration_s: float = 60.0
    step_s: float | None = None
    excitation: str = "gaussian"
    rms_n: float | None = None
    low_hz: float = 0.5
    high_hz: float | None = None
    seed: int = 1


@dataclass(frozen=True)
class OwnRig:
    """Rig of a user, as `rig.simulation.reference` has the reference rigs: a rig, its force, duration and step."""

    machine: Rig
    drive: Drive

    @property
    def duration_s(self) -> float:
        return self.drive.duration_s

    @property
    def step_s(self) -> float:
        rate = self.machine.sample_rate_hz
        return self.drive.step_s or 1 / (rate * max(1, int(np.ceil(RATE_HZ / rate))))

    def rig(self) -> Rig:
        return self.machine

    def force(self) -> Excitation:
        drive, rate = self.drive, self.machine.sample_rate_hz
        high_hz = drive.high_hz or HIGH * rate
        unknown = excitation_of(drive.excitation, rms_n=0.0, low_hz=drive.low_hz, high_hz=high_hz, seed=drive.seed)
        rms_n = rattling_n(self.machine, drive.low_hz, high_hz) if drive.rms_n is None else drive.rms_n
        return msgspec.structs.replace(unknown, rms_n=rms_n)


def own_rig(rig: Rig, settings: dict[str, str]) -> OwnRig:
    """A rig with settings given as text; raises RigError for an unknown one and for a value that does not fit."""
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
    """`ancf`, or `modal` where a body is a structure, which only that plant simulates."""
    return "ancf" if all(b.is_mass or b in rig.beams for b in rig.bodies) else "modal"


def rattling_n(rig: Rig, low_hz: float, high_hz: float) -> float:
    """The force (N rms, flat from low to high) under which the rig, without its stops, would move 4 clearances rms.

    Where several act, so much each, independent of one another.

    At the contact that moves least, by the bare bodies' modes: eta = sum_m b_m p_m F / (w_m^2 - w^2 + 2 i z_m w_m w).
    To one significant digit; 1 N where no contact has a clearance or none is reached by the force.
    """
    omega = 2 * np.pi * np.linspace(max(low_hz, high_hz * 1e-3), high_hz, LINES)
    squares = np.sum([_squares_by(rig, station, omega) for station in rig.forces], axis=0)
    wanted = []
    for contact, square in zip(rig.contacts, squares, strict=True):
        rms_m_per_n = float(np.sqrt(square))
        if rms_m_per_n > 0 and contact.law.clearance_m > 0:
            wanted.append(PLAYS * contact.law.clearance_m / rms_m_per_n)
    return float(f"{max(wanted):.1g}") if wanted and np.isfinite(max(wanted)) else 1.0


def _squares_by(rig: Rig, force_at: Station, omega: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " contacts"]:
    """The mean square over the lines of every contact's relative displacement per newton at a station, m^2/N^2."""
    moved = rig.body(force_at.body)
    modes, count = modes_of(rig, moved), modes_wanted(moved, MODES)
    natural = 2 * np.pi * modes.frequencies_hz(count)[:, None]
    ratios = np.maximum(modes.damping_ratios(count), LEAST_DAMPING)[:, None]

    def shape(station: Station | None) -> np.ndarray:
        if station is None or station.body != moved.name:
            return np.zeros(count)
        return modes.shapes(np.array([station.position_m]), count)[0]

    answers = shape(force_at)[:, None] / (natural**2 - omega**2 + 2j * ratios * natural * omega)
    across = (shape(contact.at) - shape(contact.against) for contact in rig.contacts)
    return np.array([np.mean(np.abs(row @ answers) ** 2) for row in across])
