"""Commands killed at random moments: nothing half-written is ever taken for whole. python -m tests.campaigns.kills

`rig record`, `rig import`, `rig export`, `identify contact` and `identify gap` run in processes of their own and are
ended by SIGKILL at a random moment between their start and the time that they need undisturbed. Afterwards every file
under its final name must be byte for byte, or number for number, what an undisturbed run writes; what else is there
must be named `.part`; and the same command, run again, must give the undisturbed result. (`python -m
tests.campaigns.killed_recordings` looks further into what `rig recover` saves of a killed recording.)
"""

import argparse
import json
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rig.errors import RigError
from rig.recording import Recording, read, read_truth

Words = tuple[object, ...]
SETTINGS = ("--plant", "modal", "--set", "frequency_hz=2", "--set", "high_hz=6")
PASSING = {"seconds", "elapsed_s", "made_at"}


def _commands(source: Path) -> dict[str, Callable[[Path], Words]]:
    """By what they write into a folder; the source has a recording, a table and its map."""
    recording, table, told = source / "r.mcap", source / "r.csv", source / "r.toml"
    return {
        "record": lambda out: ("rig", "record", "sdof", *SETTINGS, "--duration", 200, "--out", out / "o.mcap"),
        "import": lambda out: ("rig", "import", table, "--map", told, "--out", out / "o.mcap"),
        "export": lambda out: ("rig", "export", recording, "--format", "csv", "--out", out / "o.csv"),
        "contact": lambda out: ("identify", "contact", recording, "--out", out),
        "gap": lambda out: (
            "identify",
            "gap",
            recording,
            "--null-reference",
            out / "o.null_reference.json",
            "--out",
            out,
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        commands = _prepared(folder / "source")
        whole, needs_s = {}, {}
        for command, words in commands.items():
            whole[command] = folder / command
            begin = time.monotonic()
            _run_whole(words(_made(whole[command])))
            needs_s[command] = time.monotonic() - begin
            print(f"{command}: {needs_s[command]:.1f} s undisturbed, {_names(whole[command])}", flush=True)
        seen: Counter[str] = Counter()
        for number in range(asked.kills):
            command = list(commands)[number % len(commands)]
            place, after_s = _made(folder / f"{number}"), float(rng.uniform(0.3, 1.1)) * needs_s[command]
            state = _killed(commands[command](place), after_s)
            left = _names(place)
            _check(place, whole[command])
            _run_whole((*commands[command](place), *(("--force",) if left or command in ("record",) else ())))
            _check(place, whole[command], complete=True)
            seen[state] += 1
            print(f"kill {number + 1}: {command} after {after_s:.2f} s, {state}: {left or 'nothing'}", flush=True)
    print(f"{asked.kills} kills of seed {asked.seed}: {dict(seen)}; nothing half-written was taken for whole")


def _prepared(source: Path) -> dict[str, Callable[[Path], Words]]:
    commands = _commands(_made(source))
    _run_whole(("rig", "record", "sdof", *SETTINGS, "--duration", 30, "--out", source / "r.mcap"))
    paths = ("--out", source / "r.csv", "--map", source / "r.toml")
    _run_whole(("rig", "export", source / "r.mcap", "--format", "csv", *paths))
    return commands


def _killed(words: Words, after_s: float) -> str:
    with _started(words) as process:
        time.sleep(after_s)
        process.kill()
        process.communicate()
    if process.returncode not in (0, -signal.SIGKILL):
        raise AssertionError(f"{words}: ended by {process.returncode}")
    return "killed" if process.returncode else "done before"


def _run_whole(words: Words) -> None:
    with _started(words) as process:
        _, said = process.communicate()
    if process.returncode or said:
        raise AssertionError(f"{words}: {said}")


def _started(words: Words) -> subprocess.Popen[str]:
    name, *rest = map(str, words)
    program = [sys.executable, "-c", f"from rig.commands.start import {name}; {name}()", *rest]
    return subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def _check(place: Path, whole: Path, complete: bool = False) -> None:
    """Raises AssertionError unless all files under final names are those of the undisturbed run."""
    final = {path.name for path in place.iterdir() if path.suffix != ".part"}
    known = {path.name for path in whole.iterdir()}
    if not final <= known or (complete and final != known):
        raise AssertionError(f"{place} has {final}, the undisturbed run {known}")
    if complete and _names(place) != _names(whole):
        raise AssertionError(f"{place} keeps {_names(place)}")
    for name in final:
        if not _same(place / name, whole / name):
            raise AssertionError(f"{place / name} differs from that of the undisturbed run")


def _same(one: Path, other: Path) -> bool:
    if one.suffix == ".mcap":
        return _equal(_recording(one), _recording(other))
    if one.suffix == ".json":
        return bool(_lasting(json.loads(one.read_bytes())) == _lasting(json.loads(other.read_bytes())))
    if one.suffix == ".html":
        return one.read_text(encoding="utf-8").endswith("</html>\n")
    return one.read_bytes() == other.read_bytes()


def _recording(path: Path) -> Recording:
    try:
        return read(path)
    except RigError:
        return read_truth(path)


def _equal(one: Recording, other: Recording) -> bool:
    return one.rig == other.rig and all(
        np.array_equal(signals.values, other.signals[name].values) for name, signals in one.signals.items()
    )


def _lasting(value: Any) -> Any:
    """Without what tells how long it took."""
    if isinstance(value, dict):
        return {key: _lasting(each) for key, each in value.items() if key not in PASSING}
    return value


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


if __name__ == "__main__":
    main()
