"""Clearance that differs between the two stops of a contact."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from rig.effects.base import Effect, Scale
from rig.model.contact_laws import ContactLaw
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class AsymmetricClearance(Effect, frozen=True):
    """The gap of a contact stands off centre: its upper clearance is larger by `shift_m`, its lower one smaller."""

    name: ClassVar[str] = "asymmetric_clearance"
    words: ClassVar[str] = "a play of {contact} that lies {shift_m}"
    signed_words: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "shift_m": ("lower than believed", "higher than believed", "elsewhere")
    }
    separating_test: ClassVar[str] = "measure the relative displacement itself, with its zero"
    needs_zero: ClassVar[bool] = True
    shift_m: Annotated[float, Parameter("m", -4e-3, 4e-3, 0.0)] = 5e-4
    contact: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to four fifths of the smaller clearance, either way."""
        max_shift_m = 0.8 * scale.clearance_m()
        return cls.with_ranges(shift_m=(-max_shift_m, max_shift_m))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, shift_m=0.1 * scale.clearance_m())

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            ContactLaw,
            lambda law: law.with_clearances(law.lower_clearance_m - self.shift_m, law.upper_clearance_m + self.shift_m),
        )
