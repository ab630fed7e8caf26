"""Clearance that differs from the nominal one."""

from typing import Annotated, ClassVar

from rig.effects.base import Effect
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.model.parameters import Parameter


class ContactClearance(Effect, frozen=True):
    """Both clearances of a contact are `factor` times what is believed."""

    name: ClassVar[str] = "contact_clearance"
    words: ClassVar[str] = "a clearance of {contact} that is {factor}"
    separating_test: ClassVar[str] = "measure the relative displacement itself, with its zero"
    factor: Annotated[float, Parameter("1", 0.1, 4.0, 1.0)] = 1.1
    contact: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            ContactLaw,
            lambda law: law.with_clearances(law.lower_clearance_m * self.factor, law.upper_clearance_m * self.factor),
        )
