"""Added mass on a body."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointMass, Rig
from rig.model.parameters import Parameter, ParameterSet


class AddedMass(Effect, frozen=True):
    """A point mass that nobody counted sits on a body, at this share of its length."""

    name: ClassVar[str] = "added_mass"
    words: ClassVar[str] = "an added mass of {mass_kg} on {body}{at}"
    separating_test: ClassVar[str] = "weigh the part, or fix a known mass elsewhere and compare"
    mass_kg: Annotated[float, Parameter("kg", 0.0, 1.0, 0.0)] = 0.2
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to half of the body's mass."""
        return cls.with_ranges_along_body(scale, mass_kg=(0.0, 0.5 * scale.mass_kg()))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, mass_kg=0.05 * scale.mass_kg(), relative_position=1.0)

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, masses=(*rig.masses, PointMass(station=station, mass_kg=self.mass_kg)))
