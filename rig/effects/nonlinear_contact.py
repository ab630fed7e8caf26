"""A stop that stiffens."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import Rig
from rig.effect import Effect, Parameter


class NonlinearContact(Effect, frozen=True):
    """The force of a stop has a term in the cube of its depth, as where surfaces flatten."""

    name: ClassVar[str] = "nonlinear_contact"
    separated_by: ClassVar[str] = "excite more strongly, so that the stops are pressed deeper"
    cubic_n_per_m3: Annotated[float, Parameter("N/m^3", 0.0, 3e11)] = 3e10
    contact: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig, self.contact, lambda law: replace(law, cubic_n_per_m3=law.cubic_n_per_m3 + self.cubic_n_per_m3)
        )
