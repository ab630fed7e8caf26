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

PLACE_COUNT = 11
"""Number of places along a beam among which its softest is sought."""

Law = TypeVar("Law", bound=ContactLaw)
ComplianceStatistic = Callable[[Float[np.ndarray, " places"]], Any]
"""Statistic of the compliances along a body: np.max for its softest point, np.median for a typical one."""
Place = Mapping[str, str | None]
"""Place of an effect, by the names of its fields (contact, body, beam, sensor, ...); None: all of them together."""


@dataclass(frozen=True)
class Scale:
    """Scales of a rig for the ranges of an effect's parameters, from the rms of the exciting force and the duration.

    place is where the effect acts; without a body it is the body that the force drives.
    """

    rig: Rig
    force_rms_n: float
    duration_s: float
    place: Place = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for field_name in ("force_rms_n", "duration_s"):
            field_value = getattr(self, field_name)
            if not 0 < field_value < np.inf:
                raise RigError(
                    f"scale of rig {self.rig.name!r}: {field_name} is {field_value}; give a finite value above zero"
                )

    def with_place(self, place: Place) -> "Scale":
        """Scale for an effect at another place."""
        return dataclasses.replace(self, place=place)

    def contact_stiffness_n_per_m(self) -> float:
        """Stiffness of the stiffest contact at the place."""
        return max((law.stiffness_n_per_m for law in self._contact_laws()), default=0.0)

    def clearance_m(self) -> float:
        """Smallest clearance of the stops at the place, m; zero if there are none."""
        clearances_m = [min(law.lower_clearance_m, law.upper_clearance_m) for law in self._contact_laws()]
        return min((c for c in clearances_m if np.isfinite(c)), default=0.0)

    def contact_mass_kg(self) -> float:
        """Mass of the lightest body at the contacts of the place."""
        contacts = [contact for contact in self.rig.contacts if self.place.get("contact") in (None, contact.name)]
        return min(
            (
                self.with_place({"body": station.body}).mass_kg()
                for contact in contacts
                for station in contact_stations(contact)
            ),
            default=np.inf,
        )

    def mass_kg(self) -> float:
        """Mass of the body."""
        return self._body().mass_kg

    def stiffness_n_per_m(self, statistic: ComplianceStatistic = np.max) -> float:
        """Static stiffness of the body at its softest point, 1 / sum phi^2 / omega^2 over its elastic modes, N/m.

        With the statistic np.median, at a typical point. A free mass has the stiffness of the stiffest contact.
        """
        shapes, omega = self._shapes_and_frequencies()
        is_elastic = omega > 0
        if not np.any(is_elastic):
            return max((contact.law.stiffness_n_per_m for contact in self.rig.contacts), default=self._body().mass_kg)
        return float(1 / statistic((shapes[:, is_elastic] ** 2) @ (1 / omega[is_elastic] ** 2)))

    def length_m(self) -> float:
        """Length of the body, m; zero for a single mass."""
        return self._body().length_m

    def is_supported(self) -> bool:
        """True if the body, without its contacts, has no rigid-body mode."""
        return bool(np.all(self._shapes_and_frequencies()[1] > 0))

    def displacement_m(self, statistic: ComplianceStatistic = np.max) -> float:
        """Displacement scale of the body, m: the larger of F_rms / stiffness and the clearances of its contacts.

        The statistic as in `stiffness_n_per_m`.
        """
        body = self._body()
        touching_contacts = [
            contact
            for contact in self.rig.contacts
            if any(station.body == body.name for station in contact_stations(contact))
        ]
        clearances_m = [contact.law.clearance_m for contact in touching_contacts if contact.law.sides]
        return max(self.force_rms_n / self.stiffness_n_per_m(statistic), *clearances_m, 0.0)

    @property
    def band_hz(self) -> tuple[float, float]:
        """Band that a record resolves, Hz: from two periods per record to the passband of the sensors."""
        return 2 / self.duration_s, 0.4 * self.rig.sample_rate_hz

    def _contact_laws(self) -> list[ContactLaw]:
        return [contact.law for contact in self.rig.contacts if self.place.get("contact") in (None, contact.name)]

    def _body(self) -> Body:
        return self.rig.body(self.place.get("body") or self.place.get("beam") or self.rig.first_driven_body)

    def _shapes_and_frequencies(self) -> tuple[Float[np.ndarray, "places modes"], Float[np.ndarray, " modes"]]:
        body = self._body()
        modes: Modes = modes_of(self.rig, body)
        mode_count = body.max_modes
        return modes.shapes(body.places(PLACE_COUNT), mode_count), 2 * np.pi * modes.frequencies_hz(mode_count)


class Effect(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A difference between the real rig and its nominal model; its docstring states the physics in one sentence.

    A field annotated with a `Parameter` is a number that can be fitted; its default is clearly visible in 60 s of the
    barrel-cradle. The other fields are a seed, or the place of the effect.
    """

    name: ClassVar[str]
    words: ClassVar[str]
    """Noun phrase that names the effect, with its fields in braces; {at} is the place along its body."""
    signed_words: ClassVar[Mapping[str, tuple[str, str, str]]] = {}
    """Words behind the size of a parameter that has a direction, by its name: where it is negative, where positive;
    and in place of size and words where the record does not determine it."""
    separating_test: ClassVar[str] = "record for longer and at another level of force"
    """Experiment that separates it from effects that look alike in one record."""
    needs_zero: ClassVar[bool] = False
    """Whether it is visible only where the zero of the relative displacements is known."""
    stochastic: ClassVar[bool] = False
    """Whether only the spectrum of its action is known, so that no fit over time finds its parameters."""
    follows_level: ClassVar[bool] = False
    """Whether what it adds to a mode's stiffness or damping depends on how far the body moves: records of several
    levels then differ in its strength wherever the machine follows another law."""
    grid_screened: ClassVar[str | None] = None
    """Parameter, if any, that needs a grid of starting values: a frequency, resolved to one over the duration."""
    contains: ClassVar[tuple[str, ...]] = ()
    """Effects, if any, that its parameters beside the strength make at the same place: no set holds both."""
    of_a_record: ClassVar[tuple[str, ...]] = ()
    """Parameters, if any, that differ from record to record, such as a phase."""

    @classmethod
    def parameters(cls, _: Scale, /) -> ParameterSet:
        """Parameters that can be fitted, the strength first, with ranges for this rig, force and place."""
        return parameters_of(cls)

    @classmethod
    def typical(cls, scale: Scale) -> "Effect":
        """Effect of a detectable strength at the scale's place: for finite differences, screening and first guesses."""
        return cls.placed(scale)

    @classmethod
    def placements(cls, rig: Rig, sensors: Sequence[str]) -> list[dict[str, str | None]]:
        """Places to try: every contact, body, beam or sensor; with several contacts also all of them, tied."""
        contact_names: list[str | None] = [contact.name for contact in rig.contacts]
        places_by_field: dict[str, list[str | None]] = {
            "contact": [*contact_names, None] if len(contact_names) > 1 else contact_names,
            "body": [body.name for body in rig.bodies],
            "beam": [beam.name for beam in rig.beams],
            "sensor": list(sensors),
        }
        place_fields = [field_name for field_name in places_by_field if field_name in cls.__struct_fields__]
        return [
            dict(zip(place_fields, field_values, strict=True))
            for field_values in product(*(places_by_field[field_name] for field_name in place_fields))
        ]

    @classmethod
    def stations_on(cls, rig: Rig, body_name: str) -> tuple[Station, ...]:
        """Stations of a body at which the effect acts; empty for one of the whole body, or of a place of its own."""
        del rig, body_name
        return ()

    @classmethod
    def with_ranges(cls, **range_by_parameter: tuple[float, float]) -> ParameterSet:
        """The declared parameters, some with other ranges."""
        return parameters_of(cls).with_ranges(range_by_parameter)

    @classmethod
    def with_ranges_along_body(cls, scale: Scale, **range_by_parameter: tuple[float, float]) -> ParameterSet:
        """Parameters as `with_ranges`, without the position along the body if that is a single mass."""
        parameter_set = cls.with_ranges(**range_by_parameter)
        return parameter_set if scale.length_m() else parameter_set.excluding("relative_position")

    @classmethod
    def placed(cls, scale: Scale, **value_by_parameter: float) -> "Effect":
        """Effect at the scale's place, with these numbers."""
        return msgspec.convert({**value_by_parameter, **scale.place}, cls)

    def __post_init__(self) -> None:
        for field_name in self.__struct_fields__:
            value = getattr(self, field_name)
            if isinstance(value, float) and not np.isfinite(value):
                raise RigError(f"effect {self.name}: {field_name} is {value}; give a finite value")

    def applied_to(self, rig: Rig) -> Rig:
        """Rig with the effect; raises RigError where the effect does not apply."""
        raise NotImplementedError

    def missing_place_error(self, rig: Rig, missing_words: str) -> RigError:
        return RigError(
            f"effect {self.name}: rig {rig.name!r} has no {missing_words}; choose another place or another effect"
        )

    def with_laws(self, rig: Rig, contact: str | None, law_type: type[Law], change_law: Callable[[Law], Law]) -> Rig:
        """Rig with the law of one contact changed, of every contact if none is named.

        Raises RigError if there is no such contact or its law is of another kind.
        """
        law_by_contact = {c.name: c.law for c in rig.contacts if contact in (None, c.name)}
        if not law_by_contact:
            raise self.missing_place_error(rig, "contact" if contact is None else f"contact {contact!r}")
        changed_laws = {}
        for contact_name, law in law_by_contact.items():
            if not isinstance(law, law_type):
                raise self.missing_place_error(rig, f"{law_type.__struct_config__.tag} at {contact_name!r}")
            changed_laws[contact_name] = change_law(law)
        return replace(rig, contacts=tuple(replace(c, law=changed_laws.get(c.name, c.law)) for c in rig.contacts))

    def body_of(self, rig: Rig, name: str | None) -> Body:
        """Body of that name; without a name the one that the (first) force drives."""
        body_name = rig.first_driven_body if name is None else name
        for body in rig.bodies:
            if body.name == body_name:
                return body
        raise self.missing_place_error(rig, f"body {body_name!r}")

    def station(self, rig: Rig, body_name: str | None, relative_position: float) -> Station:
        """Station at a relative position (0 to 1) along a body."""
        target_body = self.body_of(rig, body_name)
        if not 0 <= relative_position <= 1:
            raise RigError(f"effect {self.name}: relative_position is {relative_position}; give 0 to 1")
        return Station(target_body.name, relative_position * target_body.length_m)

    def beams_of(self, rig: Rig, beam_name: str | None, end_condition: str | None = None) -> tuple[Beam, ...]:
        """Beams with these end conditions and this name, where given; raises RigError if there is none."""
        beams = tuple(
            beam for beam in rig.beams if end_condition in (None, beam.ends) and beam_name in (None, beam.name)
        )
        if not beams:
            raise self.missing_place_error(
                rig, f"{end_condition or ''} beam {'' if beam_name is None else repr(beam_name)}".strip()
            )
        return beams

    def with_sensor(self, rig: Rig, sensor_name: str | None, change_sensor: Callable[[Sensor], Sensor]) -> Rig:
        """Rig with one sensor changed, the last if none is named."""
        chosen_sensors = [sensor for sensor in rig.sensors if sensor_name in (None, sensor.name)][-1:]
        if not chosen_sensors:
            raise self.missing_place_error(rig, "sensor" if sensor_name is None else f"sensor {sensor_name!r}")
        return replace(
            rig, sensors=tuple(change_sensor(sensor) if sensor in chosen_sensors else sensor for sensor in rig.sensors)
        )


def parameters_of(effect_type: type[Effect]) -> ParameterSet:
    """Declared parameters of an effect, in the order of its fields."""
    type_by_field = get_type_hints(effect_type, include_extras=True)
    return ParameterSet(
        tuple(
            dataclasses.replace(annotation, name=field_name)
            for field_name, field_type in type_by_field.items()
            for annotation in get_args(field_type)
            if isinstance(annotation, Parameter)
        )
    )
