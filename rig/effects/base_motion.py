"""A floor that shakes."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import BaseMotion, Rig
from rig.effect import Effect, Parameter
from rig.errors import RigError


class ShakingBase(Effect, frozen=True):
    """The ground under clamps, springs and stops shakes unmeasured: Gaussian acceleration in a band, be it narrow."""

    name: ClassVar[str] = "base_motion"
    separated_by: ClassVar[str] = "record without force, or put an accelerometer on the base"
    acceleration_rms_m_per_s2: Annotated[float, Parameter("m/s^2", 0.0, 5.0)] = 0.5
    low_hz: Annotated[float, Parameter("Hz", 0.5, 200.0)] = 8.0
    high_hz: Annotated[float, Parameter("Hz", 0.5, 200.0)] = 12.0
    seed: int = 1

    def applied_to(self, rig: Rig) -> Rig:
        if rig.base_motion is not None:
            raise RigError(f"effect {self.name}: the base of rig {rig.name!r} moves already; give the effect once")
        base = BaseMotion(
            acceleration_rms_m_per_s2=self.acceleration_rms_m_per_s2,
            low_hz=self.low_hz,
            high_hz=self.high_hz,
            seed=self.seed,
        )
        return replace(rig, base_motion=base)
