"""Measured data: the EMPS benchmark, a carriage on a screw, as a free mass believed without friction.

python -m scenarios.emps --data FOLDER --out out/emps

FOLDER holds DATA_EMPS.mat and DATA_EMPS_PULSES.mat. Janot, Gautier and Brunot, "Data set and reference models of EMPS",
Workshop on Nonlinear System Identification Benchmarks, 2019.
"""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from scipy.io import loadmat

from identify.gaps.decision.answer import diagnose
from identify.gaps.page.report import write_all
from rig.commands.command_line import Force, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.lab.importing import import_file
from rig.model.description import PointDamper, Rig, Sensor, Station, to_json
from rig.model.oscillator import Oscillator
from rig.recording import Recording, read
from scenarios.free_runs import SIMULATOR, free_run

FILES = {"fit": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
SAMPLE_RATE_HZ = 1000.0
MASS_KG, VISCOUS_N_S_PER_M = 95.1, 203.0
"""Of the published linear part, which the owner believes."""
MAP = """rig = "rig.json"
sample_rate_hz = {rate}
force = {{ column = "vir", unit = "N", scale = {scale} }}

[sensors]
"position" = {{ column = "qm", unit = "m" }}
"""
app = typer.Typer(pretty_exceptions_enable=False)


class JudgedCarriage(msgspec.Struct, frozen=True, kw_only=True):
    """The verdict; rms errors of the position (mm) in free runs on both records, of the believed and the corrected
    rig."""

    verdict: str
    sentence: str
    effects: tuple[str, ...]
    believed_mm: dict[str, float]
    corrected_mm: dict[str, float]
    corrected: Rig


@app.command()
def emps(
    data: Annotated[Path, typer.Option(help=f"Folder with {' and '.join(FILES.values())}.")],
    out: Annotated[Path, typer.Option(help="Folder for the records and the results.")] = Path("out/emps"),
    force: Force = False,
) -> None:
    """Diagnoses the carriage from one record, decides on the pulses, and runs both rigs freely."""
    refuse_existing(out / "emps.json", force, new_folder=True)
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(to_json(carriage()), out / "rig.json")
    records = {name: imported(data / file, out, name) for name, file in FILES.items()}
    with progress_bar("diagnosing") as progress:
        gap, corrected = diagnose(records["fit"], records["pulses"], SIMULATOR, None, lambda _, x: progress(x))
    believed_mm, corrected_mm = (
        {name: error_mm(rig, record) for name, record in records.items()} for rig in (carriage(), corrected)
    )
    judged = JudgedCarriage(
        verdict=gap.verdict,
        sentence=gap.sentence,
        effects=gap.causes[0].effects if gap.causes else (),
        believed_mm=believed_mm,
        corrected_mm=corrected_mm,
        corrected=corrected,
    )
    write_all(gap, corrected, "EMPS", out / "gap")
    write_json(judged, out / "emps.json")
    console = Console()
    console.print(gap.sentence, soft_wrap=True)
    console.print(table(judged))
    console.print(f"records, rig.json, map_*.toml, emps.json, gap/gap.html: in {out}", soft_wrap=True)


def carriage() -> Rig:
    """A free mass with the published mass and viscous friction."""
    at = Station("carriage")
    return Rig(
        name="carriage",
        bodies=(Oscillator(name="carriage", mass_kg=MASS_KG, frequency_hz=0.0, damping_ratio=0.0),),
        contacts=(),
        force_at=at,
        sensors=(Sensor(name="position", station=at, quantity="displacement"),),
        sample_rate_hz=SAMPLE_RATE_HZ,
        dampers=(PointDamper(station=at, damping_n_s_per_m=VISCOUS_N_S_PER_M),),
    )


def imported(path: Path, out: Path, name: str) -> Recording:
    """Import a file by a map that takes the controller's voltage times the file's own gain (N/V) as the force."""
    try:
        gain_n_per_v = float(np.ravel(loadmat(path)["gtau"])[0])
    except (OSError, KeyError, ValueError) as error:
        raise RigError(f"{path}: cannot be read ({error}); give the benchmark's own file") from error
    write_bytes(MAP.format(rate=SAMPLE_RATE_HZ, scale=gain_n_per_v).encode(), out / f"map_{name}.toml")
    import_file(path, out / f"map_{name}.toml", out / f"{name}.mcap")
    return read(out / f"{name}.mcap")


def error_mm(rig: Rig, record: Recording) -> float:
    """Root mean square error of the position in a free run from rest, mm."""
    run_m, measured_m = (one.signals["displacement"].values[0] for one in (free_run(rig, record.force_n), record))
    return float(1e3 * np.sqrt(np.mean((run_m - (measured_m - measured_m[0])) ** 2)))


def table(judged: JudgedCarriage) -> Table:
    rows = Table(title=f"Free run, position error in mm rms; verdict: {judged.verdict}, {' + '.join(judged.effects)}")
    for heading in ("rig", *FILES):
        rows.add_column(heading, justify="right" if rows.columns else "left")
    for name, errors in (("believed", judged.believed_mm), ("corrected", judged.corrected_mm)):
        rows.add_row(name, *(f"{errors[one]:.1f}" for one in FILES))
    return rows


if __name__ == "__main__":
    run(app, "scenarios.emps")
