"""A stop that dissipates."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.description import Rig
from rig.effect import Effect, Parameter


class ContactDamping(Effect, frozen=True):
    """Beyond the stop a contact has this much more viscous damping."""

    name: ClassVar[str] = "contact_damping"
    separated_by: ClassVar[str] = "excite more strongly, so that the stops are struck faster"
    damping_n_s_per_m: Annotated[float, Parameter("N s/m", 0.0, 200.0)] = 20.0
    contact: str | None = None

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            lambda law: replace(law, damping_n_s_per_m=law.damping_n_s_per_m + self.damping_n_s_per_m),
        )
