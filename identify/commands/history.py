"""The commands `identify compare` and `identify history`."""

from pathlib import Path
from typing import Annotated

import typer

from identify.commands.options import TolerancesOption, UseOption, checked_use, print_json, say_written
from rig.commands.command_line import Force, Json, console_table, literal_console, progress_bar, refuse_existing, say

OutOption = Annotated[Path | None, typer.Option(help="Folder for history.html, history.csv and history.json.")]


def compare(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING", help="Recordings of one machine in their order, or folders with a contact.json."
        ),
    ],
    out: OutOption = None,
    use: UseOption = "auto",
    tolerances: TolerancesOption = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Compare recordings of one machine: which clearances, stiffnesses or modes differ by more than chance.

    Example: identify compare before.mcap after.mcap --out results
    """
    _compare_and_print(recordings, out, use, tolerances, as_json, force)


def history(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", help="Folder with the recordings of one machine, or with folders of contact.json."
        ),
    ],
    out: OutOption = None,
    use: UseOption = "auto",
    tolerances: TolerancesOption = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Compare every recording in a folder, in the order of their names: what wears, and how fast.

    Example: identify history recordings --out results
    """
    from identify.history.observations import sources_in

    _compare_and_print(sources_in(folder), out, use, tolerances, as_json, force)


def _compare_and_print(
    sources: list[Path], out: Path | None, use: str, tolerances: str | None, as_json: bool, force: bool
) -> None:
    from identify.api import compare as compare_recordings
    from identify.history.page import quantity_table

    motion_quantity = checked_use(use)
    if out is not None:
        for file_name in ("history.html", "history.csv", "history.json"):
            refuse_existing(out / file_name, force, *sources, new_folder=True)
    with progress_bar(f"comparing {len(sources)} recordings") as progress:
        history_result = compare_recordings(sources, use=motion_quantity, tolerances=tolerances, progress=progress)
    if out is not None:
        history_result.save(out)
    if as_json:
        print_json(history_result.to_dict())
        return
    say(history_result.sentence)
    headings, rows = quantity_table(history_result.report)
    literal_console().print(console_table("± 95 %", headings, rows=rows))
    for observation in history_result.report.observations:
        if observation.report is None:
            say(f"left out: {observation.name}: {observation.reason}")
        for finding in observation.report.findings if observation.report else ():
            say(f"{observation.name} is not to be relied on: {finding.sentence}")
    if out is not None:
        say_written(out, "history.html", "history.csv", "history.json")
