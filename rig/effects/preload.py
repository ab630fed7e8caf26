"""A constant force that nobody counted."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import Rig, StaticLoad
from rig.effect import Effect, Parameter


class Preload(Effect, frozen=True):
    """A constant force presses on a body, so that it rests off its believed position, against a stop if it floats."""

    name: ClassVar[str] = "preload"
    separated_by: ClassVar[str] = "measure a static displacement, or turn the rig over"
    force_n: Annotated[float, Parameter("N", -20.0, 20.0)] = 2.0
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 0.5
    body: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, loads=(*rig.loads, StaticLoad(station=station, force_n=self.force_n)))
