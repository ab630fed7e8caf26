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
from rig.commands.command_line import Force, console_table, progress_bar, refuse_existing, run
from rig.errors import RigError
from rig.files import write_bytes, write_json
from rig.lab.importing import import_file
from rig.model.description import PointDamper, Rig, Station, to_json
from rig.model.oscillator import Oscillator
from rig.recording import Recording, read
from scenarios.measured_data import SIMULATOR, free_run, one_mass_rig

FILE_NAMES = {"fit": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
SAMPLE_RATE_HZ = 1000.0
MASS_KG, VISCOUS_N_S_PER_M = 95.1, 203.0
"""Mass and viscous friction of the published linear model, which the owner believes."""
IMPORT_MAP = """rig = "rig.json"
sample_rate_hz = {rate}
force = {{ column = "vir", unit = "N", scale = {scale} }}

[sensors]
"position" = {{ column = "qm", unit = "m" }}
"""
app = typer.Typer(pretty_exceptions_enable=False)


class CarriageDiagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict, and rms position errors (mm) of the believed and the corrected rig in free runs on both records."""

    verdict: str
    sentence: str
    effects: tuple[str, ...]
    believed_mm: dict[str, float]
    corrected_mm: dict[str, float]
    corrected: Rig


@app.command()
def emps(
    data: Annotated[Path, typer.Option(help=f"Folder with {' and '.join(FILE_NAMES.values())}.")],
    out: Annotated[Path, typer.Option(help="Folder for the records and the results.")] = Path("out/emps"),
    force: Force = False,
) -> None:
    """Diagnose the carriage from one record, validate on the pulses, and simulate both rigs freely."""
    refuse_existing(out / "emps.json", force, new_folder=True)
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(to_json(carriage()), out / "rig.json")
    recordings = {name: import_benchmark(data / file, out, name) for name, file in FILE_NAMES.items()}
    with progress_bar("diagnosing") as progress:
        gap, corrected = diagnose(recordings["fit"], recordings["pulses"], SIMULATOR, None, lambda _, x: progress(x))
    believed_mm, corrected_mm = (
        {name: error_mm(rig, recording) for name, recording in recordings.items()} for rig in (carriage(), corrected)
    )
    diagnosis = CarriageDiagnosis(
        verdict=gap.verdict,
        sentence=gap.sentence,
        effects=gap.causes[0].effects if gap.causes else (),
        believed_mm=believed_mm,
        corrected_mm=corrected_mm,
        corrected=corrected,
    )
    write_all(gap, corrected, "EMPS", out / "gap")
    write_json(diagnosis, out / "emps.json")
    console = Console()
    console.print(gap.sentence, soft_wrap=True)
    console.print(error_table(diagnosis))
    console.print(f"records, rig.json, map_*.toml, emps.json, gap/gap.html: in {out}", soft_wrap=True)


def carriage() -> Rig:
    """A free mass with the published mass and viscous friction."""
    mass = Oscillator(name="carriage", mass_kg=MASS_KG, frequency_hz=0.0, damping_ratio=0.0)
    damper = PointDamper(station=Station("carriage"), damping_n_s_per_m=VISCOUS_N_S_PER_M)
    return one_mass_rig("carriage", mass, SAMPLE_RATE_HZ, "position", dampers=(damper,))


def import_benchmark(data_path: Path, folder: Path, name: str) -> Recording:
    """Import a file by a map that takes the controller's voltage times the file's own gain (N/V) as the force."""
    try:
        gain_n_per_v = float(np.ravel(loadmat(data_path)["gtau"])[0])
    except (OSError, KeyError, ValueError) as error:
        raise RigError(f"{data_path}: cannot be read ({error}); give the benchmark's own file") from error
    write_bytes(IMPORT_MAP.format(rate=SAMPLE_RATE_HZ, scale=gain_n_per_v).encode(), folder / f"map_{name}.toml")
    import_file(data_path, folder / f"map_{name}.toml", folder / f"{name}.mcap")
    return read(folder / f"{name}.mcap")


def error_mm(rig: Rig, recording: Recording) -> float:
    """Root mean square error of the position in a free run from rest, mm."""
    records = (free_run(rig, recording.force_n), recording)
    simulated_m, measured_m = (record.signals["displacement"].values[0] for record in records)
    return float(1e3 * np.sqrt(np.mean((simulated_m - (measured_m - measured_m[0])) ** 2)))


def error_table(diagnosis: CarriageDiagnosis) -> Table:
    title = f"Free run, position error in mm rms; verdict: {diagnosis.verdict}, {' + '.join(diagnosis.effects)}"
    table = console_table(title, ("rig", *FILE_NAMES))
    for name, errors_mm in (("believed", diagnosis.believed_mm), ("corrected", diagnosis.corrected_mm)):
        table.add_row(name, *(f"{errors_mm[record]:.1f}" for record in FILE_NAMES))
    return table


if __name__ == "__main__":
    run(app, "scenarios.emps")
