"""Excitation of a user's rig from its rig.json, for `rig record FILE.json`."""

from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
from jaxtyping import Float

from rig.errors import RigError, meant
from rig.model.contact_laws import ContactLaw, walls_m
from rig.model.decoding import explained
from rig.model.description import Rig, Station
from rig.model.modes import mode_count, modes_of
from rig.simulation.excitation import Excitation, excitation_of

MIN_STEP_RATE_HZ = 2.0**14
"""Least rate of a plant's steps, Hz; the rate is the next multiple of the sampling rate."""
BAND_TO_SAMPLE_RATE = 1 / 40
"""Upper end of the excited band over the sampling rate, as in the reference rigs."""
RMS_TO_CLEARANCE = 4.0
"""Rms motion of the least moved contact, without its stops, over its clearance; 2.6 to 6 in the reference rigs."""
FARTHEST_STOP_M = 0.1
"""A stop farther away counts as out of reach: even shakers of long stroke (APS 113, 158 mm) move by some 80 mm only to
either side."""
FAR_STOP_RATIO = 10.0
"""So does the farther stop of a contact whose nearer one is so many times nearer, and met long before."""
SHAKER_N = 2000.0
"""Force, N rms, of a large shaker in a laboratory: modal shakers that push through a stinger give some 50 to 500 N,
air-cooled vibrators 1 to 3 kN; more needs a test house."""
SHAKEN = ("gaussian", "burst", "sweep", "multisine", "stepped_sine")
"""Excitations that a shaker gives; a blow's peak is not so limited."""
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

    @property
    def high_hz(self) -> float:
        return self.drive.high_hz or BAND_TO_SAMPLE_RATE * self.machine.sample_rate_hz

    def force(self) -> Excitation:
        drive = self.drive
        unit_free = excitation_of(
            drive.excitation, rms_n=0.0, low_hz=drive.low_hz, high_hz=self.high_hz, seed=drive.seed
        )
        return msgspec.structs.replace(unit_free, rms_n=self.level.rms_n)

    @cached_property
    def level(self) -> "Level":
        """Level of the force, chosen unless it is given."""
        if self.drive.rms_n is not None:
            return Level(self.drive.rms_n, "as set")
        return rattling(self.machine, self.drive.low_hz, self.high_hz)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentence on a force that is beyond a shaker; none otherwise."""
        rms_n = self.level.rms_n
        if rms_n <= SHAKER_N or self.drive.excitation not in SHAKEN:
            return ()
        return (
            f"{rms_n:g} N rms is more than a large laboratory shaker gives (about {SHAKER_N:g} N rms); check the "
            "description's clearances and masses, or give --set rms_n=N",
        )


@dataclass(frozen=True)
class Level:
    """Level of a force, N rms, and why it was chosen."""

    rms_n: float
    why: str


def own_rig(rig: Rig, settings: dict[str, str]) -> OwnRig:
    """User's rig with settings given as text; raises RigError for an unknown setting or an invalid value."""
    if unknown := sorted(set(settings) - set(Drive.__struct_fields__)):
        names = Drive.__struct_fields__
        raise RigError(
            f"no setting {unknown[0]!r}{meant(unknown[0], names)} for a rig of one's own, only {', '.join(names)}; "
            "change the rest in its file"
        )
    try:
        return OwnRig(rig, msgspec.convert(settings, Drive, strict=False))
    except msgspec.ValidationError as error:
        raise RigError(f"{explained(error, settings, Drive)}; see `rig record --help` for the settings") from error


def plant_for(rig: Rig) -> str:
    """Name of the default plant: `ancf`, or `modal` if a body is a structure, which `ancf` cannot mesh."""
    return "ancf" if all(b.is_mass or b in rig.beams for b in rig.bodies) else "modal"


def rattling(rig: Rig, low_hz: float, high_hz: float) -> Level:
    """Force (N rms, flat from low to high) that would move the least moved contact, without stops, by 4 clearances rms.

    With several forces, the rms of each of them, independent of one another. The motion follows from the modes,
    eta = sum_m b_m p_m F / (w_m^2 - w^2 + 2 i z_m w_m w). Rounded to one significant digit; 1 N if no contact has a
    clearance in reach or none responds to the force. The clearance of a contact is the mean over its stops in reach.
    """
    omega = 2 * np.pi * np.linspace(max(low_hz, high_hz * 1e-3), high_hz, LINES)
    squares = np.sum([_squares_by(rig, station, omega) for station in rig.forces], axis=0)
    needed: list[tuple[float, str, float]] = []
    for contact, square in zip(rig.contacts, squares, strict=True):
        rms_m_per_n, clearance_m = float(np.sqrt(square)), reachable_clearance_m(contact.law)
        if rms_m_per_n > 0 and clearance_m:
            needed.append((RMS_TO_CLEARANCE * clearance_m / rms_m_per_n, contact.name, clearance_m))
    largest_n, name, clearance_m = max(needed, default=(np.inf, "", 0.0))
    if not np.isfinite(largest_n):
        why = f"as no contact has a clearance of at most {FARTHEST_STOP_M:g} m that the force moves it through"
        return Level(1.0, why if rig.contacts else "as there is no contact")
    least = ", which moves least," if len(needed) > 1 else ""
    motion = f"{RMS_TO_CLEARANCE:g} clearances of {1e3 * clearance_m:.3g} mm rms without its stops"
    return Level(float(f"{largest_n:.1g}"), f"by which {name!r}{least} would move by {motion}")


def reachable_clearance_m(law: ContactLaw) -> float:
    """Mean clearance, m, of the stops of a contact that a laboratory's force can reach; zero if there are none."""
    clearances_m = sorted(abs(wall_m) for wall_m, _ in walls_m(law))
    farthest_m = min([FARTHEST_STOP_M, *(FAR_STOP_RATIO * c for c in clearances_m[:1] if c)])
    in_reach_m = [c for c in clearances_m if c <= farthest_m]
    return sum(in_reach_m) / len(in_reach_m) if in_reach_m else 0.0


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
