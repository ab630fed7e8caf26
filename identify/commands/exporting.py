"""The option --export of all that draw curves."""

from pathlib import Path
from typing import Annotated

import typer

from identify.pages.tables import WRITERS

Export = Annotated[
    str | None, typer.Option(help=f"Write the curves of the figures to the folder too, as {', '.join(WRITERS)}.")
]


def check_export(export: str | None, out: Path | None) -> None:
    """Raises typer.BadParameter for an unknown format, or without a folder."""
    if export is not None and (export not in WRITERS or out is None):
        sentence = "needs --out, its folder" if export in WRITERS else f"{export!r} is none of {', '.join(WRITERS)}"
        raise typer.BadParameter(sentence, param_hint="--export")
