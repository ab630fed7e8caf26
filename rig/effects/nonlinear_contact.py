"""Stop that stiffens with its depth."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet


class NonlinearContact(Effect, frozen=True):
    """The force of a stop has a term in the cube of its depth, as where surfaces flatten."""

    name: ClassVar[str] = "nonlinear_contact"
    words: ClassVar[str] = "a cubic stiffness of {cubic_n_per_m3} in the stops of {contact}"
    separating_test: ClassVar[str] = "excite more strongly, so that the stops are pressed deeper"
    cubic_n_per_m3: Annotated[float, Parameter("N/m^3", 0.0, 3e11, 0.0)] = 3e10
    contact: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to a stop whose force is doubled where it equals three times the exciting force's root mean square."""
        return cls.with_ranges(cubic_n_per_m3=(0.0, _force_doubling_cubic_n_per_m3(scale)))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, cubic_n_per_m3=0.05 * _force_doubling_cubic_n_per_m3(scale))

    def applied_to(self, rig: Rig) -> Rig:
        return self.with_laws(
            rig,
            self.contact,
            DeadZone,
            lambda law: replace(law, cubic_n_per_m3=law.cubic_n_per_m3 + self.cubic_n_per_m3),
        )


def _force_doubling_cubic_n_per_m3(scale: Scale) -> float:
    """k / depth^2, at the depth to which three times the exciting force's root mean square presses the stop."""
    stiffness_n_per_m = scale.contact_stiffness_n_per_m()
    return stiffness_n_per_m**3 / (3 * scale.force_rms_n) ** 2
