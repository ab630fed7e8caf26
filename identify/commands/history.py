"""The commands `identify compare` and `identify history`."""

import sys
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table

from identify.api import compare as compared
from identify.commands.options import Believed, Used
from identify.history.observed import sources_in
from identify.history.page import rows
from identify.signals.kinematics import Use
from rig.commands.command_line import Force, Json, literal_console, progress_bar, refuse_existing, say

Out = Annotated[Path | None, typer.Option(help="Folder for history.html, history.csv and history.json.")]


def compare(
    recordings: Annotated[
        list[Path], typer.Argument(help="Recordings of one machine in their order, or folders with a contact.json.")
    ],
    out: Out = None,
    use: Used = "auto",
    tolerances: Believed = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Compare recordings of one machine: which clearances, stiffnesses or modes differ by more than chance.

    Example: identify compare before.mcap after.mcap --out results
    """
    _shown(recordings, out, use, tolerances, as_json, force)


def history(
    folder: Annotated[
        Path, typer.Argument(help="Folder with the recordings of one machine, or with folders of contact.json.")
    ],
    out: Out = None,
    use: Used = "auto",
    tolerances: Believed = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Compare every recording in a folder, in the order of their names: what wears, and how fast.

    Example: identify history recordings --out results
    """
    _shown(sources_in(folder), out, use, tolerances, as_json, force)


def _shown(sources: list[Path], out: Path | None, use: str, tolerances: str | None, as_json: bool, force: bool) -> None:
    if use not in get_args(Use):
        raise typer.BadParameter(f"{use!r} is none of {', '.join(get_args(Use))}", param_hint="--use")
    if out is not None:
        for name in ("history.html", "history.csv", "history.json"):
            refuse_existing(out / name, force, *sources, new_folder=True)
    with progress_bar(f"comparing {len(sources)} recordings") as progress:
        found = compared(sources, use=msgspec.convert(use, Use), tolerances=tolerances, progress=progress)
    if out is not None:
        found.save(out)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.encode(found.to_dict()) + b"\n")
        return
    say(str(found))
    table = Table("", "mean", "first to last, ± 95 %", "p, trend", "p, differences", box=SIMPLE_HEAD)
    for row in rows(found.report):
        table.add_row(*row)
    literal_console().print(table)
    for observation in found.report.observations:
        if observation.report is None:
            say(f"left out: {observation.name}: {observation.reason}")
        for finding in observation.report.findings if observation.report else ():
            say(f"{observation.name} is not to be relied on: {finding.sentence}")
