"""Entry points of the commands: while their libraries load, Ctrl-C and SIGTERM already end them with one sentence.

`rig-identify rig ...` and `rig-identify identify ...` are the two commands under a name that no other program has.
"""

import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import Any

from rig.commands.streams import prepare_streams

INTERRUPTED_STATUS = 130
ENDING_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
PYPI_NAME = "rig-identify"
COMMANDS = ("rig", "identify")
HELP_OPTIONS = {"--help", "-h"}
VERSION_OPTIONS = {"--version", "-V"}
LIGHT_OPTIONS = HELP_OPTIONS | VERSION_OPTIONS
"""Options that need no libraries."""
LAST_DATE_S = 253_402_300_800
"""The year 10000."""


def rig() -> None:
    _start("rig")


def identify() -> None:
    _start("identify")


def both() -> None:
    """`rig-identify rig ...`, `rig-identify identify ...`, `rig-identify doctor`, `rig-identify --version`."""
    command = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if command in COMMANDS:
        del sys.argv[1]
        _start(command)
    elif command == "doctor":
        _doctor()
    elif command in VERSION_OPTIONS:
        _print_and_exit(PYPI_NAME, _print_version)
    else:
        _print_and_exit(PYPI_NAME, lambda: _print_usage(0 if command in HELP_OPTIONS else 2))


def _print_version() -> int:
    print(PYPI_NAME, version(PYPI_NAME))
    return 0


def _print_usage(exit_status: int) -> int:
    print(f"Usage: {PYPI_NAME} rig ... | identify ... | doctor | --version (rig and identify say more by --help)")
    return exit_status


def _start(command_name: str) -> None:
    if sys.argv[1:] == ["doctor"]:
        _doctor()
    _check_source_date_epoch(command_name)

    def exit_interrupted(*_: Any) -> None:
        os.write(2, f"{command_name}: interrupted\n".encode())
        os._exit(INTERRUPTED_STATUS)  # nothing is open yet, and an exception might be lost in what is being imported

    earlier_handlers = {ending_signal: signal.getsignal(ending_signal) for ending_signal in ENDING_SIGNALS}
    for ending_signal, earlier_handler in earlier_handlers.items():
        if earlier_handler != signal.SIG_IGN:
            signal.signal(ending_signal, exit_interrupted)
    try:
        main = import_module(f"{command_name}.commands.cli").main
        if sys.argv[1:] and not LIGHT_OPTIONS & set(sys.argv):
            import_module(f"{command_name}.api")  # the libraries, which commands import when they run
    except ImportError as error:
        sys.exit(f"{command_name}: cannot start ({error}); ask for the reason: {PYPI_NAME} doctor")
    for ending_signal, earlier_handler in earlier_handlers.items():
        signal.signal(ending_signal, earlier_handler)
    main()


def _check_source_date_epoch(command_name: str) -> None:
    """Exit with a sentence if SOURCE_DATE_EPOCH, which numpy parses when scipy is imported, is no valid date."""
    date_text = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not (date_text.isascii() and date_text.isdigit() and int(date_text[:20]) < LAST_DATE_S):
        sys.exit(
            f"{command_name}: SOURCE_DATE_EPOCH is {date_text[:100]!r}; set it to whole seconds since 1970, or unset it"
        )


def _doctor() -> None:
    from rig.commands.doctor import doctor

    _print_and_exit(f"{PYPI_NAME} doctor", doctor)


def _print_and_exit(command_name: str, printing: Callable[[], int]) -> None:
    """Exit with the status that a function returns, which prints by itself and needs none of the libraries."""
    prepare_streams(command_name)
    try:
        exit_status = printing()
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # where what is left goes
        sys.exit(f"{command_name}: standard output: cannot be written ({error.strerror}); choose another place")
    sys.exit(exit_status)


if __name__ == "__main__":
    both()
