"""Histories of the barrel in its cradle, worn and not: python -m tests.campaigns.wear --out out/wear

Every machine is built as a laboratory builds it (`scenarios.jitter`), and recorded twelve times with forces and noise
of their own. Half of the machines wear: the clearance of one contact grows from recording to recording, by 2 % in all.
"""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import identify
from identify.history.changes import QuantityHistory
from identify.pages.wording import interval
from rig.commands.command_line import run
from rig.commands.tasks import Dask, run_tasks
from rig.effects.contact_clearance import ContactClearance
from rig.simulation.plants import plant_named
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle
from scenarios.jitter import jittered

DURATION_S = 20.0
WORN = "contact_2"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class Machine(msgspec.Struct, frozen=True):
    """How it is drawn and how much it wears in all."""

    seed: int
    wear: float
    recordings: int
    folder: str


class Outcome(msgspec.Struct, frozen=True):
    """What its history says: the quantities that changed; of the clearance that may wear, drift and p of the trend."""

    wear: float
    changed: tuple[str, ...]
    p_trend: float
    drift_percent: float
    error_percent: float
    scatter: tuple[float, ...]
    """Of each clearance about its trend, in own errors."""


@app.command()
def wear(
    out: Annotated[Path, typer.Option(help="Folder for the recordings, the histories and their pages.")] = Path(
        "out/wear"
    ),
    machines: Annotated[int, typer.Option(min=1, help="So many that wear, and as many that do not.")] = 5,
    recordings: Annotated[int, typer.Option(min=4, help="Of every machine.")] = 12,
    total: Annotated[float, typer.Option("--wear", help="Growth of the clearance from the first to the last.")] = 0.02,
    seed: Annotated[int, typer.Option(min=0, help="Everything is drawn from it.")] = 1,
    dask: Dask = None,
) -> None:
    """Records the machines and prints what identify history says of each."""
    drawn = [
        Machine(100 * seed + number, share, recordings, str(out / f"machine_{number}_{'worn' if share else 'same'}"))
        for number in range(machines)
        for share in (total, 0.0)
    ]
    found = run_tasks(outcome_of, drawn, Outcome, out / "tasks", dask)
    table = Table("machine", "wear, %", "drift found, %, ± 95 %", "p of the trend", "what changed")
    for machine, one in zip(drawn, found, strict=True):
        drift = interval(one.drift_percent, one.error_percent, "1")
        table.add_row(
            Path(machine.folder).name, f"{100 * one.wear:g}", drift, f"{one.p_trend:.2g}", "\n".join(one.changed)
        )
    Console().print(table)
    scatter = np.array([one.scatter for one in found])
    print(
        "clearances scatter about their trends, in own errors: "
        f"{np.sqrt(np.mean(scatter**2)):.2f} (root mean square), at most {scatter.max():.2f}"
    )


def outcome_of(machine: Machine) -> Outcome:
    """Records and compares."""
    rng, folder = np.random.default_rng(machine.seed), Path(machine.folder)
    folder.mkdir(parents=True, exist_ok=True)
    true, paths = None, []
    for number in range(machine.recordings):
        told = BarrelCradle(noise_density=1e-3, seed=1000 * machine.seed + number)
        rig = told.rig()
        true = true or jittered(rig, rng)
        grown = ContactClearance(factor=1 + machine.wear * number / (machine.recordings - 1), contact=WORN)
        paths.append(folder / f"run{number + 1}.mcap")
        record(
            rig,
            told.force(),
            plant=plant_named("modal"),
            duration_s=DURATION_S,
            step_s=told.step_s,
            path=paths[-1],
            progress=lambda _: None,
            actual=grown.applied_to(true),
        )
    found = identify.compare(paths)
    found.save(folder)
    quantities = found.report.quantities
    may_wear = next(q for q in quantities if (q.of, q.quantity) == (WORN, "clearance_m"))
    if may_wear.drift is None or may_wear.p_trend is None:
        raise AssertionError("a trend is tested from four recordings on")
    share = 100 / may_wear.mean
    return Outcome(
        wear=machine.wear,
        changed=tuple(f"{q.of}: {q.quantity}" for q in quantities if q.changed),
        p_trend=may_wear.p_trend,
        drift_percent=share * may_wear.drift.value,
        error_percent=share * may_wear.drift.standard_error,
        scatter=tuple(_scatter(q) for q in quantities if q.quantity == "clearance_m"),
    )


def _scatter(clearance: QuantityHistory) -> float:
    values, errors = np.array([clearance.values, clearance.own_errors], float)
    at = np.arange(values.size)
    trend = np.polynomial.Polynomial.fit(at, values, 1, w=1 / errors)
    return float(np.sqrt(np.sum(((values - trend(at)) / errors) ** 2) / (values.size - 2)))


if __name__ == "__main__":
    run(app, "python -m tests.campaigns.wear")
