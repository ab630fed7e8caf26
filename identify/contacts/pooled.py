"""A record of any length, identified segment by segment, and what the segments say together."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from identify.contacts.forces import RING_S
from identify.contacts.identification import identify_contact
from identify.contacts.results import ContactReport, Estimate, Segment
from identify.signals.kinematics import Use
from identify.signals.spectra import Averaging
from rig.errors import RigError
from rig.limits import memory_bound_bytes
from rig.model.tolerances import Tolerances
from rig.recording.segments import bytes_per_second, segments

LARGE_BYTES = 1 << 26
"""Files of more are identified segment by segment, ..."""
SEGMENT_S = 40.0
"""... of this length, which takes less memory than that."""
SHORTEST_S = 10.0
COPIES, LAST_LONGER = 18, 1.5
"""Identification takes so many times the memory of a segment's samples; the last segment is up to so much longer."""
Struct = TypeVar("Struct", bound=msgspec.Struct)
NAMES = ("name", "contact", "equation", "body", "beam", "index")
"""The fields by which what belongs together is found."""


def identify_long(
    path: Path,
    *,
    segment_s: float = SEGMENT_S,
    use: Use = "auto",
    averaging: Averaging | None = None,
    equation: str | None = None,
    tolerances: Tolerances | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[ContactReport, tuple[Segment, ...]]:
    """Identification of a recording that need not fit into memory: pooled, and from every segment by itself.

    A segment is read with the seconds before it in which the beams ring of what was earlier. One that allows no
    identification is left out. Raises RigError if none does, or the recording cannot be read.
    """
    if not SHORTEST_S <= segment_s < np.inf:
        raise RigError(f"segments of {segment_s:g} s: give {SHORTEST_S:g} s or more, of which contacts can be told")
    found: list[Segment] = []
    why = ""
    size = path.stat().st_size if path.exists() else 0
    for part in segments(path, segment_s + RING_S, RING_S):
        try:
            report = identify_contact(
                part, use=use, averaging=averaging, equation=equation, tolerances=tolerances
            ).report
            found.append(Segment(part.start_s + (RING_S if part.start_s else 0.0), part.end_s, report))
        except RigError as error:
            why = str(error)
        rows = sum(len(s.channels.names) for s in part.signals.values())
        progress(min(1.0, 8 * rows * part.end_s * part.rig.sample_rate_hz / size))
    if not found:
        raise RigError(f"{path}: no segment of {segment_s:g} s can be identified ({why})")
    return together([s.report for s in found]), tuple(found)


def longest_segment_s(path: Path) -> float:
    """The length of the segments of a large file, SEGMENT_S unless they would take more memory than the file may.

    Raises RigError where that leaves less than SHORTEST_S, as of samples by the million a second.
    """
    per_s, bound = bytes_per_second(path), memory_bound_bytes(path.stat().st_size)
    longest_s = bound / (COPIES * LAST_LONGER * per_s) - RING_S
    if longest_s < SHORTEST_S:
        raise RigError(
            f"{path}: its channels have {per_s / 1e6:.3g} MB a second, of which {SHORTEST_S + RING_S:g} s at once take "
            f"more memory than {bound / 1e6:.0f} MB; sample at a lower rate: rig export FILE --format csv --map MAP, "
            "then a lower sample_rate_hz in its rig.json, resample = true in MAP, and rig import"
        )
    return min(SEGMENT_S, longest_s)


def together(reports: Sequence[ContactReport]) -> ContactReport:
    """One report of several of the same rig: estimates pooled, figures without an error averaged, averages added."""
    merged = _of_one_kind(_of_usual_law(reports))
    answered = {c.name for c in merged.contacts}
    findings = {(f.cause, f.channels, f.of): f for r in reversed(reports) for f in reversed(r.findings)}
    equations = [r.main_equation for r in reports]
    return msgspec.structs.replace(
        merged,
        unanswered=tuple(u for u in merged.unanswered if u.name not in answered),
        findings=tuple(findings.values())[::-1],
        main_equation=max(equations, key=equations.count),
        notes=tuple(dict.fromkeys(note for r in reports for note in r.notes)),
    )


def _of_usual_law(reports: Sequence[ContactReport]) -> list[ContactReport]:
    """Each contact of those segments alone whose law is the one that most of them ask for: numbers of other laws are
    others."""
    laws = [(c.name, c.law, c.reference_depth_m) for r in reports for c in r.contacts]
    usual = {name: max(laws, key=lambda law: (law[0] == name, laws.count(law))) for name, *_ in laws}
    return [
        msgspec.structs.replace(
            r, contacts=tuple(c for c in r.contacts if (c.name, c.law, c.reference_depth_m) == usual[c.name])
        )
        for r in reports
    ]


def pooled(estimates: Sequence[Estimate]) -> Estimate:
    """The mean of estimates x_i from segments, weighted by their standard errors s_i.

    They share what is in doubt about the rig, and differ by noise and chance: their scatter v about the mean goes down
    with their number n, the rest of their variance does not: error^2 = v / n + mean of s_i^2 - v (1 - sqrt(2 / n)),
    with v taken lower in the rest by as much as it is uncertain, and the rest not below zero. Weighted, n is
    1 / sum of w_i^2 and v = n / (n - 1) sum of w_i (x_i - mean)^2. No mean is less certain than one of them unless they
    scatter more than they should. The mean's own error is that of independent ones, or that of the scatter if larger.
    """
    values, errors = np.array([(e.value, e.standard_error) for e in estimates]).T
    if len(estimates) == 1:
        return estimates[0]
    if not np.all(errors > 0):
        return Estimate(float(values.mean()), float(errors.max()))
    weights = errors**-2 / np.sum(errors**-2)
    mean, count, single = weights @ values, 1 / (weights @ weights), weights @ errors**2
    scatter = count / (count - 1) * weights @ (values - mean) ** 2
    shared = max(0.0, single - scatter * max(0.0, 1 - np.sqrt(2 / count)))
    own = [e.own_error for e in estimates if e.own_error is not None]
    return Estimate(
        float(mean),
        float(np.sqrt(max(scatter / count, min(scatter / count + shared, single)))),
        float(np.sqrt(max(scatter / count, weights**2 @ np.square(own)))) if len(own) == len(estimates) else None,
    )


def _of_one_kind(parts: Sequence[Struct]) -> Struct:
    """Field by field; the number of averages is added."""
    merged: dict[str, Any] = {}
    for name in parts[0].__struct_fields__:
        given = [value for p in parts if (value := getattr(p, name)) is not None]
        merged[name] = sum(given) if name == "averages" else _merged(given) if given else None
    return type(parts[0])(**merged)


def _merged(values: Sequence[Any]) -> Any:
    """Estimates pooled, numbers averaged, structures merged that belong together; of all else the first."""
    match values[0]:
        case Estimate():
            return pooled(values)
        case msgspec.Struct():
            return _of_one_kind(values)
        case tuple():
            return _by_name(values)
        case float():
            return float(np.mean(values))
    return values[0]


def _by_name(rows: Sequence[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Structures of several rows by the fields that name them; the first of rows of anything else."""
    alike: dict[tuple[Any, ...], list[Any]] = {}
    for item in (item for row in rows for item in row if isinstance(item, msgspec.Struct)):
        alike.setdefault(tuple(getattr(item, name, None) for name in NAMES), []).append(item)
    return tuple(map(_of_one_kind, alike.values())) if alike else rows[0]
