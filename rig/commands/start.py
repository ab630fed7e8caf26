"""Entry points of the commands: while their libraries load, Ctrl-C and SIGTERM already end them with one sentence.

`rig-identify rig ...` and `rig-identify identify ...` are the two commands under a name that no other program has.
"""

import os
import signal
import sys
from importlib import import_module
from importlib.metadata import version
from typing import Any

INTERRUPTED = 130
ENDINGS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
NAME = "rig-identify"
COMMANDS = ("rig", "identify")
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
    elif command == "--version":
        print(NAME, version(NAME))
    else:
        print(f"Usage: {NAME} rig ... | identify ... | doctor | --version (rig and identify say more by --help)")
        sys.exit(0 if command == "--help" else 2)


def _start(name: str) -> None:
    if sys.argv[1:] == ["doctor"]:
        _doctor()
    _check_date(name)

    def stop(*_: Any) -> None:
        os.write(2, f"{name}: interrupted\n".encode())
        os._exit(INTERRUPTED)  # nothing is open yet, and an exception might be lost in what is being imported

    before = {ending: signal.getsignal(ending) for ending in ENDINGS}
    for ending, handler in before.items():
        if handler != signal.SIG_IGN:
            signal.signal(ending, stop)
    try:
        main = import_module(f"{name}.commands.cli").main
    except ImportError as error:
        sys.exit(f"{name}: cannot start ({error}); ask for the reason: {NAME} doctor")
    for ending, handler in before.items():
        signal.signal(ending, handler)
    main()


def _check_date(name: str) -> None:
    """Exit with a sentence if SOURCE_DATE_EPOCH, which numpy parses when scipy is imported, is no valid date."""
    date = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not (date.isascii() and date.isdigit() and int(date[:20]) < LAST_DATE_S):
        sys.exit(f"{name}: SOURCE_DATE_EPOCH is {date[:100]!r}; set it to whole seconds since 1970, or unset it")


def _doctor() -> None:
    from rig.commands.doctor import doctor

    sys.exit(doctor())


if __name__ == "__main__":
    both()
