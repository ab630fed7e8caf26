"""NIFO against its frequency resolution (table 3 and figure 17 of the paper): 40 averages of blocks up to 1200 s.

python -m scenarios.frequency_resolution --out out/frequency_resolution
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace

from rig.commands.command_line import run
from scenarios.nifo_study import LONG, Study
from scenarios.nifo_sweep import BLOCK_S, Block, Point, Rate, points_of, shown
from scenarios.tasks import Dask

SHARES = (1 / 6, 1 / 3, 2 / 3, 1)
"""Of the longest block: 0.005, 0.0025, 0.00125 and 0.000833 Hz."""
app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def frequency_resolution(
    out: Annotated[Path, typer.Option(help="Folder for the results and the figure.")] = Path(
        "out/frequency_resolution"
    ),
    block: Block = BLOCK_S,
    sample_rate: Rate = LONG.sample_rate_hz,
    seeds: Annotated[int, typer.Option(min=1, help="So many records, each under a force of its own.")] = 2,
    dask: Dask = None,
) -> None:
    """Records the barrel in its cradle for 24 600 s, and finds the stiffnesses from blocks of four lengths."""
    blocks_s = tuple(block * share for share in SHARES)
    settings = replace(LONG, sample_rate_hz=sample_rate)
    studied = [(0.0, Study(settings=replace(settings, seed=1 + k), block_s=blocks_s)) for k in range(seeds)]
    points = [Point(1 / p.found.block_s, p.found, p.closed, p.free) for p in points_of(studied, out, dask)]
    shown("NIFO against its frequency resolution", "resolution, Hz", points, out / "frequency_resolution.png")


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.frequency_resolution").app, "scenarios.frequency_resolution")
