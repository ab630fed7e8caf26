"""Unmeasured harmonic force on a body."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import Rig, Tone
from rig.model.parameters import Parameter, ParameterSet


class HarmonicForce(Effect, frozen=True):
    """An unmeasured harmonic force acts on a body: `cosine_n` cos(2 pi f t) + `sine_n` sin(2 pi f t)."""

    name: ClassVar[str] = "tone"
    words: ClassVar[str] = "an unmeasured tone of {frequency_hz} on {body}{at}"
    separating_test: ClassVar[str] = "record without force, with motors and mains switched on and off"
    grid_screened: ClassVar[str | None] = "frequency_hz"
    of_a_record: ClassVar[tuple[str, ...]] = ("cosine_n", "sine_n")
    cosine_n: Annotated[float, Parameter("N", -5.0, 5.0, 0.0)] = 1.0
    sine_n: Annotated[float, Parameter("N", -5.0, 5.0, 0.0)] = 0.5
    frequency_hz: Annotated[float, Parameter("Hz", 0.5, 200.0)] = 50.0
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to twice the root mean square of the exciting force, at the frequencies that a record tells."""
        max_force_n = 2 * scale.force_rms_n
        return cls.with_ranges_along_body(
            scale, cosine_n=(-max_force_n, max_force_n), sine_n=(-max_force_n, max_force_n), frequency_hz=scale.band_hz
        )

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        low_hz, high_hz = scale.band_hz
        return cls.placed(scale, cosine_n=0.05 * scale.force_rms_n, sine_n=0.0, frequency_hz=(low_hz * high_hz) ** 0.5)

    def applied_to(self, rig: Rig) -> Rig:
        tone = Tone(
            station=self.station(rig, self.body, self.relative_position),
            frequency_hz=self.frequency_hz,
            cosine_n=self.cosine_n,
            sine_n=self.sine_n,
        )
        return replace(rig, tones=(*rig.tones, tone))
