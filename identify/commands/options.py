"""The options that several commands have."""

from pathlib import Path
from typing import Annotated, get_args

import typer

from identify.pages.tables import WRITERS
from identify.signals.kinematics import Use

Used = Annotated[str, typer.Option(help=f"Which sensors: {', '.join(get_args(Use))}.")]
Believed = Annotated[
    str | None,
    typer.Option(help="How exactly rig.json is believed: laboratory, exact, or a TOML file; else as it says itself."),
]
Export = Annotated[
    str | None, typer.Option(help=f"Write the curves of the figures to the folder too, as {', '.join(WRITERS)}.")
]


def check_export(export: str | None, out: Path | None) -> None:
    """Raises typer.BadParameter for an unknown format, or without a folder."""
    if export is not None and (export not in WRITERS or out is None):
        sentence = "needs --out, its folder" if export in WRITERS else f"{export!r} is none of {', '.join(WRITERS)}"
        raise typer.BadParameter(sentence, param_hint="--export")
