"""Dry friction between a body and the ground."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointDamper, Rig
from rig.model.parameters import Parameter, ParameterSet


class GroundFriction(Effect, frozen=True):
    """Dry friction of this force between a body and the ground opposes its velocity, at this share of its length."""

    name: ClassVar[str] = "ground_friction"
    words: ClassVar[str] = "a dry friction of {force_n} between {body}{at} and the ground"
    follows_level: ClassVar[bool] = True
    separating_test: ClassVar[str] = "record at two levels: dry friction matters less at the higher one"
    force_n: Annotated[float, Parameter("N", 0.0, 20.0, 0.0)] = 0.5
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to twice the root mean square of the exciting force."""
        return cls.with_ranges_along_body(scale, force_n=(0.0, 2 * scale.force_rms_n))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, force_n=0.05 * scale.force_rms_n)

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, dampers=(*rig.dampers, PointDamper(station=station, friction_n=self.force_n)))
