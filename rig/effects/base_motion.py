"""Unmeasured motion of the base."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.errors import RigError
from rig.model.description import BaseMotion, Rig
from rig.model.parameters import Parameter, ParameterSet


class ShakingBase(Effect, frozen=True):
    """The ground under clamps, springs and stops shakes unmeasured: Gaussian acceleration in a band, be it narrow."""

    name: ClassVar[str] = "base_motion"
    words: ClassVar[str] = "an unmeasured base motion of {acceleration_rms_m_per_s2} rms from {low_hz} to {high_hz}"
    separating_test: ClassVar[str] = "record without force, or put an accelerometer on the base"
    stochastic: ClassVar[bool] = True
    acceleration_rms_m_per_s2: Annotated[float, Parameter("m/s^2", 0.0, 5.0, 0.0)] = 0.5
    low_hz: Annotated[float, Parameter("Hz", 0.5, 200.0)] = 8.0
    high_hz: Annotated[float, Parameter("Hz", 0.5, 200.0)] = 12.0
    seed: int = 1

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to twice what the exciting force gives the lightest body, at the frequencies that a record tells."""
        highest_m_per_s2 = (
            2 * scale.force_rms_n / min(scale.with_place({"body": body.name}).mass_kg() for body in scale.rig.bodies)
        )
        return cls.with_ranges(
            acceleration_rms_m_per_s2=(0.0, highest_m_per_s2), low_hz=scale.band_hz, high_hz=scale.band_hz
        )

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        lightest_body_kg = min(scale.with_place({"body": body.name}).mass_kg() for body in scale.rig.bodies)
        low_hz, high_hz = scale.band_hz
        band_middle_hz = (low_hz * high_hz) ** 0.5
        return cls(
            acceleration_rms_m_per_s2=0.1 * scale.force_rms_n / lightest_body_kg,
            low_hz=0.8 * band_middle_hz,
            high_hz=1.2 * band_middle_hz,
        )

    def applied_to(self, rig: Rig) -> Rig:
        if rig.base_motion is not None:
            raise RigError(f"effect {self.name}: the base of rig {rig.name!r} moves already; give the effect once")
        added_base_motion = BaseMotion(
            acceleration_rms_m_per_s2=self.acceleration_rms_m_per_s2,
            low_hz=self.low_hz,
            high_hz=self.high_hz,
            seed=self.seed,
        )
        return replace(rig, base_motion=added_base_motion)
