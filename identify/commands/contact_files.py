"""Identification of a recording's contacts by the settings of the command, at once or segment by segment, the files of
its result, and the report on the terminal."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table

import identify
from identify.checks import Finding
from identify.contacts.drawn_results import curves_of
from identify.contacts.pooled import LARGE_FILE_BYTES, identify_by_segments, segment_length_within_memory_s
from identify.contacts.results import ContactReport, Estimate, Segment, Segments, identified_rig
from identify.pages.tables import save_tables
from identify.pages.wording import interval, number
from identify.results import ContactResult
from identify.signals.kinematics import MotionQuantity
from identify.signals.spectra import Averaging
from rig.commands.command_line import console_table, print_sentence
from rig.files import make_folder, write_bytes, write_json
from rig.model.description import to_json
from rig.model.tolerances import Tolerances
from rig.recording.segments import segments

RESULT_FILE_NAMES = ("contact.json", "contact.html", "rig.json")
"""Files of a result that must not be overwritten unasked."""


class ContactSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of `identify contact`, as its options have them."""

    use: MotionQuantity = "auto"
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
    if segment_s is None and file.exists() and file.stat().st_size > LARGE_FILE_BYTES:
        segment_s = segment_length_within_memory_s(file)
    options: dict[str, Any] = {"use": settings.use, "averaging": settings.averaging, "equation": settings.equation}
    options |= {"tolerances": settings.tolerances, "progress": progress}
    if segment_s is None:
        contact_result = identify.contact(file, **options)
        return FileAnswer(contact_result.report, lambda out: _save(contact_result, out, settings.export))
    report, segment_results = identify_by_segments(file, segment_s=segment_s, **options)
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


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print the findings of a check, if there are any."""
    if findings:
        console.print("Not to be relied on:", style="bold red")
    for finding in findings:
        print_sentence(f"  {finding.sentence}", console)


def print_report(report: ContactReport, console: Console, details: bool = False) -> None:
    """Print the findings and the table of the contacts; with details, also NIFO by modal equation and the modes."""
    print_findings(report.findings, console)
    headings = ("contact", "clearance, mm", "stiffness, N/m", "damping, N s/m")
    contact_table = console_table(f"Contacts of {report.rig}, ± 95 %", headings)
    for estimate in report.contacts:
        contact_table.add_row(
            estimate.name,
            "" if estimate.is_spring else _interval_text(estimate.clearance_m, 1e3),
            _interval_text(estimate.stiffness_n_per_m),
            _interval_text(estimate.damping_n_s_per_m),
        )
    console.print(contact_table)
    for sentence in filter(None, (estimate.law_sentence for estimate in report.contacts)):
        print_sentence(f"{sentence}.", console)
    for unanswered_contact in report.unanswered:
        print_sentence(
            f"{unanswered_contact.name}: not determined by this record: {unanswered_contact.reason}", console
        )
    for note in report.notes:
        print_sentence(f"note: {note}", console)
    if details and report.nifo:
        console.print(_nifo_table(report))
    for mode in report.modes if details else ():
        console.print(
            f"mode {mode.index} of {mode.beam}: {mode.frequency_hz:.3f} Hz, damping {100 * mode.damping_ratio:.2f} %"
            + (f" ({mode.flag})" if mode.flag else "")
        )


def _nifo_table(report: ContactReport) -> Table:
    title = "NIFO by modal equation: spectral mean, which has no known error, rms spread over frequency"
    nifo_table = console_table(title, ("equation", "contact", "stiffness, N/m", "spread, %", ""), 2)
    for equation_result in report.nifo:
        for stiffness in equation_result.stiffness:
            nifo_table.add_row(
                equation_result.equation,
                stiffness.contact,
                number(stiffness.mean_n_per_m.value),
                f"{100 * stiffness.rms_deviation_n_per_m / abs(stiffness.mean_n_per_m.value):.2g}",
                "nearly invisible" if stiffness.contact in equation_result.nearly_invisible else "",
            )
        answered_names = {s.contact for s in equation_result.stiffness}
        for contact_name in (n for n in equation_result.nearly_invisible if n not in answered_names):
            nifo_table.add_row(equation_result.equation, contact_name, "", "", "on a node: not told")
    return nifo_table


def _interval_text(estimate: Estimate, unit_factor: float = 1.0) -> str:
    return interval(unit_factor * estimate.value, unit_factor * estimate.standard_error, "1")
