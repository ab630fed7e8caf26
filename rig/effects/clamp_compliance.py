"""Compliant clamp."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.errors import RigError
from rig.model.description import Clamp, Rig, Station
from rig.model.parameters import Parameter


class ClampCompliance(Effect, frozen=True):
    """The clamp turns under the bending moment like a rotational spring E I / (length * compliance)."""

    name: ClassVar[str] = "clamp_compliance"
    words: ClassVar[str] = "a clamp of {beam} that gives way (compliance {compliance})"
    separating_test: ClassVar[str] = (
        "measure close to the clamp, where a clamp that gives moves and a softer beam does not"
    )
    compliance: Annotated[float, Parameter("1", 0.002, 0.3, 0.0)] = 0.03
    beam: str | None = None

    @classmethod
    def stations_on(cls, rig: Rig, body_name: str) -> tuple[Station, ...]:
        """Left end of the body, where it is clamped."""
        del rig
        return (Station(body_name, 0.0),)

    def applied_to(self, rig: Rig) -> Rig:
        if self.compliance <= 0:
            raise RigError(f"effect {self.name}: compliance is {self.compliance}; give a value above zero")
        beams = self.beams_of(rig, self.beam, "clamped-free")
        compliant_clamps = tuple(
            Clamp(body=beam.name, rotational_n_m_per_rad=beam.bending_stiffness_n_m2 / beam.length_m / self.compliance)
            for beam in beams
        )
        other_clamps = tuple(clamp for clamp in rig.clamps if clamp.body not in {beam.name for beam in beams})
        return replace(rig, clamps=other_clamps + compliant_clamps)
