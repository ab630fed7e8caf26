"""The command `identify gap`."""

import hashlib
import sys
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from identify.gap.answer import diagnose
from identify.gap.floor import Simulate
from rig.command_line import Force, Json, progress_bar, refuse_existing
from rig.description import Rig, to_json
from rig.errors import RigError
from rig.recording import read

SIMULATORS = "identify.simulators"
"""The entry points by which packages offer simulators."""


def gap(
    real: Annotated[Path, typer.Argument(help="The recording of reality; its rig.json is the rig that is believed.")],
    validate: Annotated[
        Path | None,
        typer.Option(help="Another recording of it, at another level of force; otherwise REAL is cut in two."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for gap.json, gap.html and the corrected rig.json.")] = None,
    simulator: Annotated[
        str, typer.Option(help="What simulates the rig: modal, ancf, or one that you installed.")
    ] = "modal",
    floor: Annotated[
        Path | None, typer.Option(help="File of the floor, made if it is not there; otherwise one beside REAL.")
    ] = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Where the believed rig differs from reality, which effect causes it, and how far the gap shrinks with it.

    Example: identify gap monday.mcap --validate tuesday.mcap --out results
    """
    if out is not None:
        refuse_existing(out / "gap.json", force)
    simulate = simulator_named(simulator)
    recording = read(real)
    validation = read(validate) if validate else None
    kept = floor or real.with_name(f"{recording.rig.name}-{_mark(recording.rig)}-{simulator}.floor.json")
    with progress_bar(f"diagnosing {real.name}") as progress:
        share = 0.0 if not kept.exists() else None

        def show(stage: str, fraction: float) -> None:
            whole = fraction if share is None else 0.7 * fraction if stage == "floor" else 0.7 + 0.3 * fraction
            progress(whole)

        with threadpool_limits(1):  # the matrices are small
            found, corrected = diagnose(recording, validation, simulate, kept, show)
    if out is not None:
        from identify.gap.report import write_all

        write_all(found, corrected, f"{recording.rig.name}: {real.name}", out)
    if as_json:
        sys.stdout.buffer.write(msgspec.json.encode(found) + b"\n")
    else:
        from identify.gap.report import shown

        Console().print(shown(found))


def simulator_named(name: str) -> Simulate:
    """The simulator that an installed package offers under this name; raises RigError if none does."""
    offered = {point.name: point for point in entry_points(group=SIMULATORS)}
    if name not in offered:
        raise RigError(f"no simulator {name!r}; there are {', '.join(sorted(offered))}")
    simulate: Simulate = offered[name].load()
    return simulate


def _mark(rig: Rig) -> str:
    return hashlib.sha256(to_json(rig)).hexdigest()[:8]
