"""The blind check of the diagnosis: cases whose answers are sealed and hashed before anything is diagnosed.

python -m tests.campaigns.blind_gap make --world wide --cases 60 --seed 7000 --out out/blind
python -m tests.campaigns.blind_gap diagnose --cases out/blind --out out/found
python -m tests.campaigns.blind_gap score --cases out/blind --found out/found --out out/score
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from rig.commands.command_line import Force, refuse_existing, run
from rig.commands.tasks import Dask, run_tasks
from rig.files import write_json
from rig.model.tolerances import tolerances_named
from tests.campaigns import score_figures
from tests.campaigns.blind_comparison import by_world, check_recordings, opened, pairs_of, refused_in, seal
from tests.campaigns.blind_diagnosis import diagnosed_cases
from tests.campaigns.calibration import calibrated, calibrated_temperature, hypotheses_of
from tests.campaigns.score_table import calibration_told, limits_told, shown, temperature_told
from tests.campaigns.scoreboard import scored
from tests.campaigns.tolerance_sensitivity import settings, table_of
from tests.campaigns.true_effect import best_of
from tests.campaigns.worlds.making import made, planned
from tests.campaigns.worlds.truth import Case, Key, World

app = typer.Typer(pretty_exceptions_enable=False, no_args_is_help=True)
Cases = Annotated[Path, typer.Option("--cases", help="Folder that `make` wrote.")]
Found = Annotated[Path, typer.Option("--found", help="Folder that `diagnose` wrote.")]
Also = Annotated[list[str] | None, typer.Option("--also", help="More folders, as CASES:FOUND; may be repeated.")]

WIDTH = 170


@app.callback()
def main() -> None:
    """The blind check of the diagnosis: make the cases, diagnose them, score what was found."""


@app.command()
def make(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and the sealed key.")],
    world: Annotated[World, typer.Option(help="How far reality is from what is believed.")] = "own",
    cases: Annotated[int, typer.Option(min=1, help="How many.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Everything is drawn from it.")] = 7000,
    nulls_only: Annotated[bool, typer.Option("--nulls-only", help="Tolerances alone, no effects.")] = False,
    duration: Annotated[float, typer.Option(min=1.5, help="Length of each record, s.")] = 30.0,
    dask: Dask = None,
    force: Force = False,
) -> None:
    """Records the cases and seals their answers; run again after an interruption, it goes on."""
    plans = planned(out, world, seed, cases, duration, nulls_only)
    refuse_existing(out / "key.sha256", force, new_folder=True)
    (out / "recordings").mkdir(parents=True, exist_ok=True)
    (out / "sealed" / "work").mkdir(parents=True, exist_ok=True)
    answers = run_tasks(made, plans, Case, out / "sealed" / "tasks", dask)
    check_recordings(out, answers)
    answered = Key(world=world, seed=seed, nulls_only=nulls_only, duration_s=duration, cases=tuple(answers))
    console = Console()
    _seal_limits(out, answers, dask, console)
    digest = seal(answered, out, "key")
    console.print(f"{len(answers)} cases in {out / 'recordings'}, answers in {out / 'sealed'}")
    console.print(f"sha256 of the answers: {digest}", soft_wrap=True)


@app.command()
def limits(cases: Cases, dask: Dask = None, force: Force = False) -> None:
    """Lays and seals the detection limits of cases that were made without; before anything is tuned on them."""
    refuse_existing(cases / "limits.sha256", force)
    key = opened(cases)
    check_recordings(cases, key.cases)
    _seal_limits(cases, key.cases, dask, Console())


def _seal_limits(folder: Path, answers: Sequence[Case], dask: str | None, console: Console) -> None:
    best = best_of(answers, folder / "recordings", folder / "sealed" / "tasks", dask)
    digest = seal(dict(zip((answer.case for answer in answers), best, strict=True)), folder, "limits")
    console.print(f"sha256 of the detection limits: {digest}", soft_wrap=True)


@app.command()
def diagnose(
    cases: Cases,
    out: Annotated[Path, typer.Option(help="Folder for what is found.")],
    tolerances: Annotated[
        str | None,
        typer.Option(help="How exactly the rigs are believed: laboratory, exact, or a TOML file; else as they say."),
    ] = None,
    null_references_of: Annotated[
        Path | None, typer.Option(help="Folder of null references of another run; what lacks there is made.")
    ] = None,
    dask: Dask = None,
) -> None:
    """Diagnoses every case from its recordings alone; run again after an interruption, it goes on."""
    believed = tolerances_named(tolerances) if tolerances else None
    found = diagnosed_cases(cases / "recordings", out, believed, null_references_of, dask)
    console = Console()
    console.print(f"{len(found)} diagnoses in {out / 'found.json'}", soft_wrap=True)
    _tell_refusals(out, console)


@app.command()
def score(
    cases: Cases,
    found: Found,
    out: Annotated[Path, typer.Option(help="Folder for score.json and the figures.")],
    also: Also = None,
) -> None:
    """Opens the sealed answers, if they are those that were hashed, and compares."""
    pairs = pairs_of(cases, found, also or ())
    worlds = by_world(pairs)
    every = [c for compared in worlds.values() for c in compared]
    groups = worlds | {"all": every} if len(worlds) > 1 else worlds
    boards = {name: scored(compared) for name, compared in groups.items()}
    reliability = {name: calibrated(compared) for name, compared in groups.items()}
    out.mkdir(parents=True, exist_ok=True)
    write_json({"worlds": boards, "calibration": reliability}, out / "score.json")
    figures = score_figures.drawn(every, out)
    console = _wide_console()
    console.print(shown(boards, f"{len(every)} blind cases"))
    for name, board in boards.items():
        console.print(f"{name}: {calibration_told(reliability[name])}", soft_wrap=True)
        console.print(f"{name}: detection limits, of the default magnitude: {limits_told(board)}", soft_wrap=True)
    console.print(f"figures: {', '.join(p.name for p in figures)} in {out}", soft_wrap=True)
    for folder, found_in in pairs:
        digest = (folder / "limits.sha256").read_text().strip()
        console.print(f"{folder}: sha256 of the detection limits: {digest}", soft_wrap=True)
        _tell_refusals(found_in, console)


@app.command()
def calibrate(cases: Cases, found: Found, also: Also = None) -> None:
    """The temperature of the posterior at which tuning cases find their right answers likeliest."""
    worlds = by_world(pairs_of(cases, found, also or ()))
    known = [hypotheses_of(c, c.gap) for compared in worlds.values() for c in compared if c.gap]
    tempered = calibrated_temperature(known)
    Console().print(temperature_told(tempered), soft_wrap=True)


@app.command()
def sensitivity(
    cases: Cases,
    out: Annotated[Path, typer.Option(help="Folder for what is found with each tolerance, and the scores.")],
    only: Annotated[str | None, typer.Option(help="One tolerance alone, by its name.")] = None,
    dask: Dask = None,
) -> None:
    """Diagnoses and scores the cases with each default tolerance doubled and halved; it takes hours, and goes on."""
    boards = {}
    for name, tolerances in settings(only):
        diagnosed_cases(cases / "recordings", out / name, tolerances, dask=dask)
        worlds = by_world([(cases, out / name)])
        boards[name] = scored([c for compared in worlds.values() for c in compared])
    write_json(boards, out / "sensitivity.json")
    _wide_console().print(table_of(boards))


def _tell_refusals(folder: Path, console: Console) -> None:
    for refused in refused_in(folder):
        what = "crashed" if refused.crashed else "was refused"
        console.print(f"{folder}: {refused.case} {what}: {refused.sentence}", soft_wrap=True)


def _wide_console() -> Console:
    """As wide as the tables where no terminal sets a width."""
    return Console() if sys.stdout.isatty() else Console(width=WIDTH)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("tests.campaigns.blind_gap").app, "tests.campaigns.blind_gap")
