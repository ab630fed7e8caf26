"""NIFO against the contact stiffness (figure 18 of the paper).

python -m scenarios.stiffness_sweep --out out/stiffness_sweep
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

STIFFNESSES_N_PER_M = (1e4, 3e4, 1e5, 3e5, 1e6)
app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def stiffness_sweep(
    out: Annotated[Path, typer.Option(help="Folder for the results and the figure.")] = Path("out/stiffness_sweep"),
    block: Block = BLOCK_S,
    sample_rate: Rate = LONG.sample_rate_hz,
    dask: Dask = None,
) -> None:
    """Records the barrel in its cradle with contacts of one stiffness after the other, and finds it."""
    settings = replace(LONG, sample_rate_hz=sample_rate)
    studied = [
        (k, Study(settings=replace(settings, stiffness_1_n_per_m=k, stiffness_2_n_per_m=k), block_s=(block,)))
        for k in STIFFNESSES_N_PER_M
    ]
    points = points_of(studied, out, dask)
    shown("NIFO against the contact stiffness", "contact stiffness, N/m", points, out / "stiffness_sweep.png")


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.stiffness_sweep").app, "scenarios.stiffness_sweep")
