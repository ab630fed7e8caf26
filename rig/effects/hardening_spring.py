"""Cubic spring between a body and the ground."""

from typing import Annotated, ClassVar

import numpy as np
from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointSpring, Rig
from rig.model.parameters import Parameter, ParameterSet


class HardeningSpring(Effect, frozen=True):
    """A force in the cube of the displacement holds a body to the ground; where it is negative, the support softens."""

    name: ClassVar[str] = "hardening_spring"
    words: ClassVar[str] = "a cubic spring of {cubic_n_per_m3} between {body}{at} and the ground"
    follows_level: ClassVar[bool] = True
    separating_test: ClassVar[str] = "record at two levels: a hardening spring grows with the cube"
    cubic_n_per_m3: Annotated[float, Parameter("N/m^3", -1e8, 1e8, 0.0)] = 1e6
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to the exciting force's root mean square where the body moves about as far as its middling point does.

        Downwards, of a body that is held, only as far as its stiffness there at such a displacement stays positive.
        """
        displacement_m = scale.displacement_m(np.median)
        highest_n_per_m3 = scale.force_rms_n / displacement_m**3
        softest_n_per_m3 = (
            min(highest_n_per_m3, scale.stiffness_n_per_m(np.median) / (3 * displacement_m**2))
            if scale.is_supported()
            else highest_n_per_m3
        )
        return cls.with_ranges_along_body(scale, cubic_n_per_m3=(-softest_n_per_m3, highest_n_per_m3))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, cubic_n_per_m3=0.01 * scale.force_rms_n / scale.displacement_m() ** 3)

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(rig, springs=(*rig.springs, PointSpring(station=station, cubic_n_per_m3=self.cubic_n_per_m3)))
