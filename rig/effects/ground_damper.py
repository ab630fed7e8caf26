"""Viscous damper between a body and the ground."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointDamper, Rig
from rig.model.parameters import Parameter, ParameterSet


class GroundDamper(Effect, frozen=True):
    """A viscous damper stands between a body and the ground, at this share of its length."""

    name: ClassVar[str] = "ground_damper"
    words: ClassVar[str] = "a damper of {damping_n_s_per_m} between {body}{at} and the ground"
    separating_test: ClassVar[str] = "record free decays: a damper at a place damps modes by their motion there"
    damping_n_s_per_m: Annotated[float, Parameter("N s/m", 0.0, 200.0, 0.0)] = 2.0
    relative_position: Annotated[float, Parameter("1", 0.0, 1.0)] = 1.0
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to critical: twice the root of the body's stiffness at its softest point and its mass."""
        return cls.with_ranges_along_body(scale, damping_n_s_per_m=(0.0, _critical_damping_n_s_per_m(scale)))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        return cls.placed(scale, damping_n_s_per_m=0.02 * _critical_damping_n_s_per_m(scale))

    def applied_to(self, rig: Rig) -> Rig:
        station = self.station(rig, self.body, self.relative_position)
        return replace(
            rig, dampers=(*rig.dampers, PointDamper(station=station, damping_n_s_per_m=self.damping_n_s_per_m))
        )


def _critical_damping_n_s_per_m(scale: Scale) -> float:
    return float(2 * (scale.stiffness_n_per_m() * scale.mass_kg()) ** 0.5)
