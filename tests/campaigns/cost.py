"""What every step costs: CPU time over the length of a record, the number of accelerometers and the plant's modes.

python -m tests.campaigns.cost --out out/cost
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import matplotlib as mpl
import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table
from scipy.fft import rfft
from threadpoolctl import threadpool_limits

from identify.contacts import identify_contact
from identify.contacts.acceptance import estimated_contacts
from identify.paper.nifo import nifo
from identify.paper.surface import fit_surface
from identify.signals.kinematics import kinematics
from identify.signals.law_evaluation import oversampling
from identify.signals.spectra import Averaging, blocks
from rig.commands.command_line import progress_bar, run
from rig.model.tolerances import LABORATORY
from rig.recording import read
from rig.simulation.excitation import force_history
from rig.simulation.plants import modal
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle

REFERENCE = BarrelCradle(sensors="acceleration", noise_density=1e-3, duration_s=60.0)
MODES = 16
SERIES = {
    "modes a beam": (10, 16, 24, 40),
    "accelerometers": (8, 12, 16, 20),
    "length of the record, s": (30.0, 60.0, 120.0, 240.0),
}
app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Plan:
    """Sizes in turn, each step's least CPU time of so many runs, and the length of NIFO's blocks."""

    series: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: SERIES)
    runs: int = 2
    block_s: float = 3.0


@dataclass(frozen=True)
class Costs:
    """CPU seconds of every step for one size."""

    size: float
    cpu_s: dict[str, float]


@app.command()
def cost(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and the figure.")] = Path("out/cost"),
) -> None:
    """Runs every step of recording and identification on records of several sizes."""
    cost_table(out, Plan())


def cost_table(out: Path, plan: Plan) -> None:
    """Print and draw what every step costs by a plan."""
    out.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[Costs]] = {}
    count, done = sum(map(len, plan.series.values())), 0
    with threadpool_limits(1), progress_bar("the steps at every size") as progress:
        for varied, sizes in plan.series.items():
            for size in sizes:
                settings, modes = _settings(varied, size)
                found.setdefault(varied, []).append(Costs(size, costs(settings, modes, out / "cost.mcap", plan)))
                done += 1
                progress(done / count)
    for varied, series in found.items():
        Console().print(_table(varied, series))
    path = out / "cost.png"
    _draw(found, path)
    Console().print(f"figure: {path}", soft_wrap=True)


def costs(settings: BarrelCradle, modes: int, path: Path, plan: Plan) -> dict[str, float]:
    """CPU seconds of every step on a record with these settings."""
    rig = settings.rig()
    force_n = force_history(settings.force(), settings.duration_s, settings.step_s)
    plant = partial(modal.simulate, modes_per_beam=modes)
    recorded = partial(
        record,
        rig,
        settings.force(),
        plant=plant,
        duration_s=settings.duration_s,
        step_s=settings.step_s,
        path=path,
        progress=lambda _: None,
    )
    cpu_s = partial(_cpu_s, plan.runs)
    spent = {
        "plant": cpu_s(lambda: list(plant(rig, force_n, settings.step_s, lambda _: None))),
        "plant, sensors and files": cpu_s(recorded),
        "reading": cpu_s(lambda: read(path)),
    }
    recording = read(path)
    found = identify_contact(recording)
    eta_m, force, equation = found.eta_m, found.motion.force_n, found.weak_nifo.equation
    times = oversampling(rig.sample_rate_hz)
    fine = np.repeat(recording.force_n, times)
    cut = blocks(force.size, rig.sample_rate_hz, Averaging(block_s=plan.block_s), (2.0, 100.0))
    return {
        **spent,
        "kinematics": cpu_s(lambda: kinematics(recording)),
        "contacts, separated and fitted": cpu_s(lambda: estimated_contacts(recording, "auto", LABORATORY)),
        "surface of an equation": cpu_s(lambda: fit_surface(equation, force, eta_m, 4, found.stops)),
        "NIFO of an equation": cpu_s(lambda: nifo(equation, force, eta_m, cut)),
        f"for comparison: one FFT of {times} x the samples": cpu_s(lambda: rfft(fine)),
    }


def _settings(varied: str, size: float) -> tuple[BarrelCradle, int]:
    if varied == "accelerometers":
        return replace(REFERENCE, stations=int(size) // 2), MODES
    if varied == "modes a beam":
        return REFERENCE, int(size)
    return replace(REFERENCE, duration_s=size), MODES


def _cpu_s(runs: int, work: Callable[[], object]) -> float:
    spent = []
    for _ in range(runs):
        begin = time.process_time()
        work()
        spent.append(time.process_time() - begin)
    return min(spent)


def _exponent(series: Sequence[Costs], step: str) -> float:
    """Of the power law from the smallest size to the largest."""
    first, last = series[0], series[-1]
    return float(np.log(last.cpu_s[step] / first.cpu_s[step]) / np.log(last.size / first.size))


def _table(varied: str, series: Sequence[Costs]) -> Table:
    table = Table(
        title=f"CPU seconds over {varied}", caption="exponent: of the power law from the first size to the last"
    )
    for heading in ("", *(f"{c.size:g}" for c in series), "exponent"):
        table.add_column(heading, justify="right" if heading else "left")
    for step in series[0].cpu_s:
        table.add_row(step, *(f"{c.cpu_s[step]:.3g}" for c in series), f"{_exponent(series, step):.2f}")
    return table


def _draw(found: dict[str, list[Costs]], path: Path) -> None:
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(10, 4.4), layout="constrained")
        panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
        for axes, (varied, series) in zip(panels, found.items(), strict=True):
            _lines(axes, varied, series)
        panels[0].set_ylabel("CPU time, s")
        figure.legend(*panels[-1].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
        figure.savefig(path, dpi=130)


def _lines(axes: Axes, varied: str, series: Sequence[Costs]) -> None:
    sizes = np.array([c.size for c in series])
    for k, step in enumerate(series[0].cpu_s):
        axes.loglog(sizes, [c.cpu_s[step] for c in series], "o-", ms=3, color=f"C{k}", label=step)
    if varied.startswith("length"):
        samples = sizes * REFERENCE.sample_rate_hz
        bound = samples * np.log(samples)
        axes.loglog(sizes, series[0].cpu_s["plant"] * bound / bound[0], "k:", label="n log n")
    axes.set_xlabel(varied)
    axes.set_xticks(sizes, [f"{s:g}" for s in sizes])
    axes.minorticks_off()


if __name__ == "__main__":
    run(app, "tests.campaigns.cost")
