"""Layout of a rig for drawings: positions of the bodies along one axis, and stations by name."""

from rig.model.description import Rig, Station


def left_end_m_by_body(rig: Rig) -> dict[str, float]:
    """Position of every body's left end, m: 0 for the first; the two stations of a contact have the same x."""
    left_m = {rig.bodies[0].name: 0.0}
    for _ in rig.bodies:
        for contact in rig.contacts:
            if contact.against is not None:
                for placed, unplaced in ((contact.at, contact.against), (contact.against, contact.at)):
                    if placed.body in left_m:
                        left_m.setdefault(unplaced.body, left_m[placed.body] + placed.position_m - unplaced.position_m)
    return {body.name: left_m.get(body.name, 0.0) for body in rig.bodies}


def station_named(rig: Rig, name: str, relative_position: float = 0.5) -> Station | None:
    """Station of a contact, a sensor, or a relative position on a body; None for other names."""
    station_by_name = {body.name: Station(body.name, relative_position * body.length_m) for body in rig.bodies}
    station_by_name |= {sensor.name: sensor.station for sensor in rig.sensors} | {
        contact.name: contact.at for contact in rig.contacts
    }
    return station_by_name.get(name)
