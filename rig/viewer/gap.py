"""What `identify gap` found, as gap.json says it: where the named effects and the unmeasured force act, and when."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from rig.errors import RigError
from rig.files import contents
from rig.model.description import Rig, Station

NAMED = {"explained", "partly_explained"}
"""Verdicts that name effects."""


class _Number(msgspec.Struct, frozen=True):
    value: float
    unit: str
    instead: str = ""


class _Cause(msgspec.Struct, frozen=True):
    effects: tuple[str, ...]
    parameters: dict[str, _Number]
    places: dict[str, str]


class _Unknown(msgspec.Struct, frozen=True):
    sentence: str
    when: str
    rms_n: float
    body: str | None = None
    position_m: float | None = None
    against_body: str | None = None
    against_position_m: float | None = None
    sensor: str | None = None
    contact: str | None = None
    by_time: tuple[float, ...] = ()


class _Share(msgspec.Struct, frozen=True):
    what: str
    share: float


class _Attribution(msgspec.Struct, frozen=True):
    positions_m: dict[str, dict[str, float]]
    contact_state: dict[str, float]
    time_s: tuple[_Share, ...]


class _Gap(msgspec.Struct, frozen=True):
    verdict: str
    sentence: str
    causes: tuple[_Cause, ...]
    attribution: _Attribution
    unknown: _Unknown | None = None


@dataclass(frozen=True)
class Mark:
    """Something that acts at a place: its words, its strength in equal parts of the time, and whether in contact only.

    The strengths are relative to the largest; always the same where there is one.
    """

    place: Station
    words: str
    strengths: tuple[float, ...] = (1.0,)
    in_contact: bool = False


@dataclass(frozen=True)
class ShownGap:
    """A diagnosis as it is drawn: its text, marks on the bodies, and the shares of the gap by station and by time.

    spans are begin, end (s) and share of the gap.
    """

    text: str
    marks: tuple[Mark, ...]
    shares: dict[Station, float]
    spans: tuple[tuple[float, float, float], ...]


def read_gap(path: Path, rig: Rig, duration_s: float) -> ShownGap:
    """The gap.json, or that of its folder.

    Raises RigError if it cannot be read, is no gap.json, or names a place that the rig or a time that the record lacks.
    """
    file = path / "gap.json" if path.is_dir() else path
    try:
        report = msgspec.json.decode(contents(file), type=_Gap)
        spans = tuple((*_span(part.what), part.share) for part in report.attribution.time_s)
        shares = {
            Station(body, float(x)): share
            for body, places in report.attribution.positions_m.items()
            for x, share in places.items()
        }
        if not all(0 <= share <= 1.001 for share in (*shares.values(), *(share for *_, share in spans))):
            raise ValueError("a share is not within 0 to 1")
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise RigError(f"{file}: is no gap.json ({error}); make one by `identify gap`") from error
    marks = (*_of_effects(report, rig), *_of_force(report, rig))
    lengths_m = {b.name: b.length_m for b in rig.bodies}
    for place in (*shares, *(m.place for m in marks)):
        if not 0 <= place.position_m <= lengths_m.get(place.body, -1.0) + 1e-6:
            raise RigError(
                f"{file}: has {place.position_m:g} m on {place.body!r}, which the rig lacks; take its own file"
            )
    if any(end > duration_s for _, end, _ in spans):
        raise RigError(f"{file}: is of a record longer than {duration_s:g} s; show the one that validates")
    return ShownGap(_text(report), marks, shares if report.verdict != "no_gap" else {}, spans)


def _span(what: str) -> tuple[float, float]:
    begin, _, end = what.partition(" to ")
    return float(begin), float(end)


def _of_effects(report: _Gap, rig: Rig) -> Iterator[Mark]:
    """The effects of the likeliest cause that act somewhere, where it explains the gap."""
    if report.verdict not in NAMED or not report.causes:
        return
    cause = report.causes[0]
    for effect in cause.effects:
        own = {n.partition(".")[2]: v for n, v in cause.parameters.items() if n.partition(".")[0] == effect}
        along = own.pop("relative_position", None)
        numbers = [f"{v.value:.3g} {v.unit}".removesuffix(" 1") for v in own.values() if not v.instead]
        for name, place in cause.places.items():
            at = _station(rig, place, 0.5 if along is None else along.value)
            if name.partition(".")[0] == effect and at is not None:
                yield Mark(at, " ".join([effect, *numbers]))


def _of_force(report: _Gap, rig: Rig) -> Iterator[Mark]:
    found = report.unknown
    if found is None or report.verdict == "no_gap":
        return
    words = f"unmeasured force, {found.rms_n:.3g} N rms, {found.when}"
    largest = max(found.by_time, default=0.0)
    strengths = tuple(one / largest for one in found.by_time) if largest > 0 else (1.0,)
    named = found.contact or found.sensor
    if named is not None:
        place = _station(rig, named, 0.5)
        what = "clearance that swings" if found.contact else "fault of the sensor"
        if place is not None:
            yield Mark(place, f"{named}: {what}", strengths)
        return
    both = ((found.body, found.position_m, words), (found.against_body, found.against_position_m, "its opposite"))
    for body, x, what in both:
        place = None if body is None else Station(body, x) if x is not None else _station(rig, body, 0.5)
        if place is not None:
            yield Mark(place, what, strengths, in_contact=found.when == "in contact")


def _station(rig: Rig, name: str, along: float) -> Station | None:
    """Of a contact, a sensor, or a body at a share of its length; None of what is everywhere."""
    named = {b.name: Station(b.name, along * b.length_m) for b in rig.bodies}
    named |= {s.name: s.station for s in rig.sensors} | {c.name: c.at for c in rig.contacts}
    return named.get(name)


def _text(report: _Gap) -> str:
    """In Markdown: the verdict's sentence, the unmeasured force's, and the contacts' state in which the gap lies."""
    states = ", ".join(f"{100 * share:.0f} % {state}" for state, share in report.attribution.contact_state.items())
    return "\n\n".join(
        [
            f"**{report.verdict.replace('_', ' ').capitalize()}**",
            report.sentence,
            *([report.unknown.sentence] if report.unknown else []),
            *([f"Of the gap: {states}."] if states and report.verdict != "no_gap" else []),
        ]
    )
