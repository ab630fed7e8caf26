"""Base of every unmodelled effect: a frozen class with a name, a few parameters, and a function from rig to rig."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.beam import Beam
from rig.model.contact_laws import ContactLaw
from rig.model.description import Body, Rig, Sensor, Station, contact_stations
from rig.model.modes import Modes, modes_of
from rig.model.parameters import Parameter, ParameterSet

PLACES = 11
"""Along a beam, where its softest place is looked for."""

Law = TypeVar("Law", bound=ContactLaw)
Compliance = Callable[[Float[np.ndarray, " places"]], Any]
"""One compliance of those along a body: np.max that of its softest point, np.median that of its middling one."""
Place = Mapping[str, str | None]
"""Where an effect acts, by the names of its fields (contact, body, beam, sensor, ...); None: all of them together."""


@dataclass(frozen=True)
class Scale:
    """Scale of a range: the rig, the root mean square of the exciting force, the record's duration.

    place is where the effect acts; its body is the one that the force drives if none is named.
    """

    rig: Rig
    force_rms_n: float
    duration_s: float
    place: Place = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("force_rms_n", "duration_s"):
            value = getattr(self, name)
            if not 0 < value < np.inf:
                raise RigError(f"scale of rig {self.rig.name!r}: {name} is {value}; give a finite value above zero")

    def at(self, place: Place) -> "Scale":
        """The same for an effect at a place."""
        return dataclasses.replace(self, place=place)

    def contact_stiffness_n_per_m(self) -> float:
        """Stiffness of the stiffest contact at the place."""
        return max((law.stiffness_n_per_m for law in self._laws()), default=0.0)

    def clearance_m(self) -> float:
        """The smallest clearance of the contacts at the place."""
        laws = self._laws()
        return min((min(law.lower_clearance_m, law.upper_clearance_m) for law in laws), default=0.0)

    def contact_mass_kg(self) -> float:
        """Mass of the lightest body at the contacts of the place."""
        chosen = [c for c in self.rig.contacts if self.place.get("contact") in (None, c.name)]
        return min((self.at({"body": s.body}).mass_kg() for c in chosen for s in contact_stations(c)), default=np.inf)

    def mass_kg(self) -> float:
        """Mass of the body."""
        return self._body().mass_kg

    def stiffness_n_per_m(self, of: Compliance = np.max) -> float:
        """Stiffness of the body at its softest point: one over the sum of phi^2 / omega^2 of its elastic modes.

        `of` np.median: at its middling point. Of a free mass, which has none, that of the stiffest contact.
        """
        shapes, omega = self._shapes()
        elastic = omega > 0
        if not np.any(elastic):
            return max((c.law.stiffness_n_per_m for c in self.rig.contacts), default=self._body().mass_kg)
        return float(1 / of((shapes[:, elastic] ** 2) @ (1 / omega[elastic] ** 2)))

    def length_m(self) -> float:
        """Length of the body; a single mass has none."""
        return self._body().length_m

    def held(self) -> bool:
        """True if the body cannot move as a rigid one, were it not for its contacts."""
        return bool(np.all(self._shapes()[1] > 0))

    def displacement_m(self, of: Compliance = np.max) -> float:
        """Displacement scale of the body: as the force bends it, or as far as the clearance of its contacts.

        At its softest point; `of` as in `stiffness_n_per_m`.
        """
        body = self._body()
        touching = [c for c in self.rig.contacts if any(s.body == body.name for s in contact_stations(c))]
        return max(self.force_rms_n / self.stiffness_n_per_m(of), *(c.law.clearance_m for c in touching), 0.0)

    @property
    def band_hz(self) -> tuple[float, float]:
        """The frequencies that a record tells: two periods long at least, and below its sensors' filters."""
        return 2 / self.duration_s, 0.4 * self.rig.sample_rate_hz

    def _laws(self) -> list[ContactLaw]:
        return [c.law for c in self.rig.contacts if self.place.get("contact") in (None, c.name)]

    def _body(self) -> Body:
        return self.rig.body(self.place.get("body") or self.place.get("beam") or self.rig.forces[0].body)

    def _shapes(self) -> tuple[Float[np.ndarray, "places modes"], Float[np.ndarray, " modes"]]:
        body = self._body()
        modes: Modes = modes_of(self.rig, body)
        count = body.max_modes
        return modes.shapes(body.places(PLACES), count), 2 * np.pi * modes.frequencies_hz(count)


class Effect(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A way in which a real rig differs from the believed one; the docstring of each says its physics in one sentence.

    A field annotated with a `Parameter` is a number that can be fitted; its default is a magnitude that shows clearly
    in 60 s of the barrel-cradle. The other fields are a seed, or say where the effect acts.
    """

    name: ClassVar[str]
    words: ClassVar[str]
    """What it is, as a part of a sentence, with its fields in braces; {at} is the place along its body."""
    separated_by: ClassVar[str] = "record for longer and at another level of force"
    """The experiment that tells it from effects that look alike in one record."""
    needs_zero: ClassVar[bool] = False
    """Whether only a known zero of the relative displacements shows it."""
    stochastic: ClassVar[bool] = False
    """Whether only the spectrum of what it does is known, so that no fit over time finds its parameters."""
    grid_screened: ClassVar[str | None] = None
    """The parameter, if there is one, that a few starts cannot find: a frequency, sharp to one over the duration."""
    of_a_record: ClassVar[tuple[str, ...]] = ()
    """The parameters, if there are any, that every record has its own of, such as a phase."""

    @classmethod
    def parameters(cls, _: Scale, /) -> ParameterSet:
        """The numbers that can be fitted, the strength first, with ranges for this rig, force and place."""
        return parameters_of(cls)

    @classmethod
    def typical(cls, scale: Scale) -> "Effect":
        """The effect, at a place, in a strength that shows: for steps of derivatives, screening and first guesses."""
        return cls.placed(scale)

    @classmethod
    def placements(cls, rig: Rig, sensors: Sequence[str]) -> list[dict[str, str | None]]:
        """Places where it is tried: every contact, body, beam or sensor; of several contacts also all of them, tied."""
        contacts: list[str | None] = [c.name for c in rig.contacts]
        targets: dict[str, list[str | None]] = {
            "contact": [*contacts, None] if len(contacts) > 1 else contacts,
            "body": [b.name for b in rig.bodies],
            "beam": [b.name for b in rig.beams],
            "sensor": list(sensors),
        }
        where = [t for t in targets if t in cls.__struct_fields__]
        return [dict(zip(where, chosen, strict=True)) for chosen in product(*(targets[t] for t in where))]

    @classmethod
    def ranged(cls, **ranges: tuple[float, float]) -> ParameterSet:
        """The declared parameters, some with other ranges."""
        return parameters_of(cls).ranged(ranges)

    @classmethod
    def along(cls, scale: Scale, **ranges: tuple[float, float]) -> ParameterSet:
        """Parameters as `ranged`, without the place along the body where that is a single mass."""
        ranged = cls.ranged(**ranges)
        return ranged if scale.length_m() else ranged.without("relative_position")

    @classmethod
    def placed(cls, scale: Scale, **numbers: float) -> "Effect":
        """The effect at the scale's place, with these numbers."""
        return msgspec.convert({**numbers, **scale.place}, cls)

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

    def with_laws(self, rig: Rig, contact: str | None, kind: type[Law], change: Callable[[Law], Law]) -> Rig:
        """The rig with the law of one contact changed; of every contact if none is named.

        Raises RigError if there is no such contact or its law is of another kind.
        """
        changed = {c.name: c.law for c in rig.contacts if contact in (None, c.name)}
        if not changed:
            raise self.nowhere(rig, "contact" if contact is None else f"contact {contact!r}")
        laws = {}
        for name, law in changed.items():
            if not isinstance(law, kind):
                raise self.nowhere(rig, f"{kind.__struct_config__.tag} at {name!r}")
            laws[name] = change(law)
        return replace(rig, contacts=tuple(replace(c, law=laws.get(c.name, c.law)) for c in rig.contacts))

    def body_of(self, rig: Rig, name: str | None) -> Body:
        """The body of that name; the one that the (first) force drives if none is named."""
        wanted = rig.forces[0].body if name is None else name
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
        beams = tuple(b for b in rig.beams if ends in (None, b.ends) and name in (None, b.name))
        if not beams:
            raise self.nowhere(rig, f"{ends or ''} beam {'' if name is None else repr(name)}".strip())
        return beams

    def with_sensor(self, rig: Rig, name: str | None, change: Callable[[Sensor], Sensor]) -> Rig:
        """The rig with one sensor changed, the last if none is named."""
        chosen = [s for s in rig.sensors if name in (None, s.name)][-1:]
        if not chosen:
            raise self.nowhere(rig, "sensor" if name is None else f"sensor {name!r}")
        return replace(rig, sensors=tuple(change(s) if s in chosen else s for s in rig.sensors))


def parameters_of(kind: type[Effect]) -> ParameterSet:
    """The parameters of an effect, in the order of its fields."""
    hints = get_type_hints(kind, include_extras=True)
    return ParameterSet(
        tuple(
            dataclasses.replace(about, name=name)
            for name, hint in hints.items()
            for about in get_args(hint)
            if isinstance(about, Parameter)
        )
    )
