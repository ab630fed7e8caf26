"""Structural damping that differs from the nominal one."""

from collections.abc import Sequence
from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.description import Rig
from rig.model.parameters import Parameter


class StructuralDamping(Effect, frozen=True):
    """The modal damping ratios of a body (of all unless one is named) are `factor` times what is believed."""

    name: ClassVar[str] = "structural_damping"
    words: ClassVar[str] = "a damping of {body} that is {factor}"
    separating_test: ClassVar[str] = "record a free decay at a low level that opens no contact"
    factor: Annotated[float, Parameter("1", 0.1, 15.0, 1.0)] = 3.0
    body: str | None = None

    @classmethod
    def placements(cls, rig: Rig, sensors: Sequence[str]) -> list[dict[str, str | None]]:
        """Places as of every effect, and all bodies, tied."""
        all_bodies_placement: list[dict[str, str | None]] = [{"body": None}] if len(rig.bodies) > 1 else []
        return super().placements(rig, sensors) + all_bodies_placement

    def applied_to(self, rig: Rig) -> Rig:
        damped_bodies = rig.bodies if self.body is None else (self.body_of(rig, self.body),)
        return replace(
            rig, bodies=tuple(body.scale_damping(self.factor) if body in damped_bodies else body for body in rig.bodies)
        )
