"""How far the gap of a blind case closes with the true effects at their true parameters: what nobody can better."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from identify.gap.closure import size
from identify.gap.faults import sound_channels
from identify.gap.floor import read_floors
from identify.gap.search import settled
from identify.gap.spectra import record_of
from rig.effects import effect_named
from rig.recording import read
from scenarios.scoreboard import Compared
from scenarios.tasks import run_tasks


class ToClose(msgspec.Struct, frozen=True):
    """The validation recording of a case, its true effects, and the file of the floors."""

    validate: str
    effects: tuple[str, ...]
    floor: str


class Closed(msgspec.Struct, frozen=True):
    """Mean squares of the whitened residual: of the believed rig, and of it with the true effects."""

    before: float
    after: float


def closed(task: ToClose) -> Closed:
    """What the diagnosis would have found, had it been told."""
    recording, _ = sound_channels(read(Path(task.validate)))
    record = record_of(recording)
    floor = read_floors(Path(task.floor), recording.rig).of(record)
    judge, before = settled(record, recording.rig, levels=floor.contacts)
    true = recording.rig
    for text in task.effects:
        true = effect_named(text).applied_to(true)
    _, after = settled(record, true, judge.seen)
    return Closed(size(judge, before, floor), size(judge, after, floor))


def shares(compared: Sequence[Compared], recordings: Path, floor: Path, kept: Path) -> list[float]:
    """Of each rightly diagnosed gap: what was closed as a share of what the truth closes."""
    right = [
        (c, c.found.closure)
        for c in compared
        if c.right and c.found.closure and c.found.closure.closed_fraction is not None
    ]
    tasks = [ToClose(str(recordings / f"{c.truth.case}_validate.mcap"), c.truth.effects, str(floor)) for c, _ in right]
    best = run_tasks(closed, tasks, Closed, kept)
    return [(found.before - found.after) / (found.before - b.after) for (_, found), b in zip(right, best, strict=True)]
