"""A rig as a value: bodies, contacts, the exciting force and the sensors. It travels in every recording as rig.json."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError, is_plain
from rig.files import contents
from rig.limits import check_json
from rig.model.beam import Beam
from rig.model.contact_laws import AnyLaw, DeadZone
from rig.model.largest import check_largest
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES, Quantity, QuantityName
from rig.model.structure import Structure
from rig.model.tolerances import Tolerances

Body = Beam | Oscillator | Structure
UNITS: dict[str, str] = {q.name: q.unit for q in QUANTITIES.values()} | {"force": "N"}
LONGEST_DELAY_S = 1.0
RISE_S = 0.5
"""Over which base motions and tones set in, so that a simulation begins at rest."""


LONGEST_NAME = 200
MOST = 1000
"""Bodies, contacts or sensors."""


def check_name(kind: str, name: str) -> None:
    """Raises RigError unless it is a name that can be shown anywhere as it is."""
    if not (is_plain(name) and 0 < len(name) <= LONGEST_NAME):
        raise RigError(f"{kind} {name!r}: give a name of 1 to {LONGEST_NAME} signs, without control characters")


def _check_names(what: str, kind: str, names: Sequence[str]) -> None:
    """Raises RigError if there are too many, or two alike, or one that `check_name` refuses."""
    if len(names) > MOST:
        raise RigError(f"{what}: has {len(names)} times a {kind}; give at most {MOST}")
    for name in names:
        check_name(kind, name)
    if twice := sorted({n for n in names if names.count(n) > 1}):
        raise RigError(f"{what}: more than one {kind} is named {twice[0]!r}; names must differ")


def _is_gain(value: float) -> bool:
    """Finite and other than zero, and so that no number within reason becomes infinite or zero by it."""
    return bool(1e-12 <= abs(value) <= 1e12)


class Station(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place on a body, metres from its left end."""

    body: str
    position_m: float = 0.0


class Contact(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Two stations that meet; the relative displacement is `at` minus `against` (None: the ground)."""

    name: str
    at: Station
    against: Station | None
    law: AnyLaw


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
        chain = self.gain * np.exp(-1j * omega * self.delay_s)
        corner = 2 * np.pi * self.high_pass_hz
        return np.asarray(chain * (1j * omega / (1j * omega + corner)) if corner else chain)

    def __post_init__(self) -> None:
        if not _is_gain(self.gain):
            raise RigError(f"sensor {self.name!r}: gain is {self.gain}; give a finite value other than zero")
        if not abs(self.delay_s) <= LONGEST_DELAY_S:
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
        _check_number("point mass", "mass_kg", self.mass_kg)


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
        _check_number("point spring", "rotational_n_m_per_rad", self.rotational_n_m_per_rad)

    @property
    def law(self) -> DeadZone:
        """Law of its force beyond the body's linear model, k3 w^3, as of a contact without clearance."""
        return _without_stops(cubic_n_per_m3=self.cubic_n_per_m3)


class PointDamper(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A damper from a body to the base: the force c v + F tanh(v / v0) against the velocity, v0 = 0.02 m/s."""

    station: Station
    damping_n_s_per_m: float = 0.0
    friction_n: float = 0.0

    def __post_init__(self) -> None:
        for field in ("damping_n_s_per_m", "friction_n"):
            _check_number("point damper", field, getattr(self, field))

    @property
    def law(self) -> DeadZone:
        """Its force, as of a contact without stiffness."""
        return _without_stops(open_damping_n_s_per_m=self.damping_n_s_per_m, friction_n=self.friction_n)


class Clamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A clamp that gives: the beam's clamped end turns against a rotational spring instead of not at all."""

    body: str
    rotational_n_m_per_rad: float

    def __post_init__(self) -> None:
        _check_number(f"clamp of {self.body!r}", "rotational_n_m_per_rad", self.rotational_n_m_per_rad)


class StaticLoad(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A constant transverse force on a body; the rig is at rest under it when a simulation begins."""

    station: Station
    force_n: float

    def __post_init__(self) -> None:
        _check_finite("static load", "force_n", self.force_n)


class Tone(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An unmeasured harmonic force on a body, a cos(2 pi f t) + b sin(2 pi f t), with t from the record's beginning.

    It sets in from rest over the first half second.
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
        s, angle = np.clip(time_s / RISE_S, 0, 1), 2 * np.pi * self.frequency_hz * time_s
        rise = s**3 * (10 - 15 * s + 6 * s**2)
        return np.asarray(rise * (self.cosine_n * np.cos(angle) + self.sine_n * np.sin(angle)))


class BaseMotion(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A transverse motion of the ground that carries clamps, springs and stops: Gaussian acceleration in a band."""

    acceleration_rms_m_per_s2: float
    low_hz: float
    high_hz: float
    seed: int = 1

    def __post_init__(self) -> None:
        _check_number("base motion", "acceleration_rms_m_per_s2", self.acceleration_rms_m_per_s2)
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
        if not _is_gain(self.gain):
            raise RigError(f"force sensor: gain is {self.gain}; give a finite value other than zero")
        if not abs(self.lag_s) <= LONGEST_DELAY_S:
            raise RigError(f"force sensor: lag_s is {self.lag_s}; give a finite value, -1 to 1 s")


class Rig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that the experimenter believes about the machine and its instruments.

    force_at is the place of the measured force, or of each of several that act at once; force_sensor holds for all.
    What stands after the sampling rate is absent from a rig that is as simple as it looks: see `rig.effects`.
    """

    name: str
    bodies: tuple[Body, ...]
    contacts: tuple[Contact, ...]
    force_at: Station | tuple[Station, ...]
    sensors: tuple[Sensor, ...]
    sample_rate_hz: float
    masses: tuple[PointMass, ...] = ()
    springs: tuple[PointSpring, ...] = ()
    clamps: tuple[Clamp, ...] = ()
    loads: tuple[StaticLoad, ...] = ()
    base_motion: BaseMotion | None = None
    force_sensor: ForceSensor = ForceSensor()
    dampers: tuple[PointDamper, ...] = ()
    tones: tuple[Tone, ...] = ()
    tolerances: Tolerances | None = None
    """How exactly all this is believed, where the owner says so."""

    def __post_init__(self) -> None:
        if not 1e-6 <= self.sample_rate_hz <= 1e9:
            raise RigError(
                f"rig {self.name!r}: sample_rate_hz is {self.sample_rate_hz}; give a value above zero, 1e-6 to 1e9"
            )
        check_name("rig", self.name)
        for kind, names in (
            ("body", [b.name for b in self.bodies]),
            ("contact", [c.name for c in self.contacts]),
            ("sensor", [s.name for s in self.sensors]),
        ):
            _check_names(f"rig {self.name!r}", kind, names)
        self._check_forces()
        for sensor in self.sensors:
            self._check_station(f"sensor {sensor.name!r}", sensor.station)
            self.fibre_m(sensor)
            if not sensor.high_pass_hz < self.sample_rate_hz / 2:
                raise RigError(
                    f"sensor {sensor.name!r}: high_pass_hz is {sensor.high_pass_hz}; give less than half the "
                    f"sample_rate_hz of {self.sample_rate_hz:g}"
                )
        for contact in self.contacts:
            for station in contact_stations(contact):
                self._check_station(f"contact {contact.name!r}", station)
        for kind, attached in (
            ("point mass", self.masses),
            ("point spring", self.springs),
            ("point load", self.loads),
            ("point damper", self.dampers),
            ("tone", self.tones),
        ):
            for one in attached:
                self._check_station(f"a {kind}", one.station)
        for clamp in self.clamps:
            if getattr(self.body(clamp.body), "ends", None) != "clamped-free":
                raise RigError(f"a clamp holds {clamp.body!r}, which is no clamped beam; name one that is")
        if len({c.body for c in self.clamps}) < len(self.clamps):
            raise RigError(f"rig {self.name!r}: more than one clamp holds the same beam; give one")
        for body in self.bodies if self.base_motion else ():
            _check_carried(body)

    @property
    def forces(self) -> tuple[Station, ...]:
        """Stations at which the measured forces act."""
        return self.force_at if isinstance(self.force_at, tuple) else (self.force_at,)

    @property
    def force_names(self) -> tuple[str, ...]:
        """Names of the forces' channels: force, or force_1, force_2, ..."""
        return force_names(len(self.forces))

    def body(self, name: str) -> Body:
        for body in self.bodies:
            if body.name == name:
                return body
        raise RigError(f"rig {self.name!r} has no body {name!r}; it has {', '.join(b.name for b in self.bodies)}")

    def fibre_m(self, sensor: Sensor) -> float:
        """A strain gauge's distance from the neutral fibre; zero of other sensors. Raises RigError if not known."""
        body = self.body(sensor.station.body)
        if body.is_mass and not sensor.measures.translates:
            raise RigError(
                f"sensor {sensor.name!r} measures {sensor.quantity} of {body.name!r}, a mass; put it on a beam"
            )
        if not sensor.measures.bends:
            return 0.0
        if sensor.fibre_m is None and body.half_thickness_m is None:
            raise RigError(f"sensor {sensor.name!r}: how thick {body.name!r} is there is not known; give fibre_m")
        return sensor.fibre_m or body.half_thickness_m or 0.0

    @property
    def beams(self) -> tuple[Beam, ...]:
        """The bodies that are uniform beams."""
        return tuple(b for b in self.bodies if isinstance(b, Beam))

    def contact(self, name: str) -> Contact:
        return next(c for c in self.contacts if c.name == name)

    def _check_forces(self) -> None:
        if isinstance(self.force_at, tuple):
            if not 2 <= len(self.force_at) <= MOST:
                raise RigError(
                    f"rig {self.name!r}: force_at is a list of {len(self.force_at)}; give the place of one force by "
                    f"itself, those of several as a list of 2 to {MOST}"
                )
            _check_names(f"rig {self.name!r}", "channel", [*self.force_names, *(s.name for s in self.sensors)])
        for name, station in zip(self.force_names, self.forces, strict=True):
            self._check_station(f"the {name}", station)

    def _check_station(self, what: str, station: Station) -> None:
        body = self.body(station.body)
        if not 0 <= station.position_m <= body.length_m:
            raise RigError(f"{what} stands at {station.position_m} m, off {body.name!r}; give 0 to {body.length_m} m")


def force_names(count: int) -> tuple[str, ...]:
    return tuple(f"force_{k}" for k in range(1, count + 1)) if count > 1 else ("force",)


def _without_stops(**numbers: float) -> DeadZone:
    return msgspec.structs.replace(
        DeadZone(lower_clearance_m=0.0, upper_clearance_m=0.0, stiffness_n_per_m=0.0), **numbers
    )


def _check_carried(body: Body) -> None:
    """Raises RigError if it is not known how a moving base carries the body."""
    if isinstance(body, Structure):
        body.translation()


def _check_finite(what: str, field: str, value: float) -> None:
    if not np.isfinite(value):
        raise RigError(f"{what}: {field} is {value}; give a finite value")


def _check_number(what: str, field: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0):
        raise RigError(f"{what}: {field} is {value}; give a finite value, zero or above")


def contact_stations(contact: Contact) -> tuple[Station, ...]:
    return (contact.at,) if contact.against is None else (contact.at, contact.against)


def stations_of(rig: Rig) -> tuple[Station, ...]:
    """Every distinct station with a sensor or a contact, body by body from left to right."""
    wanted: Iterable[Station] = {s.station for s in rig.sensors} | {
        station for contact in rig.contacts for station in contact_stations(contact)
    }
    order = [b.name for b in rig.bodies]
    return tuple(sorted(wanted, key=lambda s: (order.index(s.body), s.position_m)))


def check_given(rig: Rig, source: str) -> None:
    """Raises RigError if a sensor, a contact or a force stands where the shapes of a structure are not given.

    Only an effect may stand there, or a real rig that differs a little from what is believed: by interpolation.
    """
    places = [(f"the {name}", at) for name, at in zip(rig.force_names, rig.forces, strict=True)]
    places += [(f"sensor {s.name!r}", s.station) for s in rig.sensors]
    places += [(f"contact {c.name!r}", station) for c in rig.contacts for station in contact_stations(c)]
    for what, station in places:
        body = rig.body(station.body)
        if isinstance(body, Structure) and not body.gives(station.position_m):
            raise RigError(
                f"{source}: {what} stands at {station.position_m} m of {body.name!r}, where its modal basis gives no "
                "shapes; add a row for that place"
            )


def to_json(rig: Rig) -> bytes:
    return msgspec.json.format(msgspec.json.encode(rig), indent=2)


def _with_laws_named(read: Any) -> Any:
    """Older files do not say which law a contact has: there was the dead zone alone."""
    contacts = read.get("contacts") if isinstance(read, dict) else None
    for contact in contacts if isinstance(contacts, list) else []:
        if isinstance(contact, dict) and isinstance(contact.get("law"), dict):
            contact["law"].setdefault("type", "dead_zone")
    return read


def from_json(text: bytes, source: str) -> Rig:
    """The rig described by a JSON text; `source` names it in the error.

    Raises RigError with the place and the reason if the text is no valid rig.
    """
    check_json(text, source)
    try:
        given = _with_laws_named(msgspec.json.decode(text))
        check_largest(given, source)
        return msgspec.convert(given, Rig)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RigError(f"{source}: not a rig description: {error}; see rig/recording/README.md") from error


def read_rig(path: Path) -> Rig:
    """The rig in a file; raises RigError if it cannot be opened, is no rig, or lacks shapes where something stands."""
    rig = from_json(contents(path), str(path))
    check_given(rig, str(path))
    return rig
