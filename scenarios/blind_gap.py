"""The blind check of the diagnosis: cases whose answers are sealed and hashed before anything is diagnosed.

python -m scenarios.blind_gap make --out out/blind
python -m scenarios.blind_gap diagnose --cases out/blind --out out/found
python -m scenarios.blind_gap score --cases out/blind --found out/found --out out/score
"""

import hashlib
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console

from rig.command_line import Force, refuse_existing, run
from rig.errors import RigError
from scenarios.blind_cases import Case, Key, made, planned, sha256_of
from scenarios.tasks import run_tasks

app = typer.Typer(pretty_exceptions_enable=False, no_args_is_help=True)
Cases = Annotated[Path, typer.Option("--cases", help="Folder that `make` wrote.")]


@app.callback()
def main() -> None:
    """The blind check of the diagnosis: make the cases, diagnose them, score what was found."""


@app.command()
def make(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and the sealed key.")],
    cases: Annotated[int, typer.Option(min=1, help="How many.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Everything is drawn from it.")] = 7000,
    duration: Annotated[float, typer.Option(help="Length of each record, s.")] = 30.0,
    step_log2: Annotated[int, typer.Option(min=12, max=20, help="The ancf plant's step is 2 to minus this, s.")] = 13,
    elements: Annotated[int, typer.Option(min=4, help="Of the ancf plant, a beam.")] = 16,
    force: Force = False,
) -> None:
    """Records the cases and seals their answers; run again after an interruption, it goes on."""
    key_path, hash_path = out / "sealed" / "key.json", out / "key.sha256"
    plans = planned(cases, seed, out, duration, 2.0**-step_log2, elements)
    if hash_path.exists() and not force:
        refuse_existing(hash_path, force)
    (out / "recordings").mkdir(parents=True, exist_ok=True)
    (out / "sealed" / "work").mkdir(parents=True, exist_ok=True)
    answers = run_tasks(made, plans, Case, out / "sealed" / "tasks")
    check_recordings(out, answers)
    key = msgspec.json.format(msgspec.json.encode(Key(seed, tuple(answers))), indent=2)
    _written(key_path, key)
    digest = hashlib.sha256(key).hexdigest()
    _written(hash_path, f"{digest}\n".encode())
    console = Console()
    console.print(f"{len(answers)} cases in {out / 'recordings'}, answers in {key_path}")
    console.print(f"sha256 of the answers: {digest}", soft_wrap=True)


def check_recordings(folder: Path, answers: list[Case] | tuple[Case, ...]) -> None:
    """Raises RigError unless every recording is the one that the answers were written for."""
    for answer in answers:
        for name, digest in answer.sha256.items():
            path = folder / "recordings" / name
            if not path.exists():
                raise RigError(f"{path}: is missing; make the cases anew in another folder")
            if sha256_of(path) != digest:
                raise RigError(f"{path}: is not the recording that was sealed; make the cases anew in another folder")


def _written(path: Path, data: bytes) -> None:
    part = path.with_name(path.name + ".part")
    part.write_bytes(data)
    part.replace(path)


if __name__ == "__main__":
    run(app, "scenarios.blind_gap")
