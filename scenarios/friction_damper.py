"""Measured force over displacement: laws by `identify law`, with intervals and what they leave.

python -m scenarios.friction_damper --data FOLDER --out out/friction_damper

FOLDER holds one or more of these: 0.5Hz20lbtension.json and so on of ARTS-Laboratory/Dataset-Friction-Damper-with-
Backlash (CC BY-SA 4.0), a friction damper driven harmonically; data_simulation_4.1_MRdamper.mat and 4.4 of
labcontrol-data/mr-damper (MIT), a magneto-rheological damper on a shaking table; SNLS80mV.csv, the Silverbox benchmark.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from scipy.io import loadmat

import identify
from identify.laws import ContactLawFit
from identify.laws.results import ContactLawEstimate
from identify.pages.style import GREY, RED, picture
from identify.pages.wording import percent
from rig.commands.command_line import Force, console_table, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import Contact, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording
from scenarios import silverbox
from scenarios.measured_data import one_mass_rig, recording_of, write_and_read

METRES_PER_INCH, NEWTONS_PER_KIP = 0.0254, 4448.2216
METRES_PER_MM = 1e-3
SAMPLE_RATE_HZ = 1024.0
MASS_KG, NATURAL_HZ = 1.0, 0.05
"""Mass and natural frequency of the piston; of the force it takes some newtons at most, the damper the others."""
SEARCH_S = 5.0
"""Length of the symbolic search, s; a law with a memory does not need it."""
PANEL_COLUMN_COUNT = 3
app = typer.Typer(pretty_exceptions_enable=False)


class DamperFile(msgspec.Struct, frozen=True):
    """Rows of a file: time (s), displacement (in), friction force (kip), velocity (in/s), two actuator forces (lb)."""

    data: list[tuple[float, float, float, float, float, float]]


class DamperLaw(msgspec.Struct, frozen=True, kw_only=True):
    """Law found in a file."""

    file: str
    law: ContactLawEstimate


@app.command()
def friction_damper(
    data: Annotated[Path, typer.Option(help="Folder with the files of a data set.")],
    out: Annotated[Path, typer.Option(help="Folder for the records, the laws and the figures.")] = Path(
        "out/friction_damper"
    ),
    force: Force = False,
) -> None:
    """Identify the law of every record: its values with intervals, and what it leaves."""
    refuse_existing(out / "friction_damper.json", force, new_folder=True)
    readers = [(path, reader) for pattern, reader in READERS.items() for path in sorted(data.glob(pattern))]
    if not readers:
        raise RigError(f"{data}: holds no file like {' or '.join(READERS)}; give the folder of a data set")
    out.mkdir(parents=True, exist_ok=True)
    laws, plotted_laws = [], []
    for path, reader in readers:
        recording = write_and_read(reader(path), out / f"{path.stem}.mcap")
        with progress_bar(f"searching the law of {path.name}") as progress:
            law_result = identify.law(recording, seconds=SEARCH_S, progress=progress)
        law_result.save(out / path.stem)
        (law,) = law_result.report.laws
        laws.append(DamperLaw(file=path.name, law=law))
        plotted_laws.append(law_result.identification.fits[0])
    write_json(laws, out / "friction_damper.json")
    draw_laws(laws, plotted_laws, out / "friction_damper.png")
    console = Console()
    console.print(law_table(laws))
    console.print(
        f"records, */law.json, */law.html, friction_damper.json, friction_damper.png: in {out}", soft_wrap=True
    )


def read_damper_file(path: Path) -> Recording:
    """Recording of the displacement and friction force in a file; raises RigError if it is not one of the data set."""
    try:
        file_rows = np.array(msgspec.json.decode(path.read_bytes(), type=DamperFile).data)
    except (OSError, msgspec.DecodeError) as error:
        raise RigError(f"{path}: is no file of the data set ({error}); fetch it again") from error
    source = f"Dataset-Friction-Damper-with-Backlash, {path.name}"
    return damper_recording(file_rows[:, 1] * METRES_PER_INCH, file_rows[:, 2] * NEWTONS_PER_KIP, source)


def read_mr_damper_file(path: Path) -> Recording:
    """Recording of the displacement and force in a MATLAB file; raises RigError if it is not one of the data set."""
    try:
        arrays = loadmat(path)
        displacement_m, force_n = arrays["dist"].ravel() * METRES_PER_MM, arrays["forc"].ravel().astype(float)
        sample_rate_hz = 1 / float(arrays["Ts"].item())
    except (OSError, ValueError, KeyError) as error:
        raise RigError(f"{path}: is no file of the data set ({error}); fetch it again") from error
    return damper_recording(displacement_m, force_n, f"labcontrol-data/mr-damper, {path.name}", sample_rate_hz)


def read_silverbox_file(path: Path) -> Recording:
    """Recording of the multisines that the diagnosis of the Silverbox is judged by, with a contact for the law."""
    _, validation, _ = silverbox.recordings(silverbox.read_volts(path.parent))
    spring = Contact(name="spring", at=Station("mass"), against=None, law=symmetric_dead_zone(0.0, 1e6))
    return replace(validation, rig=msgspec.structs.replace(validation.rig, contacts=(spring,)))


READERS = {
    "*lbtension.json": read_damper_file,
    "*_MRdamper.mat": read_mr_damper_file,
    silverbox.FILE: read_silverbox_file,
}
"""Reader by the names of the files of a data set."""


def damper_recording(
    displacement_m: Float[np.ndarray, " samples"],
    force_n: Float[np.ndarray, " samples"],
    source: str,
    sample_rate_hz: float = SAMPLE_RATE_HZ,
) -> Recording:
    """Recording of a light mass that the damper holds to the ground."""
    mass = Oscillator(name="piston", mass_kg=MASS_KG, frequency_hz=NATURAL_HZ, damping_ratio=0.0)
    damper = Contact(name="damper", at=Station("piston"), against=None, law=symmetric_dead_zone(0.0, 1e6))
    rig = one_mass_rig("damper", mass, sample_rate_hz, contacts=(damper,))
    return recording_of(rig, (force_n, displacement_m), source)


def law_table(laws: list[DamperLaw]) -> Table:
    headings = ("record", "law", "left of held-out force")
    table = console_table("Laws of the records, values with 95 % intervals", headings, 2)
    for one in laws:
        left_share = one.law.candidate(one.law.best).left_share
        table.add_row(one.file.rpartition(".")[0], one.law.verdict, percent(left_share))
    return table


def draw_laws(laws: Sequence[DamperLaw], plotted_laws: Sequence[ContactLawFit], path: Path) -> None:
    """Draw the measured force and the law over the displacement, a panel for each recording."""
    panel_row_count = -(-len(laws) // PANEL_COLUMN_COUNT)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(panel_row_count, PANEL_COLUMN_COUNT, squeeze=False)
        for axes, one, law in zip(panels.ravel(), laws, plotted_laws, strict=False):
            samples = law.record
            eta_mm = 1e3 * samples.eta_at_force_m
            axes.plot(eta_mm, samples.force_n, color=GREY, lw=0.5, label="measured")
            if law.sliding is not None:
                axes.plot(eta_mm, law.plotted_force_n, color=RED, lw=0.9, label="dry friction and what is beside it")
            axes.set(title=one.file.rpartition(".")[0])
        for axes in panels[-1]:
            axes.set(xlabel="displacement, mm")
        for axes in panels[:, 0]:
            axes.set(ylabel="force, N")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)

    write_bytes(picture(draw, 9.0, 3.0 * panel_row_count).png, path)


if __name__ == "__main__":
    run(app, "scenarios.friction_damper")
