"""A restoring force that grows with the cube of the displacement."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import PointSpring, Rig
from rig.effect import Effect, Parameter


class HardeningSpring(Effect, frozen=True):
    """A restoring force in the cube of the displacement holds a body to the ground, like a support that stretches."""

    name: ClassVar[str] = "hardening_spring"
    separated_by: ClassVar[str] = "record at two levels: a hardening spring grows with the cube"
    cubic_n_per_m3: Annotated[float, Parameter("N/m^3", 0.0, 1e8)] = 1e6
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, springs=(*rig.springs, PointSpring(station=station, cubic_n_per_m3=self.cubic_n_per_m3)))
