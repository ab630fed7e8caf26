"""A newcomer's session: what the READMEs say, typed as commands, on measurements of machines that share no code with
the project (`newcomer_machine.py`). python -m tests.campaigns.newcomer --out out/newcomer

Session 1: one mass between two stops, and a second machine like it whose clearance is wider. Session 2: a cantilever
with two stops at its tip, whose modes come from an analysis (UFF 55) and whose clearance its owner has wrong.
The machines differ from what is believed by as much as the default tolerances: frequencies, mass, gains, damping.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tests.campaigns.newcomer_machine import (
    Machine,
    cantilever_modes,
    mass,
    measured,
    motion,
    noise_force,
    write_csv,
    write_mode_shapes,
)

COVERED = 1.96
"""Standard errors of a 95 % interval."""
NOISE = 1e-3
"""Of the accelerometers, m/s^2/sqrt(Hz)."""
LASER_NOISE = 1e-8
"""Of the displacement sensors, m/sqrt(Hz)."""


@dataclass(frozen=True)
class Step:
    """A command with the seconds it took, and what it found: (name, found, standard error, true value, unit)."""

    words: str
    seconds: float
    found: tuple[tuple[str, float, float, float, str], ...] = ()


@dataclass
class Session:
    """Commands run one after another in a folder; raises AssertionError if one of them fails."""

    folder: Path
    steps: list[Step] = field(default_factory=list)

    def run(self, words: str) -> None:
        name, *rest = words.split()
        begin = time.monotonic()
        program = [sys.executable, "-c", f"from rig.commands.start import {name}; {name}()", *rest]
        done = subprocess.run(program, cwd=self.folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise AssertionError(f"{words}\n{done.stdout}{done.stderr}")
        self.steps.append(Step(words, time.monotonic() - begin))

    def found(self, *values: tuple[str, float, float, float, str]) -> None:
        """What the last command found; raises AssertionError if it is outside its 95 % interval."""
        for name, value, error, true, unit in values:
            if not abs(value - true) <= COVERED * error:
                raise AssertionError(f"{name}: {value:.6g} ± {COVERED * error:.2g} {unit} (95 %), true is {true:.6g}")
        self.steps[-1] = replace(self.steps[-1], found=values)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.newcomer", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/newcomer"))
    parser.add_argument("--duration", type=float, default=60.0, help="length of each record, s; half of it for beams")
    parser.add_argument("--modes", type=int, default=10, help="of the cantilever's analysis; the machine has 12")
    asked = parser.parse_args()
    show("one mass", one_mass(_made(asked.out / "one_mass"), asked.duration))
    show("cantilever", cantilever(_made(asked.out / "cantilever"), asked.duration / 2, asked.modes))


def one_mass(folder: Path, duration_s: float) -> list[Step]:
    """Believed: 1.2 kg, 7 Hz, 1 %, 1 mm, 1e4 N/m; the first machine has 0.6 mm, 1.5e4 N/m, the second 0.75 mm."""
    rate_hz, clearance_m, wider_m, stiffness = 1024.0, 0.6e-3, 0.75e-3, 1.5e4
    for name, d, rms_n, seed in (("first", clearance_m, 0.8, 1), ("second", wider_m, 0.9, 2), ("third", wider_m, 1, 3)):
        machine = mass(1.2 * 1.001, 7 * 0.999, 0.011, d, stiffness)
        force, _, (acceleration,) = _measurement(machine, rms_n, (0.5, 20), rate_hz, duration_s, seed)
        write_csv(folder / f"{name}.csv", ("force", "acceleration"), (force, acceleration / 9.80665), rate_hz)
    session = Session(folder)
    session.run(
        "rig init mass --mass-kg 1.2 --frequency-hz 7 --clearance-m 1e-3 --stiffness-n-per-m 1e4 "
        f"--noise-density {NOISE} --sample-rate-hz {rate_hz:g} --out lab --force"
    )
    _edit(
        folder / "lab" / "map.toml",
        lambda text: (
            text.replace('"time_s"', '"time"')
            .replace('column = "mass_0000mm_acceleration"', 'column = "acceleration"')
            .replace("m/s^2", "g")
        ),
    )
    session.run("rig import first.csv --map lab/map.toml --out first.mcap --force")
    session.run("identify check first.mcap")
    session.run("identify contact first.mcap --out contact --force")
    _contact(session, folder / "contact", clearance_m, stiffness)
    session.run("rig import second.csv --map lab/map.toml --out second.mcap --force")
    session.run("rig import third.csv --map lab/map.toml --out third.mcap --force")
    session.run("identify gap second.mcap --validate third.mcap --rig contact/rig.json --out gap --force")
    _wider(session, folder / "gap", wider_m / _believed_m(folder / "contact" / "rig.json"))
    return session.steps


def cantilever(folder: Path, duration_s: float, modes: int) -> list[Step]:
    """Steel, 0.5 m by 40 mm by 8 mm, stops of 0.5 mm at its tip, where 0.4 mm is believed."""
    rate_hz, believed_m, clearance_m, stiffness, ratio, count = 4096.0, 0.4e-3, 0.5e-3, 2e5, 0.01, 12
    places = np.linspace(0, 0.5, 21)
    sensors, force_at = [6, 10, 14, 18, 20], 14
    frequencies, shapes = cantilever_modes(0.5, 0.04, 0.008, count, places)
    known = slice(modes)
    write_mode_shapes(folder / "beam.uff", places, frequencies[known], ratio, shapes[:, known])
    rng = np.random.default_rng(5)
    machine = Machine(
        frequencies * (1 + 1e-3 * rng.standard_normal(count)),
        ratio * rng.uniform(0.8, 1.2, count),
        (1 + 1e-3 * rng.standard_normal((len(sensors), 1))) * shapes[sensors],
        shapes[force_at],
        shapes[-1],
        clearance_m,
        stiffness,
    )
    names = [f"{kind} {number}" for kind in ("acc", "laser") for number in range(1, len(sensors) + 1)]
    for name, rms_n, seed in (("monday", 15.0, 1), ("tuesday", 20.0, 2)):
        force, lasers, rows = _measurement(machine, rms_n, (5, 200), rate_hz, duration_s, seed)
        write_csv(folder / f"{name}.csv", ("force", *names), (force, *rows, *lasers), rate_hz)
    session = Session(folder)
    stations = ",".join(f"{places[at]:g}" for at in sensors)
    session.run(
        "rig init structure --from-uff beam.uff --contacts-m 0.5 --force-m 0.35 --clearance-m 4e-4 "
        f"--stiffness-n-per-m 2e5 --stations-m {stations} --quantity acceleration,displacement "
        f"--noise-density {NOISE} --sample-rate-hz 4096 --out lab --force"
    )

    def named(text: str) -> str:
        text = text.replace('"time_s"', '"time"')
        quantities = [quantity for quantity in ("acceleration", "displacement") for _ in sensors]
        for at, quantity, name in zip(2 * sensors, quantities, names, strict=True):
            text = text.replace(f'column = "beam_{1e3 * places[at]:04.0f}mm_{quantity}"', f'column = "{name}"')
        return text

    _edit(folder / "lab" / "map.toml", named)
    for day in ("monday", "tuesday"):
        session.run(f"rig import {day}.csv --map lab/map.toml --out {day}.mcap --force")
    session.run("identify contact monday.mcap --out contact --force")
    _contact(session, folder / "contact", clearance_m, stiffness)
    session.run("identify gap monday.mcap --validate tuesday.mcap --out gap --force")
    _wider(session, folder / "gap", clearance_m / believed_m)
    return session.steps


def _measurement(
    machine: Machine, rms_n: float, band_hz: tuple[float, float], rate_hz: float, duration_s: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The force (N), displacements (m) and accelerations (m/s^2) as they are sampled."""
    force = noise_force(rms_n, band_hz, rate_hz, duration_s, seed)
    displacement, acceleration = motion(machine, force, rate_hz)
    return (
        measured(force, 0.0, rate_hz, seed)[0],
        measured(displacement, LASER_NOISE, rate_hz, seed),
        measured(acceleration, NOISE, rate_hz, seed + 1000),
    )


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _edit(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")


def _contact(session: Session, folder: Path, clearance_m: float, stiffness: float) -> None:
    """Raises AssertionError if something speaks against the answers, or one is outside its interval."""
    report = json.loads((folder / "contact.json").read_bytes())
    if report["findings"]:
        raise AssertionError(f"not to be relied on: {report['findings']}")
    (contact,) = report["contacts"]
    clearance, stiff = contact["clearance_m"], contact["stiffness_n_per_m"]
    session.found(
        ("clearance", 1e3 * clearance["value"], 1e3 * clearance["standard_error"], 1e3 * clearance_m, "mm"),
        ("stiffness", stiff["value"], stiff["standard_error"], stiffness, "N/m"),
    )


def _believed_m(path: Path) -> float:
    (contact,) = json.loads(path.read_bytes())["contacts"]
    return (float(contact["law"]["lower_clearance_m"]) + float(contact["law"]["upper_clearance_m"])) / 2


def _wider(session: Session, folder: Path, factor: float) -> None:
    """Raises AssertionError unless the likeliest cause is the clearance alone."""
    gap = json.loads((folder / "gap.json").read_bytes())
    cause = gap["causes"][0]
    if gap["verdict"] != "explained" or [name.split(":")[0] for name in cause["effects"]] != ["contact_clearance"]:
        raise AssertionError(f"verdict {gap['verdict']!r}, {cause['effects']}: {gap['sentence']}")
    ((name, told),) = cause["parameters"].items()
    session.found((name, told["value"], told["standard_error"], factor, ""))


def _rounded(value: float, error: float) -> str:
    """To two digits of the error."""
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(error))))}f}"


def show(title: str, steps: list[Step]) -> None:
    table = Table("step", "command", "s", "found (95 %)", "true", title=title)
    for number, step in enumerate(steps, start=1):
        found = "\n".join(
            f"{n} {_rounded(v, e)} ± {_rounded(COVERED * e, e)} {unit}" for n, v, e, _, unit in step.found
        )
        true = "\n".join(f"{t:.5g} {unit}" for _, _, _, t, unit in step.found)
        table.add_row(str(number), step.words.removesuffix(" --force"), f"{step.seconds:.1f}", found, true)
    console = Console(width=150)
    console.print(table)
    minutes = sum(step.seconds for step in steps) / 60
    console.print(f"{title}: {len(steps)} commands, {minutes:.1f} minutes")


if __name__ == "__main__":
    main()
