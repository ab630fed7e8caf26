"""The blind check of the diagnosis: cases whose answers are sealed and hashed before anything is diagnosed.

python -m scenarios.blind_gap make --world wide --cases 60 --seed 7000 --out out/blind
python -m scenarios.blind_gap diagnose --cases out/blind --out out/found
python -m scenarios.blind_gap score --cases out/blind --found out/found --out out/score
"""

import hashlib
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from identify.gap.answer import diagnose as diagnosis
from identify.gap.answer import loudest
from identify.gap.floor import floors_of
from rig import replay
from rig.command_line import Force, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.recording import Recording, read
from scenarios import score_figures
from scenarios.scoreboard import Compared, Diagnosis, Score, scored
from scenarios.tasks import Dask, run_tasks
from scenarios.true_effect import best_of
from scenarios.worlds.making import made, planned, sha256_of
from scenarios.worlds.truth import Case, Key, World

T = TypeVar("T")
app = typer.Typer(pretty_exceptions_enable=False, no_args_is_help=True)
Cases = Annotated[Path, typer.Option("--cases", help="Folder that `make` wrote.")]


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
    key_path, hash_path = out / "sealed" / "key.json", out / "key.sha256"
    plans = planned(out, world, seed, cases, duration, nulls_only)
    refuse_existing(hash_path, force)
    (out / "recordings").mkdir(parents=True, exist_ok=True)
    (out / "sealed" / "work").mkdir(parents=True, exist_ok=True)
    answers = run_tasks(made, plans, Case, out / "sealed" / "tasks", dask)
    check_recordings(out, answers)
    answered = Key(world=world, seed=seed, nulls_only=nulls_only, duration_s=duration, cases=tuple(answers))
    key = msgspec.json.format(msgspec.json.encode(answered), indent=2)
    _written(key_path, key)
    digest = hashlib.sha256(key).hexdigest()
    _written(hash_path, f"{digest}\n".encode())
    console = Console()
    console.print(f"{len(answers)} cases in {out / 'recordings'}, answers in {key_path}")
    console.print(f"sha256 of the answers: {digest}", soft_wrap=True)


def diagnosis_of(fit: Recording, validate: Recording, floor: str) -> Diagnosis:
    """The one place where the tool under test is called; `floor` is the file of what null recordings leave."""
    gap, _ = diagnosis(fit, validate, replay.modal, Path(floor))
    return msgspec.convert(msgspec.to_builtins(gap), Diagnosis)


class ToDiagnose(msgspec.Struct, frozen=True):
    """One case as its diagnosis sees it."""

    case: str
    fit: str
    validate: str
    floor: str
    sha256: dict[str, str]


class Found(msgspec.Struct, frozen=True):
    """The diagnosis of one case, and of which recordings it is."""

    case: str
    sha256: dict[str, str]
    diagnosis: Diagnosis


@app.command()
def diagnose(
    cases: Cases,
    out: Annotated[Path, typer.Option(help="Folder for what is found.")],
    floor: Annotated[Path | None, typer.Option(help="File of the floor; made with Exudyn if it is not there.")] = None,
    dask: Dask = None,
) -> None:
    """Diagnoses every case from its recordings alone; run again after an interruption, it goes on."""
    fits = sorted(p for p in (cases / "recordings").glob("*.mcap") if not p.stem.endswith("_validate"))
    if not fits:
        raise RigError(f"{cases / 'recordings'}: has no recordings; make the cases first")
    kept = floor or out / "floor.json"
    if not kept.exists():
        loud = loudest(map(read, sorted((cases / "recordings").glob("*.mcap"))))
        with threadpool_limits(1), progress_bar("the floor: nulls with Exudyn") as progress:
            floors_of(loud.rig, loud.force_n, replay.ancf, progress, kept)
    tasks = []
    for fit in fits:
        validate = fit.with_name(f"{fit.stem}_validate.mcap")
        hashes = {path.name: sha256_of(path) for path in (fit, validate)}
        tasks.append(ToDiagnose(fit.stem, str(fit), str(validate), str(kept), hashes))
    found = run_tasks(diagnosed, tasks, Found, out / "tasks", dask)
    _written(out / "found.json", msgspec.json.format(msgspec.json.encode(found), indent=2))
    Console().print(f"{len(found)} diagnoses in {out / 'found.json'}", soft_wrap=True)


def diagnosed(task: ToDiagnose) -> Found:
    """Reads the two recordings of a case and diagnoses them; the time is that of this process."""
    began = time.process_time()
    diagnosis = diagnosis_of(read(Path(task.fit)), read(Path(task.validate)), task.floor)
    return Found(task.case, task.sha256, msgspec.structs.replace(diagnosis, cpu_s=time.process_time() - began))


@app.command()
def score(
    cases: Cases,
    found: Annotated[Path, typer.Option(help="Folder that `diagnose` wrote.")],
    out: Annotated[Path, typer.Option(help="Folder for score.json and the figures.")],
    floor: Annotated[Path | None, typer.Option(help="File of the floor, if it is not beside what was found.")] = None,
) -> None:
    """Opens the sealed answers, if they are those that were hashed, and compares."""
    answers = opened(cases).cases
    check_recordings(cases, answers)
    compared = beside(answers, _decoded(found / "found.json", list[Found]))
    best = best_of(compared, cases / "recordings", floor or found / "floor.json", out / "tasks")
    board = scored(compared, best)
    out.mkdir(parents=True, exist_ok=True)
    _written(out / "score.json", msgspec.json.format(msgspec.json.encode(board), indent=2))
    figures = score_figures.drawn(compared, best, out)
    console = Console()
    console.print(shown(board, f"{len(compared)} blind cases"))
    limits = ", ".join(f"{name} {limit:.2g}" for name, limit in board.limits.items())
    console.print(f"detection limits, of the default magnitude: {limits}", soft_wrap=True)
    console.print(f"figures: {', '.join(p.name for p in figures)} in {out}", soft_wrap=True)


def opened(folder: Path) -> Key:
    """The sealed answers; raises RigError if they are not those whose hash was published."""
    path, hash_path = folder / "sealed" / "key.json", folder / "key.sha256"
    for wanted in (path, hash_path):
        if not wanted.exists():
            raise RigError(f"{wanted}: is missing; make the cases first")
    if sha256_of(path) != hash_path.read_text().strip():
        raise RigError(f"{path}: is not what was sealed: its hash differs from {hash_path}; make the cases anew")
    return _decoded(path, Key)


def check_recordings(folder: Path, answers: Sequence[Case]) -> None:
    """Raises RigError unless every recording is the one that the answers were written for."""
    for answer in answers:
        for name, digest in answer.sha256.items():
            path = folder / "recordings" / name
            if not path.exists():
                raise RigError(f"{path}: is missing; make the cases anew in another folder")
            if sha256_of(path) != digest:
                raise RigError(f"{path}: is not the recording that was sealed; make the cases anew in another folder")


def beside(answers: Sequence[Case], found: Sequence[Found]) -> list[Compared]:
    """Every answer with its diagnosis; raises RigError where one is missing or of another recording."""
    by_case = {f.case: f for f in found}
    for answer in answers:
        if answer.case not in by_case:
            raise RigError(f"{answer.case}: was not diagnosed; run diagnose on all cases")
        if by_case[answer.case].sha256 != answer.sha256:
            raise RigError(f"{answer.case}: another recording was diagnosed than was sealed; run diagnose again")
    return [Compared(answer, by_case[answer.case].diagnosis) for answer in answers]


def shown(board: Score, title: str) -> Table:
    """The scoreboard as a table."""
    table = Table(title=title)
    for heading in ("", "", "share", "95 % interval"):
        table.add_column(heading, justify="right" if table.columns else "left")
    for rate in board.rates:
        low, high = rate.interval_95
        share = f"{100 * rate.count / rate.of:.0f} %" if rate.of else ""
        table.add_row(rate.name, f"{rate.count} of {rate.of}", share, f"{100 * low:.0f} to {100 * high:.0f} %")
    if board.median_closed_fraction is not None:
        between = "{:.2f} to {:.2f}".format(*board.closed_interval_95) if board.closed_interval_95 else ""
        median = f"{board.median_closed_fraction:.2f}"
        table.add_row("median closed fraction, of those right", f"{board.closed_cases}", median, between)
    if board.share_of_true_closure is not None:
        table.add_row("... of what the true effect closes", "", f"{board.share_of_true_closure:.3f}", "")
    table.add_row(
        "CPU time of a case, median and largest", "", f"{board.cpu_s_median:.0f} s", f"{board.cpu_s_largest:.0f} s"
    )
    return table


def _decoded(path: Path, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); give the right place") from error
    except msgspec.DecodeError as error:
        raise RigError(f"{path}: {error}; make it anew") from error


def _written(path: Path, data: bytes) -> None:
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.blind_gap").app, "scenarios.blind_gap")
