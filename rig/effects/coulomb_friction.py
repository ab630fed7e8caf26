"""Dry friction across a contact."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class CoulombFriction(Effect, frozen=True):
    """Dry friction of this force opposes the relative velocity across a contact, in and out of the gap."""

    name: ClassVar[str] = "coulomb_friction"
    words: ClassVar[str] = "a dry friction of {force_n} in {contact}"
    separating_test: ClassVar[str] = "record at a low level that opens no contact"
    force_n: Annotated[float, Parameter("N", 0.0, 5.0, 0.0)] = 2.0
    contact: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to twice the root mean square of the exciting force."""
        return cls.with_ranges(force_n=(0.0, 2 * scale.force_rms_n))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, force_n=0.1 * scale.force_rms_n)

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig, self.contact, DeadZone, lambda law: replace(law, friction_n=law.friction_n + self.force_n)
        )
