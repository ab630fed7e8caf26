"""What a kind of effect is: what is drawn of it, and what it does to a machine."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.campaigns.worlds.machine import Lumped, Machine, Place, TrueBeam
from tests.campaigns.worlds.truth import EffectTruth, Expected

ALL_CONTACTS = 1 / 3
"""The share of the contact effects that act at all contacts."""
ALL_BODIES = 1 / 3
"""Likewise of the effects on all bodies."""
MOVING = 0.6
"""From this share of their length on, both beams move by some millimetres."""
SHARES_OF_BODIES = (0.1, 1.0)


@dataclass(frozen=True)
class Size:
    """A magnitude, log-uniform between low and high; `default` has strength 1.

    A number is `neutral` and the magnitude with one of the signs; a factor is (1 + magnitude) to the power of a sign.
    """

    field: str
    low: float
    high: float
    default: float
    signs: tuple[int, ...] = (1,)
    factor: bool = False
    neutral: float = 0.0
    below: float = 1.0
    """A number with the sign -1 is so much smaller."""

    def drawn(self, rng: np.random.Generator, least: float) -> tuple[float, float]:
        """The value and its strength; `least` leaves out so much of the logarithmic range's lower end."""
        magnitude = float(self.low * (self.high / self.low) ** rng.uniform(least, 1.0))
        sign = int(rng.choice(self.signs))
        if self.factor:
            return (1 + magnitude) ** sign, float(np.log1p(magnitude) / np.log1p(self.default))
        magnitude *= self.below if sign < 0 else 1.0
        return self.neutral + sign * magnitude, magnitude / self.default


Change = Callable[[Machine, EffectTruth], Machine]
Draw = Callable[[np.random.Generator, float, float], dict[str, float]]
"""More parameters, from random numbers, the size's value and the level of the force, N rms."""


def nothing_more(_rng: np.random.Generator, _value: float, _rms_n: float) -> dict[str, float]:
    return {}


@dataclass(frozen=True)
class Kind:
    """A kind of effect: its size, where it acts, what else is drawn, and what it does.

    `stand_ins`: the effects of the library that come nearest to one outside it.

    `at`: "contact" (one or all), "contacts" (one), "body" (a share of a body's length), "moving" (the same, where it
    moves), "beam", "beams" (a body or all), "clamped" (the clamped beam), "beam_itself" (the first, as a
    body), "sensor", "" (no choice).
    """

    name: str
    size: Size
    at: str
    change: Change
    more: Draw = nothing_more
    told: bool = True
    """Whether the size itself is a parameter, and not only what `more` makes of it."""
    sides: tuple[str, ...] = ()
    expected: Callable[[EffectTruth], Expected] | None = None
    library: bool = True
    stand_ins: tuple[str, ...] = ()

    def drawn(self, machine: Machine, rms_n: float, rng: np.random.Generator, least: float = 0.0) -> EffectTruth:
        """An effect of this kind on a machine that is excited at this level."""
        value, strength = self.size.drawn(rng, least)
        parameters = ({self.size.field: value} if self.told else {}) | self.more(rng, value, rms_n)
        place = self._placed(machine, rng)
        if self.library and "position_m" in place and (length_m := machine.body(str(place["body"])).length_m):
            parameters["relative_position"] = float(place["position_m"]) / length_m
        if self.sides:
            place["side"] = str(rng.choice(self.sides))
        return EffectTruth(
            name=self.name, parameters=parameters, place=place, strength=strength, stand_ins=self.stand_ins
        )

    def _placed(self, machine: Machine, rng: np.random.Generator) -> dict[str, str | float]:
        """Where it acts, but for the side of a contact."""
        if self.at in ("contact", "contacts"):
            everywhere = self.at == "contact" and rng.uniform() < ALL_CONTACTS and len(machine.contacts) > 1
            chosen = str(rng.choice([c.name for c in machine.contacts]))
            return {"contact": "all" if everywhere else chosen}
        if self.at in ("body", "moving"):
            body = machine.bodies[int(rng.integers(len(machine.bodies)))]
            position_m = _somewhere(body, MOVING if self.at == "moving" else SHARES_OF_BODIES[0], rng)
            return {"body": body.name, "position_m": position_m}
        if self.at == "beams":
            names = [b.name for b in machine.bodies]
            everywhere = rng.uniform() < ALL_BODIES and len(names) > 1
            return {"body": "all" if everywhere else str(rng.choice(names))}
        if self.at in ("beam", "clamped"):
            return {"beam": str(rng.choice([b.name for b in machine.beams if b.clamped or self.at == "beam"]))}
        if self.at == "beam_itself":
            return {"body": machine.beams[0].name}
        return {"sensor": str(rng.choice([s.name for s in machine.sensors]))} if self.at == "sensor" else {}


def _somewhere(body: TrueBeam | Lumped, least: float, rng: np.random.Generator) -> float:
    """A place on a beam beyond this share of its length, or one of the masses of a row."""
    if isinstance(body, Lumped):
        return float(rng.choice(body.positions_m))
    return float(rng.uniform(least, SHARES_OF_BODIES[1])) * body.length_m


def place_of(truth: EffectTruth) -> Place:
    """The point of a body where an effect acts."""
    return Place(str(truth.place["body"]), float(truth.place["position_m"]))
