"""Overlap of the bodies that differs from the nominal one."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import Contact, Rig, Station
from rig.model.parameters import Parameter, ParameterSet


class ContactPosition(Effect, frozen=True):
    """The bodies lie `shift_m` farther along each other than believed, so that the contacts strike at other places."""

    name: ClassVar[str] = "contact_position"
    words: ClassVar[str] = "an overlap of the bodies that is {shift_m}"
    signed_words: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "shift_m": ("shorter than believed", "longer than believed", "not as believed")
    }
    separating_test: ClassVar[str] = "measure where the parts touch"
    shift_m: Annotated[float, Parameter("m", -0.05, 0.05, 0.0)] = 0.01

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to a tenth of the shortest beam, either way."""
        max_shift_m = 0.1 * _shortest_beam_m(scale.rig)
        return cls.with_ranges(shift_m=(-max_shift_m, max_shift_m))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, shift_m=0.01 * _shortest_beam_m(scale.rig))

    def applied_to(self, rig: Rig) -> Rig:
        self.beams_of(rig, None)
        return replace(rig, contacts=tuple(self._shifted_contact(rig, contact) for contact in rig.contacts))

    def _shifted_contact(self, rig: Rig, contact: Contact) -> Contact:
        """A contact at one beam's end stays there and moves along the other; between the ends it stays on `at`."""
        if contact.against is None:
            return contact
        station, against_station = contact.at, contact.against
        if against_station.position_m in (0.0, rig.body(against_station.body).length_m):
            return replace(contact, at=self._shifted_station(rig, station, -self.shift_m))
        return replace(contact, against=self._shifted_station(rig, against_station, self.shift_m))

    def _shifted_station(self, rig: Rig, station: Station, shift_m: float) -> Station:
        if station.body not in [beam.name for beam in rig.beams]:
            raise self.missing_place_error(
                rig, f"beam at {station.position_m} m of {station.body!r} that a contact could move along"
            )
        return Station(station.body, station.position_m + shift_m)


def _shortest_beam_m(rig: Rig) -> float:
    return min((beam.length_m for beam in rig.beams), default=0.0)
