"""The command `identify`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import identify
from identify.checks import Finding
from identify.commands.gap import gap
from identify.commands.history import compare, history
from identify.commands.options import ExportOption, TolerancesOption, UseOption, check_export, checked_use, print_json
from identify.commands.plan import plan
from identify.contacts.figures import curves
from identify.contacts.pooled import LARGE_BYTES, identify_long, longest_segment_s
from identify.contacts.results import ContactReport, Estimate, Segments, identified_rig
from identify.laws.report import curves as law_curves
from identify.laws.results import LawReport
from identify.pages.tables import save_tables
from identify.pages.wording import interval, number
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
"""Share of the progress at which results are drawn."""

app = typer.Typer(no_args_is_help=True, add_completion=True, pretty_exceptions_enable=False)


app.command()(gap)
app.command()(compare)
app.command()(history)
app.command()(plan)


@app.callback()
def _callback(version: Version = False) -> None:
    """Finds clearances and contact stiffnesses in recordings made by `rig record` or by a laboratory."""


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="The recording, an .mcap file.")],
    use: UseOption = "auto",
    tolerances: TolerancesOption = None,
    as_json: Json = False,
) -> None:
    """Check whether a recording's channels fit each other, the force and rig.json; exits with 1 if they do not.

    Units, polarity, swapped or dead channels, delays, the clock, clipping, hum, lost samples, masses and modes: one
    sentence for each finding, with what to do. `identify contact`, `law` and `gap` check so by themselves.

    Example: identify check barrel_cradle.mcap
    """
    sensors = checked_use(use)
    with working(f"checking {file.name}"):
        result = identify.check(file, use=sensors, tolerances=tolerances)
    if as_json:
        print_json(result.to_dict())
    else:
        print(f"{file}: {'nothing wrong was found' if result.sound else f'{len(result.findings)} findings'}")
        for finding in result.findings:
            say(f"  {finding.sentence}")
    if not result.sound:
        raise typer.Exit(1)


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print the findings of a check, if there are any."""
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
    use: UseOption = "auto",
    equation: Annotated[str | None, typer.Option(help='Main modal equation, e.g. "barrel 3".')] = None,
    averages: Annotated[int, typer.Option(help="How many blocks to average over.")] = 40,
    block: Annotated[float | None, typer.Option(help="Length of a block, s; otherwise from the averages.")] = None,
    overlap: Annotated[float, typer.Option(help="Overlap of the blocks, 0 to below 1.")] = 0.5,
    window: Annotated[str, typer.Option(help=f"Window: {', '.join(POWERS)}.")] = "hann",
    tolerances: TolerancesOption = None,
    band: Annotated[tuple[float, float] | None, typer.Option(help="Band of NIFO, Hz; otherwise the force's.")] = None,
    segment: Annotated[
        float | None,
        typer.Option(help="Identify so many seconds at a time and pool them, as is done with files of over 64 MB."),
    ] = None,
    export: ExportOption = None,
    details: Annotated[
        bool, typer.Option("--details", help="Print NIFO by modal equation and the modes it finds, too.")
    ] = False,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Clearance and stiffness of every contact of a recording.

    Example: identify contact barrel_cradle.mcap --use acceleration --out results
    """
    sensors = checked_use(use)
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
        "use": sensors,
        "averaging": averaging,
        "equation": equation,
        "tolerances": tolerances_named(tolerances) if tolerances else None,
    }
    with progress_bar(f"identifying {file.name}") as progress:
        if segment is not None:
            report = _by_segments(file, segment, out, progress, settings)
        else:
            report = _identified(file, out, progress, settings, export)
    if as_json:
        print_json(report)
    else:
        print_report(report, literal_console(), details)


def _identified(
    file: Path, out: Path | None, progress: Callable[[float], None], settings: dict[str, Any], export: str | None
) -> ContactReport:
    """Report of a recording that is identified at once, and its files."""
    identification_share = 1.0 if out is None else DRAWN_FROM
    result = identify.contact(file, progress=lambda share: progress(identification_share * share), **settings)
    if out is not None:
        result.save(out)
        if export is not None:
            save_tables(curves(result.found), out, export)
    return result.report


def _by_segments(
    file: Path, segment_s: float, out: Path | None, progress: Callable[[float], None], settings: dict[str, Any]
) -> ContactReport:
    """Pooled report of a recording that is identified segment by segment, and its files."""
    report, segment_results = identify_long(file, segment_s=segment_s, progress=progress, **settings)
    if out is not None:
        from identify.contacts.figures import segments_figure

        make_folder(out)
        if report.contacts:
            segments_figure(report, segment_results).save(out / "segments.png")
        write_json(Segments(segment_results), out / "segments.json")
        write_bytes(to_json(identified_rig(next(iter(segments(file, segment_s, 0.0))).rig, report)), out / "rig.json")
        write_json(report, out / "contact.json")
    return report


@app.command()
def law(
    file: Annotated[Path, typer.Argument(help="The recording, an .mcap file.")],
    contact: Annotated[str | None, typer.Option(help="The contact's name; otherwise all of them.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for law.html, a page, law.json and the figures.")] = None,
    use: UseOption = "auto",
    tolerances: TolerancesOption = None,
    seconds: Annotated[float, typer.Option(help="Longest search, s, shared by the contacts.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of the search and of the points drawn for it.")] = 0,
    export: ExportOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print law.json on standard output.")] = False,
    force: Force = False,
) -> None:
    """The contact law found, not assumed: a formula for the separated force of every contact, by symbolic regression.

    Needs the extra `symbolic`; see rig doctor.

    Example: identify law barrel_cradle.mcap --contact contact_1 --out results
    """
    sensors = checked_use(use)
    check_export(export, out)
    if out is not None:
        for name in ("law.json", "law.html"):
            refuse_existing(out / name, force, file, new_folder=True)
    with progress_bar(f"searching the laws of {file.name}") as progress:
        result = identify.law(
            file,
            contact=contact,
            use=sensors,
            seconds=seconds,
            seed=seed,
            tolerances=tolerances,
            progress=progress,
        )
    if out is not None:
        result.save(out)
        if export is not None:
            save_tables(law_curves(result.found.found), out, export)
    if as_json:
        print_json(result.report)
    else:
        print_laws(result.report, literal_console())


def print_laws(report: LawReport, console: Console) -> None:
    """Print the findings, then the verdict, formula and candidates of every contact."""
    print_findings(report.findings, console)
    for estimate in report.laws:
        console.print(Text.assemble((estimate.contact, "bold"), f": {estimate.verdict}."), soft_wrap=True)
        console.print(f"  formula found: {estimate.formula}", soft_wrap=True)
        table = Table("law", "rms left of held-out data, N")
        for candidate in estimate.candidates:
            table.add_row(candidate.law, f"{candidate.held_out_error_n:.3g}")
        console.print(table)
        console.print(
            f"  of a force of {estimate.force_rms_n:.3g} N rms; damping in the closed contact explains "
            f"{100 * estimate.hysteresis_share:.2g} % of the scatter's variance"
            + ("" if estimate.repeatable else "; time ended the search, so the seed will not repeat it exactly"),
            soft_wrap=True,
        )
    for unanswered in report.unanswered:
        console.print(f"{unanswered.name}: not told by this record: {unanswered.reason}", soft_wrap=True)


def print_report(report: ContactReport, console: Console, details: bool = False) -> None:
    """Print the findings and the table of the contacts; with details, also NIFO by modal equation and the modes."""
    print_findings(report.findings, console)
    table = Table(title=f"Contacts of {report.rig}, ± 95 %")
    for heading in ("contact", "clearance, mm", "stiffness, N/m", "damping, N s/m"):
        table.add_column(heading, justify="left" if heading == "contact" else "right")
    for estimate in report.contacts:
        table.add_row(
            estimate.name,
            _interval(estimate.clearance_m, 1e3),
            _interval(estimate.stiffness_n_per_m),
            _interval(estimate.damping_n_s_per_m),
        )
    console.print(table)
    for sentence in filter(None, (estimate.law_sentence for estimate in report.contacts)):
        console.print(f"{sentence}.", soft_wrap=True)
    for unanswered in report.unanswered:
        console.print(f"{unanswered.name}: not told by this record: {unanswered.reason}")
    for note in report.notes:
        console.print(f"note: {note}", soft_wrap=True)
    if details and report.nifo:
        console.print(_nifo_table(report))
    for mode in report.modes if details else ():
        console.print(
            f"mode {mode.index} of {mode.beam}: {mode.frequency_hz:.3f} Hz, damping {100 * mode.damping_ratio:.2f} %"
            + (f" ({mode.flag})" if mode.flag else "")
        )


def _nifo_table(report: ContactReport) -> Table:
    spectra = Table(title="NIFO by modal equation: spectral mean, which has no known error, rms spread over frequency")
    for heading in ("equation", "contact", "stiffness, N/m", "spread, %", ""):
        spectra.add_column(heading)
    for result in report.nifo:
        for stiffness in result.stiffness:
            spectra.add_row(
                result.equation,
                stiffness.contact,
                number(stiffness.mean_n_per_m.value),
                f"{100 * stiffness.rms_deviation_n_per_m / abs(stiffness.mean_n_per_m.value):.2g}",
                "nearly invisible" if stiffness.contact in result.nearly_invisible else "",
            )
        answered = {s.contact for s in result.stiffness}
        for name in (n for n in result.nearly_invisible if n not in answered):
            spectra.add_row(result.equation, name, "", "", "on a node: not told")
    return spectra


def _interval(estimate: Estimate, scale: float = 1.0) -> str:
    return interval(scale * estimate.value, scale * estimate.standard_error, "1")


def main() -> None:
    run(app, "identify")
