"""Gain error common to all sensors."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.description import Rig
from rig.model.parameters import Parameter


class CommonGain(Effect, frozen=True):
    """All sensors deliver `factor` times what their calibration says: a common amplifier, or other units."""

    name: ClassVar[str] = "common_gain"
    words: ClassVar[str] = "a gain of all sensors that is {factor}"
    separating_test: ClassVar[str] = "measure one motion with a sensor of another chain, or shake a known free mass"
    factor: Annotated[float, Parameter("1", 0.05, 20.0, 1.0)] = 1.05

    def applied_to(self, rig: Rig) -> Rig:
        if len(rig.sensors) < 2:  # of one it is its gain
            raise self.missing_place_error(rig, "second sensor")
        return replace(rig, sensors=tuple(replace(sensor, gain=sensor.gain * self.factor) for sensor in rig.sensors))
