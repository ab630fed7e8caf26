"""Stop whose force is a power of its depth."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.description import Rig
from rig.model.parameters import Parameter, ParameterSet

MAX_FORCE_N = 1e9
"""Largest reference force, N: beyond it no stop is as stiff as believed at any load of a machine."""


class HertzStop(Effect, frozen=True):
    """The force of a stop grows with a power of its depth (1.5: Hertz), and equals k depth at `reference_force_n`."""

    name: ClassVar[str] = "hertz_stop"
    words: ClassVar[str] = "a force of the stops of {contact} that grows with the power {exponent} of their depth"
    separating_test: ClassVar[str] = "excite more strongly, so that the stops are pressed deeper"
    contains: ClassVar[tuple[str, ...]] = ("contact_stiffness",)
    exponent: Annotated[float, Parameter("1", 1.0, 2.0, 1.0)] = 1.5
    reference_force_n: Annotated[float, Parameter("N", 0.2, 2000.0)] = 20.0
    """Force at which the stop is as stiff as believed, by its secant: with the exponent it gives every stiffness."""
    contact: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Exponent from 1 to 2; reference force from a hundredth to a hundred times the rms of the exciting force."""
        return cls.with_ranges(reference_force_n=(0.01 * scale.force_rms_n, 100 * scale.force_rms_n))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, exponent=1.1, reference_force_n=2 * scale.force_rms_n)

    def applied_to(self, rig: Rig) -> Rig:
        if not 0 < self.reference_force_n <= MAX_FORCE_N:
            raise RigError(
                f"effect {self.name}: reference_force_n is {self.reference_force_n}; give a value above zero, at most "
                f"{MAX_FORCE_N:g}"
            )
        return self.with_laws(rig, self.contact, DeadZone, self._changed_law)

    def _changed_law(self, law: DeadZone) -> DeadZone:
        if not law.stiffness_n_per_m > 0:
            raise RigError(f"effect {self.name}: a stop without stiffness has no shape; choose another contact")
        depth_m = self.reference_force_n / law.stiffness_n_per_m
        return replace(law, exponent=self.exponent, reference_depth_m=depth_m)
