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
from scenarios.compare import equation_by_equation, forms_beside, identified_against_true, recorded, shown

app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def barrel_cradle(
    out: Annotated[Path, typer.Option(help="Folder for the recording, the results and the figures.")] = Path("out"),
    plant: Annotated[str, typer.Option(help="ancf (Exudyn) or modal.")] = "ancf",
) -> None:
    """Records the barrel-cradle rig and compares what is identified with what is true."""
    # section 3.1: two steel beams, +-5 mm of play and 1e5 N/m at both contacts, a random force of 0.5 to 100 Hz at the
    # barrel's end; every station has a displacement sensor without noise and an accelerometer of 1e-3 m/s2/sqrt(Hz)
    settings = BarrelCradle(noise_density=1e-3)
    recording = recorded(settings, plant, out / "barrel_cradle.mcap")

    # sections 3.2 and 3.3: modal transformation, surface, histogram, NIFO; displacements known, without noise
    known = identified_against_true(recording, use="displacement", equation="barrel 3", out=out)
    shown("Displacements known", known)
    equation_by_equation(known, "Displacements known: surface and NIFO in every equation of the barrel")
    forms_beside(known, "NIFO in the barrel's equation 3, displacements known")

    # beyond the paper: the accelerometers alone
    alone = identified_against_true(recording, use="acceleration", out=out / "accelerometers")
    shown("Accelerometers alone, with noise", alone)
    equation_by_equation(alone, "Accelerometers alone: surface and NIFO in every equation of the barrel")

    # for the viewer: the walls found over the true ones
    rig = read(recording)
    found = read_identified(out / "accelerometers", rig.rig, rig.duration_s)
    write_rrd(rig, read_truth(truth_path(recording)), out / "barrel_cradle.rrd", identified_contacts=found)


if __name__ == "__main__":
    run(app, "scenarios.barrel_cradle")
