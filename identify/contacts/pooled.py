"""Identification of a record of any length segment by segment, and the pooled report of its segments."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from identify.contacts.observation import RINGING_S
from identify.contacts.results import ContactEstimate, ContactReport, Estimate, Segment
from identify.contacts.space_identification import identify_recording
from identify.signals.kinematics import MotionQuantity
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.limits import memory_bound_bytes
from rig.model.tolerances import Tolerances
from rig.recording.segments import bytes_per_second, segments

LARGE_FILE_BYTES = 1 << 26
"""Size of files from which they are identified segment by segment."""
SEGMENT_S = 40.0
"""Length of the segments, whose identification takes less memory than `LARGE_FILE_BYTES`."""
SHORTEST_SEGMENT_S = 10.0
MEMORY_COPIES, LAST_SEGMENT_RATIO = 18, 1.5
"""Memory of an identification over that of a segment's samples; length of the last segment over the others, at most."""
Struct = TypeVar("Struct", bound=msgspec.Struct)
IDENTIFYING_FIELDS = ("name", "contact", "equation", "body", "beam", "index")
"""Fields by which structures of several reports are matched."""


SUMMED_FIELDS = ("averages", "whirls")
"""Fields whose values are added."""


def identify_by_segments(
    path: Path,
    *,
    segment_s: float = SEGMENT_S,
    use: MotionQuantity = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[ContactReport, tuple[Segment, ...]]:
    """Identification of a recording that need not fit into memory: the pooled report, and that of every segment.

    A segment is read with the seconds before it, in which the beams ring of what was earlier. A segment that allows no
    identification is left out. Raises RigError if none allows it, or the recording cannot be read.
    """
    if not SHORTEST_SEGMENT_S <= segment_s < np.inf:
        raise RigError(
            f"segments of {segment_s:g} s: give {SHORTEST_SEGMENT_S:g} s or more, of which contacts can be told"
        )
    identified_segments: list[Segment] = []
    refusal_reason, file_bytes = "", path.stat().st_size if path.exists() else 0
    for recording in segments(path, segment_s + RINGING_S, RINGING_S):
        start_s = recording.start_s + (RINGING_S if recording.start_s else 0.0)
        try:
            identification = identify_recording(
                recording, use=use, averaging=averaging, equation=equation, tolerances=tolerances
            )
            identified_segments.append(Segment(start_s, recording.end_s, identification.report))
        except RigError as error:
            refusal_reason = str(error)
        channel_count = sum(len(signal.channels.names) for signal in recording.signals.values())
        progress(min(1.0, 8 * channel_count * recording.end_s * recording.rig.sample_rate_hz / file_bytes))
    if not identified_segments:
        raise RigError(f"{path}: no segment of {segment_s:g} s can be identified ({refusal_reason})")
    return pooled_report([segment.report for segment in identified_segments]), tuple(identified_segments)


def segment_length_within_memory_s(path: Path) -> float:
    """Length of the segments of a large file, s: SEGMENT_S, or less where memory is bounded.

    Raises RigError where that leaves less than SHORTEST_SEGMENT_S, as of samples by the million a second.
    """
    bytes_per_s, bound_bytes = bytes_per_second(path), memory_bound_bytes(path.stat().st_size)
    memory_limit_s = bound_bytes / (MEMORY_COPIES * LAST_SEGMENT_RATIO * bytes_per_s) - RINGING_S
    if memory_limit_s < SHORTEST_SEGMENT_S:
        raise RigError(
            f"{path}: its channels have {bytes_per_s / 1e6:.3g} MB a second, of which "
            f"{SHORTEST_SEGMENT_S + RINGING_S:g} s at once take more memory than {bound_bytes / 1e6:.0f} MB; sample at "
            "a lower rate: rig export FILE --format csv --map MAP, then a lower sample_rate_hz in its rig.json, "
            "resample = true in MAP, and rig import"
        )
    return min(SEGMENT_S, memory_limit_s)


def pooled_report(reports: Sequence[ContactReport]) -> ContactReport:
    """Report of several of the same rig: estimates pooled, numbers without an error averaged, block counts added."""
    merged_report = _merged_structs(_with_most_frequent_law(reports))
    answered_names = {contact.name for contact in merged_report.contacts}
    findings = {
        (finding.cause, finding.channels, finding.of): finding
        for report in reversed(reports)
        for finding in reversed(report.findings)
    }
    main_equations = [report.main_equation for report in reports]
    return msgspec.structs.replace(
        merged_report,
        unanswered=tuple(u for u in merged_report.unanswered if u.name not in answered_names),
        findings=tuple(findings.values())[::-1],
        main_equation=max(main_equations, key=main_equations.count),
        notes=tuple(dict.fromkeys(note for report in reports for note in report.notes)),
    )


def _with_most_frequent_law(reports: Sequence[ContactReport]) -> list[ContactReport]:
    """Reports with only those contacts whose law is the one of most segments: parameters of different laws cannot be
    pooled."""

    def law_of(contact: ContactEstimate) -> tuple[str, str, float | None]:
        return contact.name, contact.law, contact.reference_depth_m

    laws = [law_of(contact) for report in reports for contact in report.contacts]
    usual_laws = {name: max(laws, key=lambda law: (law[0] == name, laws.count(law))) for name, *_ in laws}
    return [
        msgspec.structs.replace(report, contacts=tuple(c for c in report.contacts if law_of(c) == usual_laws[c.name]))
        for report in reports
    ]


def pooled_estimate(estimates: Sequence[Estimate]) -> Estimate:
    """Weighted mean of estimates x_i with standard errors s_i from segments, w_i proportional to s_i^-2.

    The errors of the rig are common to all segments, those by noise differ: the scatter v about the mean falls with the
    number n of segments, the rest of the variance does not: error^2 = v / n + mean of s_i^2 - v (1 - sqrt(2 / n)),
    where sqrt(2 / n) allows for the uncertainty of v, and the rest is not below zero. Weighted, n = 1 / sum of w_i^2
    and v = n / (n - 1) sum of w_i (x_i - mean)^2. The mean is at least as certain as one segment unless the scatter
    exceeds the standard errors. Its own error is that of independent estimates, or that of the scatter if larger.
    """
    values, errors = np.array([(estimate.value, estimate.standard_error) for estimate in estimates]).T
    if len(estimates) == 1:
        return estimates[0]
    if not np.all(errors > 0):
        return Estimate(float(values.mean()), float(errors.max()))
    weights = errors**-2 / np.sum(errors**-2)
    weighted_mean, effective_count, mean_variance = weights @ values, 1 / (weights @ weights), weights @ errors**2
    scatter_variance = effective_count / (effective_count - 1) * weights @ (values - weighted_mean) ** 2
    shared_variance = max(0.0, mean_variance - scatter_variance * max(0.0, 1 - np.sqrt(2 / effective_count)))
    mean_scatter = scatter_variance / effective_count
    mean_error = float(np.sqrt(max(mean_scatter, min(mean_scatter + shared_variance, mean_variance))))
    own_errors = [estimate.own_error for estimate in estimates if estimate.own_error is not None]
    if len(own_errors) < len(estimates):
        return Estimate(float(weighted_mean), mean_error)
    own_error = float(np.sqrt(max(mean_scatter, weights**2 @ np.square(own_errors))))
    return Estimate(float(weighted_mean), mean_error, own_error)


def _merged_structs(structs: Sequence[Struct]) -> Struct:
    """Structure merged field by field; the numbers of averages are added."""
    merged_fields: dict[str, Any] = {}
    for name in structs[0].__struct_fields__:
        field_values = [value for struct in structs if (value := getattr(struct, name)) is not None]
        if name in SUMMED_FIELDS:
            merged_fields[name] = sum(field_values[1:], field_values[0])
        else:
            merged_fields[name] = _merged_value(field_values) if field_values else None
    return type(structs[0])(**merged_fields)


def _merged_value(field_values: Sequence[Any]) -> Any:
    """Value of a field: estimates pooled, numbers averaged, structures merged; else the first."""
    match field_values[0]:
        case Estimate():
            return pooled_estimate(field_values)
        case msgspec.Struct():
            return _merged_structs(field_values)
        case tuple():
            return _merged_rows(field_values)
        case float():
            return float(np.mean(field_values))
    return field_values[0]


def _merged_rows(struct_rows: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Structures of several rows, merged where their `IDENTIFYING_FIELDS` agree; the first row if there are none."""
    structs_by_key: dict[tuple[Any, ...], list[Any]] = {}
    for struct in (struct for row in struct_rows for struct in row if isinstance(struct, msgspec.Struct)):
        structs_by_key.setdefault(tuple(getattr(struct, name, None) for name in IDENTIFYING_FIELDS), []).append(struct)
    return tuple(map(_merged_structs, structs_by_key.values())) if structs_by_key else struct_rows[0]
