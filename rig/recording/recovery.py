"""Saving what is sound of a recording whose writer was killed, whose disk was full, or whose file was damaged."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.errors import RigError
from rig.files import check_target
from rig.recording import container
from rig.recording.agreement import check_channels
from rig.recording.assembly import assembled
from rig.recording.channels import Channels
from rig.recording.file import (
    Contents,
    channel_groups,
    gathering,
    rig_of,
    truth_groups,
    with_history,
)
from rig.recording.foreign import Foreign
from rig.recording.messages import Block
from rig.recording.writer import writing


@dataclass(frozen=True)
class Loss:
    """Loss of a group: what the recovered recording holds and lacks; asked is None if the file does not say it."""

    group: str
    sample_rate_hz: float
    kept: int
    found: int
    asked: int | None

    def __str__(self) -> str:
        rate, lost = self.sample_rate_hz, max(self.found, self.asked or 0) - self.kept
        whole = "" if self.asked is not None else ", besides what was never stored"
        return (
            f"{self.group}: {self.kept} samples kept ({self.kept / rate:g} s), {lost} lost ({lost / rate:g} s){whole}"
        )


def recover(bad: Path, good: Path) -> tuple[Loss, ...]:
    """Writes what is sound of a recording from its start up to the first gap in any group, as a recording.

    Every complete chunk whose checksum is right is read. What was kept and lost of each group is returned, and written
    into the provenance; channels, attachments and metadata of other programs are kept. Raises RigError if there is no
    rig.json, no complete chunk, or the result cannot be written.
    """
    check_target(good, bad)
    contents, foreign, found = Contents(), Foreign(), defaultdict[str, list[Block]](list)
    with container.opened(bad) as file:
        try:
            for name, block in gathering(foreign.noting(container.complete(file)), contents):
                found[name].append(block.copied())
        except RigError as error:
            raise RigError(f"{bad}: {error}") from error
        except container.DAMAGE as error:
            raise RigError(
                f"{bad}: cannot be recovered ({container.reason_of(error)}); restore it from a copy"
            ) from error
    rig = rig_of(bad, contents)
    blocks = {name: _placed(found[name]) for name in contents.groups}
    kept = min(map(_unbroken, blocks.values()), default=0)
    if not kept:
        raise RigError(f"{bad}: holds no complete chunk of every group with its checksum; there is nothing to recover")
    asked_s = _asked(contents.provenance)
    losses = tuple(_loss(channels, blocks[name], kept, asked_s) for name, channels in contents.groups.items())
    signals = {
        name: assembled(bad, name, channels, [b for first, b in blocks[name].items() if first < kept])
        for name, channels in contents.groups.items()
    }
    if set(signals) != set(truth_groups(rig)):
        check_channels(bad, rig, contents.groups, channel_groups(rig))
    history = with_history(contents.provenance, f"recovered from {bad.name}; " + "; ".join(map(str, losses)))
    with writing(good, rig, contents.groups, history, foreign) as recording:
        recording.append_all({name: values[:, :kept] for name, values in signals.items()})
    return losses


def _placed(blocks: list[Block]) -> dict[int, Block]:
    """The blocks by their first samples, without those that claim the same place with other values."""
    placed: dict[int, Block] = {}
    doubtful = set()
    for block in blocks:
        before = placed.setdefault(block.first_sample, block)
        if not np.array_equal(before.values, block.values):
            doubtful.add(block.first_sample)
    return {first: block for first, block in placed.items() if first not in doubtful}


def _unbroken(blocks: dict[int, Block]) -> int:
    """Count of samples from the start to the first gap."""
    end = 0
    while end in blocks and blocks[end].values.size:
        end += blocks[end].values.shape[1]
    return end


def _asked(provenance: Mapping[str, str]) -> float | None:
    """Duration that was asked for, if the file says so."""
    try:
        return float(provenance["asked_duration_s"])
    except (KeyError, ValueError):
        return None


def _loss(channels: Channels, blocks: dict[int, Block], kept: int, asked_s: float | None) -> Loss:
    return Loss(
        group=channels.quantity,
        sample_rate_hz=channels.sample_rate_hz,
        kept=kept,
        found=sum(b.values.shape[1] for b in blocks.values()),
        asked=None if asked_s is None else round(asked_s * channels.sample_rate_hz),
    )
