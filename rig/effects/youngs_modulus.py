"""Young's modulus that differs from the nominal one."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.description import Rig
from rig.model.parameters import Parameter


class YoungsModulus(Effect, frozen=True):
    """Young's modulus of one beam (the last unless one is named) is `factor` times what is believed."""

    name: ClassVar[str] = "youngs_modulus"
    words: ClassVar[str] = "a Young's modulus of {beam} that is {factor}"
    separating_test: ClassVar[str] = (
        "fix a known mass to the beam's end: a softer beam and a giving clamp shift modes differently"
    )
    factor: Annotated[float, Parameter("1", 0.5, 2.0, 1.0)] = 0.95
    beam: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        beam = self.beams_of(rig, self.beam)[-1]
        scaled_beam = replace(beam, youngs_modulus_pa=beam.youngs_modulus_pa * self.factor)
        return replace(rig, bodies=tuple(scaled_beam if body is beam else body for body in rig.bodies))
