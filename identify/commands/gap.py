"""The command `identify gap`."""

from pathlib import Path
from typing import Annotated

import typer

from identify.commands.options import ExportOption, TolerancesOption, check_export, print_json
from rig.commands.command_line import Force, Json, literal_console, print_sentence, progress_bar, refuse_existing
from rig.commands.tasks import Dask
from rig.errors import RigError


def gap(
    real: Annotated[
        list[Path],
        typer.Argument(
            metavar="REAL",
            help="Recordings of reality, one or more of one rig, or a folder of recordings; their rig.json is believed "
            "unless --rig is given.",
        ),
    ],
    validate: Annotated[
        Path | None,
        typer.Option(
            help="Recording held back to test the answer, one of REAL or another; by default the last one given, or "
            "the last 45 % of a single one."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for gap.json, gap.html and the corrected rig.json.")] = None,
    rig: Annotated[
        Path | None, typer.Option(help="A rig.json that is believed instead of the one in the recordings.")
    ] = None,
    simulator: Annotated[
        str, typer.Option(help="What simulates the rig: modal, ancf, or one that you installed.")
    ] = "modal",
    null_reference: Annotated[
        Path | None,
        typer.Option(
            help="File that keeps the simulations of a correct machine, reused between runs; by default beside the "
            "first recording, of a folder in --out."
        ),
    ] = None,
    tolerances: TolerancesOption = None,
    matters: Annotated[
        float, typer.Option(min=0.0, help="A gap below this share of the acceleration does not matter, %.")
    ] = 0.5,
    matters_contact: Annotated[
        float, typer.Option(min=0.0, help="... or below this share of every contact force, %.")
    ] = 3.0,
    next_experiment: Annotated[
        bool,
        typer.Option(
            "--next-experiment", help="Compute which further recording would tell two causes apart (minutes)."
        ),
    ] = False,
    export: ExportOption = None,
    dask: Dask = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Diagnose where your rig.json differs from reality, which effects cause it, and how far the mismatch shrinks.

    Example: identify gap monday.mcap --validate tuesday.mcap --out results

    Example: identify gap january.mcap april.mcap july.mcap --out results

    Example: identify gap recordings --out results

    Each recording of a folder is diagnosed by itself: fitted to its first part, judged on its last. The results go to
    DIR/NAME, one table to DIR/gaps.csv and .parquet; the same command goes on after an interruption. Exit status 1 if
    recordings were refused.
    """
    from identify.api import gap as diagnose
    from identify.commands.gap_folder import GapSettings, gap_folder
    from identify.commands.many import check_folder_options
    from identify.gaps.page.report import curves
    from identify.gaps.page.screen import screen_view
    from identify.gaps.results import Matters
    from identify.gaps.wording import check_findings_introduction
    from identify.pages.tables import save_tables
    from rig.model.description import read_rig, to_json
    from rig.model.tolerances import tolerances_named

    check_export(export, out)
    matters_shares = Matters(matters / 100, matters_contact / 100)
    if any(path.is_dir() for path in real):
        if len(real) > 1:
            raise RigError(f"{len(real)} names with a folder among them; give one folder, or recordings")
        settings = GapSettings(
            simulator=simulator,
            tolerances=tolerances_named(tolerances) if tolerances else None,
            matters=matters_shares,
            next_experiment=next_experiment,
            rig=None if rig is None else to_json(read_rig(rig)).decode(),
            null_reference=None if null_reference is None else str(null_reference.absolute()),
            export=export,
        )
        results_folder = check_folder_options(real[0], out, validate=validate)
        gap_folder(real[0], results_folder, settings, dask, as_json, force)
        return
    if dask is not None:
        raise typer.BadParameter("is for a folder of recordings", param_hint="--dask")
    if out is not None:
        source_paths = [*real, *(path for path in (validate, null_reference, rig) if path)]
        for file_name in ("gap.json", "gap.html", "rig.json"):
            refuse_existing(out / file_name, force, *source_paths, new_folder=True)
    stage_spans = {"null_reference": (0.0, 0.6), "causes": (0.6, 0.4)}
    with progress_bar(f"diagnosing {', '.join(path.name for path in real)}") as progress:

        def show_progress(stage: str, stage_fraction: float) -> None:
            start_share, length_share = stage_spans[stage]
            progress(start_share + length_share * stage_fraction)

        gap_result = diagnose(
            real,
            validate,
            simulator=simulator,
            null_reference=null_reference or real[0].parent,
            tolerances=tolerances,
            matters=matters_shares,
            next_experiment=next_experiment,
            rig=rig,
            progress=show_progress,
        )
    if out is not None:
        gap_result.save(out)
        if export is not None:
            save_tables(curves(gap_result.report), out, export)
    if as_json:
        print_json(gap_result.report)
    else:
        console = literal_console()
        console.print(screen_view(gap_result.report))
        if gap_result.findings:
            print_sentence(check_findings_introduction(gap_result.report), console)
        for finding in gap_result.findings:
            print_sentence(f"  {finding.sentence}", console)
