"""Supports at other positions than the nominal ones."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, TypeVar

from msgspec.structs import replace

from rig.effects.base import Effect, Scale
from rig.model.description import PointSpring, Rig, Station, Support
from rig.model.parameters import Parameter, ParameterSet

SupportOrSpring = TypeVar("SupportOrSpring", Support, PointSpring)
MAX_SHIFT_SHARE = 0.1
"""Largest shift, as a share of the body's length."""


class SupportPosition(Effect, frozen=True):
    """The supports of a body, or the springs that hold it, stand `shift_m` farther along it than believed."""

    name: ClassVar[str] = "support_position"
    words: ClassVar[str] = "a support of {body} that stands {shift_m}"
    signed_words: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "shift_m": ("nearer to the left end", "farther from the left end", "elsewhere")
    }
    separating_test: ClassVar[str] = "measure where the supports stand"
    shift_m: Annotated[float, Parameter("m", -0.05, 0.05, 0.0)] = 0.01
    body: str | None = None

    @classmethod
    def parameters(cls, scale: Scale) -> ParameterSet:
        """Up to a tenth of the body, either way, as far as every support stays on it."""
        body_name = cls(body=scale.place.get("body")).supported_body(scale.rig)
        length_m = scale.rig.body(body_name).length_m
        positions_m = [support.station.position_m for support in _supports_or_springs(scale.rig, body_name)]
        max_shift_m = MAX_SHIFT_SHARE * length_m
        return cls.with_ranges(
            shift_m=(max(-max_shift_m, -min(positions_m)), min(max_shift_m, length_m - max(positions_m)))
        )

    @classmethod
    def typical(cls, scale: Scale) -> Effect:
        """A hundredth of the body, towards the side with more room."""
        shift_parameter = cls.parameters(scale)["shift_m"]
        return cls.placed(
            scale,
            shift_m=MAX_SHIFT_SHARE
            * (shift_parameter.high if shift_parameter.high >= -shift_parameter.low else shift_parameter.low),
        )

    @classmethod
    def placements(cls, rig: Rig, sensors: Sequence[str]) -> list[dict[str, str | None]]:
        """Every body that supports or springs hold along its length."""
        del sensors
        return [{"body": body.name} for body in rig.bodies if body.length_m and _supports_or_springs(rig, body.name)]

    @classmethod
    def stations_on(cls, rig: Rig, body_name: str) -> tuple[Station, ...]:
        """Stations of the supports or springs that hold the body."""
        return tuple(support.station for support in _supports_or_springs(rig, body_name))

    def supported_body(self, rig: Rig) -> str:
        """Name of the body, by default the first that is supported; raises RigError if there is none."""
        for place in self.placements(rig, ()):
            if self.body in (None, place["body"]):
                return str(place["body"])
        raise self.missing_place_error(
            rig, "support or spring along a body" if self.body is None else f"support or spring along {self.body!r}"
        )

    def applied_to(self, rig: Rig) -> Rig:
        shifted_supports = _supports_or_springs(rig, self.supported_body(rig))
        return replace(
            rig,
            supports=tuple(
                self._shifted(support) if support in shifted_supports else support for support in rig.supports
            ),
            springs=tuple(self._shifted(spring) if spring in shifted_supports else spring for spring in rig.springs),
        )

    def _shifted(self, support: SupportOrSpring) -> SupportOrSpring:
        station = support.station
        return replace(support, station=Station(station.body, station.position_m + self.shift_m))


def _supports_or_springs(rig: Rig, body_name: str) -> Sequence[Support | PointSpring]:
    """Supports of a body; its springs where it has none."""
    supports = [support for support in rig.supports if support.station.body == body_name]
    return supports or [spring for spring in rig.springs if spring.station.body == body_name]
