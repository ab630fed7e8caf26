"""Contact stiffness that differs from the nominal one."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.model.parameters import Parameter


class ContactStiffness(Effect, frozen=True):
    """The stops of a contact are `factor` times as stiff as believed."""

    name: ClassVar[str] = "contact_stiffness"
    words: ClassVar[str] = "a stiffness of {contact} that is {factor}"
    separating_test: ClassVar[str] = "excite more strongly, so that the stops are pressed deeper"
    factor: Annotated[float, Parameter("1", 0.1, 10.0, 1.0)] = 1.3
    contact: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            ContactLaw,
            lambda law: replace(law, stiffness_n_per_m=law.stiffness_n_per_m * self.factor),
        )
