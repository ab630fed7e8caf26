"""Components on the bodies of a rig: stations, contacts, sensors with their chains, attachments, loads and tones.

Each is a frozen struct that checks its own numbers; `rig.model.description` checks that its place is on a body.
"""

from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError, has_no_control_characters
from rig.model.contact_laws import AnyLaw, DeadZone
from rig.model.quantities import QUANTITIES, Quantity, QuantityName

MAX_DELAY_S = 1.0
RISE_S = 0.5
"""Duration over which base motions and tones set in, so that a simulation begins at rest."""
MAX_NAME_LENGTH = 200
GROUND = "ground"
"""Word in rig.json for the ground in place of a station, and the body of a station on it."""


def check_name(kind: str, name: str) -> None:
    """Raise RigError unless a name is printable, not empty and at most MAX_NAME_LENGTH characters long."""
    if not (has_no_control_characters(name) and 0 < len(name) <= MAX_NAME_LENGTH):
        raise RigError(f"{kind} {name!r}: give a name of 1 to {MAX_NAME_LENGTH} signs, without control characters")


Direction = Literal["y", "z"]
"""Transverse directions: y up, z to the side; x lies along the bodies, gravity acts along -y."""
DIRECTIONS: tuple[Direction, ...] = ("y", "z")


class Station(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place on a body, metres from its left end, with the direction of what is measured or acts there.

    One on the ground has GROUND in place of a body.
    """

    body: str
    position_m: float = 0.0
    direction: Direction = "y"

    @property
    def label(self) -> str:
        """Name of body, position and direction: barrel_1000mm, or barrel_1000mm_z."""
        return f"{self.body}_{round(self.position_m * 1000):04d}mm{'' if self.direction == 'y' else '_z'}"


ON_GROUND = Station(GROUND)
"""Place of a sensor that measures how the base shakes, and of the force of a rig that nothing else moves."""


class Contact(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Two stations that meet; the relative displacement is `at` minus `against`.

    A law of one direction acts in that of the stations; an annular one in both, and its stations give none.
    In place of a second station stands None, in rig.json null, "ground" or nothing, for the ground.
    """

    name: str
    at: Station
    against: Station | None = None
    law: AnyLaw


def contact_stations(contact: Contact) -> tuple[Station, ...]:
    return (contact.at,) if contact.against is None else (contact.at, contact.against)


class Sensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A transverse motion sensor and its chain: delivers gain times the motion of delay_s ago, plus noise.

    high_pass_hz is the corner of an AC-coupled sensor's first-order high-pass; 0 of a sensor that shows constants.
    noise_density is one-sided, in the quantity's unit per sqrt(Hz). measuring_range clips at plus and minus that value;
    bits divides twice the range into 2^bits steps. None leaves either out. fibre_m is a strain gauge's distance from
    the neutral fibre; None stands for half the thickness of a beam.
    """

    name: str
    station: Station
    quantity: QuantityName
    gain: float = 1.0
    delay_s: float = 0.0
    high_pass_hz: float = 0.0
    noise_density: float = 0.0
    measuring_range: float | None = None
    bits: int | None = None
    fibre_m: float | None = None

    @property
    def measures(self) -> Quantity:
        return QUANTITIES[self.quantity]

    def response(self, omega: Float[np.ndarray, " lines"]) -> Complex[np.ndarray, " lines"]:
        """Response at each frequency (rad/s): g exp(-i omega tau) i omega / (i omega + 2 pi f_high_pass)."""
        gain_and_delay = self.gain * np.exp(-1j * omega * self.delay_s)
        corner_rad_per_s = 2 * np.pi * self.high_pass_hz
        return np.asarray(
            gain_and_delay * (1j * omega / (1j * omega + corner_rad_per_s)) if corner_rad_per_s else gain_and_delay
        )

    def __post_init__(self) -> None:
        if not _is_plausible_gain(self.gain):
            raise RigError(f"sensor {self.name!r}: gain is {self.gain}; give a finite value other than zero")
        if not abs(self.delay_s) <= MAX_DELAY_S:
            raise RigError(f"sensor {self.name!r}: delay_s is {self.delay_s}; give a finite value, -1 to 1 s")
        if not 0 <= self.high_pass_hz < np.inf:
            raise RigError(f"sensor {self.name!r}: high_pass_hz is {self.high_pass_hz}; give zero or above")
        if not (np.isfinite(self.noise_density) and self.noise_density >= 0):
            raise RigError(f"sensor {self.name!r}: noise_density is {self.noise_density}; give zero or above")
        if self.measuring_range is not None and not 0 < self.measuring_range < np.inf:
            raise RigError(
                f"sensor {self.name!r}: measuring_range is {self.measuring_range}; give a finite value above zero"
            )
        if self.bits is not None and (self.measuring_range is None or not 2 <= self.bits <= 32):
            raise RigError(f"sensor {self.name!r}: bits is {self.bits}; give 2 to 32, together with a measuring_range")
        if self.fibre_m is not None and not (self.measures.bends and 0 < abs(self.fibre_m) < np.inf):
            raise RigError(
                f"sensor {self.name!r}: fibre_m is {self.fibre_m}; give it to strain gauges, other than zero"
            )


class PointMass(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A mass without rotational inertia, fixed to a body."""

    station: Station
    mass_kg: float

    def __post_init__(self) -> None:
        _check_not_negative("point mass", "mass_kg", self.mass_kg)


class PointSpring(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A spring from a body to the base: the force k w + k3 w^3 against the displacement, k_r w' against the slope.

    k and k3 may be negative: a spring that believed stiffness is less by, and one that softens.
    """

    station: Station
    stiffness_n_per_m: float = 0.0
    cubic_n_per_m3: float = 0.0
    rotational_n_m_per_rad: float = 0.0

    def __post_init__(self) -> None:
        for field in ("stiffness_n_per_m", "cubic_n_per_m3"):
            _check_finite("point spring", field, getattr(self, field))
        _check_not_negative("point spring", "rotational_n_m_per_rad", self.rotational_n_m_per_rad)

    @property
    def law(self) -> DeadZone:
        """Contact law, without clearance, of the force beyond the body's linear model: k3 w^3."""
        return _law_without_stops(cubic_n_per_m3=self.cubic_n_per_m3)


class Support(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A pin or roller of the base, at which a body does not move but turns freely.

    stiffness_n_per_m is that of a support that gives; None stands for one that is much stiffer than the body
    (`rig.model.supports`).
    """

    station: Station
    stiffness_n_per_m: float | None = None

    def __post_init__(self) -> None:
        if self.stiffness_n_per_m is not None and not 0 < self.stiffness_n_per_m < np.inf:
            raise RigError(
                f"support: stiffness_n_per_m is {self.stiffness_n_per_m}; give a finite value above zero, or leave it "
                "out where the support is stiff"
            )


class PointDamper(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A damper from a body to the base: the force c v + F tanh(v / v0) against the velocity, v0 = 0.02 m/s."""

    station: Station
    damping_n_s_per_m: float = 0.0
    friction_n: float = 0.0

    def __post_init__(self) -> None:
        for field in ("damping_n_s_per_m", "friction_n"):
            _check_not_negative("point damper", field, getattr(self, field))

    @property
    def law(self) -> DeadZone:
        """Contact law, without clearance and stiffness, of the damper's force."""
        return _law_without_stops(open_damping_n_s_per_m=self.damping_n_s_per_m, friction_n=self.friction_n)


class Clamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A compliant clamp: the beam's clamped end turns against a rotational spring."""

    body: str
    rotational_n_m_per_rad: float

    def __post_init__(self) -> None:
        _check_not_negative(f"clamp of {self.body!r}", "rotational_n_m_per_rad", self.rotational_n_m_per_rad)


class StaticLoad(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A constant transverse force on a body; the rig is at rest under it when a simulation begins."""

    station: Station
    force_n: float

    def __post_init__(self) -> None:
        _check_finite("static load", "force_n", self.force_n)


class Tone(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An unmeasured harmonic force on a body, a cos(2 pi f t) + b sin(2 pi f t), with t from the record's beginning.

    It rises smoothly from zero over the first RISE_S.
    """

    station: Station
    frequency_hz: float
    cosine_n: float = 0.0
    sine_n: float = 0.0

    def __post_init__(self) -> None:
        for field in ("cosine_n", "sine_n"):
            _check_finite("tone", field, getattr(self, field))
        if not 0 < self.frequency_hz < np.inf:
            raise RigError(f"tone: frequency_hz is {self.frequency_hz}; give a finite value above zero")

    def force_n(self, time_s: Float[np.ndarray, " times"]) -> Float[np.ndarray, " times"]:
        rise_share, phase_rad = np.clip(time_s / RISE_S, 0, 1), 2 * np.pi * self.frequency_hz * time_s
        rise = rise_share**3 * (10 - 15 * rise_share + 6 * rise_share**2)
        return np.asarray(rise * (self.cosine_n * np.cos(phase_rad) + self.sine_n * np.sin(phase_rad)))


class BaseMotion(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A transverse motion of the ground that carries clamps, springs and stops: Gaussian acceleration in a band.

    It begins at start_s and rises smoothly over RISE_S; a sensor on the ground measures it.
    """

    acceleration_rms_m_per_s2: float
    low_hz: float
    high_hz: float
    seed: int = 1
    start_s: float = 0.0

    def __post_init__(self) -> None:
        for field in ("acceleration_rms_m_per_s2", "start_s"):
            _check_not_negative("base motion", field, getattr(self, field))
        if not 0 < self.low_hz < self.high_hz < np.inf:
            raise RigError(f"base motion: the band {self.low_hz} to {self.high_hz} Hz is empty; give 0 < low < high")
        if self.seed < 0:
            raise RigError(f"base motion: seed is {self.seed}; give zero or above")


class ForceSensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Force sensor: the true force is the measured one of lag_s ago divided by gain.

    A negative lag is a force channel that comes late.
    """

    gain: float = 1.0
    lag_s: float = 0.0

    def __post_init__(self) -> None:
        if not _is_plausible_gain(self.gain):
            raise RigError(f"force sensor: gain is {self.gain}; give a finite value other than zero")
        if not abs(self.lag_s) <= MAX_DELAY_S:
            raise RigError(f"force sensor: lag_s is {self.lag_s}; give a finite value, -1 to 1 s")


def _is_plausible_gain(value: float) -> bool:
    """True if 1e-12 <= |value| <= 1e12, so that no plausible signal becomes zero or infinite by this gain."""
    return bool(1e-12 <= abs(value) <= 1e12)


def _check_finite(owner: str, field: str, value: float) -> None:
    if not np.isfinite(value):
        raise RigError(f"{owner}: {field} is {value}; give a finite value")


def _check_not_negative(owner: str, field: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0):
        raise RigError(f"{owner}: {field} is {value}; give a finite value, zero or above")


def _law_without_stops(**coefficients: float) -> DeadZone:
    return msgspec.structs.replace(
        DeadZone(lower_clearance_m=0.0, upper_clearance_m=0.0, stiffness_n_per_m=0.0), **coefficients
    )
