"""Errors of NIFO over one varied quantity, as the paper studies them: a table and a figure.

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
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table

from identify.pages.wording import COVERED
from rig.commands.command_line import console_table, run
from rig.commands.tasks import Dask, run_tasks
from scenarios.nifo_study import LONG_RECORD_RIG, NifoEstimate, NifoOutcome, Study, nifo_outcome

BLOCK_S = 1200.0
"""The paper's longest block, for a resolution of 0.000833 Hz."""
BLOCK_SHARES = (1 / 6, 1 / 3, 2 / 3, 1)
"""Block lengths over the longest: 0.005, 0.0025, 0.00125 and 0.000833 Hz."""
NOISE_DENSITY = 2e-7
"""Noise density of the displacements, m/sqrt(Hz): 6 um rms at 2048 samples a second."""
FORM_NAMES = {"paper": "the paper's NIFO", "weak": "weak form"}
COLOURS = {"paper": "#b4540a", "weak": "#1f5fa8"}
PAPER_ERRORS_PERCENT = (0.115, 2.65)
"""The paper's stated errors of the two stiffnesses, per cent."""

app = typer.Typer(pretty_exceptions_enable=False)
Varied = Literal["resolution", "stiffness", "force", "clearance"]


@dataclass(frozen=True)
class Sweep:
    """Varied quantity: its name, axis with unit, the settings that take its values, and their factor on the axis."""

    quantity: str
    axis: str
    settings: tuple[str, ...]
    values: Sequence[float]
    unit_factor: float = 1.0
    noise_densities: tuple[float, ...] = (0.0,)


STIFFNESSES, CLEARANCES = ("stiffness_1_n_per_m", "stiffness_2_n_per_m"), ("clearance_1_m", "clearance_2_m")
RMS_N = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
SWEEPS: Mapping[str, Sweep] = {
    "resolution": Sweep("its frequency resolution", "resolution, Hz", ("seed",), ()),
    "stiffness": Sweep("the contact stiffness", "contact stiffness, N/m", STIFFNESSES, (1e4, 3e4, 1e5, 3e5, 1e6)),
    "force": Sweep("the force", "force, N rms", ("rms_n",), RMS_N, noise_densities=(0.0, NOISE_DENSITY)),
    "clearance": Sweep("the clearance", "clearance, mm", CLEARANCES, (1e-3, 2e-3, 5e-3, 1e-2, 2e-2), unit_factor=1e3),
}
"""Sweeps by their quantity; that of the resolution has a value for every block length of each record."""


@app.command()
def nifo_sweep(
    varied: Annotated[Varied, typer.Argument(help="What is varied.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results and the figure; out/nifo_VARIED by default.")
    ] = None,
    block: Annotated[
        float, typer.Option("--block", min=1.0, help="Longest block, s; a record is 20.5 times as long.")
    ] = BLOCK_S,
    sample_rate: Annotated[
        float, typer.Option(min=1024.0, help="Of the sensors, Hz.")
    ] = LONG_RECORD_RIG.sample_rate_hz,
    records: Annotated[
        int, typer.Option(min=1, help="So many records, each under a force of its own; of the resolution alone.")
    ] = 2,
    dask: Dask = None,
) -> None:
    """Record the barrel in its cradle while one quantity is varied, and identify the contact stiffnesses by NIFO."""
    folder, sweep = out or Path("out") / f"nifo_{varied}", SWEEPS[varied]
    of_resolution, rig = varied == "resolution", replace(LONG_RECORD_RIG, sample_rate_hz=sample_rate)
    values = range(1, 1 + records) if of_resolution else sweep.values
    studies = [
        Study(
            settings=replace(rig, **dict.fromkeys(sweep.settings, value)),
            block_s=tuple(block * share for share in (BLOCK_SHARES if of_resolution else (1.0,))),
            noise_densities=sweep.noise_densities,
        )
        for value in values
    ]
    outcomes = run_tasks(nifo_outcome, studies, NifoOutcome, folder / "tasks", dask)
    points = []
    for value, outcome in zip(values, outcomes, strict=True):
        closed_shares = dict(zip(outcome.contacts, outcome.closed_shares, strict=True))
        for estimate in outcome.estimates:
            axis_value = 1 / estimate.block_s if of_resolution else sweep.unit_factor * value
            points.append(Point(axis_value, estimate, closed_shares[estimate.contact], outcome.incoherent_rms_shares))
    noisy_points = [point for point in points if point.estimate.noise_density]
    ideal = ideal_range(noisy_points) if noisy_points else None
    print_and_draw(f"NIFO against {sweep.quantity}", sweep.axis, points, folder / f"{varied}.png", ideal)
    if ideal:
        Console().print(
            f"with noise the errors are within three times the least from {ideal[0]:g} to {ideal[1]:g} N rms"
        )


@dataclass(frozen=True)
class Point:
    """Estimate of a contact at a value of the varied quantity, and the share of the time for which it is closed.

    incoherent_rms_shares are those of force and penetrations (`nifo_study.incoherent_rms_shares`).
    """

    value: float
    estimate: NifoEstimate
    closed_share: float
    incoherent_rms_shares: tuple[float, ...]

    @property
    def case(self) -> str:
        """Name of the case that has a line of its own; empty without noise."""
        return "noise" if self.estimate.noise_density else ""

    @property
    def line(self) -> str:
        """Name of the point's line in the figure."""
        names = (FORM_NAMES[self.estimate.form], self.estimate.contact.replace("_", " "), self.case)
        return ", ".join(filter(None, names))


def ideal_range(points: Sequence[Point]) -> tuple[float, float]:
    """Range of values around the best one in which the weak form's error is within three times the least.

    The error is the rms over the contacts.
    """
    weak_points = [point for point in points if point.estimate.form == "weak"]
    values = sorted({point.value for point in weak_points})
    errors = _rms_over_records(weak_points, values, lambda estimate: estimate.mean_error_percent)
    best, bad = int(np.argmin(errors)), np.flatnonzero(errors > 3 * errors.min())
    return values[max(bad[bad < best], default=-1) + 1], values[min(bad[bad > best], default=len(values)) - 1]


def _rms_over_records(
    points: Sequence[Point], values: Sequence[float], error_of: Callable[[NifoEstimate], float]
) -> Float[np.ndarray, " values"]:
    """Root mean square of an error over the points at each value."""
    errors = ([error_of(point.estimate) for point in points if point.value == value] for value in values)
    return np.array([np.sqrt(np.mean(np.square(row))) for row in errors])


def print_and_draw(
    title: str, quantity: str, points: Sequence[Point], path: Path, ideal: tuple[float, float] | None = None
) -> None:
    """Print the table and draw the figure over a quantity with its unit; the `ideal` range is shaded."""
    Console().print(_table(title, quantity, points))
    with mpl.rc_context({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(9, 4.6), layout="constrained")
        mean_axes, spread_axes = figure.subplots(1, 2, sharex=True)
        _draw_lines(mean_axes, points, lambda e: e.mean_error_percent)
        _draw_lines(spread_axes, points, lambda e: e.spread_percent)
        for paper_error, style in zip(PAPER_ERRORS_PERCENT, (":", "-."), strict=True):
            mean_axes.axhline(paper_error, color="k", lw=1, ls=style, label=f"{paper_error} %, stated in the paper")
        if ideal is not None:
            for axes in (mean_axes, spread_axes):
                axes.axvspan(*ideal, color="#3a7d44", alpha=0.12, lw=0, label="ideal range, with noise")
        mean_axes.set(xlabel=quantity, ylabel="error of the spectral mean of the stiffness, %")
        spread_axes.set(xlabel=quantity, ylabel="rms spread of the stiffness over frequency, %")
        figure.legend(*mean_axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
        figure.suptitle(title)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=130)
    Console().print(f"figure: {path}", soft_wrap=True)


def _table(title: str, quantity: str, points: Sequence[Point]) -> Table:
    """Table with a row for each record and a column for each form and contact."""
    columns = dict.fromkeys((point.estimate.form, point.estimate.contact) for point in points)
    headings = (quantity, "closed, %", "free, %", *(f"{FORM_NAMES[form]}\n{contact}" for form, contact in columns))
    table = console_table(title, [heading.replace("_", " ") for heading in headings], 0)
    table.caption = (
        "error of the spectral mean ± 95 % (rms spread over frequency), %; free: of force and penetrations, the "
        "amplitude that is no linear response to the others"
    )
    points_by_row: dict[tuple[str, float], list[Point]] = {}
    for point in points:
        points_by_row.setdefault((point.case, point.value), []).append(point)
    for (case, value), row_points in points_by_row.items():
        closed_shares = [
            np.mean([point.closed_share for point in row_points if point.estimate.contact == contact])
            for contact in dict.fromkeys(contact for _, contact in columns)
        ]
        closed_text = ", ".join(f"{100 * share:.0f}" for share in closed_shares)
        cells = (
            "\n".join(
                f"{e.mean_error_percent:.4f} ± {COVERED * e.standard_error_percent:.4f} ({e.spread_percent:.3g})"
                for e in (point.estimate for point in row_points)
                if (e.form, e.contact) == column
            )
            for column in columns
        )
        incoherent_text = ", ".join(f"{100 * share:.0f}" for share in row_points[0].incoherent_rms_shares)
        table.add_row(f"{value:.3g}{case and ', ' + case}", closed_text, incoherent_text, *cells)
    return table


def _draw_lines(axes: Axes, points: Sequence[Point], error_of: Callable[[NifoEstimate], float]) -> None:
    """Draw a line for each form, contact and case: the root mean square of an error over the records."""
    cases = list(dict.fromkeys(point.case for point in points))
    for line in dict.fromkeys(point.line for point in points):
        line_points = [point for point in points if point.line == line]
        values = sorted({point.value for point in line_points})
        axes.loglog(
            values,
            _rms_over_records(line_points, values, error_of),
            color=COLOURS[line_points[0].estimate.form],
            marker="os"[line_points[0].estimate.contact.endswith("2")],
            ls=("-", "--")[cases.index(line_points[0].case)],
            ms=4,
            label=line,
        )
    values = sorted({point.value for point in points})
    axes.set_xticks(values, [f"{float(f'{value:.3g}'):g}" for value in values])
    axes.set_xticks([], minor=True)


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.nifo_sweep").app, "scenarios.nifo_sweep")
