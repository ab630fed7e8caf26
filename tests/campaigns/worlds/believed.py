"""The rig that the owner of a blind case believes in, and the machine that it would be."""

import msgspec
import numpy as np
from msgspec.structs import replace

from rig.model.description import Body, Contact, Rig, Sensor, Station
from rig.simulation.reference import BarrelCradle
from tests.campaigns.worlds.laws import StopLaw
from tests.campaigns.worlds.machine import Link, Machine, MotionSensor, Place, TrueBeam
from tests.campaigns.worlds.truth import World

NOISE_DENSITY = 1e-3
"""Of the accelerometers, m/s^2/sqrt(Hz)."""
APART_M = 0.03
"""No two stations of a beam are closer."""


def believed_rig(world: World, rng: np.random.Generator) -> Rig:
    """The reference rig with six accelerometers a beam; in the world "other" one of other dimensions."""
    return _other(rng) if world == "other" else BarrelCradle(sensors="acceleration", noise_density=NOISE_DENSITY).rig()


def _other(rng: np.random.Generator) -> Rig:
    """Lengths 0.8 to 1.3 m, 8 to 13 mm thick, clearances 2 to 7 mm, stiffnesses 3e4 to 4e5 N/m, 4 to 8 stations."""
    while True:
        length_m = float(rng.uniform(0.8, 1.3))
        stations = int(rng.integers(4, 9))
        settings = BarrelCradle(
            length_m=length_m,
            overlap_start_m=length_m * float(rng.uniform(0.38, 0.52)),
            clearance_1_m=float(rng.uniform(2e-3, 7e-3)),
            clearance_2_m=float(rng.uniform(2e-3, 7e-3)),
            stiffness_1_n_per_m=float(3e4 * (4 / 0.3) ** rng.uniform()),
            stiffness_2_n_per_m=float(3e4 * (4 / 0.3) ** rng.uniform()),
            stations=(4, 6, 6, 8, 8)[stations - 4],
            sensors="acceleration",
            noise_density=NOISE_DENSITY,
        )
        rig = settings.rig()
        barrel_m = length_m * float(rng.uniform(0.85, 1.15))
        thickness_m = {b.name: float(rng.uniform(8e-3, 13e-3)) for b in rig.bodies}
        left_out = {b.name: int(rng.integers(100)) for b in rig.bodies}
        rig = _with_stations(_with_barrel(rig, barrel_m), stations, left_out)
        bodies = tuple(_thick(b, thickness_m[b.name]) for b in rig.bodies)
        if _spread_out(rig, stations):
            return replace(rig, bodies=bodies)


def _thick(body: Body, thickness_m: float) -> Body:
    return replace(body, thickness_m=thickness_m)


def _with_barrel(rig: Rig, length_m: float) -> Rig:
    """The rig with a barrel of another length: contacts stay, the force is at its end, other stations go along."""
    old_m = rig.body("barrel").length_m
    kept = {contact.at for contact in rig.contacts}
    bodies = tuple(replace(b, length_m=length_m) if b.name == "barrel" else b for b in rig.bodies)
    sensors = []
    for sensor in rig.sensors:
        station = sensor.station
        if station.body == "barrel" and station not in kept:
            station = Station("barrel", min(station.position_m / old_m, 1.0) * length_m)
        name = f"{station.body}_{round(station.position_m * 1000):04d}mm_acceleration"
        sensors.append(replace(sensor, station=station, name=name))
    return replace(rig, bodies=bodies, sensors=tuple(sensors), force_at=Station("barrel", length_m))


def _with_stations(rig: Rig, stations: int, left_out: dict[str, int]) -> Rig:
    """Of every beam with one sensor too many, one that is at no contact is left out."""
    struck = {station for c in rig.contacts for station in (c.at, c.against)}
    gone: list[Sensor] = []
    for beam, chosen in left_out.items():
        own = [s for s in rig.sensors if s.station.body == beam]
        free = [s for s in own if s.station not in struck]
        if len(own) > stations:
            gone.append(free[chosen % len(free)])
    return replace(rig, sensors=tuple(s for s in rig.sensors if s not in gone))


def _spread_out(rig: Rig, stations: int) -> bool:
    for body in rig.bodies:
        positions_m = [s.station.position_m for s in rig.sensors if s.station.body == body.name]
        if len(positions_m) != stations or np.diff(sorted(positions_m)).min() < APART_M:
            return False
    return True


def nominal_machine(rig: Rig) -> Machine:
    """The machine that is exactly as believed, of beams with contacts between them."""
    return Machine(
        beams=tuple(_beam(body) for body in rig.bodies),
        contacts=tuple(_link(contact) for contact in rig.contacts),
        force_at=_place(rig.forces[0]),
        sensors=tuple(
            MotionSensor(name=s.name, at=_place(s.station), noise_density=s.noise_density) for s in rig.sensors
        ),
    )


def _beam(body: Body) -> TrueBeam:
    told = msgspec.to_builtins(body)
    numbers = ("length_m", "width_m", "thickness_m", "youngs_modulus_pa", "density_kg_per_m3", "damping_ratio")
    return TrueBeam(name=body.name, clamped=told["ends"] == "clamped-free", **{field: told[field] for field in numbers})


def _place(station: Station) -> Place:
    return Place(station.body, station.position_m)


def _link(contact: Contact) -> Link:
    law = contact.law
    return Link(
        name=contact.name,
        at=_place(contact.at),
        against=_place(contact.against) if contact.against else None,
        law=StopLaw(
            lower_m=law.lower_clearance_m,
            upper_m=law.upper_clearance_m,
            stiffness_below_n_per_m=law.stiffness_n_per_m,
            stiffness_above_n_per_m=law.stiffness_n_per_m,
        ),
    )
