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
from identify.laws import FoundLaw
from identify.laws.results import ContactLawEstimate
from identify.pages.style import GREY, RED, picture
from identify.pages.wording import interval
from rig.commands.command_line import Force, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.model.contact_laws.dead_zone import equal_sides
from rig.model.description import Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals, channel_groups, read, writing

NAME = re.compile(r"(?P<hz>[0-9.]+)Hz(?P<tension>[0-9.]+)lbtension\.json")
METRES_PER_INCH, NEWTONS_PER_KIP, NEWTONS_PER_POUND = 0.0254, 4448.2216, 4.4482216
SAMPLE_RATE_HZ = 1024.0
MASS_KG, NATURAL_HZ = 1.0, 0.05
"""Nothing stands between force and damper: a mass of so little takes a newton of kilonewtons."""
SECONDS = 5.0
"""Of the symbolic search, which a law with a memory does not need."""
app = typer.Typer(pretty_exceptions_enable=False)


class Measured(msgspec.Struct, frozen=True):
    """A file's rows: time (s), displacement (in), friction force (kip), velocity (in/s), two actuator forces (lb)."""

    data: list[tuple[float, float, float, float, float, float]]


class DamperLaw(msgspec.Struct, frozen=True, kw_only=True):
    """The law found at a frequency and a tension of the band."""

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
    """Finds the damper's law at every tension: sliding force, backlash and stiffness, with intervals."""
    refuse_existing(out / "friction_damper.json", force, new_folder=True)
    files = sorted((p for p in data.glob("*.json") if NAME.fullmatch(p.name)), key=_order)
    if not files:
        raise RigError(f"{data}: holds no file like 0.5Hz20lbtension.json; give the folder of the data set")
    out.mkdir(parents=True, exist_ok=True)
    laws, curves = [], []
    for path in files:
        record = written(recording_of(path), out / f"{path.stem}.mcap")
        with progress_bar(f"searching the law of {path.name}") as progress:
            found = identify.law(record, seconds=SECONDS, progress=progress)
        found.save(out / path.stem)
        hz, tension = _order(path)
        (law,) = found.report.laws
        laws.append(DamperLaw(file=path.name, frequency_hz=hz, tension_n=tension * NEWTONS_PER_POUND, law=law))
        curves.append(found.found.found[0])
    write_json(laws, out / "friction_damper.json")
    drawn(laws, curves, out / "friction_damper.png")
    console = Console()
    console.print(table(laws))
    console.print(
        f"records, */law.json, */law.png, friction_damper.json, friction_damper.png: in {out}", soft_wrap=True
    )


def _order(path: Path) -> tuple[float, float]:
    name = NAME.fullmatch(path.name)
    assert name
    return float(name["hz"]), float(name["tension"])


def recording_of(path: Path) -> Recording:
    """Displacement and friction force of a file; raises RigError if it is not one of the data set."""
    try:
        rows = np.array(msgspec.json.decode(path.read_bytes(), type=Measured).data)
    except (OSError, msgspec.DecodeError) as error:
        raise RigError(f"{path}: is no file of the data set ({error}); fetch it again") from error
    return recorded(rows[:, 1] * METRES_PER_INCH, rows[:, 2] * NEWTONS_PER_KIP, path.name)


def recorded(
    displacement_m: Float[np.ndarray, " samples"], force_n: Float[np.ndarray, " samples"], source: str
) -> Recording:
    """A recording of a light mass that the damper holds to the ground."""
    rig = damper()
    rows = zip(channel_groups(rig).items(), (force_n, displacement_m), strict=True)
    signals = {name: Signals(channels, 0.0, row[None]) for (name, channels), row in rows}
    return Recording(rig, signals, {"source": f"Dataset-Friction-Damper-with-Backlash, {source}"})


def damper() -> Rig:
    at = Station("piston")
    return Rig(
        name="friction damper",
        bodies=(Oscillator(name="piston", mass_kg=MASS_KG, frequency_hz=NATURAL_HZ, damping_ratio=0.0),),
        contacts=(Contact(name="band", at=at, against=None, law=equal_sides(0.0, 1e6)),),
        force_at=at,
        sensors=(Sensor(name="displacement", station=at, quantity="displacement"),),
        sample_rate_hz=SAMPLE_RATE_HZ,
    )


def written(recording: Recording, path: Path) -> Recording:
    """What is read back from the file."""
    with writing(path, recording.rig, channel_groups(recording.rig), recording.provenance) as file:
        for name, signals in recording.signals.items():
            file.append(name, signals.values)
    return read(path)


def table(laws: list[DamperLaw]) -> Table:
    found = Table(title="The damper's law by the tension of its band (95 % intervals of the scatter)")
    for heading in ("record", "law", "slides at, kN", "and at, kN", "backlash, mm", "stiffness, MN/m", "left, % rms"):
        found.add_column(heading, justify="right" if found.columns else "left")
    for one in laws:
        best = next(c.held_out_error_n for c in one.law.candidates if c.law == one.law.best)
        cells = [one.file.removesuffix(".json"), one.law.best]
        if one.law.sliding is None:
            cells += ["", "", "", ""]
        else:
            s = one.law.sliding
            scaled = ((s.upper_n, 1e-3), (s.lower_n, 1e-3), (s.backlash_m, 1e3), (s.stiffness_n_per_m, 1e-6))
            cells += [interval(x * e.value, x * e.standard_error, "1") for e, x in scaled]
        found.add_row(*cells, f"{100 * best / one.law.force_rms_n:.1f}")
    return found


COLUMNS = 3


def drawn(laws: Sequence[DamperLaw], curves: Sequence[FoundLaw], path: Path) -> None:
    """A panel a record."""
    lines = -(-len(laws) // COLUMNS)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(lines, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes, one, curve in zip(panels.ravel(), laws, curves, strict=False):
            record = curve.record
            axes.plot(1e3 * record.eta_at_force_m, 1e-3 * record.force_n, color=GREY, lw=0.5, label="measured")
            if curve.sliding is not None:
                force = record.low_passed(curve.sliding)
                eta_mm = 1e3 * record.eta_at_force_m
                axes.plot(eta_mm, 1e-3 * force, color=RED, lw=0.9, label="friction behind a backlash")
            axes.set(title=f"{one.frequency_hz:g} Hz, band {one.tension_n:.0f} N")
        for axes in panels[-1]:
            axes.set(xlabel="displacement, mm")
        for axes in panels[:, 0]:
            axes.set(ylabel="force, kN")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)

    write_bytes(picture(draw, 9.0, 3.0 * lines).png, path)


if __name__ == "__main__":
    run(app, "scenarios.friction_damper")
