"""Linear spring between a body and the ground, added or missing."""

from typing import Annotated, ClassVar

import numpy as np
from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointSpring, Rig
from rig.model.modes import modes_of
from rig.model.parameters import Parameter, ParameterSet

MAX_MISSING_SHARE = 0.9
"""Largest share of a body's stiffness that may be missing."""


class LinearSpring(Effect, frozen=True):
    """A linear spring between a body and the ground is there beside what is believed, or (negative) is missing."""

    name: ClassVar[str] = "linear_spring"
    words: ClassVar[str] = "a spring of {stiffness_n_per_m} between {body}{at} and the ground"
    separating_test: ClassVar[str] = "fix a known mass to the body: a spring and a mass shift its modes differently"
    stiffness_n_per_m: Annotated[float, Parameter("N/m", 0.0, 1e4, 0.0)] = 500.0
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Nearly all of the body's stiffness at its middling point missing, up to five times that at its softest.

        What takes more than there is at a place makes no rig. Of a body that floats, from nothing up to the exciting
        force over how far it moves.
        """
        scale_n_per_m = _stiffness_scale_n_per_m(scale)
        lowest_n_per_m = -MAX_MISSING_SHARE * scale.stiffness_n_per_m(np.median) if scale.is_supported() else 0.0
        return cls.with_ranges_along_body(
            scale, stiffness_n_per_m=(lowest_n_per_m, 5 * scale_n_per_m if scale.is_supported() else scale_n_per_m)
        )

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, stiffness_n_per_m=0.05 * _stiffness_scale_n_per_m(scale))

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        spring = PointSpring(station=station, stiffness_n_per_m=self.stiffness_n_per_m)
        rig_with_spring = replace(rig, springs=(*rig.springs, spring))
        if self.stiffness_n_per_m < 0:
            modes_of(rig_with_spring, rig_with_spring.body(station.body))  # refuses what is more than holds the body
        return rig_with_spring


def _stiffness_scale_n_per_m(scale: Scale) -> float:
    return scale.stiffness_n_per_m() if scale.is_supported() else scale.force_rms_n / scale.displacement_m()
