"""Options and output that several commands share."""

import sys
from pathlib import Path
from typing import Annotated, Any, get_args

import msgspec
import typer

from identify.pages.tables import WRITERS
from identify.signals.kinematics import Use

UseOption = Annotated[str, typer.Option(help=f"Which sensors: {', '.join(get_args(Use))}.")]
TolerancesOption = Annotated[
    str | None,
    typer.Option(help="How exactly rig.json is believed: laboratory, exact, or a TOML file; else as it says itself."),
]
ExportOption = Annotated[
    str | None, typer.Option(help=f"Write the curves of the figures to the folder too, as {', '.join(WRITERS)}.")
]


def checked_use(use: str) -> Use:
    """Sensors to use; raises typer.BadParameter for an unknown name."""
    if use not in get_args(Use):
        raise typer.BadParameter(f"{use!r} is none of {', '.join(get_args(Use))}", param_hint="--use")
    return msgspec.convert(use, Use)


def check_export(export: str | None, out: Path | None) -> None:
    """Raises typer.BadParameter for an unknown format, or without a folder."""
    if export is not None and (export not in WRITERS or out is None):
        sentence = "needs --out, its folder" if export in WRITERS else f"{export!r} is none of {', '.join(WRITERS)}"
        raise typer.BadParameter(sentence, param_hint="--export")


def print_json(value: Any) -> None:
    """Write a value as a line of JSON to standard output."""
    sys.stdout.buffer.write(msgspec.json.encode(value) + b"\n")
