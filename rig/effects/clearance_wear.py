"""Clearance that grows with time."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class ClearanceWear(Effect, frozen=True):
    """Wear makes the clearance of a contact grow steadily, by this share of it a minute."""

    name: ClassVar[str] = "clearance_wear"
    words: ClassVar[str] = "a clearance of {contact} that grows by {growth_per_minute} of itself"
    separating_test: ClassVar[str] = "record for longer: wear goes on, an error of the clearance does not"
    growth_per_minute: Annotated[float, Parameter("1/min", 0.0, 0.5, 0.0)] = 0.1
    contact: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to a doubled clearance at the record's end."""
        return cls.with_ranges(growth_per_minute=(0.0, 60 / scale.duration_s))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, growth_per_minute=6 / scale.duration_s)

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            ContactLaw,
            lambda law: replace(law, wear_m_per_s=law.wear_m_per_s + self.growth_per_minute * law.clearance_m / 60),
        )
