"""A force that comes late."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import Rig
from rig.effect import Effect, Parameter


class ActuatorLag(Effect, frozen=True):
    """The true force follows the measured one `lag_s` later."""

    name: ClassVar[str] = "actuator_lag"
    separated_by: ClassVar[str] = "shake a known free mass with the same force sensor"
    lag_s: Annotated[float, Parameter("s", 0.0, 3e-3, 0.0)] = 5e-4

    def applied_to(self, rig: Rig) -> Rig:
        sensor = rig.force_sensor
        return replace(rig, force_sensor=replace(sensor, lag_s=sensor.lag_s + self.lag_s))
