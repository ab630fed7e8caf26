"""Checks of a whole rig: names, places, directions and supports."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rig.errors import RigError
from rig.model.components import ON_GROUND, Sensor, Station, Support, check_name, contact_stations
from rig.model.structure import Structure

if TYPE_CHECKING:
    from rig.model.description import Body, Rig

MAX_PER_KIND = 1000
"""Largest number of bodies, of contacts, of sensors and of forces."""


def check_components(rig: "Rig") -> None:
    """Raise RigError if a name, place or direction is wrong, or nothing could hold or drive a body so."""
    check_name("rig", rig.name)
    _check_names(f"rig {rig.name!r}", "body", [body.name for body in rig.bodies])
    _check_names(f"rig {rig.name!r}", "contact", [contact.name for contact in rig.contacts])
    _check_names(f"rig {rig.name!r}", "sensor", [sensor.name for sensor in rig.sensors])
    _check_forces(rig)
    for sensor in rig.sensors:
        _check_sensor(rig, sensor)
    for contact in rig.contacts:
        for station in contact_stations(contact):
            _check_station(rig, f"contact {contact.name!r}", station)
    for kind, components in (
        ("point mass", rig.masses),
        ("point spring", rig.springs),
        ("support", rig.supports),
        ("point load", rig.loads),
        ("point damper", rig.dampers),
        ("tone", rig.tones),
    ):
        for component in components:
            _check_station(rig, f"a {kind}", component.station)
    _check_supports_and_clamps(rig)
    _check_directions(rig)
    if not abs(rig.gravity_m_per_s2) < np.inf:
        raise RigError(f"rig {rig.name!r}: gravity_m_per_s2 is {rig.gravity_m_per_s2}; give a finite value")
    for body in rig.bodies if rig.base_motion or rig.base_sensors or rig.gravity_m_per_s2 else ():
        _check_carried_by_base(body)


def _check_forces(rig: "Rig") -> None:
    if isinstance(rig.force_at, tuple):
        if not 2 <= len(rig.force_at) <= MAX_PER_KIND:
            raise RigError(
                f"rig {rig.name!r}: force_at is a list of {len(rig.force_at)}; give the place of one force by "
                f"itself, those of several as a list of 2 to {MAX_PER_KIND}"
            )
        _check_names(f"rig {rig.name!r}", "channel", [*rig.force_names, *(sensor.name for sensor in rig.sensors)])
    for force_name, station in zip(rig.force_names, rig.forces, strict=True):
        if not rig.is_on_ground(station):
            _check_station(rig, f"the {force_name}", station)
        elif len(rig.forces) > 1 or not rig.base_sensors:
            raise RigError(
                f"rig {rig.name!r}: the {force_name} acts on the ground, where it moves nothing; give force_at the "
                "place of the measured force, or leave it out and put a sensor on the ground, if it shakes"
            )


def _check_sensor(rig: "Rig", sensor: Sensor) -> None:
    if not rig.is_on_ground(sensor.station):
        _check_station(rig, f"sensor {sensor.name!r}", sensor.station)
    elif sensor.station != ON_GROUND:
        raise RigError(f"sensor {sensor.name!r} stands on the ground, which has one place; give no position_m")
    rig.fibre_m(sensor)
    if not sensor.high_pass_hz < rig.sample_rate_hz / 2:
        raise RigError(
            f"sensor {sensor.name!r}: high_pass_hz is {sensor.high_pass_hz}; give less than half the "
            f"sample_rate_hz of {rig.sample_rate_hz:g}"
        )


def _check_directions(rig: "Rig") -> None:
    for contact in rig.contacts:
        directions = {station.direction for station in contact_stations(contact)}
        if contact.law.spatial and directions != {"y"}:
            raise RigError(f"contact {contact.name!r} is annular, in both directions; give its stations none")
        if len(directions) > 1:
            raise RigError(f"contact {contact.name!r} has stations in y and in z; give both the same direction")
    for station in (*(mass.station for mass in rig.masses), *(support.station for support in rig.supports)):
        if station.direction != "y":
            raise RigError(f"rig {rig.name!r}: a mass or support is in both directions; give its station none")
    if rig.in_space and (rig.base_motion or rig.base_sensors):
        raise RigError(
            f"rig {rig.name!r} moves in y and z, where no base may shake; leave base_motion and sensors on the "
            "ground out, or the direction z and annular contacts"
        )


def _check_supports_and_clamps(rig: "Rig") -> None:
    for support in rig.supports:
        _check_support(rig, support)
    for clamp in rig.clamps:
        if getattr(rig.body(clamp.body), "ends", None) != "clamped-free":
            raise RigError(f"a clamp holds {clamp.body!r}, which is no clamped beam; name one that is")
    if len({clamp.body for clamp in rig.clamps}) < len(rig.clamps):
        raise RigError(f"rig {rig.name!r}: more than one clamp holds the same beam; give one")


def _check_support(rig: "Rig", support: Support) -> None:
    body, position_m = rig.body(support.station.body), support.station.position_m
    if body.is_mass:
        raise RigError(
            f"a support holds {body.name!r}, a mass; supports stand along beams and structures, a mass has its own "
            "spring, frequency_hz"
        )
    if body.clamped and position_m == 0:
        raise RigError(f"a support stands at the clamped end of {body.name!r}, which is held there; leave it out")
    if sum(other_support.station == support.station for other_support in rig.supports) > 1:
        raise RigError(f"more than one support stands at {position_m} m of {body.name!r}; give one")


def _check_station(rig: "Rig", owner: str, station: Station) -> None:
    body = rig.body(station.body)
    if not 0 <= station.position_m <= body.length_m:
        raise RigError(f"{owner} stands at {station.position_m} m, off {body.name!r}; give 0 to {body.length_m} m")


def _check_names(owner: str, kind: str, names: Sequence[str]) -> None:
    """Raise RigError if there are too many names, or two are equal, or `check_name` refuses one."""
    if len(names) > MAX_PER_KIND:
        raise RigError(f"{owner}: has {len(names)} times a {kind}; give at most {MAX_PER_KIND}")
    for name in names:
        check_name(kind, name)
    if duplicates := sorted({name_twice for name_twice in names if names.count(name_twice) > 1}):
        raise RigError(f"{owner}: more than one {kind} is named {duplicates[0]!r}; names must differ")


def _check_carried_by_base(body: "Body") -> None:
    """Raise RigError if the modes of a body do not say how a moving base carries it."""
    if isinstance(body, Structure):
        body.translation()
