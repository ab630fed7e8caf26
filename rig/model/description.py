"""A rig as a value: bodies and the components on them, checked as a whole; every recording holds it as rig.json.

The components' structs are in `rig.model.components` and importable from here.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from rig.errors import RigError
from rig.files import contents
from rig.limits import SCHEMA_VERSION, check_json_size_and_keys, check_largest_number, check_schema_version
from rig.model.beam import Beam
from rig.model.checks import check_components
from rig.model.components import (
    DIRECTIONS,
    GROUND,
    ON_GROUND,
    RISE_S,
    BaseMotion,
    Clamp,
    Contact,
    Direction,
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
from rig.model.rig_json import normalised_rig_json
from rig.model.structure import Structure
from rig.model.tolerances import Tolerances

__all__ = [
    "GROUND",
    "ON_GROUND",
    "RISE_S",
    "UNITS",
    "BaseMotion",
    "Body",
    "Clamp",
    "Contact",
    "Direction",
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
    "check_name",
    "check_shapes_known",
    "contact_rows",
    "contact_stations",
    "force_names",
    "from_json",
    "read_rig",
    "rig_stations",
    "to_brief_json",
    "to_json",
]

Body = Beam | Oscillator | Structure
UNITS: dict[str, str] = {quantity.name: quantity.unit for quantity in QUANTITIES.values()} | {"force": "N"}
UNWRITTEN_DEFAULTS = (
    b',"direction":"y"',
    b',"gravity_m_per_s2":0.0',
    b',"outer_diameter_m":0.0,"inner_diameter_m":0.0',
    b',"width_m":0.0,"thickness_m":0.0',
)
"""Fields at their defaults that rig.json leaves out; no text within the JSON's strings reads so."""


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
    gravity_m_per_s2: float = 0.0
    """Acceleration of gravity, along -y."""
    tolerances: Tolerances | None = None
    """Standard deviations of the description, where its author states them."""
    schema_version: int = SCHEMA_VERSION
    """Version of the structure of rig.json: fields of a version keep their names, units and meaning."""

    def __post_init__(self) -> None:
        if not 1e-6 <= self.sample_rate_hz <= 1e9:
            raise RigError(
                f"rig {self.name!r}: sample_rate_hz is {self.sample_rate_hz}; give a value above zero, 1e-6 to 1e9"
            )
        check_components(self)

    @property
    def base_sensors(self) -> tuple[Sensor, ...]:
        """Sensors on the ground, which measure how the base shakes."""
        return tuple(sensor for sensor in self.sensors if self.is_on_ground(sensor.station))

    def is_on_ground(self, station: Station) -> bool:
        """True for a station on the ground, not on a body of that name."""
        return station.body == GROUND and all(body.name != GROUND for body in self.bodies)

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Directions in which the bodies move: y, and z if something measures or acts in it."""
        moves_in_z = any(station.direction == "z" for station in self._stations) or any(
            contact.law.spatial for contact in self.contacts
        )
        return DIRECTIONS if moves_in_z else DIRECTIONS[:1]

    @property
    def in_space(self) -> bool:
        """True if the bodies move in both directions."""
        return len(self.directions) > 1

    @property
    def _stations(self) -> Iterator[Station]:
        """Stations of everything that has a direction."""
        yield from self.forces
        yield from (station for contact in self.contacts for station in contact_stations(contact))
        for components in (self.sensors, self.springs, self.loads, self.dampers, self.tones):
            yield from (component.station for component in components)

    @property
    def forces(self) -> tuple[Station, ...]:
        """Stations of the measured forces."""
        return self.force_at if isinstance(self.force_at, tuple) else (self.force_at,)

    @property
    def first_driven_body(self) -> str:
        """Name of the body of the (first) force; of the first body where the base alone shakes."""
        station = self.forces[0]
        return self.bodies[0].name if self.is_on_ground(station) else station.body

    @property
    def inputs(self) -> tuple[Station, ...]:
        """Places of the measured excitation: those of the forces on bodies, then the ground if it has a sensor."""
        stations_on_bodies = tuple(station for station in self.forces if not self.is_on_ground(station))
        return (*stations_on_bodies, ON_GROUND) if self.base_sensors else stations_on_bodies

    @property
    def force_names(self) -> tuple[str, ...]:
        """Channel names of the forces: force, or force_1, force_2, ..."""
        return force_names(len(self.forces))

    def force_names_in(self, direction: Direction) -> tuple[str, ...]:
        """Channel names of the forces in one direction."""
        return tuple(
            name for name, station in zip(self.force_names, self.forces, strict=True) if station.direction == direction
        )

    def body(self, name: str) -> Body:
        """Body of that name; raises RigError if there is none."""
        for body in self.bodies:
            if body.name == name:
                return body
        raise RigError(f"rig {self.name!r} has no body {name!r}; it has {', '.join(body.name for body in self.bodies)}")

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
        return tuple(body for body in self.bodies if isinstance(body, Beam))

    def contact(self, name: str) -> Contact:
        """Contact of that name."""
        return next(contact for contact in self.contacts if contact.name == name)


def force_names(count: int) -> tuple[str, ...]:
    return tuple(f"force_{k}" for k in range(1, count + 1)) if count > 1 else ("force",)


def rig_stations(rig: Rig) -> tuple[Station, ...]:
    """Every distinct station on a body with a sensor or a contact, body by body from left to right."""
    stations = {sensor.station for sensor in rig.sensors if sensor not in rig.base_sensors} | {
        station for contact in contact_rows(rig) for station in contact_stations(contact)
    }
    body_order = [body.name for body in rig.bodies]
    return tuple(sorted(stations, key=lambda s: (body_order.index(s.body), s.position_m, s.direction)))


def contact_rows(rig: Rig) -> tuple[Contact, ...]:
    """Contacts by the components of their relative displacement: an annular one twice, NAME_y and NAME_z."""
    return tuple(
        row
        for contact in rig.contacts
        for row in (
            [_contact_component(contact, direction) for direction in DIRECTIONS] if contact.law.spatial else [contact]
        )
    )


def _contact_component(contact: Contact, direction: Direction) -> Contact:
    at, against = (
        None if station is None else replace(station, direction=direction) for station in (contact.at, contact.against)
    )
    return replace(contact, name=f"{contact.name}_{direction}", at=at, against=against)


def check_shapes_known(rig: Rig, source: str) -> None:
    """Raise RigError if a sensor, contact or force is at a place where a structure's modal basis gives no shapes.

    Interpolated shapes are for effects and perturbed rigs only.
    """
    labelled_stations = [(f"the {name}", station) for name, station in zip(rig.force_names, rig.forces, strict=True)]
    labelled_stations += [(f"sensor {sensor.name!r}", sensor.station) for sensor in rig.sensors]
    labelled_stations += [
        (f"contact {contact.name!r}", station) for contact in rig.contacts for station in contact_stations(contact)
    ]
    for label, station in labelled_stations:
        if rig.is_on_ground(station):
            continue
        body = rig.body(station.body)
        if isinstance(body, Structure) and not body.has_shapes_at(station.position_m):
            node_note = " or give a station by its node" if any(row.node for row in body.rows) else ""
            raise RigError(
                f"{source}: {label} stands at {station.position_m} m of {body.name!r}, where its modal basis gives no "
                f"shapes; add a row for that place{node_note}"
            )


def to_json(rig: Rig) -> bytes:
    """JSON text of a rig, without the fields of `UNWRITTEN_DEFAULTS` at their defaults."""
    text = msgspec.json.encode(rig)
    for field in UNWRITTEN_DEFAULTS:
        text = text.replace(field, b"")
    return msgspec.json.format(text, indent=2)


def to_brief_json(rig: Rig) -> bytes:
    """JSON text of a rig for people to write on: without the fields that are at their defaults, but the version."""
    return msgspec.json.format(
        msgspec.json.encode(_without_defaults(rig) | {"schema_version": rig.schema_version}), indent=2
    )


def _without_defaults(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_without_defaults(item) for item in value]
    if not isinstance(value, msgspec.Struct):
        return value
    config = value.__struct_config__
    tag = {config.tag_field: config.tag} if config.tag_field else {}
    written_fields = [field for field in msgspec.structs.fields(value) if not _is_default(field, value)]
    return tag | {field.encode_name: _without_defaults(getattr(value, field.name)) for field in written_fields}


def _is_default(field: msgspec.structs.FieldInfo, struct: msgspec.Struct) -> bool:
    if field.default_factory is not msgspec.NODEFAULT:
        return bool(getattr(struct, field.name) == field.default_factory())
    return field.default is not msgspec.NODEFAULT and bool(getattr(struct, field.name) == field.default)


def from_json(text: bytes, source_label: str) -> Rig:
    """Rig from a JSON text; raises RigError with `source_label`, the place and the reason if it is invalid."""
    check_json_size_and_keys(text, source_label)
    try:
        decoded = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RigError(f"{source_label}: not a rig description: it is no JSON ({error}); correct it there") from error
    check_schema_version(decoded, source_label)
    check_largest_number(decoded, source_label)
    error_prefix = f"{source_label}: not a rig description"
    try:
        typed_json = normalised_rig_json(decoded)
    except RigError as error:
        raise RigError(f"{error_prefix}: {error}") from error
    return converted(typed_json, Rig, error_prefix)


def read_rig(path: Path) -> Rig:
    """Rig in a JSON file; raises RigError if it cannot be read, is invalid, or lacks shapes (`check_shapes_known`)."""
    rig = from_json(contents(path), str(path))
    check_shapes_known(rig, str(path))
    return rig
