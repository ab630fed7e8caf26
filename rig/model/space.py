"""A rig in space as two plane rigs, in y and in z, that nothing but annular contacts couples."""

from msgspec.structs import replace

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws.annular import Annular
from rig.model.description import Contact, Direction, Rig, Station


def in_plane(rig: Rig, direction: Direction) -> Rig:
    """Plane rig of one direction, with everything of that direction turned to y.

    An annular contact becomes its dead zone (`Annular.in_plane`), which keeps its places. Masses, supports and clamps
    hold in both directions, gravity in y alone; a rectangular beam bends in z over its width. Where no force acts in
    the direction, one stands at the place of the first force: its signal is zero.
    """
    if not rig.in_space:
        return rig
    forces_in_y = tuple(station_in_y(station) for station in rig.forces if station.direction == direction)
    forces_in_y = forces_in_y or (station_in_y(rig.forces[0]),)
    components_by_field = {}
    for field in ("sensors", "springs", "loads", "dampers", "tones"):
        components = (c for c in getattr(rig, field) if c.station.direction == direction)
        components_by_field[field] = tuple(replace(c, station=station_in_y(c.station)) for c in components)
    contacts = (contact for contact in rig.contacts if contact.law.spatial or contact.at.direction == direction)
    return replace(
        rig,
        bodies=tuple(body.bending_in_z if direction == "z" and isinstance(body, Beam) else body for body in rig.bodies),
        contacts=tuple(map(_plane_contact, contacts)),
        force_at=forces_in_y if len(forces_in_y) > 1 else forces_in_y[0],
        gravity_m_per_s2=rig.gravity_m_per_s2 if direction == "y" else 0.0,
        **components_by_field,
    )


def plane_rigs(rig: Rig) -> dict[Direction, Rig]:
    """Plane rigs by direction; a plane rig is its own in y."""
    return {direction: in_plane(rig, direction) for direction in rig.directions}


def station_in_y(station: Station) -> Station:
    """Station in y."""
    return replace(station, direction="y")


def _plane_contact(contact: Contact) -> Contact:
    law = contact.law.in_plane if isinstance(contact.law, Annular) else contact.law
    against = None if contact.against is None else station_in_y(contact.against)
    return replace(contact, at=station_in_y(contact.at), against=against, law=law)


def check_plane(rig: Rig, purpose: str) -> None:
    """Raise RigError if a rig moves in two directions or has weight, which `purpose` ("rig fmu") does not take."""
    annular_names = [contact.name for contact in rig.contacts if contact.law.spatial]
    sensor_names_in_z = [sensor.name for sensor in rig.sensors if sensor.station.direction == "z"]
    reasons = [f"contact {name!r} is annular" for name in annular_names[:1]]
    reasons += [f"sensor {name!r} has the direction z" for name in sensor_names_in_z[:1]]
    reasons += ["something in it has the direction z"] * rig.in_space
    reasons += ["it has gravity"] * bool(rig.gravity_m_per_s2)
    if reasons:
        raise RigError(
            f"rig {rig.name!r}: {reasons[0]}, and {purpose} takes rigs that move in one direction, without gravity; "
            "describe the motion in y alone, with dead zones"
        )
