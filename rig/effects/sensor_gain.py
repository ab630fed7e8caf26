"""Gain error of one sensor."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.description import Rig
from rig.model.parameters import Parameter


class SensorGain(Effect, frozen=True):
    """One sensor (the last unless one is named) delivers `factor` times what its calibration says."""

    name: ClassVar[str] = "sensor_gain"
    words: ClassVar[str] = "a gain of {sensor} that is {factor}"
    separating_test: ClassVar[str] = "exchange the sensor with another and record again"
    factor: Annotated[float, Parameter("1", 0.2, 5.0, 1.0)] = 1.05
    sensor: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_sensor(rig, self.sensor, lambda sensor: replace(sensor, gain=sensor.gain * self.factor))
