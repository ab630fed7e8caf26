"""Conventions of every command: how it fails, shows progress, and protects existing files."""

import os
import re
import signal
import sys
import threading
import time
import warnings
from _thread import interrupt_main
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from inspect import cleandoc
from pathlib import Path
from shutil import get_terminal_size
from textwrap import TextWrapper
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from rig.commands.streams import prepare_streams
from rig.errors import RigError, has_no_control_characters, one_line
from rig.files import check_target, part_path_of

INTERRUPTED_STATUS = 130
PROGRESS_LINE_PERIOD_S = 10.0
"""Time between two lines of progress where there is no terminal."""
LOST_INTERRUPT_S = 0.05
"""Time after which a swallowed interrupt is repeated: callbacks are shorter."""
SPEED_PERIOD_S = 3600.0
"""Time over which the speed is averaged that tells the time left: steps may last minutes."""

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output, and nothing else.")]


def _say_version(requested: bool) -> bool:
    if requested:
        print("rig-identify", version("rig-identify"))
        raise typer.Exit
    return requested


Version = Annotated[
    bool, typer.Option("--version", "-V", callback=_say_version, is_eager=True, help="Show the version and exit.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


OPTIONS_OF_ONE_MEANING = (
    {"--duration", "--seconds", "--length", "--time"},
    {"--out", "--output", "--out-dir", "-o"},
    {"--force", "--overwrite", "--yes", "-f", "-y"},
)
"""Options that other programs, or other commands, have for one thing."""


CommandFunction = TypeVar("CommandFunction", bound=Callable[..., Any])


class Command(TyperCommand):
    """Command that says what an option of other programs is called here; its flags have no `<bool>` in the help."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _with_plain_flags(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except Exception as error:  # the class for an unknown option is typer's own or click's, by typer's version
            unknown_option = getattr(error, "option_name", None)
            known_options = {option for parameter in self.get_params(ctx) for option in parameter.opts}
            for options in OPTIONS_OF_ONE_MEANING:
                if unknown_option in options - known_options and options & known_options:
                    error.possibilities = sorted(options & known_options)  # type: ignore[attr-defined]
            raise


class CommandGroup(TyperGroup):
    """Group of commands, whose flags have no `<bool>` in the help."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _with_plain_flags(super().get_params(ctx))


def _with_plain_flags(command_parameters: list[Any]) -> list[Any]:
    for command_parameter in command_parameters:
        if getattr(command_parameter, "is_flag", False):
            command_parameter.metavar = ""
    return command_parameters


class CommandApp(typer.Typer):
    """Application whose group and commands are of the classes above, unless they name others."""

    def __init__(self, *, cls: type[TyperGroup] = CommandGroup, **options: Any) -> None:
        super().__init__(cls=cls, pretty_exceptions_enable=False, **options)

    def command(
        self, name: str | None = None, *, cls: type[TyperCommand] | None = Command, **options: Any
    ) -> Callable[[CommandFunction], CommandFunction]:
        return super().command(name, cls=cls, **options)


def help_filled_by(texts_by_placeholder: Callable[[], Mapping[str, str]]) -> type[TyperCommand]:
    """Command class whose help has placeholders, {name}, filled by `texts_by_placeholder` (slow) when it is shown.

    A paragraph of the help fills the width of the terminal, wherever the lines of the docstring end.
    """

    class FilledHelpCommand(Command):
        def format_help(self, ctx: Any, formatter: Any) -> None:
            text_by_placeholder = texts_by_placeholder()
            paragraphs = cleandoc(self.help or "").split("\n\n")
            self.help = "\n\n".join(paragraph.replace("\n", " ") for paragraph in paragraphs)
            self.epilog = (self.epilog or "").format_map(text_by_placeholder)
            for command_parameter in self.params:
                if help_text := getattr(command_parameter, "help", None):
                    command_parameter.help = help_text.format_map(text_by_placeholder)  # type: ignore[attr-defined]
            super().format_help(ctx, formatter)

    return FilledHelpCommand


class StoppedError(Exception):
    """Interruption by Ctrl-C with a message that says what was kept."""


def run(app: typer.Typer, command_name: str) -> None:
    """Run a command and exit: 0 done, 1 unusable input (one line on standard error), 2 wrong usage, 130 interrupted.

    Ctrl-C, a termination request and a closed terminal are interruptions.
    """
    _prepare_streams_and_signals(command_name)
    try:
        try:
            app(prog_name=command_name, help_option_names=["--help", "-h"])
        finally:
            sys.stdout.flush()
    except RigError as error:
        exit_status, sentence = 1, str(error)
    except MemoryError as error:
        exit_status, sentence = 1, f"there is not enough memory for this ({error}); ask for a shorter record"
    except StoppedError as error:
        exit_status, sentence = INTERRUPTED_STATUS, str(error)
    except SystemExit as exit_error:
        if exit_error.code != INTERRUPTED_STATUS:
            raise
        exit_status, sentence = INTERRUPTED_STATUS, "interrupted"  # typer has taken the KeyboardInterrupt
    except KeyboardInterrupt:
        exit_status, sentence = INTERRUPTED_STATUS, "interrupted"
    except OSError as error:
        file_name = "standard output" if error.filename is None else error.filename
        exit_status = 1
        sentence = one_line(f"{file_name}: cannot be read or written ({error.strerror}); choose another place")
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # where what is left goes
    _print_wrapped_line(f"{command_name}: {sentence}", is_error=True)
    sys.exit(exit_status)


def _prepare_streams_and_signals(command_name: str) -> None:
    """Prepare the process: its streams, SIGTERM and SIGHUP as interruptions, no warnings of libraries."""
    prepare_streams(command_name)
    for signal_name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, signal_name) and signal.getsignal(getattr(signal, signal_name)) == signal.SIG_DFL:
            signal.signal(getattr(signal, signal_name), _interrupt)
    sys.unraisablehook = repeat_lost_interrupt
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def _interrupt(*_: object) -> None:
    """Interrupt as Ctrl-C does, even where SIGINT is ignored, as in a background command of a shell."""
    if signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, signal.SIG_DFL):
        raise KeyboardInterrupt
    signal.raise_signal(signal.SIGINT)


def repeat_lost_interrupt(unraisable: Any) -> None:
    """Interrupt again, a little later, where a callback of compiled code, such as a compiler's, swallowed it."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        threading.Timer(LOST_INTERRUPT_S, interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)


def say(text: str) -> None:
    """Print a line on standard output, with control characters escaped; a terminal breaks it between words."""
    _print_wrapped_line(text if has_no_control_characters(text) else one_line(text))


def print_sentence(sentence: str, console: Console) -> None:
    """Print a sentence on a console, as `say` does."""
    console.print(fitted(sentence, console.width) if console.is_terminal else sentence, soft_wrap=True)


def fitted(text: str, width: int) -> str:
    """Text in lines of at most `width` columns, broken between words and indented as it begins.

    Longer words, such as paths, stay whole, and so does a value with its interval and its percent sign.
    """
    indent = text[: len(text) - len(text.lstrip())]
    text_without_breaks = re.sub(r"(?<=\d) (?=[±%])|(?<=±) ", "\u2060", text.lstrip())
    wrapper = TextWrapper(
        width, initial_indent=indent, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return wrapper.fill(text_without_breaks).replace("\u2060", " ")


def _print_wrapped_line(line: str, is_error: bool = False) -> None:
    """Print a line, fitted to a terminal; where it is piped it stays one line, for programs that read lines."""
    stream = sys.stderr if is_error else sys.stdout
    print(fitted(line, get_terminal_size().columns) if stream.isatty() else line, file=stream)


def literal_console() -> Console:
    """Console for tables on standard output that prints names literally: no markup, emoji or highlighting."""
    return Console(markup=False, emoji=False, highlight=False)


def console_table(
    title: str, headings: Sequence[str], text_column_count: int = 1, rows: Iterable[Sequence[str]] = ()
) -> Table:
    """Table for a console: so many columns of text, then numbers, aligned right."""
    table = Table(title=title)
    for column_index, heading in enumerate(headings):
        table.add_column(heading, justify="left" if column_index < text_column_count else "right")
    for row in rows:
        table.add_row(*row)
    return table


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[float], None]]:
    """Progress bar on standard error; yields a function to call with the fraction done. Lines when piped."""
    console = Console(stderr=True)
    if not console.is_terminal:
        with _progress_lines(description) as progress_in_lines:
            yield progress_in_lines
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    transient_bar = Progress(*columns, console=console, transient=True, speed_estimate_period=SPEED_PERIOD_S)
    with transient_bar as progress:
        task_id = progress.add_task(one_line(description), total=1.0)
        yield lambda done_share: progress.update(task_id, completed=done_share)


@contextmanager
def progress_spinner(description: str) -> Iterator[None]:
    """Spinner on standard error for work of unknown duration. Lines when piped."""
    console = Console(stderr=True)
    with console.status(Text(one_line(description))) if console.is_terminal else _progress_lines(description):
        yield


@contextmanager
def _progress_lines(description: str) -> Iterator[Callable[[float], None]]:
    """Line on standard error every PROGRESS_LINE_PERIOD_S; yields a function to call with the fraction done."""
    started_s = time.monotonic()
    is_done = threading.Event()
    share_words = ""

    def set_share(done_share: float) -> None:
        nonlocal share_words
        share_words = f"{done_share:.0%}, "

    def print_lines() -> None:
        while not is_done.wait(PROGRESS_LINE_PERIOD_S):
            with suppress(OSError, ValueError):  # standard error may be full or closed: the work goes on
                line = f"{one_line(description)}: {share_words}{time.monotonic() - started_s:.0f} s"
                print(line, file=sys.stderr, flush=True)

    printer = threading.Thread(target=print_lines, daemon=True)
    printer.start()
    try:
        yield set_share
    finally:
        is_done.set()
        printer.join()


def check_file_ending(path: Path, endings: Sequence[str], content_words: str) -> None:
    """Raise RigError unless the name of a file to be written ends as files of its content do."""
    if path.suffix.lower() not in endings:
        ending_words = f"ends in {path.suffix!r}" if path.suffix else "has no ending"
        raise RigError(
            f"{path}: {ending_words}, and {content_words} in {' or '.join(endings)}; name it "
            f"{path.with_suffix(endings[0]).name}"
        )


def refuse_existing(path: Path, force: bool, *sources: Path, new_folder: bool = False) -> None:
    """Raise RigError if the path exists and `force` is false, or if `check_target` refuses it."""
    check_target(path, *sources, new_folder=new_folder)
    part_path = part_path_of(path)
    if path.exists() and not force:
        raise RigError(f"{path}: exists already; give another name, or --force to overwrite it")
    if path.suffix == ".mcap" and part_path.exists() and not force:
        raise RigError(
            f"{part_path}: is being written or was cut off; save it by `rig recover` under another name, or give "
            "--force"
        )
