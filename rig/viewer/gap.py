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


class _ShareInterval(msgspec.Struct, frozen=True):
    begin: float
    end: float
    share: float


class _Attribution(msgspec.Struct, frozen=True):
    positions_m: dict[str, dict[float, float]]
    contact_state: dict[str, float]
    time_s: tuple[_ShareInterval, ...]


class _Rollout(msgspec.Struct, frozen=True):
    horizon_s: float = 0.0


class _GapReport(msgspec.Struct, frozen=True):
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

    station: Station
    words: str
    strengths: tuple[float, ...] = (1.0,)
    in_contact: bool = False


@dataclass(frozen=True)
class ShownGap:
    """Diagnosis as drawn: its text, marks on the bodies, and the mismatch by station and over time.

    share_spans are start and end (s) and share of the mismatch. horizon_s is how long null simulations can be
    predicted, zero where that is not known.
    """

    text: str
    marks: tuple[Mark, ...]
    share_by_station: dict[Station, float]
    share_spans: tuple[tuple[float, float, float], ...]
    horizon_s: float = 0.0


def read_gap(path: Path, rig: Rig, duration_s: float) -> ShownGap:
    """Read a gap.json, given by its path or folder.

    Raises RigError if it is unreadable or invalid, or names a place or time outside the rig or the record.
    """
    gap_path = path / "gap.json" if path.is_dir() else path
    report = _decode_gap(gap_path)
    attribution = report.attribution
    share_spans = tuple((interval.begin, interval.end, interval.share) for interval in attribution.time_s)
    share_by_station = {
        Station(body_name, position_m): mismatch_share
        for body_name, share_by_position in attribution.positions_m.items()
        for position_m, mismatch_share in share_by_position.items()
    }
    marks = (*_effect_marks(report, rig), *_unmeasured_force_marks(report, rig))
    _check_places(gap_path, rig, (*share_by_station, *(mark.station for mark in marks)))
    if any(end_s > duration_s for _, end_s, _ in share_spans):
        raise RigError(f"{gap_path}: is of a record longer than {duration_s:g} s; show the one that validates")
    horizon_s = report.rollout.horizon_s if report.rollout else 0.0
    if report.verdict in UNLOCATED_VERDICTS:
        share_by_station = {}
    return ShownGap(
        _markdown_text(report), marks, share_by_station, share_spans, horizon_s if 0 < horizon_s <= duration_s else 0.0
    )


def read_corrected_rig(path: Path, rig: Rig) -> Rig | None:
    """Corrected rig.json beside a gap.json, given by its path or folder; None if there is none.

    Raises RigError if it is unreadable or invalid, or of a rig with other bodies, contacts or forces.
    """
    rig_path = (path if path.is_dir() else path.parent) / "rig.json"
    if not rig_path.exists():
        return None
    corrected_rig = read_rig(rig_path)

    def compared_properties(compared_rig: Rig) -> tuple[object, ...]:
        name_lists = [body.name for body in compared_rig.bodies], [contact.name for contact in compared_rig.contacts]
        return *name_lists, compared_rig.forces, compared_rig.sample_rate_hz

    if compared_properties(corrected_rig) != compared_properties(rig):
        raise RigError(f"{rig_path}: is of another rig than the recording; take the folder of its own diagnosis")
    return corrected_rig


def _decode_gap(gap_path: Path) -> _GapReport:
    report = decoded_result(contents(gap_path), _GapReport, str(gap_path), "gap.json", "make one by `identify gap`")
    shares = [interval.share for interval in report.attribution.time_s]
    shares += [share for shares_of_body in report.attribution.positions_m.values() for share in shares_of_body.values()]
    if not all(0 <= share <= 1.001 for share in shares):
        raise RigError(f"{gap_path}: is no gap.json (a share is not within 0 to 1); make one by `identify gap`")
    return report


def _check_places(gap_path: Path, rig: Rig, stations: Iterable[Station]) -> None:
    length_by_body_m = {body.name: body.length_m for body in rig.bodies}
    for station in stations:
        if not 0 <= station.position_m <= length_by_body_m.get(station.body, -1.0) + 1e-6:
            raise RigError(
                f"{gap_path}: has {station.position_m:g} m on {station.body!r}, which the rig lacks; take its own file"
            )


def _effect_marks(report: _GapReport, rig: Rig) -> Iterator[Mark]:
    """Marks of the localised effects of the likeliest cause, if the verdict names effects."""
    if report.verdict not in EFFECT_VERDICTS or not report.causes:
        return
    cause = report.causes[0]
    effect_counts = Counter[str]()
    for effect, words in zip(cause.effects, cause.words, strict=True):
        effect_counts[effect] += 1
        effect_label = effect if effect_counts[effect] == 1 else f"{effect}_{effect_counts[effect]}"
        position_parameter = cause.parameters.get(f"{effect_label}.relative_position")
        for field_name, place_name in cause.places.items():
            station = station_named(rig, place_name, 0.5 if position_parameter is None else position_parameter.value)
            if field_name.partition(".")[0] == effect_label and station is not None:
                yield Mark(station, words)


def _unmeasured_force_marks(report: _GapReport, rig: Rig) -> Iterator[Mark]:
    force = report.unknown
    if force is None or report.verdict in UNLOCATED_VERDICTS:
        return
    largest_rms_n = max(force.by_time, default=0.0)
    strengths = tuple(rms_n / largest_rms_n for rms_n in force.by_time) if largest_rms_n > 0 else (1.0,)
    if owner_name := force.contact or force.sensor:
        mark_words = "clearance that swings" if force.contact else "fault of the sensor"
        if station := station_named(rig, owner_name, 0.5):
            yield Mark(station, f"{owner_name}: {mark_words}", strengths)
        return
    words = f"unmeasured force, {force.rms_n:.3g} N rms, {force.when}"
    force_ends = [(force.body, force.position_m, words), (force.against_body, force.against_position_m, "its opposite")]
    for body_name, position_m, mark_words in force_ends:
        if body_name is not None and position_m is not None:
            yield Mark(Station(body_name, position_m), mark_words, strengths, in_contact=force.when == "in contact")


def _markdown_text(report: _GapReport) -> str:
    """Markdown text: verdict, its sentence, that of the unmeasured force, and the mismatch by contact state."""
    paragraphs = [f"**{report.verdict.replace('_', ' ').capitalize()}**", report.sentence]
    if report.unknown:
        paragraphs.append(report.unknown.sentence)
    shares_text = ", ".join(f"{100 * share:.0f} % {state}" for state, share in report.attribution.contact_state.items())
    if shares_text and report.verdict not in UNLOCATED_VERDICTS:
        paragraphs.append(f"Share of the gap by the state of the contacts: {shares_text}.")
    return "\n\n".join(paragraphs)
