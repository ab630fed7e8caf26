"""Conventions of every command: one way to fail, one to show progress, one to keep what is there."""

import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from rig.errors import RigError, is_plain, one_line
from rig.files import check_target, part_of

INTERRUPTED = 130

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output, and nothing else.")]


def _say_version(asked: bool) -> bool:
    if asked:
        print("rig-identify", version("rig-identify"))
        raise typer.Exit
    return asked


Version = Annotated[
    bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Show the version and exit.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


class StoppedError(Exception):
    """Ctrl-C where there is more to say than that: its text says what is left."""


def run(app: typer.Typer, name: str) -> None:
    """Runs a command and exits: 0 done, 1 the input cannot be used (one line on standard error), 2 wrong words.

    130 is an interruption: Ctrl-C, a request to end, a terminal that is closed.
    """
    _prepare(name)
    try:
        try:
            app(prog_name=name)
        finally:
            sys.stdout.flush()
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
    except KeyboardInterrupt:
        status, sentence = INTERRUPTED, "interrupted"
    except BrokenPipeError:  # whoever reads has enough, as `head` has
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(1)
    except OSError as error:
        where = "standard output" if error.filename is None else error.filename
        status, sentence = 1, one_line(f"{where}: cannot be read or written ({error.strerror}); choose another place")
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # where what is left goes
    print(f"{name}: {sentence}", file=sys.stderr)
    sys.exit(status)


def _prepare(name: str) -> None:
    """Standard output takes every sign or is refused if closed; all ways to end a command are one; numpy is silent."""
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115
    if sys.stdout is None:
        sys.exit(f"{name}: standard output is closed; direct it into a file or to {os.devnull}")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    for ending in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, ending) and signal.getsignal(getattr(signal, ending)) == signal.SIG_DFL:
            signal.signal(getattr(signal, ending), _interrupt)
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def _interrupt(*_: object) -> None:
    """Interrupt as Ctrl-C does, also where that is ignored, as in a command that a shell runs in the background."""
    if signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, signal.SIG_DFL):
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def say(text: str) -> None:
    """Prints a line on standard output; what it quotes of files cannot command the terminal."""
    print(text if is_plain(text) else one_line(text))


def literal_console() -> Console:
    """Console for tables on standard output, with names as they are: no markup, no emoji, no colours."""
    return Console(markup=False, emoji=False, highlight=False)


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[float], None]]:
    """A bar with the time left on standard error; call what it gives with the fraction done. Silent when piped."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(one_line(description), total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


@contextmanager
def working(description: str) -> Iterator[None]:
    """A sign of life on standard error where nobody knows how long it takes. Silent when piped."""
    console = Console(stderr=True)
    with console.status(Text(one_line(description))) if console.is_terminal else nullcontext():
        yield


def refuse_existing(path: Path, force: bool, *sources: Path, new_folder: bool = False) -> None:
    """Raises RigError if the path exists and overwriting was not asked for.

    And always if it cannot be written, or is one of the sources by whatever name; see `check_target`.
    """
    check_target(path, *sources, new_folder=new_folder)
    part = part_of(path)
    if path.exists() and not force:
        raise RigError(f"{path}: exists already; give another name, or --force to overwrite it")
    if path.suffix == ".mcap" and part.exists() and not force:
        raise RigError(
            f"{part}: is being written or was cut off; save it by `rig recover` under another name, or give --force"
        )
