"""The command `rig view`: a recording for the rerun viewer, with what was identified and diagnosed."""

import math
import os
from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from rig.commands.command_line import Force, check_file_ending, progress_bar, progress_spinner, refuse_existing
from rig.extras import needs_extra
from rig.files import check_source


def view(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file.")],
    out: Annotated[Path | None, typer.Option(help="The .rrd to write; otherwise beside the recording.")] = None,
    truth: Annotated[Path | None, typer.Option(help="The truth file; otherwise the one beside the recording.")] = None,
    contact: Annotated[
        Path | None,
        typer.Option(
            help="A contact.json of `identify contact`, or its folder: its walls; where there is no truth file, with "
            "`--export csv` or `parquet` also its relative displacements and separated forces."
        ),
    ] = None,
    gap: Annotated[
        Path | None,
        typer.Option(
            help="A gap.json of `identify gap`, or its folder: where and when the gap acts, with the verdict; with the "
            "corrected rig.json beside it also how both rigs predict the motion."
        ),
    ] = None,
    station: Annotated[
        str | None,
        typer.Option(
            help="With --gap: sensor, contact or body whose predicted displacement is shown; otherwise the station "
            "where the believed rig errs most."
        ),
    ] = None,
    magnification: Annotated[float | None, typer.Option(help="Of the beams' deflection; otherwise chosen.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve it to a browser on this computer; Ctrl-C ends it.")] = False,
    force: Force = False,
) -> None:
    """Write a recording for the rerun viewer, and open it where there is a display.

    Example: rig view barrel_cradle.mcap --contact results/contact.json --out barrel_cradle.rrd
    """
    from rig.recording import read, read_truth, truth_path
    from rig.simulation.prediction import modal

    with needs_extra("view", "rig view (rerun)"):
        from rig.viewer.deflection import deflection
        from rig.viewer.gap import read_corrected_rig, read_gap
        from rig.viewer.identified import NOTHING_IDENTIFIED, read_identified
        from rig.viewer.prediction import WINDOW_S, predicted_motion
        from rig.viewer.viewing import open_viewer, write_rrd
        from rig.viewer.web import LOOPBACK, serve

    if magnification is not None and not 0 < magnification < math.inf:
        raise typer.BadParameter(f"{magnification} is not a finite number above zero", param_hint="--magnification")
    check_source(file)
    rrd_path = out or file.with_suffix(".rrd")
    truth_file_path = truth or truth_path(file)
    refuse_existing(rrd_path, force, file, truth_file_path, *(path for path in (contact, gap) if path is not None))
    check_file_ending(rrd_path, (".rrd",), "a view")
    recording = read(file)
    truth_recording = read_truth(truth_file_path) if truth or truth_file_path.exists() else None
    identified_contacts = NOTHING_IDENTIFIED
    if contact is not None:
        identified_contacts = read_identified(contact, recording.rig, recording.duration_s)
    shown_gap, prediction = None, None
    if gap is not None:
        shown_gap = read_gap(gap, recording.rig, recording.duration_s)
        if (corrected_rig := read_corrected_rig(gap, recording.rig)) is not None:
            shown_motion, window_s = deflection(recording, truth_recording), max(shown_gap.horizon_s, WINDOW_S)
            with progress_spinner("predicting the believed and the corrected rig"):
                prediction = predicted_motion(recording, shown_motion, corrected_rig, modal, window_s, station)
    with progress_bar(f"writing {rrd_path.name}") as progress:
        write_rrd(
            recording,
            truth_recording,
            rrd_path,
            magnification,
            identified_contacts=identified_contacts,
            gap=shown_gap,
            prediction=prediction,
            progress=progress,
        )
    opens_viewer = out is None and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    next_words = "" if web or opens_viewer else f"; open it: rerun --bind {LOOPBACK} {quote(str(rrd_path))}"
    print(f"{rrd_path}: written{next_words}", flush=True)
    if web:
        serve(rrd_path, lambda address: print(f"open {address}; Ctrl-C ends it", flush=True))
    elif opens_viewer:
        open_viewer(rrd_path)
