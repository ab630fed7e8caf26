"""Tables and figures of the studies of NIFO: its errors over one thing that is varied."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib as mpl
import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from identify.pages.wording import COVERED
from scenarios.nifo_study import NifoEstimate, NifoOutcome, Study, estimated
from scenarios.tasks import run_tasks

BLOCK_S = 1200.0
"""The paper's longest block, for a resolution of 0.000833 Hz."""
Block = Annotated[float, typer.Option("--block", min=1.0, help="Longest block, s; a record is 20.5 times as long.")]
Rate = Annotated[float, typer.Option("--sample-rate", min=1024.0, help="Of the sensors, Hz.")]
NAMES = {"paper": "the paper's NIFO", "weak": "weak form"}
COLOURS = {"paper": "#b4540a", "weak": "#1f5fa8"}
STATED = (0.115, 2.65)
"""The paper's stated errors of the two stiffnesses, per cent."""


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
