"""Damping of a closed contact."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class ContactDamping(Effect, frozen=True):
    """Beyond the stop a contact has this much more viscous damping."""

    name: ClassVar[str] = "contact_damping"
    words: ClassVar[str] = "an additional damping of {damping_n_s_per_m} in {contact}"
    separating_test: ClassVar[str] = "excite more strongly, so that the stops are struck faster"
    damping_n_s_per_m: Annotated[float, Parameter("N s/m", 0.0, 200.0, 0.0)] = 20.0
    contact: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to critical: twice the root of the contact's stiffness and the lighter body's mass."""
        critical_n_s_per_m = 2 * (scale.contact_stiffness_n_per_m() * scale.contact_mass_kg()) ** 0.5
        return cls.with_ranges(damping_n_s_per_m=(0.0, critical_n_s_per_m))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        critical_n_s_per_m = 2 * (scale.contact_stiffness_n_per_m() * scale.contact_mass_kg()) ** 0.5
        return cls.placed(scale, damping_n_s_per_m=0.02 * critical_n_s_per_m)

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            ContactLaw,
            lambda law: replace(law, damping_n_s_per_m=law.damping_n_s_per_m + self.damping_n_s_per_m),
        )
