"""A rig as a value: bodies and the components on them, checked as a whole; every recording holds it as rig.json.

The components' structs are in `rig.model.components` and importable from here.
"""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from rig.errors import RigError
from rig.files import contents
from rig.limits import SCHEMA_VERSION, check_json, check_largest, check_schema_version
from rig.model.beam import Beam
from rig.model.components import (
    GROUND,
    RISE_S,
    BaseMotion,
    Clamp,
    Contact,
    ForceSensor,
    PointDamper,
    PointMass,
    PointSpring,
    Sensor,
    StaticLoad,
    Station,
    Support,
    Tone,
    check_name,
    contact_stations,
)
from rig.model.decoding import converted
from rig.model.oscillator import Oscillator
from rig.model.quantities import QUANTITIES
from rig.model.rig_json import json_in_types
from rig.model.structure import Structure
from rig.model.tolerances import Tolerances

__all__ = [
    "GROUND",
    "RISE_S",
    "UNITS",
    "BaseMotion",
    "Body",
    "Clamp",
    "Contact",
    "ForceSensor",
    "PointDamper",
    "PointMass",
    "PointSpring",
    "Rig",
    "Sensor",
    "StaticLoad",
    "Station",
    "Support",
    "Tone",
    "check_given",
    "check_name",
    "contact_stations",
    "force_names",
    "from_json",
    "read_rig",
    "stations_of",
    "to_json",
]

Body = Beam | Oscillator | Structure
UNITS: dict[str, str] = {q.name: q.unit for q in QUANTITIES.values()} | {"force": "N"}
ON_GROUND = Station(GROUND)
"""Place of a sensor that measures how the base shakes, and of the force of a rig that nothing else moves."""
MAX_PER_KIND = 1000
"""Largest number of bodies, of contacts, of sensors and of forces."""


class Rig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Nominal model of the machine and its instruments.

    force_at is the place of the measured force, or of each of several that act at once; force_sensor holds for all.
    Without it no force acts: the base shakes the rig, which a sensor on the ground measures, and the force's channel is
    zero.
    The fields after sample_rate_hz are mostly empty; `rig.effects` fills them.
    """

    name: str
    """Name of the machine."""
    bodies: tuple[Body, ...]
    """Beams, masses and structures given by their modes."""
    contacts: tuple[Contact, ...]
    """Contacts between two bodies, or a body and the ground."""
    force_at: Station | tuple[Station, ...] = ON_GROUND
    """Place of the measured force, or of each of several that act at once; the ground where the base alone shakes."""
    sensors: tuple[Sensor, ...]
    """Sensors with place, quantity and noise; one on the ground measures how the base shakes."""
    sample_rate_hz: float
    """Rate of every channel, Hz."""
    masses: tuple[PointMass, ...] = ()
    """Attached point masses."""
    springs: tuple[PointSpring, ...] = ()
    """Springs from a body to the base."""
    supports: tuple[Support, ...] = ()
    """Pins and rollers of the base along a body."""
    clamps: tuple[Clamp, ...] = ()
    """Compliance of the clamps of beams."""
    loads: tuple[StaticLoad, ...] = ()
    """Constant forces."""
    base_motion: BaseMotion | None = None
    """Motion of the base that carries the bodies; unmeasured, unless a sensor stands on the ground."""
    force_sensor: ForceSensor = ForceSensor()
    """Errors of the force sensor; they hold for every force."""
    dampers: tuple[PointDamper, ...] = ()
    """Dampers from a body to the base."""
    tones: tuple[Tone, ...] = ()
    """Unmeasured harmonic forces."""
    tolerances: Tolerances | None = None
    """Standard deviations of the description, where its author states them."""
    schema_version: int = SCHEMA_VERSION
    """Version of the structure of rig.json: fields of a version keep their names, units and meaning."""

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
            self._check_sensor(sensor)
        for contact in self.contacts:
            for station in contact_stations(contact):
                self._check_station(f"contact {contact.name!r}", station)
        for kind, attached in (
            ("point mass", self.masses),
            ("point spring", self.springs),
            ("support", self.supports),
            ("point load", self.loads),
            ("point damper", self.dampers),
            ("tone", self.tones),
        ):
            for item in attached:
                self._check_station(f"a {kind}", item.station)
        self._check_held()
        for body in self.bodies if self.base_motion or self.base_sensors else ():
            _check_carried(body)

    @property
    def base_sensors(self) -> tuple[Sensor, ...]:
        """Sensors on the ground, which measure how the base shakes."""
        return tuple(s for s in self.sensors if self.is_on_ground(s.station))

    def is_on_ground(self, station: Station) -> bool:
        """True for a station on the ground, not on a body of that name."""
        return station.body == GROUND and all(b.name != GROUND for b in self.bodies)

    @property
    def forces(self) -> tuple[Station, ...]:
        """Stations of the measured forces."""
        return self.force_at if isinstance(self.force_at, tuple) else (self.force_at,)

    @property
    def first_driven(self) -> str:
        """Name of the body of the (first) force; of the first body where the base alone shakes."""
        station = self.forces[0]
        return self.bodies[0].name if self.is_on_ground(station) else station.body

    @property
    def inputs(self) -> tuple[Station, ...]:
        """Places of the measured excitation: those of the forces on bodies, then the ground if it has a sensor."""
        on_bodies = tuple(station for station in self.forces if not self.is_on_ground(station))
        return (*on_bodies, ON_GROUND) if self.base_sensors else on_bodies

    @property
    def force_names(self) -> tuple[str, ...]:
        """Channel names of the forces: force, or force_1, force_2, ..."""
        return force_names(len(self.forces))

    def body(self, name: str) -> Body:
        """Body of that name; raises RigError if there is none."""
        for body in self.bodies:
            if body.name == name:
                return body
        raise RigError(f"rig {self.name!r} has no body {name!r}; it has {', '.join(b.name for b in self.bodies)}")

    def fibre_m(self, sensor: Sensor) -> float:
        """Distance of a strain gauge from the neutral fibre, m; zero for other sensors.

        Raises RigError if it is unknown, or if the quantity cannot be measured on a mass.
        """
        if self.is_on_ground(sensor.station):
            if not sensor.measures.translates:
                raise RigError(f"sensor {sensor.name!r} measures {sensor.quantity} of the ground; put it on a beam")
            return 0.0
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
        """Contact of that name."""
        return next(c for c in self.contacts if c.name == name)

    def _check_forces(self) -> None:
        if isinstance(self.force_at, tuple):
            if not 2 <= len(self.force_at) <= MAX_PER_KIND:
                raise RigError(
                    f"rig {self.name!r}: force_at is a list of {len(self.force_at)}; give the place of one force by "
                    f"itself, those of several as a list of 2 to {MAX_PER_KIND}"
                )
            _check_names(f"rig {self.name!r}", "channel", [*self.force_names, *(s.name for s in self.sensors)])
        for name, station in zip(self.force_names, self.forces, strict=True):
            if not self.is_on_ground(station):
                self._check_station(f"the {name}", station)
            elif len(self.forces) > 1 or not self.base_sensors:
                raise RigError(
                    f"rig {self.name!r}: the {name} acts on the ground, where it moves nothing; give force_at the "
                    "place of the measured force, or leave it out and put a sensor on the ground, if it shakes"
                )

    def _check_sensor(self, sensor: Sensor) -> None:
        if not self.is_on_ground(sensor.station):
            self._check_station(f"sensor {sensor.name!r}", sensor.station)
        elif sensor.station != ON_GROUND:
            raise RigError(f"sensor {sensor.name!r} stands on the ground, which has one place; give no position_m")
        self.fibre_m(sensor)
        if not sensor.high_pass_hz < self.sample_rate_hz / 2:
            raise RigError(
                f"sensor {sensor.name!r}: high_pass_hz is {sensor.high_pass_hz}; give less than half the "
                f"sample_rate_hz of {self.sample_rate_hz:g}"
            )

    def _check_held(self) -> None:
        for support in self.supports:
            self._check_support(support)
        for clamp in self.clamps:
            if getattr(self.body(clamp.body), "ends", None) != "clamped-free":
                raise RigError(f"a clamp holds {clamp.body!r}, which is no clamped beam; name one that is")
        if len({c.body for c in self.clamps}) < len(self.clamps):
            raise RigError(f"rig {self.name!r}: more than one clamp holds the same beam; give one")

    def _check_support(self, support: Support) -> None:
        body, position_m = self.body(support.station.body), support.station.position_m
        if body.is_mass:
            raise RigError(
                f"a support holds {body.name!r}, a mass; supports stand along beams and structures, a mass has its own "
                "spring, frequency_hz"
            )
        if body.clamped and position_m == 0:
            raise RigError(f"a support stands at the clamped end of {body.name!r}, which is held there; leave it out")
        if sum(other.station == support.station for other in self.supports) > 1:
            raise RigError(f"more than one support stands at {position_m} m of {body.name!r}; give one")

    def _check_station(self, label: str, station: Station) -> None:
        body = self.body(station.body)
        if not 0 <= station.position_m <= body.length_m:
            raise RigError(f"{label} stands at {station.position_m} m, off {body.name!r}; give 0 to {body.length_m} m")


def force_names(count: int) -> tuple[str, ...]:
    return tuple(f"force_{k}" for k in range(1, count + 1)) if count > 1 else ("force",)


def _check_names(owner: str, kind: str, names: Sequence[str]) -> None:
    """Raise RigError if there are too many names, or two are equal, or `check_name` refuses one."""
    if len(names) > MAX_PER_KIND:
        raise RigError(f"{owner}: has {len(names)} times a {kind}; give at most {MAX_PER_KIND}")
    for name in names:
        check_name(kind, name)
    if doubled := sorted({n for n in names if names.count(n) > 1}):
        raise RigError(f"{owner}: more than one {kind} is named {doubled[0]!r}; names must differ")


def _check_carried(body: Body) -> None:
    """Raise RigError if the modes of a body do not say how a moving base carries it."""
    if isinstance(body, Structure):
        body.translation()


def stations_of(rig: Rig) -> tuple[Station, ...]:
    """Every distinct station on a body with a sensor or a contact, body by body from left to right."""
    stations = {s.station for s in rig.sensors if s not in rig.base_sensors} | {
        station for contact in rig.contacts for station in contact_stations(contact)
    }
    order = [b.name for b in rig.bodies]
    return tuple(sorted(stations, key=lambda s: (order.index(s.body), s.position_m)))


def check_given(rig: Rig, source: str) -> None:
    """Raise RigError if a sensor, contact or force is at a place where a structure's modal basis gives no shapes.

    Interpolated shapes are for effects and perturbed rigs only.
    """
    places = [(f"the {name}", station) for name, station in zip(rig.force_names, rig.forces, strict=True)]
    places += [(f"sensor {s.name!r}", s.station) for s in rig.sensors]
    places += [(f"contact {c.name!r}", station) for c in rig.contacts for station in contact_stations(c)]
    for label, station in places:
        if rig.is_on_ground(station):
            continue
        body = rig.body(station.body)
        if isinstance(body, Structure) and not body.has_shapes_at(station.position_m):
            named = " or give a station by its node" if any(row.node for row in body.rows) else ""
            raise RigError(
                f"{source}: {label} stands at {station.position_m} m of {body.name!r}, where its modal basis gives no "
                f"shapes; add a row for that place{named}"
            )


def to_json(rig: Rig) -> bytes:
    return msgspec.json.format(msgspec.json.encode(rig), indent=2)


def from_json(text: bytes, source: str) -> Rig:
    """Rig from a JSON text; raises RigError with `source`, the place and the reason if it is invalid."""
    check_json(text, source)
    try:
        decoded = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RigError(f"{source}: not a rig description: it is no JSON ({error}); correct it there") from error
    check_schema_version(decoded, source)
    check_largest(decoded, source)
    wrong = f"{source}: not a rig description"
    try:
        in_types = json_in_types(decoded)
    except RigError as error:
        raise RigError(f"{wrong}: {error}") from error
    return converted(in_types, Rig, wrong)


def read_rig(path: Path) -> Rig:
    """Rig in a JSON file; raises RigError if it cannot be read, is invalid, or lacks shapes (`check_given`)."""
    rig = from_json(contents(path), str(path))
    check_given(rig, str(path))
    return rig
