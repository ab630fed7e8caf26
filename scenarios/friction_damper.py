"""Measured data: a friction damper with backlash, at several tensions of its band: its law by `identify law`.

python -m scenarios.friction_damper --data FOLDER --out out/friction_damper

FOLDER holds the files 0.5Hz20lbtension.json and so on of ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash
(CC BY-SA 4.0): harmonic displacement, and the force that it takes.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from jaxtyping import Float
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import identify
from identify.laws import ContactLawFit
from identify.laws.results import ContactLawEstimate
from identify.pages.style import GREY, RED, picture
from identify.pages.wording import interval
from rig.commands.command_line import Force, console_table, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.description import Contact, Rig, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording
from scenarios.measured_data import one_mass_rig, recording_of, write_and_read

FILE_NAME = re.compile(r"(?P<hz>[0-9.]+)Hz(?P<tension>[0-9.]+)lbtension\.json")
METRES_PER_INCH, NEWTONS_PER_KIP, NEWTONS_PER_POUND = 0.0254, 4448.2216, 4.4482216
SAMPLE_RATE_HZ = 1024.0
MASS_KG, NATURAL_HZ = 1.0, 0.05
"""Mass and natural frequency of the piston; of the force's kilonewtons it takes a newton, the damper the others."""
SEARCH_S = 5.0
"""Length of the symbolic search, s; a law with a memory does not need it."""
PANEL_COLUMN_COUNT = 3
UNIT_FACTORS = {"upper_n": 1e-3, "lower_n": 1e-3, "backlash_m": 1e3, "stiffness_n_per_m": 1e-6}
"""Factors from the fields of a sliding law to the units of the table: kN, kN, mm, MN/m."""
app = typer.Typer(pretty_exceptions_enable=False)


class DamperFile(msgspec.Struct, frozen=True):
    """Rows of a file: time (s), displacement (in), friction force (kip), velocity (in/s), two actuator forces (lb)."""

    data: list[tuple[float, float, float, float, float, float]]


class DamperLaw(msgspec.Struct, frozen=True, kw_only=True):
    """Law of the damper at a frequency of the motion and a tension of the band."""

    file: str
    frequency_hz: float
    tension_n: float
    law: ContactLawEstimate


@app.command()
def friction_damper(
    data: Annotated[Path, typer.Option(help="Folder with the files *Hz*lbtension.json.")],
    out: Annotated[Path, typer.Option(help="Folder for the records, the laws and the figures.")] = Path(
        "out/friction_damper"
    ),
    force: Force = False,
) -> None:
    """Identify the damper's law at every tension: sliding force, backlash and stiffness, with intervals."""
    refuse_existing(out / "friction_damper.json", force, new_folder=True)
    paths = sorted((p for p in data.glob("*.json") if FILE_NAME.fullmatch(p.name)), key=_frequency_and_tension)
    if not paths:
        raise RigError(f"{data}: holds no file like 0.5Hz20lbtension.json; give the folder of the data set")
    out.mkdir(parents=True, exist_ok=True)
    laws, plotted_laws = [], []
    for path in paths:
        recording = write_and_read(read_damper_file(path), out / f"{path.stem}.mcap")
        with progress_bar(f"searching the law of {path.name}") as progress:
            law_result = identify.law(recording, seconds=SEARCH_S, progress=progress)
        law_result.save(out / path.stem)
        frequency_hz, tension_lb = _frequency_and_tension(path)
        (law,) = law_result.report.laws
        tension_n = tension_lb * NEWTONS_PER_POUND
        laws.append(DamperLaw(file=path.name, frequency_hz=frequency_hz, tension_n=tension_n, law=law))
        plotted_laws.append(law_result.identification.fits[0])
    write_json(laws, out / "friction_damper.json")
    draw_laws(laws, plotted_laws, out / "friction_damper.png")
    console = Console()
    console.print(law_table(laws))
    console.print(
        f"records, */law.json, */law.png, friction_damper.json, friction_damper.png: in {out}", soft_wrap=True
    )


def _frequency_and_tension(path: Path) -> tuple[float, float]:
    name_match = FILE_NAME.fullmatch(path.name)
    assert name_match
    return float(name_match["hz"]), float(name_match["tension"])


def read_damper_file(path: Path) -> Recording:
    """Recording of the displacement and friction force in a file; raises RigError if it is not one of the data set."""
    try:
        file_rows = np.array(msgspec.json.decode(path.read_bytes(), type=DamperFile).data)
    except (OSError, msgspec.DecodeError) as error:
        raise RigError(f"{path}: is no file of the data set ({error}); fetch it again") from error
    return damper_recording(file_rows[:, 1] * METRES_PER_INCH, file_rows[:, 2] * NEWTONS_PER_KIP, path.name)


def damper_recording(
    displacement_m: Float[np.ndarray, " samples"], force_n: Float[np.ndarray, " samples"], source: str
) -> Recording:
    """Recording of a light mass that the damper holds to the ground."""
    return recording_of(damper_rig(), (force_n, displacement_m), f"Dataset-Friction-Damper-with-Backlash, {source}")


def damper_rig() -> Rig:
    """Rig of the piston, which the band holds to the ground."""
    mass = Oscillator(name="piston", mass_kg=MASS_KG, frequency_hz=NATURAL_HZ, damping_ratio=0.0)
    band = Contact(name="band", at=Station("piston"), against=None, law=symmetric_dead_zone(0.0, 1e6))
    return one_mass_rig("friction damper", mass, SAMPLE_RATE_HZ, contacts=(band,))


def law_table(laws: list[DamperLaw]) -> Table:
    headings = ("record", "law", "slides at, kN", "and at, kN", "backlash, mm", "stiffness, MN/m", "left, % rms")
    table = console_table("The damper's law by the tension of its band (95 % intervals of the scatter)", headings, 2)
    for damper_law in laws:
        law = damper_law.law
        error_n = next(candidate.held_out_error_n for candidate in law.candidates if candidate.law == law.best)
        cells = [""] * len(UNIT_FACTORS)
        if law.sliding is not None:
            estimates = ((getattr(law.sliding, field), factor) for field, factor in UNIT_FACTORS.items())
            cells = [interval(factor * e.value, factor * e.standard_error, "1") for e, factor in estimates]
        file_stem = damper_law.file.removesuffix(".json")
        table.add_row(file_stem, law.best, *cells, f"{100 * error_n / law.force_rms_n:.1f}")
    return table


def draw_laws(laws: Sequence[DamperLaw], plotted_laws: Sequence[ContactLawFit], path: Path) -> None:
    """Draw the measured force and the law over the displacement, a panel for each recording."""
    panel_row_count = -(-len(laws) // PANEL_COLUMN_COUNT)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(panel_row_count, PANEL_COLUMN_COUNT, sharex=True, sharey=True, squeeze=False)
        for axes, damper_law, law in zip(panels.ravel(), laws, plotted_laws, strict=False):
            samples = law.record
            axes.plot(1e3 * samples.eta_at_force_m, 1e-3 * samples.force_n, color=GREY, lw=0.5, label="measured")
            if law.sliding is not None:
                force_n = samples.low_passed(law.sliding)
                eta_mm = 1e3 * samples.eta_at_force_m
                axes.plot(eta_mm, 1e-3 * force_n, color=RED, lw=0.9, label="friction behind a backlash")
            axes.set(title=f"{damper_law.frequency_hz:g} Hz, band {damper_law.tension_n:.0f} N")
        for axes in panels[-1]:
            axes.set(xlabel="displacement, mm")
        for axes in panels[:, 0]:
            axes.set(ylabel="force, kN")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)

    write_bytes(picture(draw, 9.0, 3.0 * panel_row_count).png, path)


if __name__ == "__main__":
    run(app, "scenarios.friction_damper")
