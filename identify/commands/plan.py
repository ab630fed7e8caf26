"""The command `identify plan`."""

import os
from pathlib import Path
from typing import Annotated

import typer

from identify.commands.options import TolerancesOption, print_json, say_written
from rig.commands.command_line import Force, Json, console_table, literal_console, progress_bar, refuse_existing, say

SHOWN_CHANGE_COUNT = 8
"""Number of ranked changes on the terminal."""
MAX_WORKER_COUNT = 8
"""Most processes, each of which takes some 0.4 GB."""


def plan_help_words() -> dict[str, str]:
    """Word for the help: the number of changes that are tried at most."""
    from identify.planning.ranking import MAX_CHANGE_COUNT

    return {"changes": str(MAX_CHANGE_COUNT)}


def plan(
    source: Annotated[
        Path, typer.Argument(metavar="RIG", help="The rig.json, or a recording whose rig and force are planned again.")
    ],
    duration: Annotated[
        float | None, typer.Option(help="Length of the record, s; otherwise 60, or that of the recording.")
    ] = None,
    force_rms: Annotated[
        float | None,
        typer.Option(help="Force, N rms, of each if there are several; otherwise as `rig record` chooses it."),
    ] = None,
    base_rms: Annotated[
        float | None,
        typer.Option(
            help="Acceleration of the base, m/s² rms, where it alone shakes the rig; otherwise that of base_motion in "
            "rig.json, or that which moves the contacts by four clearances."
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Band of the force or of the base, Hz; otherwise as `rig record` chooses it."),
    ] = None,
    tolerances: TolerancesOption = None,
    changes: Annotated[
        int | None,
        typer.Option(
            min=0, help="How many changes of the test to try at most, otherwise {changes}; 0: expected intervals alone."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="How many processes; otherwise one for each core, at most 8.")
    ] = None,
    simulator: Annotated[str, typer.Option(help="Simulator of the planned test, by its entry point.")] = "modal",
    out: Annotated[Path | None, typer.Option(help="Folder for plan.html, a page, and plan.json.")] = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Predict what a test will determine: the expected 95 % intervals, and what would shorten them most.

    The rig is simulated as described, with its sensors, noise and tolerances, and the records are identified. Then one
    thing is changed at a time: sensors, force, band, place, duration, noise, tolerances.

    Example: identify plan rig.json --duration 30 --force-rms 14 --band 0.5 100 --out plan
    """
    from identify.api import plan as plan_test
    from identify.planning import page
    from identify.planning.ranking import MAX_CHANGE_COUNT

    if out is not None:
        for file_name in ("plan.html", "plan.json"):
            refuse_existing(out / file_name, force, source, new_folder=True)
    with progress_bar(f"planning {source.name}") as progress:
        plan_result = plan_test(
            source,
            duration_s=duration,
            force_rms_n=force_rms,
            base_rms_m_per_s2=base_rms,
            band_hz=band,
            tolerances=tolerances,
            simulator=simulator,
            most_changes=MAX_CHANGE_COUNT if changes is None else changes,
            workers=workers or min(os.cpu_count() or 1, MAX_WORKER_COUNT),
            progress=progress,
        )
    if out is not None:
        plan_result.save(out)
    if as_json:
        print_json(plan_result.to_dict())
        return
    report, console = plan_result.report, literal_console()
    say(f"Planned: {page.test_sentence(report)}.")
    if report.contacts:
        title = f"Contacts of {report.rig}, expected, ± 95 %"
        console.print(console_table(title, page.CONTACT_HEAD, rows=page.contact_rows(report)))
    for sentence in page.annular_contact_sentences(report):
        say(f"{sentence}.")
    for contact in report.undetermined:
        say(f"{contact.name} cannot be determined by this test: {contact.reason}; {contact.remedy}")
    if report.changes and not report.advice:
        say("No change that was tried would help.")
    if report.advice:
        change_rows = list(page.change_rows(report.advice))[:SHOWN_CHANGE_COUNT]
        title = "What would help, ranked by the widest interval"
        change_table = console_table(title, page.CHANGE_HEAD, rows=change_rows)
        change_table.columns[-1].justify = "left"
        console.print(change_table)
    if report.effects:
        title = "Smallest effects that identify gap would name"
        console.print(console_table(title, page.KIND_HEAD, 2, rows=page.effect_kind_rows(report.effects)))
    for sentence in filter(None, (page.idle_sensor_sentence(report), *(f"note: {note}" for note in report.notes))):
        say(sentence)
    if out is not None:
        say_written(out, "plan.html", "plan.json")
