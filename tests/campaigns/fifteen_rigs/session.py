"""A user's commands, each in a process of its own, and what is read of contact.json."""

import csv
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tests.campaigns.fifteen_rigs.laboratory import Measured, TrueContact

COVERED = 1.96
"""Standard errors of a 95 % interval."""


@dataclass(frozen=True)
class CommandRun:
    words: str
    seconds: float
    status: int
    said: str


@dataclass
class UserSession:
    """Commands and edits in a folder, one after another."""

    folder: Path
    done: list[CommandRun] = field(default_factory=list)
    edits: int = 0

    def run(self, words: str) -> CommandRun:
        name, *rest = words.split()
        begin = time.monotonic()
        program = [sys.executable, "-c", f"from rig.commands.start import {name}; {name}()", *rest]
        ended = subprocess.run(program, cwd=self.folder, capture_output=True, text=True, check=False)
        said = (ended.stdout + ended.stderr).strip()
        self.done.append(CommandRun(words, time.monotonic() - begin, ended.returncode, said))
        return self.done[-1]

    def edit(self, name: str, change: Callable[[str], str]) -> None:
        path = self.folder / name
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
        self.edits += 1

    def edit_rig(self, name: str, change: Callable[[dict[str, Any]], None]) -> None:
        def changed(text: str) -> str:
            rig = json.loads(text)
            change(rig)
            return json.dumps(rig, indent=2)

        self.edit(name, changed)

    def write(self, name: str, text: str) -> None:
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_text(text, encoding="utf-8")
        self.edits += 1


def write_record(path: Path, record: Measured, rate_hz: float, forces: tuple[str, ...] = ("force",)) -> None:
    """A logger's CSV: time, forces and sensors, with units in brackets."""
    units = {"acceleration": "m/s^2", "displacement": "m", "strain": "m/m"}
    names = [f"{name} [N]" for name in forces]
    names += [f"{name} [{next(u for q, u in units.items() if name.endswith(q))}]" for name in record.columns]
    columns = [*record.forces_n[: len(forces)], *record.columns.values()]
    write_columns(path, ["time [s]", *names], columns, rate_hz)


def write_columns(path: Path, names: list[str], columns: list[Float[np.ndarray, " samples"]], rate_hz: float) -> None:
    time_s = np.arange(columns[0].size) / rate_hz
    rows = np.column_stack([time_s, *columns])
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerow(names)
        np.savetxt(stream, rows, fmt=["%.9f", *["%.8g"] * len(columns)], delimiter=",")


def answers(folder: Path, truth: list[TrueContact]) -> dict[str, Any]:
    """What contact.json says of each contact beside what is true: (value, half its 95 % interval, true)."""
    report = json.loads((folder / "contact.json").read_bytes())
    values: dict[str, list[float]] = {}
    for contact in report["contacts"]:
        true = next(t for t in truth if t.name == contact["name"])
        for quantity, value in true_values(true).items():
            told = contact.get(quantity)
            if told is not None and value is not None:
                values[f"{true.name} {quantity}"] = [told["value"], COVERED * told["standard_error"], value]
    return {
        "values": values,
        "unanswered": [f"{u['name']}: {u['reason']}" for u in report["unanswered"]],
        "findings": [f"{f['evidence']}: {f['mend']}" for f in report["findings"]],
    }


def true_values(true: TrueContact) -> dict[str, float | None]:
    """Half the play, or the clearance of the one stop; each side; stiffness; damping; in contact.json's words."""
    sides = [c for c in (true.lower_m, true.upper_m) if c is not None]
    return {
        "clearance_m": sum(sides) / len(sides) if sides else None,
        "lower_clearance_m": true.lower_m,
        "upper_clearance_m": true.upper_m,
        "stiffness_n_per_m": true.stiffness_n_per_m,
        "damping_n_s_per_m": true.damping_n_s_per_m,
    }
