"""Time shift of the force channel."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class ForceShift(Effect, frozen=True):
    """The true force follows the measured one `shift_s` later, or (negative) comes that much before it."""

    name: ClassVar[str] = "force_shift"
    words: ClassVar[str] = "a force that acts {shift_s}"
    signed_words: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "shift_s": ("earlier than measured", "later than measured", "at another time than measured")
    }
    separating_test: ClassVar[str] = "shake a known free mass with the same force sensor"
    shift_s: Annotated[float, Parameter("s", -5e-3, 5e-3, 0.0)] = 5e-4

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to 5 ms, or five samples, either way."""
        max_shift_s = max(5e-3, 5 / scale.rig.sample_rate_hz)
        return cls.with_ranges(shift_s=(-max_shift_s, max_shift_s))

    def applied_to(self, rig: Rig) -> Rig:
        force_sensor = rig.force_sensor
        return replace(rig, force_sensor=replace(force_sensor, lag_s=force_sensor.lag_s + self.shift_s))
