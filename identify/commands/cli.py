"""The command `identify`."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import identify
from identify.checks import Finding
from identify.commands.gap import gap
from identify.commands.history import compare, history
from identify.commands.options import Believed, Export, Used, check_export
from identify.contacts.curves import curves
from identify.contacts.identified_rig import identified_rig
from identify.contacts.pooled import LARGE_BYTES, identify_long, longest_segment_s
from identify.contacts.results import ContactReport, Estimate, Segments
from identify.laws.curves import curves as law_curves
from identify.laws.results import LawReport
from identify.pages.tables import save_tables
from identify.pages.wording import interval, number
from identify.signals.kinematics import Use
from identify.signals.spectra import POWERS, Averaging
from rig.commands.command_line import (
    Force,
    Json,
    Version,
    literal_console,
    progress_bar,
    refuse_existing,
    run,
    say,
    working,
)
from rig.files import make_folder, write_bytes, write_json
from rig.model.description import to_json
from rig.model.tolerances import tolerances_named
from rig.recording.segments import segments

DRAWN_FROM = 0.8
"""The share of the time after which results are drawn."""

app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)


app.command()(gap)
app.command()(compare)
app.command()(history)


@app.callback()
def _group(version: Version = False) -> None:
    """Finds clearances and contact stiffnesses in recordings made by `rig record` or by a laboratory."""


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="The recording, an .mcap file.")],
    use: Used = "auto",
    tolerances: Believed = None,
    as_json: Json = False,
) -> None:
    """Check whether a recording's channels fit each other, the force and rig.json; exits with 1 if they do not.

    Units, polarity, swapped or dead channels, delays, the clock, clipping, hum, lost samples, masses and modes: one
    sentence for each finding, with what to do. `identify contact`, `law` and `gap` check so by themselves.

    Example: identify check barrel_cradle.mcap
    """
    if use not in get_args(Use):
        raise typer.BadParameter(f"{use!r} is none of {', '.join(get_args(Use))}", param_hint="--use")
    with working(f"checking {file.name}"):
        found = identify.check(file, use=msgspec.convert(use, Use), tolerances=tolerances)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.encode(found.to_dict()) + b"\n")
    else:
        print(f"{file}: {'nothing wrong was found' if found.sound else f'{len(found.findings)} findings'}")
        for finding in found.findings:
            say(f"  {finding.sentence}")
    if not found.sound:
        raise typer.Exit(1)


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """First of all, where there are any."""
    if findings:
        console.print("Not to be relied on:", style="bold red")
    for finding in findings:
        console.print(f"  {finding.sentence}", soft_wrap=True)


@app.command()
def contact(
    file: Annotated[Path, typer.Argument(help="The recording, an .mcap file.")],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for contact.json, the identified rig.json, the figures and contact.html, a page."),
    ] = None,
    use: Used = "auto",
    equation: Annotated[str | None, typer.Option(help='Main modal equation, e.g. "barrel 3".')] = None,
    averages: Annotated[int, typer.Option(help="How many blocks to average over.")] = 40,
    block: Annotated[float | None, typer.Option(help="Length of a block, s; otherwise from the averages.")] = None,
    overlap: Annotated[float, typer.Option(help="Overlap of the blocks, 0 to below 1.")] = 0.5,
    window: Annotated[str, typer.Option(help=f"Window: {', '.join(POWERS)}.")] = "hann",
    tolerances: Believed = None,
    band: Annotated[tuple[float, float] | None, typer.Option(help="Band of NIFO, Hz; otherwise the force's.")] = None,
    segment: Annotated[
        float | None,
        typer.Option(help="Identify so many seconds at a time and pool them, as is done with files of over 64 MB."),
    ] = None,
    export: Export = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Clearance and stiffness of every contact of a recording.

    Example: identify contact barrel_cradle.mcap --use acceleration --out results
    """
    if use not in get_args(Use):
        raise typer.BadParameter(f"{use!r} is none of {', '.join(get_args(Use))}", param_hint="--use")
    if window not in POWERS:
        raise typer.BadParameter(f"{window!r} is none of {', '.join(POWERS)}", param_hint="--window")
    check_export(export, out)
    averaging = Averaging(averages=averages, block_s=block, overlap=overlap, window=window, band_hz=band)
    if out is not None:
        for name in ("contact.json", "contact.html", "rig.json"):
            refuse_existing(out / name, force, file, new_folder=True)
    if segment is None and file.exists() and file.stat().st_size > LARGE_BYTES:
        segment = longest_segment_s(file)
    settings = {
        "use": msgspec.convert(use, Use),
        "averaging": averaging,
        "equation": equation,
        "tolerances": tolerances_named(tolerances) if tolerances else None,
    }
    with progress_bar(f"identifying {file.name}") as progress:
        if segment is not None:
            report = _by_segments(file, segment, out, progress, settings)
        else:
            report = _whole(file, out, progress, settings, export)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.encode(report) + b"\n")
    else:
        print_report(report, literal_console())


def _whole(
    file: Path, out: Path | None, progress: Callable[[float], None], settings: dict[str, Any], export: str | None
) -> ContactReport:
    drawn = 1.0 if out is None else DRAWN_FROM
    found = identify.contact(file, progress=lambda share: progress(drawn * share), **settings)
    if out is not None:
        found.save(out)
        if export is not None:
            save_tables(curves(found.found), out, export)
    return found.report


def _by_segments(
    file: Path, segment_s: float, out: Path | None, progress: Callable[[float], None], settings: dict[str, Any]
) -> ContactReport:
    report, parts = identify_long(file, segment_s=segment_s, progress=progress, **settings)
    if out is not None:
        from identify.contacts.figures import segments_drawn

        make_folder(out)
        if report.contacts:
            segments_drawn(report, parts).save(out / "segments.png")
        write_json(Segments(parts), out / "segments.json")
        write_bytes(to_json(identified_rig(next(iter(segments(file, segment_s, 0.0))).rig, report)), out / "rig.json")
        write_json(report, out / "contact.json")
    return report


@app.command()
def law(
    file: Annotated[Path, typer.Argument(help="The recording, an .mcap file.")],
    contact: Annotated[str | None, typer.Option(help="The contact's name; otherwise all of them.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for law.html, a page, law.json and the figures.")] = None,
    use: Used = "auto",
    tolerances: Believed = None,
    seconds: Annotated[float, typer.Option(help="Longest search, s, shared by the contacts.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the search and of the points drawn for it.")] = 0,
    export: Export = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print law.json on standard output.")] = False,
    force: Force = False,
) -> None:
    """The contact law found, not assumed: a formula for the separated force of every contact, by symbolic regression.

    Needs the extra `symbolic`; see rig doctor.

    Example: identify law barrel_cradle.mcap --contact contact_1 --out results
    """
    if use not in get_args(Use):
        raise typer.BadParameter(f"{use!r} is none of {', '.join(get_args(Use))}", param_hint="--use")
    check_export(export, out)
    if out is not None:
        for name in ("law.json", "law.html"):
            refuse_existing(out / name, force, file, new_folder=True)
    with progress_bar(f"searching the laws of {file.name}") as progress:
        found = identify.law(
            file,
            contact=contact,
            use=msgspec.convert(use, Use),
            seconds=seconds,
            seed=seed,
            tolerances=tolerances,
            progress=progress,
        )
    if out is not None:
        found.save(out)
        if export is not None:
            save_tables(law_curves(found.found.found), out, export)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.encode(found.report) + b"\n")
    else:
        print_laws(found.report, literal_console())


def print_laws(report: LawReport, console: Console) -> None:
    """A sentence for every contact, then what was found and how it compares; before them what speaks against it."""
    print_findings(report.findings, console)
    for found in report.laws:
        console.print(Text.assemble((found.contact, "bold"), f": {found.verdict}."), soft_wrap=True)
        console.print(f"  formula found: {found.formula}", soft_wrap=True)
        table = Table("law", "rms left of held-out data, N")
        for candidate in found.candidates:
            table.add_row(candidate.law, f"{candidate.held_out_error_n:.3g}")
        console.print(table)
        console.print(
            f"  of a force of {found.force_rms_n:.3g} N rms; damping in the closed contact explains "
            f"{100 * found.hysteresis_share:.2g} % of the scatter's variance"
            + ("" if found.repeatable else "; time ended the search, so the seed will not repeat it exactly"),
            soft_wrap=True,
        )
    for silent in report.unanswered:
        console.print(f"{silent.name}: not told by this record: {silent.reason}", soft_wrap=True)


def print_report(report: ContactReport, console: Console) -> None:
    """The answer as tables: contacts, then NIFO by modal equation; before them what speaks against it."""
    print_findings(report.findings, console)
    table = Table(title=f"Contacts of {report.rig}, ± 95 %")
    for heading in ("contact", "clearance, mm", "stiffness, N/m", "damping, N s/m"):
        table.add_column(heading, justify="left" if heading == "contact" else "right")
    for found in report.contacts:
        table.add_row(
            found.name,
            _shown(found.clearance_m, 1e3),
            _shown(found.stiffness_n_per_m),
            _shown(found.damping_n_s_per_m),
        )
    console.print(table)
    for sentence in filter(None, (found.law_sentence for found in report.contacts)):
        console.print(f"{sentence}.", soft_wrap=True)
    for silent in report.unanswered:
        console.print(f"{silent.name}: not told by this record: {silent.reason}")
    if report.nifo:
        console.print(_nifo_table(report))
    for note in report.notes:
        console.print(f"note: {note}", soft_wrap=True)
    for mode in report.modes:
        console.print(
            f"mode {mode.index} of {mode.beam}: {mode.frequency_hz:.3f} Hz, damping {100 * mode.damping_ratio:.2f} %"
            + (f" ({mode.flag})" if mode.flag else "")
        )


def _nifo_table(report: ContactReport) -> Table:
    spectra = Table(title="NIFO by modal equation: spectral mean, which has no known error, rms spread over frequency")
    for heading in ("equation", "contact", "stiffness, N/m", "spread, %", ""):
        spectra.add_column(heading)
    for each in report.nifo:
        for stiffness in each.stiffness:
            spectra.add_row(
                each.equation,
                stiffness.contact,
                number(stiffness.mean_n_per_m.value),
                f"{100 * stiffness.rms_deviation_n_per_m / abs(stiffness.mean_n_per_m.value):.2g}",
                "nearly invisible" if stiffness.contact in each.nearly_invisible else "",
            )
        answered = {s.contact for s in each.stiffness}
        for name in (n for n in each.nearly_invisible if n not in answered):
            spectra.add_row(each.equation, name, "", "", "on a node: not told")
    return spectra


def _shown(estimate: Estimate, scale: float = 1.0) -> str:
    return interval(scale * estimate.value, scale * estimate.standard_error, "1")


def main() -> None:
    run(app, "identify")
