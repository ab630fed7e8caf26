"""Time delay of one sensor."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class SensorDelay(Effect, frozen=True):
    """One sensor (the last unless one is named) shows the motion of `delay_s` ago."""

    name: ClassVar[str] = "sensor_delay"
    words: ClassVar[str] = "a signal of {sensor} that comes {delay_s}"
    signed_words: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "delay_s": ("too early", "too late", "at the wrong time")
    }
    separating_test: ClassVar[str] = "exchange the sensor's channel with another and record again"
    delay_s: Annotated[float, Parameter("s", -2e-3, 2e-3, 0.0)] = 5e-4
    sensor: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to 2 ms, or five samples, either way."""
        max_delay_s = max(2e-3, 5 / scale.rig.sample_rate_hz)
        return cls.with_ranges(delay_s=(-max_delay_s, max_delay_s))

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_sensor(rig, self.sensor, lambda sensor: replace(sensor, delay_s=sensor.delay_s + self.delay_s))
