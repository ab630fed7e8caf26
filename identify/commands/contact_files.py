"""Identification of a recording's contacts by the settings of the command, at once or segment by segment, and the files
of its result."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

import identify
from identify.contacts.drawn_results import curves_of
from identify.contacts.pooled import LARGE_BYTES, identify_long, longest_segment_s
from identify.contacts.results import ContactReport, Segment, Segments, identified_rig
from identify.pages.tables import save_tables
from identify.results import ContactResult
from identify.signals.kinematics import Use
from identify.signals.spectra import Averaging
from rig.files import make_folder, write_bytes, write_json
from rig.model.description import to_json
from rig.model.tolerances import Tolerances
from rig.recording.segments import segments

RESULTS = ("contact.json", "contact.html", "rig.json")
"""Files of a result that must not be overwritten unasked."""


class ContactSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of `identify contact`, as its options have them."""

    use: Use = "auto"
    averaging: Averaging = Averaging()
    equation: str | None = None
    tolerances: Tolerances | None = None
    segment_s: float | None = None
    export: str | None = None


@dataclass(frozen=True)
class FileAnswer:
    """Report on a recording, and the function that writes its files to a folder."""

    report: ContactReport
    save: Callable[[Path], None]


def identify_file(
    file: Path, settings: ContactSettings, progress: Callable[[float], None] = lambda _: None
) -> FileAnswer:
    """Answer on a recording, segment by segment if the settings say so or the file is large.

    Raises RigError if the recording does not allow it.
    """
    segment_s = settings.segment_s
    if segment_s is None and file.exists() and file.stat().st_size > LARGE_BYTES:
        segment_s = longest_segment_s(file)
    if segment_s is None:
        contact_result = identify.contact(
            file,
            use=settings.use,
            averaging=settings.averaging,
            equation=settings.equation,
            tolerances=settings.tolerances,
            progress=progress,
        )
        return FileAnswer(contact_result.report, lambda out: _save(contact_result, out, settings.export))
    report, segment_results = identify_long(
        file,
        segment_s=segment_s,
        use=settings.use,
        averaging=settings.averaging,
        equation=settings.equation,
        tolerances=settings.tolerances,
        progress=progress,
    )
    return FileAnswer(report, lambda out: _save_pooled(file, segment_s, report, segment_results, out))


def _save(contact_result: ContactResult, out: Path, export: str | None) -> None:
    contact_result.save(out)
    if export is not None:
        save_tables(curves_of(contact_result.identification), out, export)


def _save_pooled(
    file: Path, segment_s: float, report: ContactReport, segment_results: tuple[Segment, ...], out: Path
) -> None:
    from identify.contacts.figures import segments_figure

    make_folder(out)
    if report.contacts:
        segments_figure(report, segment_results).save(out / "segments.png")
    write_json(Segments(segment_results), out / "segments.json")
    write_bytes(to_json(identified_rig(next(iter(segments(file, segment_s, 0.0))).rig, report)), out / "rig.json")
    write_json(report, out / "contact.json")
