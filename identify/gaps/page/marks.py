"""Marks of a diagnosis on the drawing of the rig: the named effects, and the unmeasured force, each at its place."""

from collections.abc import Iterator

from identify.gaps.decision_table import Verdict
from identify.gaps.residual.unfolding import IN_Z
from identify.gaps.results import Gap
from identify.gaps.wording import MIN_DESCRIPTION_SHARE, MIN_HINT_SHARE
from identify.pages.machine import DrawnMark
from identify.pages.wording import change_words, estimate_words, number, percent
from rig.model.description import Rig, Station
from rig.model.layout import station_named

UNLOCATED_VERDICTS = {Verdict.CONSISTENT, Verdict.CANNOT_TELL}
"""Verdicts that locate no difference."""


def marks(gap: Gap, rig: Rig) -> tuple[DrawnMark, ...]:
    """Marks of what the verdict names and of what stays unexplained, where that is certain, and of dead channels.

    The ground, on which a sensor may stand, has no place in the drawing.
    """
    located_marks = () if gap.verdict in UNLOCATED_VERDICTS else (*_effect_marks(gap, rig), *_force_marks(gap, rig))
    return tuple(mark for mark in (*located_marks, *_channel_marks(gap, rig)) if not rig.is_on_ground(mark.station))


def _channel_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of channels that were left out."""
    for channel_name, fault in gap.channel_faults.items():
        if station := station_named(rig, channel_name):
            yield DrawnMark(station, f"{channel_name} is {fault}")


def _effect_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the named effects of the likeliest cause, the first of several contacts with words.

    An effect of the whole rig has none. One with which the rig predicts no better is doubtful.
    """
    is_doubtful = gap.evidence.vetoed and gap.verdict == Verdict.UNEXPLAINED
    for cause in gap.causes[:1]:
        for label, effect_words, strength in zip(cause.labels, cause.words, cause.strengths, strict=True):
            if not strength.is_named:
                continue
            position_share = cause.parameters.get(f"{label}.relative_position")
            names = [name.removesuffix(IN_Z) for key, name in cause.places.items() if key.partition(".")[0] == label]
            of_whole_body = position_share is None and any(body.name in names and body.length_m for body in rig.bodies)
            length_share = 0.5 if position_share is None else position_share.value
            station = next(filter(None, (station_named(rig, name, length_share) for name in names)), None)
            is_on_all = cause.places.get(f"{label}.contact") == "all"
            stations = [station] if station else [contact.at for contact in rig.contacts if is_on_all]
            for index, station in enumerate(stations):
                words = "likewise" if index else f"{'doubtful: ' * is_doubtful}{effect_words}"
                yield DrawnMark(station, words, of_whole_body=of_whole_body)


def _force_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the unmeasured force that describes the rest: at its place, its channel, its contact or its bodies.

    None where it explains as little as in null simulations; a hint where it explains less than half.
    """
    unknown = gap.unknown
    if unknown is None or unknown.explained < MIN_HINT_SHARE:
        return
    is_hint = unknown.explained < MIN_DESCRIPTION_SHARE
    hint = f"a hint (explains {percent(unknown.explained)}): " * is_hint
    if (name := unknown.contact or unknown.sensor) and (station := station_named(rig, name)):
        fault = "clearance that swings" if unknown.contact else "fault of the sensor"
        yield DrawnMark(station, f"{hint}{name}: {fault}", is_hint)
    for body_name, growth in unknown.growth.items():
        change = change_words(growth.value, growth.standard_error)
        middle = Station(body_name, rig.body(body_name).length_m / 2)
        words = f"{hint}stiffness of the {body_name} changes by {change}"
        yield DrawnMark(middle, words, is_hint, of_whole_body=True)
    against = None
    if unknown.against_body is not None and unknown.against_position_m is not None:
        against = Station(unknown.against_body, unknown.against_position_m)
    if unknown.body is not None and unknown.position_m is not None:
        force_words = "unmeasured pair of forces" if against else "unmeasured force"
        position_words = estimate_words(
            unknown.position_m, unknown.position_error_m or 0.0, "m", f"{unknown.position_m:.2f} m"
        )
        place_words = "" if rig.body(unknown.body).is_mass else f", near {position_words}"
        size_words = f"{hint}{force_words}, {number(unknown.rms_n, 3)} N rms{place_words}"
        yield DrawnMark(Station(unknown.body, unknown.position_m), size_words, is_hint)
    if against:
        yield DrawnMark(against, "its opposite", is_hint)
