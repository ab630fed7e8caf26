"""The commands of `rig` that bring recordings and rigs back, in and out: recover, import, export, draw."""

import json
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer

from rig.commands.command_line import Force, Json, progress_bar, refuse_existing, say, working
from rig.files import check_source
from rig.lab.exporting import WRITERS, export
from rig.lab.importing import Map, import_file
from rig.model.description import read_rig
from rig.model.schema import rig_schema, schema_of
from rig.recording import read
from rig.recording.recovery import recover as recover_recording


def recover(
    bad: Annotated[Path, typer.Argument(metavar="FILE", help="A recording that was cut off: FILE.mcap or FILE.part.")],
    out: Annotated[Path, typer.Option(help="The recording to write.")],
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Save what is sound of a recording that was cut off or damaged, and say what is lost.

    Example: rig recover barrel_cradle.mcap.part --out saved.mcap
    """
    refuse_existing(out, force, bad)
    with working(f"recovering {bad.name}"):
        losses = recover_recording(bad, out)
    if as_json:
        print(json.dumps({"recording": str(out), "groups": msgspec.to_builtins(losses)}))
        return
    print(f"{out}: recovered from {bad}")
    for loss in losses:
        print(f"  {loss}")


def import_(
    source: Annotated[Path, typer.Argument(help="The measured data: .csv, .txt, .uff, .unv, .mat or .tdms.")],
    map_: Annotated[Path, typer.Option("--map", help="The TOML file that says which column is which sensor.")],
    out: Annotated[Path, typer.Option(help="The recording to write.")],
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make a recording of data measured elsewhere.

    Example: rig import run7.csv --map run7.toml --out run7.mcap
    """
    refuse_existing(out, force, source, map_)
    with working(f"importing {source.name}"):
        steps = import_file(source, map_, out)
    if as_json:
        print(json.dumps({"recording": str(out), "history": steps}))
        return
    print(f"{out}: imported from {source}; next: identify check {out}")
    for step in steps:
        say(f"  {step}")


def export_(
    file: Annotated[Path, typer.Argument(help="The recording, an .mcap file.")],
    format_: Annotated[str, typer.Option("--format", help=f"One of: {', '.join(WRITERS)}.")],
    out: Annotated[Path, typer.Option(help="The file to write.")],
    map_: Annotated[
        Path | None, typer.Option("--map", help="Write the map to import it again too, and rig.json beside the map.")
    ] = None,
    force: Force = False,
) -> None:
    """Write the samples of a recording for other programs.

    Example: rig export barrel_cradle.mcap --format csv --out barrel_cradle.csv --map barrel_cradle.toml
    """
    if format_ not in WRITERS:
        raise typer.BadParameter(f"{format_!r} is none of {', '.join(WRITERS)}", param_hint="--format")
    refuse_existing(out, force, file)
    written = [out]
    if map_ is not None:
        refuse_existing(map_, force, file, out)
        written += [map_, map_.with_name("rig.json")]
        refuse_existing(written[-1], force, file, out, map_)
    with progress_bar(f"writing {out.name}") as progress:
        export(read(file), format_, out, map_, progress)
    print(f"{', '.join(map(str, written))}: written")


def draw(
    file: Annotated[Path, typer.Argument(help="A rig.json, or a recording.")],
    out: Annotated[Path | None, typer.Option(help="The .svg to write; otherwise beside the file.")] = None,
    force: Force = False,
) -> None:
    """Draw a rig: bodies, sensors, contacts with their clearances, the force, and what is attached.

    Example: rig draw lab/rig.json --out lab/rig.svg
    """
    from rig.viewer.schematic import draw as draw_rig

    check_source(file)
    target = out or file.with_suffix(".svg")
    refuse_existing(target, force, file)
    draw_rig(read_rig(file) if file.suffix == ".json" else read(file).rig, target)
    print(f"{target}: written; a browser shows it")


def fmu(
    file: Annotated[Path, typer.Argument(help="A rig.json, identified or corrected, or a recording.")],
    out: Annotated[Path, typer.Option(help="The .fmu to write.")],
    step: Annotated[float, typer.Option(help="Of the plant, s; communication steps are multiples of it.")] = 2.0**-14,
    force: Force = False,
) -> None:
    """Write a rig as an FMU 3.0 (Co-Simulation): force in, sensors and contacts out.

    Example: rig fmu results/rig.json --out rig.fmu
    """
    from rig.simulation.fmu import export_fmu

    if not 0 < step < np.inf:
        raise typer.BadParameter(f"{step} is not a finite number above zero", param_hint="--step")
    check_source(file)
    refuse_existing(out, force, file)
    export_fmu(read_rig(file) if file.suffix == ".json" else read(file).rig, out, step)
    print(f"{out}: written; its force is the value at the end of the next step")


def schema(
    of_map: Annotated[bool, typer.Option("--map", help="That of the import map, a TOML file, instead.")] = False,
) -> None:
    """Print the JSON Schema of rig.json, by which editors complete and check it.

    Name it in rig.json by a first line "$schema": "rig.schema.json", in map.toml (Taplo, Even Better TOML) by
    #:schema map.schema.json

    Example: rig schema > rig.schema.json
    """
    chosen = schema_of(Map, "import map") if of_map else rig_schema()
    print(json.dumps(chosen, indent=2))
