"""Supports that stand elsewhere."""

from collections.abc import Sequence
from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointSpring, Rig, Station
from rig.model.parameters import Parameter, ParameterSet

LARGEST_SHIFT_SHARE = 0.1
"""Largest shift, as a share of the body's length."""


class SupportPosition(Effect, frozen=True):
    """The springs that support a body stand `shift_m` farther along it than believed."""

    name: ClassVar[str] = "support_position"
    words: ClassVar[str] = "a support of {body} that stands {shift_m} farther along"
    separated_by: ClassVar[str] = "measure where the supports stand"
    shift_m: Annotated[float, Parameter("m", -0.05, 0.05, 0.0)] = 0.01
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to a tenth of the body, either way, as far as every support stays on it."""
        body_name = cls(body=scale.place.get("body")).supported_body(scale.rig)
        length_m = scale.rig.body(body_name).length_m
        positions_m = [spring.station.position_m for spring in _supporting_springs(scale.rig, body_name)]
        most_m = LARGEST_SHIFT_SHARE * length_m
        return cls.ranged(shift_m=(max(-most_m, -min(positions_m)), min(most_m, length_m - max(positions_m))))

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        """A hundredth of the body, towards the side with more room."""
        shift_range = cls.parameters(scale)["shift_m"]
        return cls.placed(
            scale,
            shift_m=LARGEST_SHIFT_SHARE
            * (shift_range.high if shift_range.high >= -shift_range.low else shift_range.low),
        )

    @classmethod
    def placements(cls, rig: Rig, sensors: Sequence[str]) -> list[dict[str, str | None]]:
        """Every body that springs support along its length."""
        del sensors
        return [{"body": body.name} for body in rig.bodies if body.length_m and _supporting_springs(rig, body.name)]

    def supported_body(self, rig: Rig) -> str:
        """Name of the body, by default the first that springs support; raises RigError if there is none."""
        for place in self.placements(rig, ()):
            if self.body in (None, place["body"]):
                return str(place["body"])
        raise self.missing_place(rig, "spring along a body" if self.body is None else f"spring along {self.body!r}")

    def applied_to(self, rig: Rig) -> Rig:
        body_name = self.supported_body(rig)
        return replace(
            rig, springs=tuple(self._shifted_spring(s) if s.station.body == body_name else s for s in rig.springs)
        )

    def _shifted_spring(self, spring: PointSpring) -> PointSpring:
        return replace(spring, station=Station(spring.station.body, spring.station.position_m + self.shift_m))


def _supporting_springs(rig: Rig, body_name: str) -> list[PointSpring]:
    return [spring for spring in rig.springs if spring.station.body == body_name]
