"""The machines of the world "bench" as they should be, of random dimensions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import replace

from tests.campaigns.worlds.laws import StopLaw
from tests.campaigns.worlds.machine import MODES, Link, Lumped, Machine, MotionSensor, Place, Quantity, TrueBeam
from tests.campaigns.worlds.whole import GUIDES

NOISE: dict[Quantity, float] = {"acceleration": 1e-3, "velocity": 5e-7, "displacement": 5e-8}
"""One-sided densities: m/s^2, m/s and m, each per sqrt(Hz)."""
FAR_M = 1.0
"""A stop that is not there."""
SUPPORT_N_PER_M = 1e8
ACCELEROMETERS: tuple[Quantity, ...] = ("acceleration",)
EITHER: tuple[Quantity, ...] = ("acceleration", "displacement")
ANY: tuple[Quantity, ...] = ("acceleration", "velocity", "displacement")


def carriage(rng: np.random.Generator) -> Machine:
    """A mass on guides that rub, held by a weak spring; its position is measured."""
    body = _mass("carriage", _between(rng, 8, 40), _between(rng, 0.4, 0.9), _between(rng, 0.05, 0.2))
    friction_n = _between(rng, 0.05, 0.15) * body.grounded_n_per_m[0] * 0.03
    guides = Link(name=GUIDES, at=Place("carriage"), against=None, law=StopLaw(friction_n=friction_n))
    return replace(_machine([Place("carriage")], Place("carriage"), "displacement", lumped=(body,)), links=(guides,))


def masses(count: int, grounded: bool, rng: np.random.Generator) -> Machine:
    """Masses on springs of their own; each knocks against the next, the last one also against the ground."""
    bodies = tuple(
        _mass(f"mass_{k + 1}", _between(rng, 0.8, 3), _between(rng, 4, 9), _between(rng, 0.01, 0.03))
        for k in range(count)
    )
    places = [Place(b.name) for b in bodies]
    ends: list[Place | None] = [*places[1:], *([None] if grounded else [])]
    stops = [_stop(f"contact_{k + 1}", places[k], end, (4e-4, 1e-3), rng) for k, end in enumerate(ends)]
    return _machine(places, places[0], _quantity(EITHER, rng), lumped=bodies, contacts=tuple(stops))


def two_masses(rng: np.random.Generator) -> Machine:
    return masses(2, False, rng)


def three_masses(rng: np.random.Generator) -> Machine:
    return masses(3, True, rng)


def chain(rng: np.random.Generator) -> Machine:
    """Three masses with springs between them, the first one held; the last one knocks against the ground."""
    body = _row("chain", 3, _between(rng, 0.8, 2), _between(rng, 6, 12), _between(rng, 0.008, 0.02), 0.2, rng)
    places = [Place("chain", x) for x in body.positions_m]
    stop = _stop("contact_1", places[-1], None, (4e-4, 1e-3), rng)
    return _machine(places, places[0], _quantity(EITHER, rng), lumped=(body,), contacts=(stop,))


def frame(rng: np.random.Generator) -> Machine:
    """Four storeys on leaf springs, a bumper between the upper two."""
    body = _row("frame", 4, _between(rng, 5, 8), _between(rng, 20, 35), _between(rng, 0.006, 0.015), 0.3, rng)
    floors = [Place("frame", x) for x in body.positions_m]
    bumper = _stop("bumper", floors[3], floors[2], (1e-4, 3e-4), rng, stiffness=(2e5, 1e6))
    return _machine(floors, floors[0], "acceleration", lumped=(body,), contacts=(bumper,))


def bare_cantilever(rng: np.random.Generator) -> Machine:
    return _cantilever(rng, (0.4, 0.7, 1.0), ANY)


def cantilever(rng: np.random.Generator) -> Machine:
    """With a stop on either side of its tip."""
    plain = _cantilever(rng, (0.2, 0.4, 0.6, 0.8, 0.9, 1.0), EITHER)
    stop = _stop("tip", plain.sensors[-1].at, None, (5e-4, 1.5e-3), rng, stiffness=(3e4, 1e5))
    return replace(plain, contacts=(stop,))


def cantilever_one_sided(rng: np.random.Generator) -> Machine:
    plain = cantilever(rng)
    (stop,) = plain.contacts
    return replace(plain, contacts=(replace(stop, law=replace(stop.law, lower_m=FAR_M)),))


def held_mass(rng: np.random.Generator) -> Machine:
    """A mass between stops that do not stand evenly."""
    body = _mass("mass", _between(rng, 1, 3), _between(rng, 8, 15), _between(rng, 0.005, 0.02))
    stop = _stop("stop_1", Place("mass"), None, (5e-4, 1e-3), rng)
    uneven = replace(stop, law=replace(stop.law, lower_m=stop.law.lower_m * _between(rng, 1.1, 1.5)))
    return _machine([Place("mass")], Place("mass"), "displacement", lumped=(body,), contacts=(uneven,))


def shaken_mass(rng: np.random.Generator) -> Machine:
    """The same on a base that is shaken; force and displacement are those against the base."""
    plain = held_mass(rng)
    return replace(plain, cell=replace(plain.cell, base_kg=plain.lumped[0].masses_kg[0]))


def supported_beam(rng: np.random.Generator) -> Machine:
    """A clamped beam on a stiff support, with a mass between that and its end."""
    plain = _cantilever(rng, (0.25, 0.45, 0.8, 0.9, 1.0), ACCELEROMETERS)
    (beam,) = plain.beams
    support_m, mass_m = (_between(rng, low, high) * beam.length_m for low, high in ((0.55, 0.65), (0.75, 0.95)))
    held = replace(beam, springs=((support_m, SUPPORT_N_PER_M),), masses=((mass_m, _between(rng, 0.3, 0.8)),))
    return replace(plain, beams=(held,), force_at=plain.sensors[2].at)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _quantity(among: Sequence[Quantity], rng: np.random.Generator) -> Quantity:
    return among[int(rng.integers(len(among)))]


def _machine(places: Sequence[Place], force_at: Place, quantity: Quantity, **parts: Any) -> Machine:
    """Sensors of one quantity at these places."""
    sensors = tuple(
        MotionSensor(
            name=f"{p.body}_{round(1000 * p.position_m):04d}mm_{quantity}",
            at=p,
            quantity=quantity,
            noise_density=NOISE[quantity],
        )
        for p in places
    )
    return Machine(**{"beams": (), "contacts": ()} | parts, force_at=force_at, sensors=sensors)


def _mass(name: str, mass_kg: float, hertz: float, damping_ratio: float) -> Lumped:
    return Lumped(
        name=name,
        positions_m=(0.0,),
        masses_kg=(mass_kg,),
        grounded_n_per_m=(mass_kg * (2 * np.pi * hertz) ** 2,),
        damping_ratio=damping_ratio,
        frequency_factors=(1.0,),
        damping_factors=(1.0,),
    )


def _row(
    name: str, count: int, mass_kg: float, hertz: float, damping_ratio: float, apart_m: float, rng: np.random.Generator
) -> Lumped:
    """Masses and springs that differ by a tenth; hertz is that of one of them on one of the springs."""
    spring_n_per_m = mass_kg * (2 * np.pi * hertz) ** 2
    kilograms = (mass_kg * rng.uniform(0.9, 1.1, count)).tolist()
    ground, *between = (spring_n_per_m * rng.uniform(0.9, 1.1, count)).tolist()
    return Lumped(
        name=name,
        positions_m=tuple((apart_m * np.arange(count)).tolist()),
        masses_kg=tuple(kilograms),
        grounded_n_per_m=(ground, *(0.0,) * (count - 1)),
        between_n_per_m=tuple(between),
        damping_ratio=damping_ratio,
        frequency_factors=(1.0,) * count,
        damping_factors=(1.0,) * count,
    )


def _cantilever(rng: np.random.Generator, shares: Sequence[float], among: Sequence[Quantity]) -> Machine:
    beam = TrueBeam(
        name="beam",
        clamped=True,
        length_m=round(_between(rng, 0.8, 1.2), 3),
        width_m=round(_between(rng, 0.04, 0.06), 4),
        thickness_m=round(_between(rng, 0.008, 0.012), 5),
        youngs_modulus_pa=210e9,
        density_kg_per_m3=7850.0,
        damping_ratio=_between(rng, 0.004, 0.01),
        frequency_factors=(1.0,) * MODES,
    )
    places = [Place("beam", share * beam.length_m) for share in shares]
    return _machine(places, places[1], _quantity(among, rng), beams=(beam,))


def _stop(
    name: str,
    at: Place,
    against: Place | None,
    clearance_m: tuple[float, float],
    rng: np.random.Generator,
    stiffness: tuple[float, float] = (1e4, 5e4),
) -> Link:
    """A stop on either side, as far from the middle."""
    gap_m = _between(rng, *clearance_m)
    stiffness_n_per_m = float(stiffness[0] * (stiffness[1] / stiffness[0]) ** rng.uniform())
    law = StopLaw(
        lower_m=gap_m,
        upper_m=gap_m,
        stiffness_below_n_per_m=stiffness_n_per_m,
        stiffness_above_n_per_m=stiffness_n_per_m,
        damping_n_s_per_m=_between(rng, 5, 15),
    )
    return Link(name=name, at=at, against=against, law=law)
