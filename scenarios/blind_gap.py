"""The blind check of the diagnosis: cases whose answers are sealed and hashed before anything is diagnosed.

python -m scenarios.blind_gap make --world wide --cases 60 --seed 7000 --out out/blind
python -m scenarios.blind_gap diagnose --cases out/blind --out out/found
python -m scenarios.blind_gap score --cases out/blind --found out/found --out out/score
"""

import hashlib
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import typer
from rich.console import Console

from rig.command_line import Force, refuse_existing, run
from rig.errors import RigError
from rig.model.tolerances import tolerances_named
from scenarios.blind_diagnosis import Found, diagnosed_cases
from scenarios.tasks import Dask, run_tasks
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


@app.command()
def diagnose(
    cases: Cases,
    out: Annotated[Path, typer.Option(help="Folder for what is found.")],
    tolerances: Annotated[
        str | None,
        typer.Option(help="How exactly the rigs are believed: laboratory, exact, or a TOML file; else as they say."),
    ] = None,
    nulls_of: Annotated[
        Path | None, typer.Option(help="Folder of null references of another run; what lacks there is made.")
    ] = None,
    dask: Dask = None,
) -> None:
    """Diagnoses every case from its recordings alone; run again after an interruption, it goes on."""
    believed = tolerances_named(tolerances) if tolerances else None
    found = diagnosed_cases(cases / "recordings", out, believed, nulls_of, dask)
    _written(out / "found.json", msgspec.json.format(msgspec.json.encode(found), indent=2))
    Console().print(f"{len(found)} diagnoses in {out / 'found.json'}", soft_wrap=True)


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
