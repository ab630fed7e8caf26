"""What every unmodelled effect is: a frozen class with a name, a few parameters, and a function from rig to rig."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, get_args, get_type_hints

import msgspec
import numpy as np
from msgspec.structs import replace

from rig.beam import Beam
from rig.contact import DeadZone
from rig.description import Body, Rig, Sensor, Station
from rig.errors import RigError


@dataclass(frozen=True)
class Parameter:
    """Of an effect's number: its unit ("1" if it has none) and its plausible range."""

    unit: str
    low: float
    high: float


class Effect(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A way in which a real rig differs from the believed one; the docstring of each says its physics in one sentence.

    A field annotated with a `Parameter` is a number that can be fitted; its default is a magnitude that shows clearly
    in 60 s of the barrel-cradle. The other fields are a seed, or say where the effect acts.
    """

    name: ClassVar[str]
    separated_by: ClassVar[str] = "record for longer and at another level of force"
    """The experiment that tells it from effects that look alike in one record."""
    needs_zero: ClassVar[bool] = False
    """Whether only a known zero of the relative displacements shows it."""

    def __post_init__(self) -> None:
        for field in self.__struct_fields__:
            value = getattr(self, field)
            if isinstance(value, float) and not np.isfinite(value):
                raise RigError(f"effect {self.name}: {field} is {value}; give a finite value")

    def applied_to(self, rig: Rig) -> Rig:
        """The rig with the effect; raises RigError where it makes no sense."""
        raise NotImplementedError

    def nowhere(self, rig: Rig, wanted: str) -> RigError:
        return RigError(f"effect {self.name}: rig {rig.name!r} has no {wanted}; choose another place or another effect")

    def with_laws(self, rig: Rig, contact: str | None, change: Callable[[DeadZone], DeadZone]) -> Rig:
        """The rig with the law of one contact changed; of every contact if none is named."""
        changed = [c for c in rig.contacts if contact in (None, c.name)]
        if not changed:
            raise self.nowhere(rig, "contact" if contact is None else f"contact {contact!r}")
        return replace(rig, contacts=tuple(replace(c, law=change(c.law)) if c in changed else c for c in rig.contacts))

    def body_of(self, rig: Rig, name: str | None) -> Body:
        """The body of that name; the one that the force drives if none is named."""
        wanted = rig.force_at.body if name is None else name
        for body in rig.bodies:
            if body.name == wanted:
                return body
        raise self.nowhere(rig, f"body {wanted!r}")

    def station(self, rig: Rig, body: str | None, relative_position: float) -> Station:
        """A place on a body, as a share of its length."""
        chosen = self.body_of(rig, body)
        if not 0 <= relative_position <= 1:
            raise RigError(f"effect {self.name}: relative_position is {relative_position}; give 0 to 1")
        return Station(chosen.name, relative_position * chosen.length_m)

    def beams_of(self, rig: Rig, name: str | None, ends: str | None = None) -> tuple[Beam, ...]:
        """The beams with such ends, or the one of that name; raises RigError if there is none."""
        beams = tuple(
            b for b in rig.bodies if isinstance(b, Beam) and ends in (None, b.ends) and name in (None, b.name)
        )
        if not beams:
            raise self.nowhere(rig, f"{ends or ''} beam {'' if name is None else repr(name)}".strip())
        return beams

    def with_sensor(self, rig: Rig, name: str | None, change: Callable[[Sensor], Sensor]) -> Rig:
        """The rig with one sensor changed, the last if none is named."""
        chosen = [s for s in rig.sensors if name in (None, s.name)][-1:]
        if not chosen:
            raise self.nowhere(rig, "sensor" if name is None else f"sensor {name!r}")
        return replace(rig, sensors=tuple(change(s) if s in chosen else s for s in rig.sensors))


def parameters_of(kind: type[Effect]) -> dict[str, Parameter]:
    """The parameters of an effect by name, in the order of its fields."""
    found = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        for about in get_args(hint):
            if isinstance(about, Parameter):
                found[name] = about
    return found
