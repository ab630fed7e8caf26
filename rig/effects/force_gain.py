"""Gain error of the force sensor."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.description import Rig
from rig.model.parameters import Parameter


class ForceGain(Effect, frozen=True):
    """The measured force is `factor` times the true one."""

    name: ClassVar[str] = "force_gain"
    words: ClassVar[str] = "a gain of the force sensor that is {factor}"
    separating_test: ClassVar[str] = "shake a known free mass with the same force sensor"
    factor: Annotated[float, Parameter("1", 0.2, 5.0, 1.0)] = 1.05

    def applied_to(self, rig: Rig) -> Rig:
        force_sensor = rig.force_sensor
        return replace(rig, force_sensor=replace(force_sensor, gain=force_sensor.gain * self.factor))
