"""A tube that lies in two rings of its cradle, in two directions and under its weight: recorded and identified.

python -m scenarios.barrel_cradle_annular --out out
"""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from identify.contacts.results import Estimate
from identify.contacts.space_identification import SpaceIdentification, identify_in_space
from identify.contacts.space_report import write_space_results
from identify.pages.wording import COVERED
from rig.commands.command_line import progress_bar, run
from rig.model.contact_laws.annular import Annular
from rig.model.tolerances import tolerances_named
from rig.recording import read, read_truth, truth_path
from rig.simulation.reference import BarrelCradleAnnular
from scenarios.compare import recorded

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
    """Records the tube in its rings and compares what accelerometers alone tell with what is true."""
    # two steel tubes, 2 mm of radial clearance, 5e5 N/m, friction 0.1, weight; two shakers of 60 N rms at the barrel's
    # end, eight two-axis accelerometers of 1e-3 m/s2/sqrt(Hz)
    settings = BarrelCradleAnnular(sensors="acceleration", noise_density=1e-3, duration_s=duration_s, step_s=step_s)
    path = recorded(settings, plant, out / "barrel_cradle_annular.mcap")
    with progress_bar(f"identifying {path.name}") as progress:
        identification = identify_in_space(read(path), tolerances=tolerances_named(tolerances), progress=progress)
    true = {c.name: c.law for c in read_truth(truth_path(path)).rig.contacts}
    write_space_results(
        identification, out / "contact", f"{identification.rig.name}: {path.name}", true, "true", (path,)
    )
    print_comparison(identification, {name: law for name, law in true.items() if isinstance(law, Annular)}, tolerances)


def print_comparison(identification: SpaceIdentification, true: dict[str, Annular], tolerances: str) -> None:
    """Print identified against true values, and what else the record tells."""
    table = Table(title=f"Accelerometers alone (± 95 %, tolerances: {tolerances})")
    for heading in ("contact", "quantity", "true", "identified", "± 95 %", "off by, %"):
        table.add_column(heading, justify="left" if heading in ("contact", "quantity") else "right")
    for contact in identification.report.contacts:
        law = true[contact.name]
        quantities: tuple[tuple[str, Estimate | None, float, float], ...] = (
            ("radial clearance, mm", contact.clearance_m, law.clearance_m, 1e3),
            ("stiffness, N/m", contact.stiffness_n_per_m, law.stiffness_n_per_m, 1.0),
            ("damping, N s/m", contact.damping_n_s_per_m, law.damping_n_s_per_m, 1.0),
            ("friction coefficient", contact.friction_coefficient, law.friction_coefficient, 1.0),
            ("sliding speed, mm/s", contact.sliding_speed_m_per_s, law.sliding_speed_m_per_s, 1e3),
        )
        for name, estimate, value, scale in quantities:
            if estimate is not None:
                reach, off = COVERED * estimate.standard_error, 100 * (estimate.value / value - 1)
                cells = (f"{scale * value:.6g}", f"{scale * estimate.value:.6g}", f"{scale * reach:.2g}", f"{off:+.4f}")
                table.add_row(contact.name, name, *cells)
    console = Console()
    console.print(table)
    for contact in identification.report.contacts:
        console.print(f"{contact.law_sentence}.", soft_wrap=True)
    for refused in identification.report.unanswered:
        console.print(f"{refused.name}: not told by this record: {refused.reason}", soft_wrap=True)


if __name__ == "__main__":
    run(app, "scenarios.barrel_cradle_annular")
