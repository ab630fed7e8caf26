"""Blind cases diagnosed from their recordings alone: null references first, as many cases share them, then each case.

A case needs one for each of its recordings; each is made once over all cases.
"""

import resource
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from msgspec.structs import replace

from identify.gaps.decision.answer import diagnose
from identify.gaps.decision.null_reference import null_reference_key, null_reference_of
from identify.gaps.decision.null_simulations import null_simulator
from identify.gaps.decision.prepare import simulator_named
from identify.gaps.decision.recordings import without_faulty_channels
from identify.gaps.residual.record import Record
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import Gap
from rig.commands.tasks import run_tasks
from rig.errors import RigError
from rig.files import write_json
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording, read
from tests.campaigns.worlds.making import sha256_of

SIMULATOR = simulator_named("modal")
MIB_PER_UNIT = 1 / 2**20 if sys.platform == "darwin" else 1 / 2**10
"""`getrusage` counts memory in bytes there, in KiB elsewhere."""


class ToDiagnose(msgspec.Struct, frozen=True, kw_only=True):
    """One case as its diagnosis sees it; null references are kept in a folder, those of its recordings by `keys`."""

    case: str
    fit: str
    validate: str
    null_reference: str
    keys: tuple[str, str]
    tolerances: Tolerances | None
    sha256: dict[str, str]


class NullReferenceToMake(msgspec.Struct, frozen=True, kw_only=True):
    """A null reference, and the recordings of one case that needs it for the first or the second of them."""

    key: str
    fit: str
    validate: str
    which: int
    null_reference: str
    tolerances: Tolerances | None


class NullReferenceMade(msgspec.Struct, frozen=True):
    """What a null reference cost; nothing if another run had made it. Why there is none, where it was refused, or
    crashed."""

    key: str
    cpu_s: float
    memory_mib: float
    refusal: str = ""
    crashed: bool = False


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """The diagnosis of one case without curves, and of which recordings it is.

    cpu_s is that of the diagnosis without its null references; null_references_cpu_s of those by their keys, which many
    cases may share (0 if it was there already); memory_mib the largest of the process so far.
    """

    case: str
    sha256: dict[str, str]
    gap: Gap
    cpu_s: float
    null_references_cpu_s: dict[str, float]
    memory_mib: float
    tolerances: Tolerances | None


class Refused(msgspec.Struct, frozen=True, kw_only=True):
    """A case whose diagnosis was refused, and with which sentence; `crashed` if that is an error of the program."""

    case: str
    sha256: dict[str, str]
    sentence: str
    crashed: bool = False


class Answer(msgspec.Struct, frozen=True):
    """What was found of a case, or that it was refused."""

    found: Found | None = None
    refused: Refused | None = None


def diagnosed_cases(
    recordings: Path,
    out: Path,
    tolerances: Tolerances | None = None,
    null_references_of: Path | None = None,
    dask: str | None = None,
) -> list[Found]:
    """Every case of a folder of recordings, also written to found.json; what `out` keeps is not computed again.

    Cases that are refused stand in refused.json, each with the sentence.
    """
    fits = sorted(p for p in recordings.glob("*.mcap") if not p.stem.endswith("_validate"))
    if not fits:
        raise RigError(f"{recordings}: has no recordings; make the cases first")
    null_reference = null_references_of or out / "null_references"
    null_reference.mkdir(parents=True, exist_ok=True)
    prepared = [_task(fit, null_reference, tolerances) for fit in fits]
    tasks = [p for p in prepared if isinstance(p, ToDiagnose)]
    made = _null_references(tasks, out, dask)
    answers = [Answer(refused=p) for p in prepared if isinstance(p, Refused)]
    without = {t.case: one for t in tasks for one in (made[key] for key in t.keys) if one.refusal}
    answers += [Answer(refused=_refused(t, without[t.case])) for t in tasks if t.case in without]
    answers += TOOL.run_tasks(diagnosed, [t for t in tasks if t.case not in without], Answer, out / "tasks", dask)
    found = [
        replace(a.found, null_references_cpu_s={k: made[k].cpu_s for k in a.found.null_references_cpu_s})
        for a in answers
        if a.found
    ]
    write_json(found, out / "found.json")
    write_json(sorted((a.refused for a in answers if a.refused), key=lambda r: r.case), out / "refused.json")
    return found


def _null_references(tasks: Sequence[ToDiagnose], out: Path, dask: str | None) -> dict[str, NullReferenceMade]:
    """By key, each made from the first case that needs it."""
    first = {key: (task, which) for task in reversed(tasks) for which, key in reversed([*enumerate(task.keys)])}
    to_make = [
        NullReferenceToMake(
            key=key,
            fit=t.fit,
            validate=t.validate,
            which=which,
            null_reference=t.null_reference,
            tolerances=t.tolerances,
        )
        for key, (t, which) in sorted(first.items())
    ]
    return {m.key: m for m in TOOL.run_tasks(TOOL.null_reference_made, to_make, NullReferenceMade, out / "tasks", dask)}


def null_reference_made(task: NullReferenceToMake) -> NullReferenceMade:
    """Makes and keeps the null reference of a recording, unless it is there."""
    recording = TOOL.without_faulty_channels(read(Path(task.fit)), read(Path(task.validate)))[0][task.which]
    there = any(Path(task.null_reference).glob(f"{task.key[:16]}.json"))
    began = time.process_time()
    believed, kept = _believed(recording, task.tolerances), Path(task.null_reference)
    refusal, crashed = "", False
    try:
        simulate = null_simulator(recording, TOOL.record_of(recording, tolerances=believed), SIMULATOR.simulate)
        TOOL.null_reference_of(recording, believed, simulate, SIMULATOR.name, path=kept, predict=SIMULATOR.predict)
    except RigError as error:
        refusal = str(error)
    except Exception as error:  # as of a case
        refusal, crashed = f"{type(error).__name__}: {error}", True
    cpu_s = 0.0 if there else time.process_time() - began
    return NullReferenceMade(task.key, cpu_s, _memory_mib(), refusal, crashed)


def diagnosed(task: ToDiagnose) -> Answer:
    """Reads the two recordings of a case and diagnoses them; the time is that of this process."""
    began = time.process_time()
    try:
        gap = TOOL.gap_of(read(Path(task.fit)), read(Path(task.validate)), Path(task.null_reference), task.tolerances)
    except RigError as error:
        return Answer(refused=Refused(case=task.case, sha256=task.sha256, sentence=str(error)))
    except Exception as error:  # counted against the program, and the other cases go on
        sentence = f"{type(error).__name__}: {error}"
        return Answer(refused=Refused(case=task.case, sha256=task.sha256, sentence=sentence, crashed=True))
    found = Found(
        case=task.case,
        sha256=task.sha256,
        gap=without_curves(gap),
        cpu_s=time.process_time() - began,
        null_references_cpu_s=dict.fromkeys(task.keys, 0.0),
        memory_mib=_memory_mib(),
        tolerances=task.tolerances,
    )
    return Answer(found)


def gap_of(fit: Recording, validate: Recording, null_reference: Path, tolerances: Tolerances | None) -> Gap:
    """The one place where the tool under test is called."""
    return diagnose(fit, validate, SIMULATOR, null_reference, tolerances=tolerances)[0]


def without_curves(gap: Gap) -> Gap:
    """Without what is large and not scored."""
    attribution = replace(gap.attribution, positions_m={}, time_s=(), band_hz=(), surface={})
    return replace(gap, attribution=attribution)


def _null_key(recording: Recording, tolerances: Tolerances) -> str:
    counted = TOOL.record_of(recording, tolerances=tolerances).counted_part
    return null_reference_key(recording, counted, tolerances, SIMULATOR.name)


def _task(fit: Path, null_reference: Path, tolerances: Tolerances | None) -> ToDiagnose | Refused:
    validate = fit.with_name(f"{fit.stem}_validate.mcap")
    sha256 = {path.name: sha256_of(path) for path in (fit, validate)}
    try:
        recordings, _ = TOOL.without_faulty_channels(read(fit), read(validate))
        fitted, validation = (_null_key(recording, _believed(recording, tolerances)) for recording in recordings)
    except RigError as error:
        return Refused(case=fit.stem, sha256=sha256, sentence=str(error))
    return ToDiagnose(
        case=fit.stem,
        fit=str(fit),
        validate=str(validate),
        null_reference=str(null_reference),
        keys=(fitted, validation),
        tolerances=tolerances,
        sha256=sha256,
    )


def _refused(task: ToDiagnose, made: NullReferenceMade) -> Refused:
    return Refused(case=task.case, sha256=task.sha256, sentence=made.refusal, crashed=made.crashed)


def _believed(recording: Recording, tolerances: Tolerances | None) -> Tolerances:
    return tolerances or recording.rig.tolerances or LABORATORY


def _memory_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MIB_PER_UNIT


@dataclass(frozen=True)
class Tool:
    """What is called of the tool under test, and how its tasks are run."""

    gap_of: Callable[..., Gap] = gap_of
    null_reference_of: Callable[..., object] = null_reference_of
    null_reference_made: Callable[[NullReferenceToMake], NullReferenceMade] = null_reference_made
    record_of: Callable[..., Record] = record_of
    without_faulty_channels: Callable[..., tuple[list[Recording], dict[str, str]]] = without_faulty_channels
    run_tasks: Callable[..., list[Any]] = run_tasks


TOOL = Tool()
