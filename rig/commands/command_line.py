"""What every command shares: one way to fail, one way to show progress, one way to keep what is there."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from rig.errors import RigError
from rig.files import part_of

INTERRUPTED = 130

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output, and nothing else.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


class StoppedError(Exception):
    """Ctrl-C where there is more to say than that: its text says what is left."""


def run(app: typer.Typer, name: str) -> None:
    """Runs a command and exits: 0 done, 1 the input cannot be used (one line on standard error), 2 wrong words.

    130 is an interruption (Ctrl-C).
    """
    try:
        app(prog_name=name)
    except RigError as error:
        status, sentence = 1, str(error)
    except MemoryError as error:
        status, sentence = 1, f"there is not enough memory for this ({error}); ask for a shorter record"
    except StoppedError as error:
        status, sentence = INTERRUPTED, str(error)
    except SystemExit as stop:
        if stop.code != INTERRUPTED:
            raise
        status, sentence = INTERRUPTED, "interrupted"  # typer has taken the KeyboardInterrupt
    print(f"{name}: {sentence}", file=sys.stderr)
    sys.exit(status)


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[float], None]]:
    """A bar with the time left on standard error; call what it gives with the fraction done. Silent when piped."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(description, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


@contextmanager
def working(description: str) -> Iterator[None]:
    """A sign of life on standard error where nobody knows how long it takes. Silent when piped."""
    console = Console(stderr=True)
    with console.status(description) if console.is_terminal else nullcontext():
        yield


def refuse_existing(path: Path, force: bool) -> None:
    """Raises RigError if the path exists and overwriting was not asked for, and always for a symbolic link."""
    part = part_of(path)
    if path.exists() and not force:
        raise RigError(f"{path}: exists already; give another name, or --force to overwrite it")
    if path.suffix == ".mcap" and part.exists() and not force:
        raise RigError(
            f"{part}: is being written or was cut off; save it by `rig recover` under another name, or give --force"
        )
