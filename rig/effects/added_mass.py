"""A mass that was forgotten."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import PointMass, Rig
from rig.effect import Effect, Parameter


class AddedMass(Effect, frozen=True):
    """A point mass that nobody counted sits on a body, at this share of its length."""

    name: ClassVar[str] = "added_mass"
    separated_by: ClassVar[str] = "weigh the part, or fix a known mass elsewhere and compare"
    mass_kg: Annotated[float, Parameter("kg", 0.0, 1.0)] = 0.2
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, masses=(*rig.masses, PointMass(station=station, mass_kg=self.mass_kg)))
