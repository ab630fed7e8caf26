"""Marks of a diagnosis on the drawing of the rig: the named effects, and the unmeasured force, each at its place."""

from collections.abc import Iterator

from identify.gaps.decision_table import Verdict
from identify.gaps.results import Gap
from identify.gaps.wording import interval
from identify.pages.machine import DrawnMark
from rig.model.description import Rig, Station
from rig.model.layout import station_named
from rig.model.unmeasured_force import Value

UNLOCATED = {Verdict.CONSISTENT, Verdict.CANNOT_TELL}
"""Verdicts that locate no difference."""


def marks(gap: Gap, rig: Rig) -> tuple[DrawnMark, ...]:
    """Marks of what the verdict names and of what stays unexplained, where that is certain, and of dead channels."""
    located = () if gap.verdict in UNLOCATED else (*_effect_marks(gap, rig), *_force_marks(gap, rig))
    return (*located, *_channel_marks(gap, rig))


def _channel_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of channels that were left out."""
    for name, fault in gap.channel_faults.items():
        if station := station_named(rig, name):
            yield DrawnMark(station, f"{name} is {fault}")


def _effect_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the named effects of the likeliest cause; an effect of the whole rig has none."""
    for cause in gap.causes[:1]:
        for label, words, strength in zip(cause.labels, cause.words, cause.strengths, strict=True):
            position = cause.parameters.get(f"{label}.relative_position")
            stations = (
                station_named(rig, place, 0.5 if position is None else position.value)
                for name, place in cause.places.items()
                if name.partition(".")[0] == label
            )
            station = next(filter(None, stations), None)
            if strength.is_named and station is not None:
                yield DrawnMark(station, words)


def _force_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the unmeasured force that describes the rest: at its place, its channel, its contact or its bodies."""
    force = gap.unknown
    if force is None:
        return
    if (name := force.contact or force.sensor) and (station := station_named(rig, name)):
        yield DrawnMark(station, f"{name}: {'clearance that swings' if force.contact else 'fault of the sensor'}")
    for body, growth in force.growth.items():
        yield DrawnMark(
            Station(body, rig.body(body).length_m / 2), f"stiffness of {body} changes by {interval(growth)}"
        )
    if force.body is not None and force.position_m is not None:
        pair = force.against_body is not None and force.against_position_m is not None
        position = interval(Value(force.position_m, force.position_error_m or 0.0, "m"))
        words = "unmeasured pair of forces" if pair else "unmeasured force"
        yield DrawnMark(Station(force.body, force.position_m), f"{words}, {force.rms_n:.3g} N rms, at {position}")
    if force.against_body is not None and force.against_position_m is not None:
        yield DrawnMark(Station(force.against_body, force.against_position_m), "its opposite")
