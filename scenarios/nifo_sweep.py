"""Errors of NIFO over one thing that is varied, as the paper studies them: a table and a figure.

python -m scenarios.nifo_sweep resolution     table 3 and figure 17: 40 averages of blocks up to 1200 s
python -m scenarios.nifo_sweep stiffness      figure 18
python -m scenarios.nifo_sweep force          figure 19, with displacements known exactly and with noise
python -m scenarios.nifo_sweep clearance      figure 20
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import matplotlib as mpl
import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table

from identify.pages.wording import COVERED
from rig.commands.command_line import run
from rig.commands.tasks import Dask, run_tasks
from rig.simulation.reference import BarrelCradle
from scenarios.nifo_study import LONG, NifoEstimate, NifoOutcome, Study, estimated

BLOCK_S = 1200.0
"""The paper's longest block, for a resolution of 0.000833 Hz."""
BLOCK_SHARES = (1 / 6, 1 / 3, 2 / 3, 1)
"""Of the longest block: 0.005, 0.0025, 0.00125 and 0.000833 Hz."""
STIFFNESSES_N_PER_M = (1e4, 3e4, 1e5, 3e5, 1e6)
RMS_N = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
NOISE_M = 2e-7
"""Of the displacements, m/sqrt(Hz): 6 um rms at 2048 samples a second."""
CLEARANCES_M = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2)
NAMES = {"paper": "the paper's NIFO", "weak": "weak form"}
COLOURS = {"paper": "#b4540a", "weak": "#1f5fa8"}
STATED = (0.115, 2.65)
"""The paper's stated errors of the two stiffnesses, per cent."""

app = typer.Typer(pretty_exceptions_enable=False)
Varied = Literal["resolution", "stiffness", "force", "clearance"]


@dataclass(frozen=True)
class Sweep:
    """What is varied, for title and axis, and the studies of a setting and a longest block (s) with its values."""

    title: str
    axis: str
    studies: Callable[[BarrelCradle, float, int], list[tuple[float, Study]]]


def _of_resolution(settings: BarrelCradle, block_s: float, records: int) -> list[tuple[float, Study]]:
    """Of which every record gives a value for each of its blocks."""
    blocks_s = tuple(block_s * share for share in BLOCK_SHARES)
    return [(0.0, Study(settings=replace(settings, seed=1 + k), block_s=blocks_s)) for k in range(records)]


def _of_stiffness(settings: BarrelCradle, block_s: float, _records: int) -> list[tuple[float, Study]]:
    return [
        (k, Study(settings=replace(settings, stiffness_1_n_per_m=k, stiffness_2_n_per_m=k), block_s=(block_s,)))
        for k in STIFFNESSES_N_PER_M
    ]


def _of_force(settings: BarrelCradle, block_s: float, _records: int) -> list[tuple[float, Study]]:
    return [
        (rms_n, Study(settings=replace(settings, rms_n=rms_n), block_s=(block_s,), noise_densities=(0.0, NOISE_M)))
        for rms_n in RMS_N
    ]


def _of_clearance(settings: BarrelCradle, block_s: float, _records: int) -> list[tuple[float, Study]]:
    return [
        (1e3 * c, Study(settings=replace(settings, clearance_1_m=c, clearance_2_m=c), block_s=(block_s,)))
        for c in CLEARANCES_M
    ]


SWEEPS: Mapping[str, Sweep] = {
    "resolution": Sweep("NIFO against its frequency resolution", "resolution, Hz", _of_resolution),
    "stiffness": Sweep("NIFO against the contact stiffness", "contact stiffness, N/m", _of_stiffness),
    "force": Sweep("NIFO against the force", "force, N rms", _of_force),
    "clearance": Sweep("NIFO against the clearance", "clearance, mm", _of_clearance),
}


@app.command()
def nifo_sweep(
    varied: Annotated[Varied, typer.Argument(help="What is varied.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results and the figure; out/nifo_VARIED by default.")
    ] = None,
    block: Annotated[
        float, typer.Option("--block", min=1.0, help="Longest block, s; a record is 20.5 times as long.")
    ] = BLOCK_S,
    sample_rate: Annotated[float, typer.Option(min=1024.0, help="Of the sensors, Hz.")] = LONG.sample_rate_hz,
    records: Annotated[
        int, typer.Option(min=1, help="So many records, each under a force of its own; of the resolution alone.")
    ] = 2,
    dask: Dask = None,
) -> None:
    """Record the barrel in its cradle while one thing is varied, and find the contact stiffnesses by NIFO."""
    folder, sweep = out or Path("out") / f"nifo_{varied}", SWEEPS[varied]
    points = points_of(sweep.studies(replace(LONG, sample_rate_hz=sample_rate), block, records), folder, dask)
    if varied == "resolution":
        points = [Point(1 / p.found.block_s, p.found, p.closed, p.free) for p in points]
    noisy = [p for p in points if p.found.noise_density]
    ideal = ideal_range(noisy) if noisy else None
    shown(sweep.title, sweep.axis, points, folder / f"{varied}.png", ideal)
    if ideal:
        Console().print(
            f"with noise the errors are within three times the least from {ideal[0]:g} to {ideal[1]:g} N rms"
        )


@dataclass(frozen=True)
class Point:
    """What was found for one contact where the thing that is varied has this value.

    `closed` of the time it is, and so much of the force and of the penetrations is free (`incoherent_shares`).
    """

    value: float
    found: NifoEstimate
    closed: float
    free: tuple[float, ...]

    @property
    def case(self) -> str:
        """A line of its own."""
        return "noise" if self.found.noise_density else ""

    @property
    def line(self) -> str:
        return ", ".join(filter(None, (NAMES[self.found.form], self.found.contact.replace("_", " "), self.case)))


def points_of(studied: Sequence[tuple[float, Study]], out: Path, dask: str | None) -> list[Point]:
    """Of a value and a study each; what an earlier, interrupted run finished is not computed again."""
    outcomes = run_tasks(estimated, [study for _, study in studied], NifoOutcome, out / "tasks", dask)
    return [
        Point(value, found, dict(zip(outcome.contacts, outcome.closed, strict=True))[found.contact], outcome.free)
        for (value, _), outcome in zip(studied, outcomes, strict=True)
        for found in outcome.estimates
    ]


def ideal_range(points: Sequence[Point]) -> tuple[float, float]:
    """The ends of the values around the best one at all of which the weak form's error is within three times the least.

    The error is the rms over the contacts.
    """
    weak = [point for point in points if point.found.form == "weak"]
    values = sorted({point.value for point in weak})
    errors = np.array([np.sqrt(np.mean([p.found.off_percent**2 for p in weak if p.value == v])) for v in values])
    best, bad = int(np.argmin(errors)), np.flatnonzero(errors > 3 * errors.min())
    return values[max(bad[bad < best], default=-1) + 1], values[min(bad[bad > best], default=len(values)) - 1]


def shown(
    title: str, varied: str, points: Sequence[Point], path: Path, ideal: tuple[float, float] | None = None
) -> None:
    """Prints the table and draws the figure; `varied` names what is varied, with its unit; `ideal` is shaded."""
    Console().print(_table(title, varied, points))
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(9, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2, sharex=True)
        _drawn(left, points, lambda e: e.off_percent)
        _drawn(right, points, lambda e: e.spread_percent)
        for stated, style in zip(STATED, (":", "-."), strict=True):
            left.axhline(stated, color="k", lw=1, ls=style, label=f"{stated} %, stated in the paper")
        if ideal is not None:
            for axes in (left, right):
                axes.axvspan(*ideal, color="#3a7d44", alpha=0.12, lw=0, label="ideal range, with noise")
        left.set(xlabel=varied, ylabel="error of the spectral mean of the stiffness, %")
        right.set(xlabel=varied, ylabel="rms spread of the stiffness over frequency, %")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
        figure.suptitle(title)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=130)
    Console().print(f"figure: {path}", soft_wrap=True)


def _table(title: str, varied: str, points: Sequence[Point]) -> Table:
    """A row for each record, a column for each form and contact."""
    table = Table(
        title=title,
        caption="error of the spectral mean ± 95 % (rms spread over frequency), %; free: of force and "
        "penetrations, the amplitude that is no linear response to the others",
    )
    columns = dict.fromkeys((p.found.form, p.found.contact) for p in points)
    for heading in (varied, "closed, %", "free, %", *(f"{NAMES[form]}\n{contact}" for form, contact in columns)):
        table.add_column(heading.replace("_", " "), justify="right")
    rows: dict[tuple[str, float], list[Point]] = {}
    for point in points:
        rows.setdefault((point.case, point.value), []).append(point)
    for (case, value), own in rows.items():
        shares = [
            np.mean([p.closed for p in own if p.found.contact == c]) for c in dict.fromkeys(c for _, c in columns)
        ]
        closed = ", ".join(f"{100 * share:.0f}" for share in shares)
        found = (
            "\n".join(
                f"{p.found.off_percent:.4f} ± {COVERED * p.found.error_percent:.4f} ({p.found.spread_percent:.3g})"
                for p in own
                if (p.found.form, p.found.contact) == column
            )
            for column in columns
        )
        free = ", ".join(f"{100 * share:.0f}" for share in own[0].free)
        table.add_row(f"{value:.3g}{case and ', ' + case}", closed, free, *found)
    return table


def _drawn(axes: Axes, points: Sequence[Point], what: Callable[[NifoEstimate], float]) -> None:
    """A line each: the root mean square over the records of a value."""
    cases = list(dict.fromkeys(p.case for p in points))
    for line in dict.fromkeys(p.line for p in points):
        own = [p for p in points if p.line == line]
        values = sorted({p.value for p in own})
        sizes = [np.sqrt(np.mean([what(p.found) ** 2 for p in own if p.value == value])) for value in values]
        axes.loglog(
            values,
            sizes,
            color=COLOURS[own[0].found.form],
            marker="os"[own[0].found.contact.endswith("2")],
            ls=("-", "--")[cases.index(own[0].case)],
            ms=4,
            label=line,
        )
    values = sorted({p.value for p in points})
    axes.set_xticks(values, [f"{float(f'{value:.3g}'):g}" for value in values])
    axes.set_xticks([], minor=True)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.nifo_sweep").app, "scenarios.nifo_sweep")
