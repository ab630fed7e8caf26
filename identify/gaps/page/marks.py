"""Marks of a diagnosis on the drawing of the rig: the named effects, and the unmeasured force, each at its place."""

from collections.abc import Iterator

from identify.gaps.decision_table import Verdict
from identify.gaps.residual.unfolding import IN_Z
from identify.gaps.results import Gap
from identify.gaps.wording import DESCRIPTION_EXPLAINED, HINT_EXPLAINED
from identify.pages.machine import DrawnMark
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
            position_share = cause.parameters.get(f"{label}.relative_position")
            effect_stations = (
                station_named(rig, place.removesuffix(IN_Z), 0.5 if position_share is None else position_share.value)
                for place_label, place in cause.places.items()
                if place_label.partition(".")[0] == label
            )
            station = next(filter(None, effect_stations), None)
            stations = [contact.at for contact in rig.contacts] if cause.places.get(f"{label}.contact") == "all" else []
            if strength.is_named:
                for index, marked_station in enumerate([station] if station is not None else stations):
                    yield DrawnMark(
                        marked_station, "likewise" if index else f"{'doubtful: ' * is_doubtful}{effect_words}"
                    )


def _force_marks(gap: Gap, rig: Rig) -> Iterator[DrawnMark]:
    """Marks of the unmeasured force that describes the rest: at its place, its channel, its contact or its bodies.

    None where it explains as little as in null simulations; a hint where it explains less than half.
    """
    unmeasured_force = gap.unknown
    if unmeasured_force is None or unmeasured_force.explained < HINT_EXPLAINED:
        return
    hint_words = "a hint: " * (unmeasured_force.explained < DESCRIPTION_EXPLAINED)
    if (contact_or_sensor := unmeasured_force.contact or unmeasured_force.sensor) and (
        station := station_named(rig, contact_or_sensor)
    ):
        fault_words = "clearance that swings" if unmeasured_force.contact else "fault of the sensor"
        yield DrawnMark(station, f"{hint_words}{contact_or_sensor}: {fault_words}")
    for body_name, growth in unmeasured_force.growth.items():
        yield DrawnMark(
            Station(body_name, rig.body(body_name).length_m / 2),
            f"{hint_words}stiffness of the {body_name} changes by {100 * growth.value:+.2g} %",
        )
    if unmeasured_force.body is not None and unmeasured_force.position_m is not None:
        is_pair = unmeasured_force.against_body is not None and unmeasured_force.against_position_m is not None
        force_words = "unmeasured pair of forces" if is_pair else "unmeasured force"
        place_words = "" if rig.body(unmeasured_force.body).is_mass else f", near {unmeasured_force.position_m:.2f} m"
        yield DrawnMark(
            Station(unmeasured_force.body, unmeasured_force.position_m),
            f"{hint_words}{force_words}, {unmeasured_force.rms_n:.3g} N rms{place_words}",
        )
    if unmeasured_force.against_body is not None and unmeasured_force.against_position_m is not None:
        yield DrawnMark(Station(unmeasured_force.against_body, unmeasured_force.against_position_m), "its opposite")
