"""The paper's section 3: a free barrel in a clamped cradle, recorded with Exudyn and identified.

python -m scenarios.barrel_cradle --out out
"""

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.command_line import run
from rig.recording import read, read_truth, truth_path
from rig.simulation.reference import BarrelCradle
from rig.viewer.identified import read_identified
from rig.viewer.viewing import write_rrd
from scenarios.compare import identify_against_truth, record_reference_rig

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def barrel_cradle(
    out: Annotated[Path, typer.Option(help="Folder for the recording, the results and the figures.")] = Path("out"),
    plant: Annotated[str, typer.Option(help="ancf (Exudyn) or modal.")] = "ancf",
) -> None:
    """Record the barrel-cradle rig and compare what is identified with what is true."""
    # section 3.1: two steel beams, +-5 mm of play and 1e5 N/m at both contacts, a random force of 0.5 to 100 Hz at the
    # barrel's end; every station has a displacement sensor without noise and an accelerometer of 1e-3 m/s2/sqrt(Hz)
    settings = BarrelCradle(noise_density=1e-3)
    recording = record_reference_rig(settings, plant, out / "barrel_cradle.mcap")

    # sections 3.2 and 3.3: modal transformation, surface, histogram, NIFO; displacements known, without noise
    by_displacement = identify_against_truth(recording, use="displacement", equation="barrel 3", out=out)
    by_displacement.print_estimates("Displacements known")
    by_displacement.print_by_equation("Displacements known: surface and NIFO in every equation of the barrel")
    by_displacement.print_nifo_forms("NIFO in the barrel's equation 3, displacements known")

    # beyond the paper: the accelerometers alone
    by_acceleration = identify_against_truth(recording, use="acceleration", out=out / "accelerometers")
    by_acceleration.print_estimates("Accelerometers alone, with noise")
    by_acceleration.print_by_equation("Accelerometers alone: surface and NIFO in every equation of the barrel")

    # for the viewer: the identified walls over the true ones
    content = read(recording)
    contacts = read_identified(out / "accelerometers", content.rig, content.duration_s)
    write_rrd(content, read_truth(truth_path(recording)), out / "barrel_cradle.rrd", identified_contacts=contacts)

    by_acceleration.print_answer("by accelerometers alone", out / "accelerometers" / "contact.html")


if __name__ == "__main__":
    run(app, "scenarios.barrel_cradle")
