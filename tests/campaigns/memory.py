"""What identify contact and identify gap take of memory and time, against the size of the recording.

python -m tests.campaigns.memory --out out/memory
"""

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated

import matplotlib as mpl
import typer
from matplotlib.figure import Figure
from msgspec.structs import replace
from rich.console import Console
from rich.progress import track
from rich.table import Table

from rig import RigError
from rig.commands.command_line import run
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof

TIMES, BESIDE_MB = 8.0, 300.0
"""Wanted: at most so many times the recording, and so much beside."""
RIGS: dict[str, tuple[BarrelCradle | Sdof, tuple[float, ...]]] = {
    "two beams": (BarrelCradle(sensors="acceleration", noise_density=1e-3, step_s=2.0**-14), (25.0, 30.0, 60.0, 120.0)),
    "one mass": (Sdof(sensors="acceleration", noise_density=1e-3, step_s=2.0**-12), (60.0, 300.0, 900.0)),
}
TELL_PEAK = (
    "import atexit, re; "
    "atexit.register(lambda: print(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1]))"
)
LARGE = {"two beams": (300.0,), "one mass": ()}
"""Lengths, s, that only `identify contact` is given: it takes them segment by segment."""
COMMANDS = ("contact", "gap")
COLOURS = {"two beams": "#1f5fa8", "one mass": "#c8501e"}
app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Taken:
    """By one command of one recording."""

    rig: str
    command: str
    recording_mb: float
    peak_mb: float
    cpu_s: float
    wall_s: float

    @property
    def wanted_mb(self) -> float:
        return TIMES * self.recording_mb + BESIDE_MB


@app.command()
def memory(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and the figure.")] = Path("out/memory"),
) -> None:
    """Records both rigs at several lengths, and runs the commands on them, each in a process of its own."""
    out.mkdir(parents=True, exist_ok=True)
    tasks = [
        (name, length, command)
        for name, (_, lengths) in RIGS.items()
        for command in COMMANDS
        for length in lengths + (LARGE[name] if command == "contact" else ())
    ]
    found = [taken(*task, out) for task in track(tasks, console=Console(stderr=True))]
    table = Table(title="Memory and time against the recording's size")
    for heading in ("rig", "identify", "recording, MB", "peak memory, MB", "wanted, MB", "CPU time, s", "wall time, s"):
        table.add_column(heading, justify="left" if heading in ("rig", "identify") else "right")
    for one in found:
        sizes = (one.recording_mb, one.peak_mb, one.wanted_mb, one.cpu_s, one.wall_s)
        table.add_row(one.rig, one.command, *(f"{size:.3g}" for size in sizes))
    Console().print(table)
    path = out / "memory.png"
    draw(found, path)
    Console().print(f"figure: {path}", soft_wrap=True)


def taken(name: str, length_s: float, command: str, out: Path) -> Taken:
    """Peak memory is that of the process (its resident set), as it tells itself: ru_maxrss begins with its parent's."""
    path = out / f"{name.replace(' ', '_')}_{length_s:g}s.mcap"
    if not path.exists():
        settings = replace(RIGS[name][0], duration_s=length_s)
        record(
            settings.rig(),
            settings.force(),
            plant=partial(modal.simulate, modes_per_beam=16),
            duration_s=length_s,
            step_s=settings.step_s,
            path=path,
            progress=lambda _: None,
        )
    words = [sys.executable, "-c", f"{TELL_PEAK}; from identify.commands.cli import main; main()", command, str(path)]
    begun = time.monotonic()
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        said = process.stdout.read() if process.stdout else ""
        _, status, used = os.wait4(process.pid, 0)
    wall_s = time.monotonic() - begun
    if status:
        raise RigError(f"identify {command} {path} ended with status {os.waitstatus_to_exitcode(status)}")
    peak_mb = int(said.split()[-1]) * 1024 / 1e6
    return Taken(name, command, path.stat().st_size / 1e6, peak_mb, used.ru_utime + used.ru_stime, wall_s)


def draw(found: list[Taken], path: Path) -> None:
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(9, 4), layout="constrained")
        left, right = figure.subplots(1, 2)
        for name in RIGS:
            for command, style in zip(COMMANDS, ("o-", "s--"), strict=True):
                chosen = [f for f in found if (f.rig, f.command) == (name, command)]
                sizes, peaks, times = zip(*sorted((f.recording_mb, f.peak_mb, f.cpu_s) for f in chosen), strict=True)
                label = f"identify {command}, {name}"
                left.plot(sizes, peaks, style, color=COLOURS[name], label=label)
                right.plot(sizes, times, style, color=COLOURS[name], label=label)
        wanted = sorted((f.recording_mb, f.wanted_mb) for f in found)
        left.plot(*zip(*wanted, strict=True), "k:", label=f"{TIMES:g} x recording + {BESIDE_MB:g} MB")
        left.set(xlabel="recording, MB", ylabel="peak memory, MB", xscale="log", yscale="log")
        right.set(xlabel="recording, MB", ylabel="CPU time, s", xscale="log", yscale="log")
        left.legend(frameon=False)
        figure.savefig(path, dpi=130)


if __name__ == "__main__":
    run(import_module("tests.campaigns.memory").app, "tests.campaigns.memory")
