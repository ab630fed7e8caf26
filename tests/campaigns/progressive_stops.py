"""Random machines with a progressive stop: a mass between two stops on either side, the farther one behind the nearer.

python -m tests.campaigns.progressive_stops --machines 5 --seed 1 --out out/progressive_stops
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

import identify
from identify.pages.wording import COVERED
from rig.commands.command_line import run
from rig.model.description import Rig
from scenarios.jitter import jittered
from tests.campaigns.topologies import Topology, interval, progressive_stop, recorded

NEARER_M, FARTHER_M, RATIO, STIFFNESS = (3e-4, 1e-3), 1.5e-3, (1.5, 3.0), (5e3, 1e5)
WRONG_CLEARANCE, WRONG_STIFFNESS = 0.2, 0.4
"""By so much, at most, rig.json is off."""
app = typer.Typer(pretty_exceptions_enable=False)


def machine(seed: int) -> tuple[Topology, Rig]:
    """What is believed of a machine, with a force that reaches the farther stop, and the machine."""
    rng = np.random.default_rng(seed)
    nearer = rng.uniform(*NEARER_M)
    farther = nearer * rng.uniform(RATIO[0], min(RATIO[1], FARTHER_M / nearer))
    low, high = np.log(STIFFNESS)
    stiffness = np.exp(rng.uniform(low, high, 2))
    true = np.column_stack([(nearer, farther), stiffness])
    believed = true * (1 + rng.uniform(-1, 1, (2, 2)) * (WRONG_CLEARANCE, WRONG_STIFFNESS))
    quantity = ("displacement", "acceleration")[seed % 2]
    spring = (2 * np.pi * 12) ** 2
    to_farther_n = spring * farther + stiffness[0] * (farther - nearer)
    case = Topology(progressive_stop(quantity, *believed.tolist()), float(0.6 * to_farther_n), "")
    return case, jittered(progressive_stop(quantity, *true.tolist()), rng)


@app.command()
def progressive_stops(
    machines: Annotated[int, typer.Option(min=1, help="How many.")] = 5,
    seed: Annotated[int, typer.Option(help="Of the first; odd ones have an accelerometer, others a displacement.")] = 1,
    out: Annotated[Path, typer.Option(help="Folder for the recordings.")] = Path("out/progressive_stops"),
) -> None:
    """Identifies both stops of random machines from 30 s, and counts the 95 % intervals that hold the true values."""
    out.mkdir(parents=True, exist_ok=True)
    table = Table(title="Found, with 95 % intervals (true value)")
    for heading in ("machine", "stop", "clearance, mm", "stiffness, N/mm"):
        table.add_column(heading)
    hits: list[bool] = []
    for number in track(range(seed, seed + machines), console=Console(stderr=True)):
        case, true = machine(number)
        report = identify.contact(recorded(case, out / f"{number}.mcap", seed=number, actual=true)).report
        for found in report.contacts:
            law = true.contact(found.name).law
            rows = ((found.clearance_m, 1e3, law.clearance_m), (found.stiffness_n_per_m, 1e-3, law.stiffness_n_per_m))
            hits += [abs(e.value - value) < COVERED * e.standard_error for e, _, value in rows]
            table.add_row(str(number), found.name, *(interval(*row) for row in rows))
        for silent in report.unanswered:
            table.add_row(str(number), silent.name, silent.reason, "")
    Console().print(table)
    Console().print(f"{sum(hits)} of {len(hits)} values are within their intervals")


if __name__ == "__main__":
    run(import_module("tests.campaigns.progressive_stops").app, "tests.campaigns.progressive_stops")
