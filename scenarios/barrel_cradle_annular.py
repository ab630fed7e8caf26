"""A tube that lies in two rings of its cradle, in two directions and under its weight: recorded and identified.

python -m scenarios.barrel_cradle_annular --out out
"""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from identify.contacts.space_identification import identify_in_space
from identify.contacts.space_report import write_space_results
from rig.commands.command_line import progress_bar, run
from rig.model.tolerances import tolerances_named
from rig.recording import read, read_truth, truth_path
from rig.simulation.reference import BarrelCradleAnnular
from scenarios.compare import print_estimates, record_reference_rig

QUANTITIES = {
    "clearance_m": ("radial clearance, mm", 1e3),
    "stiffness_n_per_m": ("stiffness, N/m", 1.0),
    "damping_n_s_per_m": ("damping, N s/m", 1.0),
    "friction_coefficient": ("friction coefficient", 1.0),
    "sliding_speed_m_per_s": ("sliding speed, mm/s", 1e3),
}
app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def barrel_cradle_annular(
    out: Annotated[Path, typer.Option(help="Folder for the recording, the results and the figures.")] = Path("out"),
    plant: Annotated[str, typer.Option(help="ancf (Exudyn) or modal.")] = "ancf",
    duration_s: Annotated[
        float, typer.Option(help="Length of the recording, s; each takes Exudyn 12 s of CPU.")
    ] = 40.0,
    step_s: Annotated[float, typer.Option(help="Time step, s: blows on steel are short.")] = 2.0**-16,
    tolerances: Annotated[str, typer.Option(help="laboratory or exact.")] = "laboratory",
) -> None:
    """Record the tube in its rings and compare what accelerometers alone determine with what is true."""
    # two steel tubes, 2 mm of radial clearance, 5e5 N/m, friction 0.1, weight; two shakers of 60 N rms at the barrel's
    # end, eight two-axis accelerometers of 1e-3 m/s2/sqrt(Hz)
    settings = BarrelCradleAnnular(sensors="acceleration", noise_density=1e-3, duration_s=duration_s, step_s=step_s)
    path = record_reference_rig(settings, plant, out / "barrel_cradle_annular.mcap")
    with progress_bar(f"identifying {path.name}") as progress:
        identification = identify_in_space(read(path), tolerances=tolerances_named(tolerances), progress=progress)
    true_laws = {contact.name: contact.law for contact in read_truth(truth_path(path)).rig.contacts}
    write_space_results(
        identification, out / "contact", f"{identification.rig.name}: {path.name}", true_laws, "true", (path,)
    )
    contacts, title = identification.report.contacts, f"Accelerometers alone (± 95 %, tolerances: {tolerances})"
    print_estimates(title, contacts, true_laws, QUANTITIES)
    console = Console()
    for contact in contacts:
        console.print(f"{contact.law_sentence}.", soft_wrap=True)
    for refused in identification.report.unanswered:
        console.print(f"{refused.name}: not determined by this record: {refused.reason}", soft_wrap=True)


if __name__ == "__main__":
    run(app, "scenarios.barrel_cradle_annular")
