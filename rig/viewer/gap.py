"""Results of `identify gap`, by gap.json: where the named effects and the unmeasured force act, and when."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec

from rig.errors import RigError
from rig.files import contents
from rig.limits import decoded_result
from rig.model.description import Rig, Station, read_rig
from rig.model.layout import station_named
from rig.model.unmeasured_force import UnmeasuredForce, Value

EFFECT_VERDICTS = {"explained", "partly_explained", "small"}
"""Verdicts that name effects."""
UNLOCATED_VERDICTS = {"consistent", "cannot_tell"}
"""Verdicts that locate no difference."""


class _Cause(msgspec.Struct, frozen=True):
    effects: tuple[str, ...]
    words: tuple[str, ...]
    parameters: dict[str, Value]
    places: dict[str, str]


class _Share(msgspec.Struct, frozen=True):
    begin: float
    end: float
    share: float


class _Attribution(msgspec.Struct, frozen=True):
    positions_m: dict[str, dict[float, float]]
    contact_state: dict[str, float]
    time_s: tuple[_Share, ...]


class _Rollout(msgspec.Struct, frozen=True):
    horizon_s: float = 0.0


class _Gap(msgspec.Struct, frozen=True):
    verdict: str
    sentence: str
    causes: tuple[_Cause, ...]
    attribution: _Attribution
    rollout: _Rollout | None = None
    unknown: UnmeasuredForce | None = None


@dataclass(frozen=True)
class Mark:
    """Mark of an effect or force at a place, with its strength over time and whether it acts in contact only.

    The strengths, relative to the largest, are those of equal parts of the time; a single one is constant.
    """

    place: Station
    words: str
    strengths: tuple[float, ...] = (1.0,)
    in_contact: bool = False


@dataclass(frozen=True)
class ShownGap:
    """Diagnosis as drawn: its text, marks on the bodies, and the mismatch by station and over time.

    spans are start and end (s) and share of the mismatch. horizon_s is how long null simulations can be predicted,
    zero where that is not known.
    """

    text: str
    marks: tuple[Mark, ...]
    shares: dict[Station, float]
    spans: tuple[tuple[float, float, float], ...]
    horizon_s: float = 0.0


def read_gap(path: Path, rig: Rig, duration_s: float) -> ShownGap:
    """Read a gap.json, given by its path or folder.

    Raises RigError if it is unreadable or invalid, or names a place or time outside the rig or the record.
    """
    file = path / "gap.json" if path.is_dir() else path
    report = _decoded(file)
    attribution = report.attribution
    spans = tuple((interval.begin, interval.end, interval.share) for interval in attribution.time_s)
    shares = {
        Station(body, x): share for body, places in attribution.positions_m.items() for x, share in places.items()
    }
    marks = (*_of_effects(report, rig), *_of_force(report, rig))
    _check_places(file, rig, (*shares, *(m.place for m in marks)))
    if any(end_s > duration_s for _, end_s, _ in spans):
        raise RigError(f"{file}: is of a record longer than {duration_s:g} s; show the one that validates")
    horizon_s = report.rollout.horizon_s if report.rollout else 0.0
    if report.verdict in UNLOCATED_VERDICTS:
        shares = {}
    return ShownGap(_text(report), marks, shares, spans, horizon_s if 0 < horizon_s <= duration_s else 0.0)


def read_corrected(path: Path, rig: Rig) -> Rig | None:
    """Corrected rig.json beside a gap.json, given by its path or folder; None if there is none.

    Raises RigError if it is unreadable or invalid, or of a rig with other bodies, contacts or forces.
    """
    file = (path if path.is_dir() else path.parent) / "rig.json"
    if not file.exists():
        return None
    corrected = read_rig(file)
    names = [([b.name for b in r.bodies], [c.name for c in r.contacts], r.forces) for r in (corrected, rig)]
    if names[0] != names[1] or corrected.sample_rate_hz != rig.sample_rate_hz:
        raise RigError(f"{file}: is of another rig than the recording; take the folder of its own diagnosis")
    return corrected


def _decoded(file: Path) -> _Gap:
    report = decoded_result(contents(file), _Gap, str(file), "gap.json", "make one by `identify gap`")
    attribution = report.attribution
    by_station = (share for places in attribution.positions_m.values() for share in places.values())
    if not all(0 <= share <= 1.001 for share in (*by_station, *(interval.share for interval in attribution.time_s))):
        raise RigError(f"{file}: is no gap.json (a share is not within 0 to 1); make one by `identify gap`")
    return report


def _check_places(file: Path, rig: Rig, places: Iterable[Station]) -> None:
    lengths_m = {b.name: b.length_m for b in rig.bodies}
    for place in places:
        if not 0 <= place.position_m <= lengths_m.get(place.body, -1.0) + 1e-6:
            raise RigError(
                f"{file}: has {place.position_m:g} m on {place.body!r}, which the rig lacks; take its own file"
            )


def _of_effects(report: _Gap, rig: Rig) -> Iterator[Mark]:
    """Marks of the localised effects of the likeliest cause, if the verdict names effects."""
    if report.verdict not in EFFECT_VERDICTS or not report.causes:
        return
    cause = report.causes[0]
    occurrences = Counter[str]()
    for effect, words in zip(cause.effects, cause.words, strict=True):
        occurrences[effect] += 1
        label = effect if occurrences[effect] == 1 else f"{effect}_{occurrences[effect]}"
        position = cause.parameters.get(f"{label}.relative_position")
        for name, place in cause.places.items():
            station = station_named(rig, place, 0.5 if position is None else position.value)
            if name.partition(".")[0] == label and station is not None:
                yield Mark(station, words)


def _of_force(report: _Gap, rig: Rig) -> Iterator[Mark]:
    force = report.unknown
    if force is None or report.verdict in UNLOCATED_VERDICTS:
        return
    largest = max(force.by_time, default=0.0)
    strengths = tuple(rms / largest for rms in force.by_time) if largest > 0 else (1.0,)
    if named := force.contact or force.sensor:
        label = "clearance that swings" if force.contact else "fault of the sensor"
        if place := station_named(rig, named, 0.5):
            yield Mark(place, f"{named}: {label}", strengths)
        return
    words = f"unmeasured force, {force.rms_n:.3g} N rms, {force.when}"
    force_ends = [(force.body, force.position_m, words), (force.against_body, force.against_position_m, "its opposite")]
    for body, x, label in force_ends:
        if body is not None and x is not None:
            yield Mark(Station(body, x), label, strengths, in_contact=force.when == "in contact")


def _text(report: _Gap) -> str:
    """Markdown text: verdict, its sentence, that of the unmeasured force, and the mismatch by contact state."""
    states = ", ".join(f"{100 * share:.0f} % {state}" for state, share in report.attribution.contact_state.items())
    return "\n\n".join(
        [
            f"**{report.verdict.replace('_', ' ').capitalize()}**",
            report.sentence,
            *([report.unknown.sentence] if report.unknown else []),
            *([f"Of the gap: {states}."] if states and report.verdict not in UNLOCATED_VERDICTS else []),
        ]
    )
