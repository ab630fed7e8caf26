"""Blind cases diagnosed from their recordings alone: null references first, as many cases share one, then each case."""

import resource
import sys
import time
from pathlib import Path

import msgspec
from msgspec.structs import replace

from identify.gaps.decision.answer import Simulator, diagnose
from identify.gaps.decision.null_reference import null_key, null_reference_of
from identify.gaps.decision.recordings import sound
from identify.gaps.results import Gap
from rig.errors import RigError
from rig.files import write_json
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording, read
from rig.simulation import replay
from scenarios.tasks import run_tasks
from scenarios.worlds.making import sha256_of

SIMULATOR = Simulator("modal", replay.modal)
MIB_PER_UNIT = 1 / 2**20 if sys.platform == "darwin" else 1 / 2**10
"""`getrusage` counts memory in bytes there, in KiB elsewhere."""


class ToDiagnose(msgspec.Struct, frozen=True, kw_only=True):
    """One case as its diagnosis sees it; null references are kept in a folder, that of the case by its `key`."""

    case: str
    fit: str
    validate: str
    null_reference: str
    key: str
    tolerances: Tolerances | None
    sha256: dict[str, str]


class NullReferenceToMake(msgspec.Struct, frozen=True, kw_only=True):
    """A null reference, and the recordings of one case that needs it."""

    key: str
    fit: str
    validate: str
    null_reference: str
    tolerances: Tolerances | None


class NullReferenceMade(msgspec.Struct, frozen=True):
    """What a null reference cost; nothing if another run had made it."""

    key: str
    cpu_s: float
    memory_mib: float


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """The diagnosis of one case without curves, and of which recordings it is.

    cpu_s is that of the diagnosis without its null reference, which took null_reference_cpu_s and may be shared by
    many cases (0 if it was there already); memory_mib the largest of the process so far.
    """

    case: str
    sha256: dict[str, str]
    gap: Gap
    cpu_s: float
    null_reference_cpu_s: float
    memory_mib: float
    key: str
    tolerances: Tolerances | None


def diagnosed_cases(
    recordings: Path,
    out: Path,
    tolerances: Tolerances | None = None,
    null_references_of: Path | None = None,
    dask: str | None = None,
) -> list[Found]:
    """Every case of a folder of recordings, also written to found.json; what `out` keeps is not computed again."""
    fits = sorted(p for p in recordings.glob("*.mcap") if not p.stem.endswith("_validate"))
    if not fits:
        raise RigError(f"{recordings}: has no recordings; make the cases first")
    null_reference = null_references_of or out / "null_references"
    null_reference.mkdir(parents=True, exist_ok=True)
    tasks = [_task(fit, null_reference, tolerances) for fit in fits]
    first = {task.key: task for task in reversed(tasks)}
    to_make = [
        NullReferenceToMake(
            key=key, fit=t.fit, validate=t.validate, null_reference=t.null_reference, tolerances=tolerances
        )
        for key, t in sorted(first.items())
    ]
    cost = {
        made.key: made.cpu_s for made in run_tasks(null_reference_made, to_make, NullReferenceMade, out / "tasks", dask)
    }
    found = run_tasks(diagnosed, tasks, Found, out / "tasks", dask)
    found = [replace(f, null_reference_cpu_s=cost[f.key]) for f in found]
    write_json(found, out / "found.json")
    return found


def null_reference_made(task: NullReferenceToMake) -> NullReferenceMade:
    """Makes and keeps the null reference of a case, unless it is there."""
    (_, validation), _ = sound(read(Path(task.fit)), read(Path(task.validate)))
    there = any(Path(task.null_reference).glob(f"{task.key[:16]}.json"))
    began = time.process_time()
    believed = _believed(validation, task.tolerances)
    null_reference_of(validation, believed, SIMULATOR.simulate, SIMULATOR.name, kept=Path(task.null_reference))
    return NullReferenceMade(task.key, 0.0 if there else time.process_time() - began, _memory_mib())


def diagnosed(task: ToDiagnose) -> Found:
    """Reads the two recordings of a case and diagnoses them; the time is that of this process."""
    began = time.process_time()
    gap = gap_of(read(Path(task.fit)), read(Path(task.validate)), Path(task.null_reference), task.tolerances)
    return Found(
        case=task.case,
        sha256=task.sha256,
        gap=without_curves(gap),
        cpu_s=time.process_time() - began,
        null_reference_cpu_s=0.0,
        memory_mib=_memory_mib(),
        key=task.key,
        tolerances=task.tolerances,
    )


def gap_of(fit: Recording, validate: Recording, null_reference: Path, tolerances: Tolerances | None) -> Gap:
    """The one place where the tool under test is called."""
    return diagnose(fit, validate, SIMULATOR, null_reference, tolerances=tolerances)[0]


def without_curves(gap: Gap) -> Gap:
    """Without what is large and not scored."""
    attribution = replace(gap.attribution, positions_m={}, time_s=(), band_hz=(), surface={})
    return replace(gap, curves=(), attribution=attribution)


def _task(fit: Path, null_reference: Path, tolerances: Tolerances | None) -> ToDiagnose:
    validate = fit.with_name(f"{fit.stem}_validate.mcap")
    (_, validation), _ = sound(read(fit), read(validate))
    return ToDiagnose(
        case=fit.stem,
        fit=str(fit),
        validate=str(validate),
        null_reference=str(null_reference),
        key=null_key(validation, _believed(validation, tolerances), SIMULATOR.name),
        tolerances=tolerances,
        sha256={path.name: sha256_of(path) for path in (fit, validate)},
    )


def _believed(recording: Recording, tolerances: Tolerances | None) -> Tolerances:
    return tolerances or recording.rig.tolerances or LABORATORY


def _memory_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MIB_PER_UNIT
