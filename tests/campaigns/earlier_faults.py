"""Machines like those that earlier programs answered against their own numbers, simulated anew.

python -m tests.campaigns.earlier_faults --out out/earlier_faults

Recordings are made by `tests.campaigns.worlds`, which shares no function with the product's plants.
"""

from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as with_fields
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer
from msgspec.structs import replace
from rich.console import Console
from rich.table import Table

import identify
from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.prepare import simulator_named
from rig.commands.command_line import Force, refuse_existing, run
from rig.commands.tasks import Dask, run_tasks
from rig.errors import RigError
from rig.files import write_json
from rig.model.description import Rig
from rig.recording import read
from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.bench import BENCHES
from tests.campaigns.worlds.describing import described
from tests.campaigns.worlds.forces import Excitation, Gaussian
from tests.campaigns.worlds.instruments import Measured, measured
from tests.campaigns.worlds.kinds import Kind
from tests.campaigns.worlds.library import EFFECTS
from tests.campaigns.worlds.machine import Machine
from tests.campaigns.worlds.making import write
from tests.campaigns.worlds.outside import OUTSIDE
from tests.campaigns.worlds.tolerances import built, perturbed
from tests.campaigns.worlds.truth import EffectTruth

DURATION_S, LOUDER = 30.0, 1.5
app = typer.Typer(pretty_exceptions_enable=False)
Place = dict[str, str | float]


@dataclass(frozen=True)
class Row:
    """A machine of two beams (machine "") or of the world "bench", and its difference from rig.json: effects by kind,
    parameters and place, another change of the machine, or a change of the record."""

    description: str
    machine: str = ""
    effects: tuple[tuple[str, dict[str, float], Place], ...] = ()
    alter_machine: Callable[[Machine], Machine] = lambda machine: machine
    alter_record: Callable[[Measured], Measured] = lambda record: record
    level_n: float = 15.0
    contacts_alone: bool = False


def _softer_storey(machine: Machine) -> Machine:
    (frame,) = machine.lumped
    first, second, *rest = frame.between_n_per_m
    return replace(machine, lumped=(replace(frame, between_n_per_m=(first, 0.95 * second, *rest)),))


def _clipped(record: Measured) -> Measured:
    limit = 0.6 * float(np.abs(record.delivered[3]).max())
    delivered = record.delivered.copy()
    delivered[3] = np.clip(delivered[3], -limit, limit)
    return with_fields(record, delivered=delivered)


BARREL: Place = {"body": "barrel", "position_m": 0.9}
TIP: Place = {"body": "beam", "position_m": 0.8}
ROWS: dict[str, Row] = {
    "clearance_and_damping": Row(
        "clearance of contact 1 5.8 % larger, damping of both contacts 10 N s/m",
        effects=(
            ("contact_clearance", {"factor": 1.058}, {"contact": "contact_1"}),
            ("contact_damping", {"damping_n_s_per_m": 10.0}, {"contact": "all"}),
        ),
    ),
    "damping": Row(
        "damping of both contacts 10 N s/m",
        effects=(("contact_damping", {"damping_n_s_per_m": 10.0}, {"contact": "all"}),),
    ),
    "base_motion": Row(
        "base motion of 0.12 m/s2, 2 to 60 Hz, and damping of both beams 1.8 times",
        effects=(
            ("base_motion", {"acceleration_rms_m_per_s2": 0.12, "low_hz": 2.0, "high_hz": 60.0}, {}),
            ("structural_damping", {"factor": 1.8}, {"body": "all"}),
        ),
    ),
    "friction": Row(
        "two masses on springs, friction of 0.1 N to the ground",
        "two_masses",
        (("ground_friction", {"force_n": 0.1}, {"body": "mass_1", "position_m": 0.0}),),
    ),
    "carriage": Row("slow carriage, nothing changed", "carriage"),
    "decay_modulus": Row(
        "decay of a cantilever, first frequency 26 % higher",
        "bare_cantilever_decay",
        (("youngs_modulus", {"factor": 1.26**2}, {"beam": "beam"}),),
    ),
    "hit_modulus": Row(
        "the same, hit by a hammer",
        "bare_cantilever_hit",
        (("youngs_modulus", {"factor": 1.26**2}, {"beam": "beam"}),),
    ),
    "decay_mass": Row(
        "decay of a cantilever, 0.22 kg at 0.8 m", "bare_cantilever_decay", (("added_mass", {"mass_kg": 0.22}, TIP),)
    ),
    "wear": Row(
        "both clearances grow by 0.56 of themselves a minute",
        effects=(("clearance_wear", {"growth_per_minute": 0.56}, {"contact": "all"}),),
    ),
    "force_gain": Row("gain of the force -4 %", effects=(("force_gain", {"factor": 0.96}, {}),)),
    "clipped": Row("a sensor that clips at 0.6 of its largest value", alter_record=_clipped),
    "mostly_open": Row("a force of 4 N, contacts open most of the time, nothing changed", level_n=4.0),
    "storey": Row("a storey's springs 5 % softer", "frame", alter_machine=_softer_storey),
    "drag": Row(
        "quadratic drag of 8.1 N s2/m2 on the barrel",
        effects=(("quadratic_drag", {"drag_n_s2_per_m2": 8.1}, BARREL),),
    ),
    "power_law": Row(
        "identify contact: stop of exponent 1.15",
        "cantilever",
        (("power_law_stop", {"exponent": 1.15, "reference_depth_m": 2e-4}, {"contact": "tip"}),),
        contacts_alone=True,
    ),
    "no_pull": Row(
        "identify contact: a stop that cannot pull, 59 N s/m more",
        "cantilever",
        (("stop_without_pull", {"damping_n_s_per_m": 59.0}, {"contact": "tip"}),),
        contacts_alone=True,
    ),
}


class RowTask(msgspec.Struct, frozen=True, kw_only=True):
    """One row, its seed, and the folder of its recordings."""

    name: str
    seed: int
    folder: str


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict and sentence of the program on a row; `contact` for an identification, `refused` with the error."""

    name: str
    description: str
    verdict: str
    sentence: str


@app.command()
def earlier_faults(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and the answers.")] = Path("out/earlier_faults"),
    seed: Annotated[int, typer.Option(min=0, help="Tolerances, forces and noise are drawn from it.")] = 1,
    dask: Dask = None,
    force: Force = False,
) -> None:
    """Records every row, asks for its diagnosis, and prints what is said."""
    refuse_existing(out / "answers.json", force, new_folder=True)
    out.mkdir(parents=True, exist_ok=True)
    tasks = [RowTask(name=name, seed=seed, folder=str(out)) for name in ROWS]
    answers = run_tasks(answered, tasks, Answer, out / "tasks", dask)
    write_json(answers, out / "answers.json")
    table = Table(show_lines=True)
    for heading in ("machine", "verdict", "sentence"):
        table.add_column(heading)
    for answer in answers:
        table.add_row(answer.description, answer.verdict, answer.sentence)
    Console().print(table)


def answered(task: RowTask) -> Answer:
    """Record a row twice, and ask the program about it."""
    row, folder = ROWS[task.name], Path(task.folder)
    rng = np.random.default_rng([task.seed, list(ROWS).index(task.name)])
    rig, true, excitations = machine_of(row, rng)
    paths = [folder / f"{task.name}_{which}.mcap" for which in ("fit", "validate")]
    for path, excitation in zip(paths, excitations, strict=True):
        record = measured(true, excitation, round(DURATION_S * rig.sample_rate_hz), rig.sample_rate_hz, _seed(rng))
        write(path, rig, row.alter_record(record))
    try:
        if row.contacts_alone:
            found = identify.contact(read(paths[0]))
            return Answer(name=task.name, description=row.description, verdict="contact", sentence=str(found))
        gap, _ = diagnose(read(paths[0]), read(paths[1]), simulator_named("modal"), None)
    except RigError as error:
        return Answer(name=task.name, description=row.description, verdict="refused", sentence=str(error))
    return Answer(name=task.name, description=row.description, verdict=gap.verdict, sentence=gap.sentence)


def machine_of(row: Row, rng: np.random.Generator) -> tuple[Rig, Machine, tuple[Excitation, Excitation]]:
    """The nominal rig of a row, the machine as it is, and the excitations of its two records."""
    kinds: dict[str, Kind]
    excitations: tuple[Excitation, Excitation]
    if row.machine:
        bench = BENCHES[row.machine].drawn(rng, rng)
        rig = described(bench.nominal, bench.name, bench.sample_rate_hz)
        true, kinds, excitations = built(bench.nominal, rng), dict(bench.kinds), bench.excitations
    else:
        rig = believed_rig("own", rng)
        true, kinds = perturbed(nominal_machine(rig), "own", rng), EFFECTS | OUTSIDE
        first, second = (Gaussian(rms_n=row.level_n * louder, begins_s=1.0) for louder in (1.0, LOUDER))
        excitations = (first, second)
    for name, parameters, place in row.effects:
        true = kinds[name].change(true, EffectTruth(name=name, parameters=parameters, place=place, strength=1.0))
    return rig, row.alter_machine(true), excitations


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 2**31))


if __name__ == "__main__":
    run(app, "tests.campaigns.earlier_faults")
