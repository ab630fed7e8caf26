"""What the true effects of a blind case achieve at their true parameters: what nobody can better."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from identify.gap.closure import size
from identify.gap.faults import sound_channels
from identify.gap.floor import MARGIN, Floors, read_floors
from identify.gap.search import settled
from identify.gap.spectra import Record, record_of
from rig.description import Rig
from rig.effects import effect_named
from rig.errors import RigError
from rig.recording import read
from scenarios.scoreboard import Best, Compared
from scenarios.tasks import run_tasks
from scenarios.worlds.truth import Case


class Told(msgspec.Struct, frozen=True):
    """The recordings of a case, its true effects, and the file of the floors."""

    fit: str
    validate: str
    effects: tuple[str, ...]
    floor: str


def achieved(told: Told) -> Best:
    """What the diagnosis would have found, had it been told."""
    floors = read_floors(Path(told.floor), read(Path(told.fit)).rig)
    fit, validation = (_record(Path(path)) for path in (told.fit, told.validate))
    gain, _, _ = _with_truth(fit, told.effects, floors)
    _, before, after = _with_truth(validation, told.effects, floors)
    needed = sum(MARGIN * floors.of(fit).gains.get(effect_named(text).name, 0.0) for text in told.effects)
    return Best(before, after, gain, needed)


def _record(path: Path) -> Record:
    return record_of(sound_channels(read(path))[0])


def _with_truth(record: Record, effects: Sequence[str], floors: Floors) -> tuple[float, float, float]:
    """By how much the true effects lower the cost; the size of the gap without and with them."""
    floor = floors.of(record)
    judge, before = settled(record, record.rig, levels=floor.contacts)
    true: Rig = record.rig
    for text in effects:
        true = effect_named(text).applied_to(true)
    _, after = settled(record, true, judge.seen)
    return before.cost - after.cost, size(judge, before, floor), size(judge, after, floor)


def best_of(compared: Sequence[Compared], recordings: Path, floor: Path, kept: Path) -> Mapping[str, Best]:
    """By case, of every single effect and every pair that the library can put into a rig."""
    cases = [c.truth for c in compared if c.truth.kind in ("single", "pair") and _is_known(c.truth)]
    paths = [[str(recordings / f"{c.case}{end}.mcap") for end in ("", "_validate")] for c in cases]
    tasks = [
        Told(fit, other, tuple(e.text for e in c.effects), str(floor))
        for c, (fit, other) in zip(cases, paths, strict=True)
    ]
    return {c.case: best for c, best in zip(cases, run_tasks(achieved, tasks, Best, kept), strict=True)}


def _is_known(truth: Case) -> bool:
    try:
        return all(effect_named(effect.text) for effect in truth.effects)
    except RigError:
        return False
