"""The commands of `rig` that bring recordings and rigs back, in and out: recover, import, export, draw."""

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from rig.commands.command_line import (
    Force,
    Json,
    check_file_ending,
    progress_bar,
    progress_spinner,
    refuse_existing,
    say,
)
from rig.errors import one_line
from rig.files import check_source, write_bytes

if TYPE_CHECKING:
    from rig.model.description import Rig
else:
    Rig = Any  # what a command needs of rig.lab and rig.model is imported when it runs: the help is shown at once


def format_help_texts() -> dict[str, str]:
    """Words for the help: suffixes that are read, formats that are written."""
    from rig.lab.exporting import WRITERS
    from rig.lab.tables import READERS

    return {"suffixes": ", ".join(READERS), "formats": ", ".join(WRITERS)}


def recover(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording that was cut off: FILE.mcap or FILE.part.")],
    out: Annotated[Path, typer.Option(help="The recording to write.")],
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Recover the undamaged part of a recording that was cut off or damaged, and print what is lost.

    Example: rig recover barrel_cradle.mcap.part --out saved.mcap
    """
    from rig.recording.recovery import recover as recover_recording

    refuse_existing(out, force, file)
    check_file_ending(out, (".mcap",), "a recording")
    with progress_spinner(f"recovering {file.name}"):
        losses = recover_recording(file, out)
    if as_json:
        print(json.dumps({"recording": str(out), "groups": msgspec.to_builtins(losses)}))
        return
    print(f"{out}: recovered from {file}")
    for loss in losses:
        print(f"  {loss}")


def import_(
    source: Annotated[Path, typer.Argument(metavar="FILE", help="The measured data, a file of {suffixes}.")],
    map_: Annotated[
        Path | None,
        typer.Option("--map", help="The TOML file that says which column is which sensor; without it one is proposed."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The recording to write, with --map.")] = None,
    write_map: Annotated[Path | None, typer.Option(help="Without --map: write the proposed map to this .toml.")] = None,
    rig: Annotated[
        Path | None,
        typer.Option(help="Without --map: the rig.json of the proposed map; otherwise the one beside the map or FILE."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make a recording of data measured elsewhere; without a map, look at the data and propose one.

    Example: rig import run7.csv --write-map run7.toml, then rig import run7.csv --map run7.toml --out run7.mcap
    """
    from rig.lab.importing import import_file

    if map_ is None:
        if out is not None:
            raise typer.BadParameter(
                "a recording needs a --map; leave --out away to have one proposed", param_hint="--out"
            )
        _propose_map(source, write_map, rig, force, as_json)
        return
    if out is None or write_map is not None or rig is not None:
        raise typer.BadParameter("give --out with --map, and neither --write-map nor --rig", param_hint="--map")
    refuse_existing(out, force, source, map_)
    check_file_ending(out, (".mcap",), "a recording")
    with progress_spinner(f"importing {source.name}"):
        history_steps = import_file(source, map_, out)
    if as_json:
        print(json.dumps({"recording": str(out), "history": history_steps}))
        return
    say(f"{out}: imported from {source}; next: identify check {out}")
    for history_step in history_steps:
        say(f"  {history_step}")


def _propose_map(source_path: Path, write_map: Path | None, rig_path: Path | None, force: bool, as_json: bool) -> None:
    """Print the map proposed for a file, or write it and print the observations behind it."""
    from rig.lab.looking import proposed_import_map
    from rig.model.description import read_rig
    from rig.recording import RIG_NAME

    if write_map is not None:
        refuse_existing(write_map, force, source_path)
        check_file_ending(write_map, (".toml",), "a map")
    map_folder = (write_map or source_path).parent
    rig_path = rig_path or next((p for p in (map_folder / RIG_NAME, source_path.parent / RIG_NAME) if p.exists()), None)
    rig_name = RIG_NAME if rig_path is None else Path(os.path.relpath(rig_path, map_folder)).as_posix()
    with progress_spinner(f"looking at {source_path.name}"):
        proposal = proposed_import_map(source_path, None if rig_path is None else read_rig(rig_path), rig_name)
    if write_map is not None:
        write_bytes(proposal.text.encode(), write_map)
    if as_json:
        print(json.dumps({"map": proposal.text, "seen": proposal.facts, "left": proposal.placeholder_count}))
        return
    map_name = write_map or source_path.with_suffix(".toml")
    fill_phrase = (
        f"fill in its {proposal.placeholder_count} values marked ?, then " if proposal.placeholder_count else ""
    )
    next_command = f"{fill_phrase}rig import {source_path} --map {map_name} --out {source_path.with_suffix('.mcap')}"
    if write_map is None:
        print(proposal.text, end="")
        print(one_line(f"# next: save this as {map_name}, {next_command}"))
        return
    for observation in proposal.facts:
        say(observation)
    say(f"{write_map}: written; next: {next_command}")


def export_(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file.")],
    format_: Annotated[str, typer.Option("--format", help="One of: {formats}.")],
    out: Annotated[Path, typer.Option(help="The file to write.")],
    map_: Annotated[
        Path | None, typer.Option("--map", help="Write the map to import it again too, and rig.json beside the map.")
    ] = None,
    force: Force = False,
) -> None:
    """Write the samples of a recording for other programs.

    Example: rig export barrel_cradle.mcap --format csv --out barrel_cradle.csv --map barrel_cradle.toml
    """
    from rig.lab.exporting import FILE_ENDINGS_BY_FORMAT, WRITERS, export
    from rig.recording import RIG_NAME, read

    if format_ not in WRITERS:
        raise typer.BadParameter(f"{format_!r} is none of {', '.join(WRITERS)}", param_hint="--format")
    refuse_existing(out, force, file)
    check_file_ending(out, FILE_ENDINGS_BY_FORMAT[format_], f"a file of the format {format_}")
    written_paths = [out]
    if map_ is not None:
        check_file_ending(map_, (".toml",), "a map")
        refuse_existing(map_, force, file, out)
        written_paths += [map_, map_.with_name(RIG_NAME)]
        refuse_existing(written_paths[-1], force, file, out, map_)
    with progress_bar(f"writing {out.name}") as progress:
        export(read(file), format_, out, map_, progress)
    print(f"{', '.join(map(str, written_paths))}: written")


def _rig_from_file(file: Path) -> Rig:
    """Rig of a rig.json or of a recording."""
    from rig.model.description import read_rig
    from rig.recording import read

    return read_rig(file) if file.suffix == ".json" else read(file).rig


def draw(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A rig.json, or a recording.")],
    out: Annotated[Path | None, typer.Option(help="The .svg to write; otherwise beside the file.")] = None,
    force: Force = False,
) -> None:
    """Draw a rig: bodies, sensors, contacts with their clearances, the force, and what is attached.

    Example: rig draw lab/rig.json --out lab/rig.svg
    """
    from rig.viewer.schematic import draw as draw_rig

    check_source(file)
    svg_path = out or file.with_suffix(".svg")
    refuse_existing(svg_path, force, file)
    check_file_ending(svg_path, (".svg",), "a drawing")
    draw_rig(_rig_from_file(file), svg_path)
    print(f"{svg_path}: written; a browser shows it")


def fmu(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A rig.json, identified or corrected, or a recording.")],
    out: Annotated[Path, typer.Option(help="The .fmu to write.")],
    step: Annotated[float, typer.Option(help="Of the plant, s; communication steps are multiples of it.")] = 2.0**-14,
    force: Force = False,
) -> None:
    """Write a rig as an FMU 3.0 (Co-Simulation): force in, sensors and contacts out.

    Example: rig fmu results/rig.json --out rig.fmu
    """
    from rig.simulation.fmu import export_fmu

    if not 0 < step < math.inf:
        raise typer.BadParameter(f"{step} is not a finite number above zero", param_hint="--step")
    check_source(file)
    refuse_existing(out, force, file)
    check_file_ending(out, (".fmu",), "an FMU")
    export_fmu(_rig_from_file(file), out, step)
    print(f"{out}: written; its force is the value at the end of the next step")


def schema(
    of_map: Annotated[bool, typer.Option("--map", help="That of the import map, a TOML file, instead.")] = False,
) -> None:
    """Print the JSON Schema of rig.json, by which editors complete and check it.

    Name it in rig.json by a first line "$schema": "rig.schema.json", in map.toml (Taplo, Even Better TOML) by
    #:schema map.schema.json

    Example: rig schema > rig.schema.json
    """
    from rig.lab.import_map import Map
    from rig.model.schema import rig_schema, schema_of

    chosen_schema = schema_of(Map, "import map") if of_map else rig_schema()
    print(json.dumps(chosen_schema, indent=2))
