"""NIFO against the level of the force (figure 19 of the paper), with displacements known exactly and with noise.

python -m scenarios.excitation_sweep --out out/excitation_sweep
"""

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from msgspec.structs import replace
from rich.console import Console

from rig.commands.command_line import run
from scenarios.nifo_study import LONG, Study
from scenarios.nifo_sweep import BLOCK_S, Block, Rate, ideal_range, points_of, shown
from scenarios.tasks import Dask

RMS_N = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
NOISE = 2e-7
"""Of the displacements, m/sqrt(Hz): 6 um rms at 2048 samples a second."""
app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def excitation_sweep(
    out: Annotated[Path, typer.Option(help="Folder for the results and the figure.")] = Path("out/excitation_sweep"),
    block: Block = BLOCK_S,
    sample_rate: Rate = LONG.sample_rate_hz,
    dask: Dask = None,
) -> None:
    """Records the barrel in its cradle under weaker and stronger forces, and finds the stiffnesses."""
    settings = replace(LONG, sample_rate_hz=sample_rate)
    studied = [
        (rms_n, Study(settings=replace(settings, rms_n=rms_n), block_s=(block,), noise_densities=(0.0, NOISE)))
        for rms_n in RMS_N
    ]
    points = points_of(studied, out, dask)
    low, high = ideal_range([p for p in points if p.found.noise_density])
    shown("NIFO against the force", "force, N rms", points, out / "excitation_sweep.png", (low, high))
    Console().print(f"with noise the errors are within three times the least from {low:g} to {high:g} N rms")


if __name__ == "__main__":  # under its own name, by which other processes find its tasks
    run(import_module("scenarios.excitation_sweep").app, "scenarios.excitation_sweep")
