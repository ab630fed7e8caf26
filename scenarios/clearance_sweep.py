"""NIFO against the clearance (figure 20 of the paper).

python -m scenarios.clearance_sweep --out out/clearance_sweep
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from rig.commands.command_line import run
from scenarios.nifo_study import LONG, Study
from scenarios.nifo_sweep import BLOCK_S, Block, Rate, points_of, shown
from scenarios.tasks import Dask

CLEARANCES_M = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2)
app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def clearance_sweep(
    out: Annotated[Path, typer.Option(help="Folder for the results and the figure.")] = Path("out/clearance_sweep"),
    block: Block = BLOCK_S,
    sample_rate: Rate = LONG.sample_rate_hz,
    dask: Dask = None,
) -> None:
    """Records the barrel in its cradle with one clearance after the other, and finds the stiffnesses."""
    settings = replace(LONG, sample_rate_hz=sample_rate)
    studied = [
        (1e3 * c, Study(settings=replace(settings, clearance_1_m=c, clearance_2_m=c), block_s=(block,)))
        for c in CLEARANCES_M
    ]
    points = points_of(studied, out, dask)
    shown("NIFO against the clearance", "clearance, mm", points, out / "clearance_sweep.png")


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.clearance_sweep").app, "scenarios.clearance_sweep")
