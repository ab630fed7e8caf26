"""Saving what is sound of a recording whose writer was killed, whose disk was full, or whose file was damaged."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.errors import RigError
from rig.files import check_target
from rig.recording import container
from rig.recording.assembly import assembled
from rig.recording.channels import Channels, check_channels
from rig.recording.file import (
    Contents,
    channel_groups,
    group_blocks,
    rig_of,
    truth_groups,
    with_history,
)
from rig.recording.foreign import Foreign
from rig.recording.messages import Block
from rig.recording.writer import writing


@dataclass(frozen=True)
class Loss:
    """Samples of a group that were kept, that were found in the file, and that were asked for (None: unknown)."""

    group: str
    sample_rate_hz: float
    kept: int
    found: int
    asked: int | None

    def __str__(self) -> str:
        rate, lost = self.sample_rate_hz, max(self.found, self.asked or 0) - self.kept
        unstored = "" if self.asked is not None else ", besides what was never stored"
        kept_s, lost_s = self.kept / rate, lost / rate
        return f"{self.group}: {self.kept} samples kept ({kept_s:g} s), {lost} lost ({lost_s:g} s){unstored}"


def recover(damaged: Path, target: Path) -> tuple[Loss, ...]:
    """Write the undamaged samples of a recording, from its start to the first gap in any group, as a recording.

    Every complete chunk whose checksum is right is read. What was kept and lost of each group is returned, and written
    into the provenance; channels, attachments and metadata of other programs are kept. Raises RigError if there is no
    rig.json, no complete chunk, or the result cannot be written.
    """
    check_target(target, damaged)
    contents, foreign, read_blocks = Contents(), Foreign(), defaultdict[str, list[Block]](list)
    with container.open_recording(damaged) as file:
        try:
            for name, block in group_blocks(foreign.collecting(container.read_sound(file)), contents):
                read_blocks[name].append(block.copied())
        except RigError as error:
            raise RigError(f"{damaged}: {error}") from error
        except container.DAMAGE as error:
            raise RigError(
                f"{damaged}: cannot be recovered ({container.reason_of(error)}); restore it from a copy"
            ) from error
    rig = rig_of(damaged, contents)
    blocks = {name: _undisputed(read_blocks[name]) for name in contents.groups}
    kept_samples = min(map(_unbroken, blocks.values()), default=0)
    if not kept_samples:
        raise RigError(
            f"{damaged}: holds no complete chunk of every group with its checksum; there is nothing to recover"
        )
    requested_s = _requested_duration_s(contents.provenance)
    losses = tuple(
        _loss(channels, blocks[name], kept_samples, requested_s) for name, channels in contents.groups.items()
    )
    signals = {
        name: assembled(damaged, name, channels, [b for first, b in blocks[name].items() if first < kept_samples])
        for name, channels in contents.groups.items()
    }
    if set(signals) != set(truth_groups(rig)):
        check_channels(damaged, rig, contents.groups, channel_groups(rig))
    history = with_history(contents.provenance, f"recovered from {damaged.name}; " + "; ".join(map(str, losses)))
    with writing(target, rig, contents.groups, history, foreign) as recording:
        recording.append_all({name: values[:, :kept_samples] for name, values in signals.items()})
    return losses


def _undisputed(blocks: list[Block]) -> dict[int, Block]:
    """Blocks by first sample, without those that contradict another block at the same place."""
    by_start: dict[int, Block] = {}
    disputed = set()
    for block in blocks:
        earlier = by_start.setdefault(block.first_sample, block)
        if not np.array_equal(earlier.values, block.values):
            disputed.add(block.first_sample)
    return {first: block for first, block in by_start.items() if first not in disputed}


def _unbroken(blocks: dict[int, Block]) -> int:
    """Number of samples from the start to the first gap."""
    stop = 0
    while stop in blocks and blocks[stop].values.size:
        stop += blocks[stop].values.shape[1]
    return stop


def _requested_duration_s(provenance: Mapping[str, str]) -> float | None:
    """Duration that was asked for, s; None if the file does not say it."""
    try:
        return float(provenance["asked_duration_s"])
    except (KeyError, ValueError):
        return None


def _loss(channels: Channels, blocks: dict[int, Block], kept_samples: int, requested_s: float | None) -> Loss:
    return Loss(
        group=channels.quantity,
        sample_rate_hz=channels.sample_rate_hz,
        kept=kept_samples,
        found=sum(b.values.shape[1] for b in blocks.values()),
        asked=None if requested_s is None else round(requested_s * channels.sample_rate_hz),
    )
