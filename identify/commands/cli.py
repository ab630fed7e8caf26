"""The command `identify`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

import identify
from identify.commands.contact import contact
from identify.commands.gap import gap
from identify.commands.history import compare, history
from identify.commands.options import (
    ExportOption,
    TolerancesOption,
    UseOption,
    check_export,
    checked_use,
    option_help_words,
    print_json,
    say_written,
)
from identify.commands.plan import plan, plan_help_words
from rig.commands.command_line import (
    CommandApp,
    Force,
    Json,
    Version,
    console_table,
    help_filled_by,
    literal_console,
    print_sentence,
    progress_bar,
    progress_spinner,
    refuse_existing,
    run,
    say,
)

if TYPE_CHECKING:
    from identify.laws.results import LawReport
else:
    LawReport = Any

app = CommandApp(no_args_is_help=True)

CommandOfOptions = help_filled_by(option_help_words)

app.command(cls=CommandOfOptions)(contact)
app.command(cls=CommandOfOptions)(gap)
app.command(cls=CommandOfOptions)(compare)
app.command(cls=CommandOfOptions)(history)
app.command(cls=help_filled_by(plan_help_words))(plan)


@app.callback()
def _callback(version: Version = False) -> None:
    """Finds clearances and contact stiffnesses in recordings made by `rig record` or by a laboratory."""


@app.command(cls=CommandOfOptions)
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file.")],
    use: UseOption = "auto",
    tolerances: TolerancesOption = None,
    as_json: Json = False,
) -> None:
    """Check whether a recording's channels fit each other, the force and rig.json; exits with 1 if they do not.

    Units, polarity, swapped or dead channels, delays, the clock, clipping, hum, lost samples, masses and modes: one
    sentence for each finding, with what to do. `identify contact`, `law` and `gap` check so by themselves.

    Example: identify check barrel_cradle.mcap
    """
    motion_quantity = checked_use(use)
    with progress_spinner(f"checking {file.name}"):
        check_result = identify.check(file, use=motion_quantity, tolerances=tolerances)
    if as_json:
        print_json(check_result.to_dict())
    else:
        finding_count = len(check_result.findings)
        count_words = f"{finding_count} finding{'s' * (finding_count > 1)}"
        say(f"{file}: {count_words if finding_count else 'nothing wrong was found'}")
        for finding in check_result.findings:
            say(f"  {finding.sentence}")
        for note in check_result.notes:
            say(f"note: {note}")
    if not check_result.sound:
        raise typer.Exit(1)


@app.command(cls=CommandOfOptions)
def law(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file.")],
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
    from identify.laws.report import curves
    from identify.pages.tables import save_tables

    motion_quantity = checked_use(use)
    check_export(export, out)
    if out is not None:
        for file_name in ("law.json", "law.html"):
            refuse_existing(out / file_name, force, file, new_folder=True)
    with progress_bar(f"searching the laws of {file.name}") as progress:
        law_result = identify.law(
            file,
            contact=contact,
            use=motion_quantity,
            seconds=seconds,
            seed=seed,
            tolerances=tolerances,
            progress=progress,
        )
    if out is not None:
        law_result.save(out)
        if export is not None:
            save_tables(curves(law_result.identification.fits), out, export)
    if as_json:
        print_json(law_result.report)
    else:
        print_laws(law_result.report, literal_console())
        if out is not None:
            say_written(out, "law.html", "law.json")


def print_laws(report: LawReport, console: Console) -> None:
    """Print the findings, then the verdict, formula and candidates of every contact."""
    from identify.commands.contact_files import print_findings
    from identify.laws.results import FORMULA
    from identify.pages.wording import percent

    print_findings(report.findings, console)
    for law_estimate in report.laws:
        console.print(
            Text.assemble((law_estimate.contact, "bold"), f": {law_estimate.verdict}."),
            soft_wrap=not console.is_terminal,
        )
        if law_estimate.candidate(FORMULA).fits:
            print_sentence(f"  formula found: {law_estimate.formula}", console)
        candidate_rows = (
            (candidate.law, f"{candidate.held_out_error_n:.3g}", percent(candidate.left_share))
            for candidate in law_estimate.candidates
        )
        console.print(console_table("", ("law", "rms left of held-out data, N", "of the force"), rows=candidate_rows))
        damping_text = ""
        if law_estimate.sliding is None:
            share_text = f"{100 * law_estimate.hysteresis_share:.2g} %"
            damping_text = f"; damping in the closed contact explains {share_text} of what straight pieces leave"
        print_sentence(
            f"  of a force of {law_estimate.force_rms_n:.3g} N rms{damping_text}"
            + ("" if law_estimate.repeatable else "; time ended the search, so the seed will not repeat it exactly"),
            console,
        )
    for unanswered_contact in report.unanswered:
        print_sentence(
            f"{unanswered_contact.name}: not determined by this record: {unanswered_contact.reason}", console
        )


def main() -> None:
    run(app, "identify")
