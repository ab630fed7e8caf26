"""The paper's section 2: one mass between two stops, recorded and identified.

python -m scenarios.sdof --out out/sdof
"""

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.command_line import run
from rig.simulation.reference import Sdof
from scenarios.compare import forms_beside, identified_against_true, recorded, shown

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def sdof(
    out: Annotated[Path, typer.Option(help="Folder for the recording, the results and the figures.")] = Path(
        "out/sdof"
    ),
    plant: Annotated[str, typer.Option(help="ancf (Exudyn) or modal.")] = "ancf",
) -> None:
    """Records the one-mass rig under the paper's conditions and compares what is identified with what is true."""
    # section 2.1: 1 kg on a 5 Hz spring, stops at +-1 mm with 1e4 N/m, a random force from 0 to 15 Hz
    settings = Sdof(noise_density=1e-3)
    recording = recorded(settings, plant, out / "sdof.mcap")

    # sections 2.2 and 2.3: displacement known, no noise, 40 averages, Hann window, 50 % overlap
    known = identified_against_true(recording, use="displacement", out=out)
    shown("One mass, displacement known", known)
    forms_beside(known, "NIFO over 0.5 to 14.5 Hz, displacement known", band_hz=(0.5, 14.5))

    # beyond the paper: the accelerometer alone, with its noise
    alone = identified_against_true(recording, use="acceleration", out=out / "accelerometer")
    shown("One mass, accelerometer alone, with noise", alone)


if __name__ == "__main__":
    run(app, "scenarios.sdof")
