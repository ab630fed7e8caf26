"""Errors of rig.json."""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from msgspec.structs import replace

from rig.model.beam import Beam
from rig.model.description import Body, Rig, Sensor, Station
from tests.campaigns.spoiling.alteration import Alteration, Change, with_rig, with_sensors


def of_description(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    body = rig.bodies[int(rng.integers(len(rig.bodies)))]
    alone = len(rig.bodies) == 1  # then its mass and the force, its frequencies and the clock are told apart by nothing

    def put(make: Callable[[Body], Body]) -> Change:
        return with_rig(lambda r: _with_body(r, make(body)))

    about, channels = (body.name,), ("force",) if alone else ()
    yield Alteration(
        "mass 10 % off",
        put(lambda b: b.scale_mass(1.1)),
        frozenset({"mass", "gain"} if alone else {"mass"}),
        channels,
        about,
        group="rig.json",
    )
    yield Alteration(
        "density 10 % off",
        put(lambda b: b.scale_mass(1.1).scale_frequencies(1.1**-0.5)),
        frozenset({"mass", "gain"} if alone else {"mass"}),
        channels,
        about,
        group="rig.json",
    )
    yield Alteration(
        "frequencies 5 % off",
        put(lambda b: b.scale_frequencies(1.05)),
        frozenset({"frequency", "clock"} if alone else {"frequency"}),
        of=() if alone else about,
        group="rig.json",
    )
    yield Alteration(
        "frequencies 15 % off",
        put(lambda b: b.scale_frequencies(14 / 12)),
        frozenset({"frequency", "clock"} if alone else {"frequency"}),
        of=() if alone else about,
        group="rig.json",
    )
    yield Alteration(
        "damping four times", put(lambda b: b.scale_damping(4.0)), frozenset({"damping"}), of=about, group="rig.json"
    )
    if not body.is_mass:
        yield from _of_places(rig, body, rng)
    clamped = [b for b in rig.bodies if isinstance(b, Beam)]
    for beam in clamped:
        ends = "free-free" if beam.clamped else "clamped-free"
        turned = with_rig(partial(_with_body, body=replace(beam, ends=ends)))
        yield Alteration(
            f"{beam.name} described as {ends}", turned, frozenset({"ends", "model"}), of=(beam.name,), group="rig.json"
        )


def _with_body(rig: Rig, body: Body) -> Rig:
    return replace(rig, bodies=tuple(body if b.name == body.name else b for b in rig.bodies))


def _of_places(rig: Rig, body: Body, rng: np.random.Generator) -> Iterator[Alteration]:
    own = [s for s in rig.sensors if s.station.body == body.name]
    at_contacts = {p for c in rig.contacts for p in (c.at, c.against) if p}
    free = [s for s in own if s.station not in at_contacts] or own
    moved = free[int(rng.integers(len(free)))]
    if isinstance(body, Beam):
        for by_m in (0.05, 0.01):
            shifted = partial(_shifted, name=moved.name, by_m=by_m)
            yield Alteration(
                f"one station {1e3 * by_m:g} mm off",
                with_sensors(shifted),
                frozenset({"station"}),
                (moved.name,),
                group="rig.json",
            )
    turned = with_sensors(
        lambda s: (
            replace(s, station=Station(body.name, body.length_m - s.station.position_m))
            if s.station.body == body.name
            else s
        )
    )
    places = sorted(s.station.position_m for s in own)
    if not np.allclose(places, sorted(body.length_m - p for p in places)) or not at_contacts:
        yield Alteration(
            "stations count from the other end",
            turned,
            frozenset({"mirrored", "model"}),
            tuple(s.name for s in own),
            of=(body.name,),
            group="rig.json",
        )
    (at,) = rig.forces
    if at.body == body.name:
        other = min((s.station for s in own if s.station != at), key=lambda p: abs(p.position_m - at.position_m))
        yield Alteration(
            "the force at the next station",
            with_rig(lambda r: replace(r, force_at=other)),
            frozenset({"force place"}),
            group="rig.json",
        )


def _shifted(sensor: Sensor, name: str, by_m: float) -> Sensor:
    """Inwards from a body's end."""
    at_m = sensor.station.position_m
    moved = Station(sensor.station.body, at_m - by_m if at_m >= by_m else at_m + by_m)
    return replace(sensor, station=moved) if sensor.name == name else sensor
