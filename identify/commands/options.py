"""Options and output that several commands share."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import msgspec
import typer

from rig.commands.command_line import say

if TYPE_CHECKING:
    from identify.signals.kinematics import MotionQuantity
else:
    MotionQuantity = str  # what a command needs of the other rooms is imported when it runs: the help is shown at once

UseOption = Annotated[str, typer.Option(help="Which sensors: {use}.")]
TolerancesOption = Annotated[
    str | None,
    typer.Option(help="How exactly rig.json is believed: laboratory, exact, or a TOML file; else as it says itself."),
]
ExportOption = Annotated[
    str | None, typer.Option(help="Write the curves of the figures to the folder too, as {table_formats}.")
]


def option_help_words() -> dict[str, str]:
    """Words for the help of the options: sensors, windows, formats of tables."""
    from identify.pages.tables import WRITERS
    from identify.signals.kinematics import MotionQuantity
    from identify.signals.spectra import WINDOW_EXPONENTS

    return {
        "use": ", ".join(get_args(MotionQuantity)),
        "windows": ", ".join(WINDOW_EXPONENTS),
        "table_formats": ", ".join(WRITERS),
    }


def checked_use(use: str) -> MotionQuantity:
    """Sensors to use; raises typer.BadParameter for an unknown name."""
    from identify.signals.kinematics import MotionQuantity

    if use not in get_args(MotionQuantity):
        raise typer.BadParameter(f"{use!r} is none of {', '.join(get_args(MotionQuantity))}", param_hint="--use")
    return msgspec.convert(use, MotionQuantity)


def check_export(export: str | None, out: Path | None) -> None:
    """Raise typer.BadParameter for an unknown format, or without a folder."""
    from identify.pages.tables import WRITERS

    if export is not None and (export not in WRITERS or out is None):
        error_words = "needs --out, its folder" if export in WRITERS else f"{export!r} is none of {', '.join(WRITERS)}"
        raise typer.BadParameter(error_words, param_hint="--export")


def say_written(folder: Path, page_name: str, *others: str) -> None:
    """Print which page was written and is to be opened, and what lies beside it."""
    say(f"{folder / page_name}: written, open it in a browser; beside it {', '.join(others)}")


def print_json(value: Any) -> None:
    """Write a value as a line of JSON to standard output."""
    sys.stdout.buffer.write(msgspec.json.encode(value) + b"\n")
