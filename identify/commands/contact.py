"""The command `identify contact`, for a recording or for a folder of them."""

from pathlib import Path
from typing import Annotated

import typer

from identify.commands.options import (
    ExportOption,
    TolerancesOption,
    UseOption,
    check_export,
    checked_use,
    print_json,
    say_written,
)
from rig.commands.command_line import Force, Json, literal_console, progress_bar, refuse_existing
from rig.commands.tasks import Dask

DRAWING_START_SHARE = 0.8
"""Share of the progress at which results are drawn."""


def contact(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The recording, an .mcap file, or a folder of them.")],
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for contact.json, the identified rig.json, the figures and contact.html, a page."),
    ] = None,
    use: UseOption = "auto",
    equation: Annotated[str | None, typer.Option(help='Main modal equation, e.g. "barrel 3".')] = None,
    averages: Annotated[int, typer.Option(help="How many blocks to average over.")] = 40,
    block: Annotated[float | None, typer.Option(help="Length of a block, s; otherwise from the averages.")] = None,
    overlap: Annotated[float, typer.Option(help="Overlap of the blocks, 0 to below 1.")] = 0.5,
    window: Annotated[str, typer.Option(help="Window: {windows}.")] = "hann",
    tolerances: TolerancesOption = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Frequency band of the NIFO plots, Hz; by default that of the force."),
    ] = None,
    segment: Annotated[
        float | None,
        typer.Option(help="Identify so many seconds at a time and pool them, as is done with files of over 64 MB."),
    ] = None,
    export: ExportOption = None,
    details: Annotated[
        bool, typer.Option("--details", help="Print NIFO by modal equation and the modes it finds, too.")
    ] = False,
    dask: Dask = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Clearance and stiffness of every contact of a recording, or of all recordings of a folder.

    A folder needs --out DIR: the results of each recording go to DIR/NAME, one table of all contacts to
    DIR/contacts.csv and .parquet. The same command goes on after an interruption. Exit status 1 if recordings were
    refused.

    Examples: identify contact barrel_cradle.mcap --use acceleration --out results

    identify contact recordings --out results
    """
    from identify.commands.contact_files import RESULT_FILE_NAMES, ContactSettings, identify_file, print_report
    from identify.commands.contact_folder import contact_folder
    from identify.commands.many import check_folder_options
    from identify.signals.spectra import WINDOW_EXPONENTS, Averaging
    from rig.model.tolerances import tolerances_named

    motion_quantity = checked_use(use)
    if window not in WINDOW_EXPONENTS:
        raise typer.BadParameter(f"{window!r} is none of {', '.join(WINDOW_EXPONENTS)}", param_hint="--window")
    check_export(export, out)
    settings = ContactSettings(
        use=motion_quantity,
        averaging=Averaging(averages=averages, block_s=block, overlap=overlap, window=window, band_hz=band),
        equation=equation,
        tolerances=tolerances_named(tolerances) if tolerances else None,
        segment_s=segment,
        export=export,
    )
    if file.is_dir():
        contact_folder(file, check_folder_options(file, out, details=details), settings, dask, as_json, force)
        return
    if dask is not None:
        raise typer.BadParameter("is for a folder of recordings", param_hint="--dask")
    if out is not None:
        for file_name in RESULT_FILE_NAMES:
            refuse_existing(out / file_name, force, file, new_folder=True)
    with progress_bar(f"identifying {file.name}") as progress:
        identifying_share = 1.0 if out is None else DRAWING_START_SHARE
        file_answer = identify_file(file, settings, lambda share: progress(identifying_share * share))
        if out is not None:
            file_answer.save(out)
    if as_json:
        print_json(file_answer.report)
    else:
        print_report(file_answer.report, literal_console(), details)
        if out is not None:
            has_page = (out / "contact.html").exists()  # which a long record, pooled by segments, does not get
            say_written(out, "contact.html" if has_page else "segments.png", "contact.json", "the identified rig.json")
