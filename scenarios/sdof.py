"""The paper's section 2: one mass between two stops, recorded and identified.

python -m scenarios.sdof --out out/sdof
"""

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.command_line import run
from rig.simulation.reference import Sdof
from scenarios.compare import identify_against_truth, record_reference_rig

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def sdof(
    out: Annotated[Path, typer.Option(help="Folder for the recording, the results and the figures.")] = Path(
        "out/sdof"
    ),
    plant: Annotated[str, typer.Option(help="ancf (Exudyn) or modal.")] = "ancf",
) -> None:
    """Record the one-mass rig under the paper's conditions and compare what is identified with what is true."""
    # section 2.1: 1 kg on a 5 Hz spring, stops at +-1 mm with 1e4 N/m, a random force from 0 to 15 Hz
    settings = Sdof(noise_density=1e-3)
    recording = record_reference_rig(settings, plant, out / "sdof.mcap")

    # sections 2.2 and 2.3: displacement known, no noise, 40 averages, Hann window, 50 % overlap
    by_displacement = identify_against_truth(recording, use="displacement", out=out)
    by_displacement.print_estimates("One mass, displacement known")
    by_displacement.print_nifo_forms("NIFO over 0.5 to 14.5 Hz, displacement known", band_hz=(0.5, 14.5))

    # beyond the paper: the accelerometer alone, with its noise
    by_acceleration = identify_against_truth(recording, use="acceleration", out=out / "accelerometer")
    by_acceleration.print_estimates("One mass, accelerometer alone, with noise")
    by_acceleration.print_answer("by the accelerometer alone", out / "accelerometer" / "contact.html")


if __name__ == "__main__":
    run(app, "scenarios.sdof")
