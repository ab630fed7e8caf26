"""Makes the cases: draws, simulates, writes what a laboratory would have, and keeps the truth apart."""

import hashlib
from pathlib import Path

import msgspec
import numpy as np

from rig.errors import CutOffError, RigError
from rig.model.description import Rig
from rig.recording import channel_groups, writing
from tests.campaigns.worlds.drawing import Drawn, drawn_case
from tests.campaigns.worlds.instruments import Measured, measured
from tests.campaigns.worlds.truth import Case, RecordTruth, World

DRAWS = 20


class Planned(msgspec.Struct, frozen=True, kw_only=True):
    """One case to be made; the folder is where everything goes."""

    folder: str
    world: World
    seed: int
    number: int
    nulls_only: bool
    duration_s: float

    @property
    def case(self) -> str:
        return f"case_{self.number:03d}"


def planned(
    folder: Path, world: World, seed: int, cases: int, duration_s: float, nulls_only: bool = False
) -> list[Planned]:
    """The first so many cases of a world's seed."""
    return [
        Planned(folder=str(folder), world=world, seed=seed, number=k, nulls_only=nulls_only, duration_s=duration_s)
        for k in range(cases)
    ]


def made(plan: Planned) -> Case:
    """Draws and records one case; a draw that cannot be simulated is drawn again and counted.

    Raises RigError if no draw can be simulated.
    """
    refused: list[str] = []
    for draw in range(DRAWS):
        drawn = drawn_case(plan.world, plan.seed, plan.number, draw, plan.nulls_only)
        try:
            records, hashes = _recorded(plan, drawn)
        except CutOffError as error:  # the disk's fault, not the draw's; this error does not pass between processes
            raise RigError(str(error)) from error
        except RigError as error:
            refused.append(f"{', '.join(e.text for e in drawn.effects)}: {error}")
            continue
        return Case(
            case=plan.case,
            world=plan.world,
            kind=drawn.kind,
            effects=drawn.effects,
            expected=drawn.expected,
            hung=drawn.hung,
            machine=drawn.machine,
            records=records,
            nominal=drawn.nominal,
            drawn=drawn.drawn,
            true=drawn.true,
            draw=draw,
            refused=tuple(refused),
            sha256=hashes,
        )
    raise RigError(f"{plan.case}: none of {DRAWS} draws could be simulated, the last: {refused[-1]}")


def _recorded(plan: Planned, drawn: Drawn) -> tuple[tuple[RecordTruth, ...], dict[str, str]]:
    """Writes both recordings; what is true of each, and their hashes by name."""
    records, rate_hz = [], drawn.rig.sample_rate_hz
    samples = round(plan.duration_s * rate_hz)
    work = Path(plan.folder, "sealed", "work")
    names = (f"{plan.case}.mcap", f"{plan.case}_validate.mcap")
    for name, seed, excitation in zip(names, drawn.seeds, drawn.excitations, strict=True):
        record = measured(drawn.true, excitation, samples, rate_hz, seed)
        write(work / name, drawn.rig, record)
        records.append(RecordTruth(file=name, excitation=excitation, seed=seed, closed_fraction=record.closed_fraction))
    for name in names:
        (work / name).replace(Path(plan.folder, "recordings", name))
    return tuple(records), {name: sha256_of(Path(plan.folder, "recordings", name)) for name in names}


def write(path: Path, rig: Rig, record: Measured) -> None:
    """A recording of what was measured on a machine that is believed to be `rig`."""
    rows = {"force": record.force_n[None, :]}
    for quantity in dict.fromkeys(s.quantity for s in rig.sensors):
        rows[quantity] = record.delivered[[s.quantity == quantity for s in rig.sensors]]
    for name, values in rows.items():
        if not np.isfinite(values).all():
            raise RigError(f"{path}: the {name} is no finite number; draw a weaker effect")
    with writing(path, rig, channel_groups(rig), {"made_by": "tests.campaigns.worlds"}) as recording:
        recording.append_all(rows)


def sha256_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
