"""Constant force on a body."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import Rig, StaticLoad
from rig.model.parameters import Parameter, ParameterSet


class Preload(Effect, frozen=True):
    """A constant force presses on a body, so that it rests off its believed position, against a stop if it floats."""

    name: ClassVar[str] = "preload"
    words: ClassVar[str] = "a constant force of {force_n} on {body}{at}"
    separating_test: ClassVar[str] = "measure a static displacement, or turn the rig over"
    force_n: Annotated[float, Parameter("N", -20.0, 20.0, 0.0)] = 2.0
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 0.5
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to twice the root mean square of the exciting force, either way."""
        max_force_n = 2 * scale.force_rms_n
        return cls.with_ranges_along_body(scale, force_n=(-max_force_n, max_force_n))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, force_n=0.1 * scale.force_rms_n)

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, loads=(*rig.loads, StaticLoad(station=station, force_n=self.force_n)))
