"""Comparison of this project with other methods on identical recordings.

python -m scenarios.peers --out out/peers
"""

import csv
import io
import time
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from rig.commands.command_line import progress_bar, run
from rig.errors import RigError
from rig.files import write_bytes
from rig.recording import Recording, read
from rig.simulation.plants.modal import simulate
from rig.simulation.record import record
from rig.simulation.reference import BarrelCradle, Sdof
from scenarios.peers.methods import METHODS
from scenarios.peers.peer_data import MODES_PER_BEAM
from scenarios.peers.table import HEADINGS, PeerOutcome, PeerTrial, row

SENSORS = "displacement+velocity+acceleration"
SDOF = Sdof(noise_density=1e-3, sensors=SENSORS, duration_s=40.0)
BARREL_CRADLE = BarrelCradle(noise_density=1e-3, sensors=SENSORS, duration_s=20.0, step_s=2.0**-16)
RIGS: dict[str, Sdof | BarrelCradle] = {
    "sdof": SDOF,
    "sdof_noise": SDOF,
    "barrel_cradle": BARREL_CRADLE,
    "barrel_cradle_noise": BARREL_CRADLE,
}
"""Rigs with noisy accelerometers, and with displacements and velocities, which peers need: without noise, or with that
of `SENSOR_NOISE` in the rigs called noise."""
SENSOR_NOISE = {"displacement": 5e-8, "velocity": 5e-7}
"""Noise densities of a good laser, m/sqrt(Hz) and m/s/sqrt(Hz)."""
TITLES = {
    "sdof": "one mass",
    "sdof_noise": "one mass, noise in all sensors",
    "barrel_cradle": "two beams",
    "barrel_cradle_noise": "two beams, noise in all sensors",
}
app = typer.Typer(pretty_exceptions_enable=False)


@app.command()
def peers(
    out: Annotated[Path, typer.Option(help="Folder for the recordings, the results and the table.")] = Path(
        "out/peers"
    ),
    seeds: Annotated[int, typer.Option(help="Recordings of each rig: seeds 1, 2, ...", min=1)] = 3,
    method: Annotated[list[str] | None, typer.Option(help=f"Of {', '.join(METHODS)}; all by default.")] = None,
) -> None:
    """Identify the recordings by every method that is installed, one after another, and print the table.

    Results are kept in the folder, and not computed again.
    """
    if unknown_methods := [method_name for method_name in method or () if method_name not in METHODS]:
        raise RigError(f"--method {unknown_methods[0]}: there is no such method; give any of {', '.join(METHODS)}")
    out.mkdir(parents=True, exist_ok=True)
    rows: list[tuple[str, ...]] = []
    for rig_name in RIGS:
        for method_name in method or METHODS:
            peer = METHODS[method_name]
            if not peer.installed:
                needed = f"it needs {', '.join(peer.packages)}: pip install 'rig-identify[peers]'"
                print(f"{peer.title} on {TITLES[rig_name]}: skipped; {needed}")
                continue
            outcomes = [outcome_of(PeerTrial(method_name, rig_name, seed), out) for seed in range(1, seeds + 1)]
            rows.append(row(peer.title, peer.prior_knowledge, outcomes))
            print(" | ".join((TITLES[rig_name], *rows[-1][1:])), flush=True)
    csv_buffer = io.StringIO()
    csv.writer(csv_buffer).writerows([HEADINGS, *rows])
    write_bytes(csv_buffer.getvalue().encode(), out / "peers.csv")
    installed_methods = [METHODS[method_name] for method_name in method or METHODS if METHODS[method_name].installed]
    Console().print(f"{out / 'peers.csv'}; {', '.join(m.versions for m in installed_methods)}", highlight=False)


def outcome_of(trial: PeerTrial, folder: Path) -> PeerOutcome:
    """Outcome of a trial: the one kept in the folder, or computed and kept there."""
    method = METHODS[trial.method]
    path = folder / f"{trial.rig}_{trial.seed}_{trial.method}.json"
    if path.exists():
        return msgspec.json.decode(path.read_bytes(), type=PeerOutcome)
    recording_path = folder / f"{trial.rig}_{trial.seed}.mcap"
    if not recording_path.exists():
        _record(trial, recording_path)
    for module in method.modules:
        import_module(module)  # not among the seconds that are measured
    outcome = run_trial(trial, read(recording_path))
    write_bytes(msgspec.json.encode(outcome), path)
    return outcome


def _record(trial: PeerTrial, path: Path) -> None:
    """Record the trial's rig by the plant `modal`, with as many modes a beam as leave stiffnesses true to 0.01 %."""
    settings = msgspec.structs.replace(RIGS[trial.rig], seed=trial.seed)
    rig = settings.rig()
    if trial.rig.endswith("_noise"):
        sensors = (
            msgspec.structs.replace(s, noise_density=SENSOR_NOISE.get(s.quantity, s.noise_density)) for s in rig.sensors
        )
        rig = msgspec.structs.replace(rig, sensors=tuple(sensors))
    with progress_bar(f"recording {path.name}") as progress:
        record(
            rig,
            settings.force(),
            plant=partial(simulate, modes_per_beam=MODES_PER_BEAM),
            duration_s=settings.duration_s,
            step_s=settings.step_s,
            path=path,
            progress=progress,
        )


def run_trial(trial: PeerTrial, recording: Recording) -> PeerOutcome:
    """Outcome of a method on a recording, on one thread; seconds are those of the processor."""
    method = METHODS[trial.method]
    true_laws = tuple((contact.law.clearance_m, contact.law.stiffness_n_per_m) for contact in recording.rig.contacts)
    begin_s = time.process_time()
    try:
        with threadpool_limits(1):
            answers = method.answers(recording)
    except Exception as error:  # a peer may raise anything, and the others go on
        failure = f"{type(error).__name__}: {error}"
        return PeerOutcome(trial=trial, versions=method.versions, true=true_laws, failure=failure)
    cpu_s = time.process_time() - begin_s
    return PeerOutcome(trial=trial, versions=method.versions, true=true_laws, answers=answers, cpu_s=cpu_s)


if __name__ == "__main__":
    run(app, "scenarios.peers")
