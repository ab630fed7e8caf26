"""Recovery of recordings whose writer was killed, whose disk was full, or whose file was damaged."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rig.errors import RigError
from rig.files import check_target
from rig.recording import container
from rig.recording.assembly import assemble
from rig.recording.channels import Channels, check_channels
from rig.recording.file import (
    FileContents,
    blocks_with_group_names,
    channel_groups,
    rig_of,
    truth_groups,
    with_processing_steps,
)
from rig.recording.foreign import ForeignRecords
from rig.recording.messages import Block
from rig.recording.writer import writing


@dataclass(frozen=True)
class GroupLoss:
    """Samples of a group that were kept, found in the file, and requested (None: unknown)."""

    group: str
    sample_rate_hz: float
    kept: int
    found: int
    asked: int | None

    def __str__(self) -> str:
        rate_hz, lost_count = self.sample_rate_hz, max(self.found, self.asked or 0) - self.kept
        caveat = "" if self.asked is not None else ", besides what was never stored"
        kept_s, lost_s = self.kept / rate_hz, lost_count / rate_hz
        return f"{self.group}: {self.kept} samples kept ({kept_s:g} s), {lost_count} lost ({lost_s:g} s){caveat}"


def recover(damaged_path: Path, target_path: Path) -> tuple[GroupLoss, ...]:
    """Write the undamaged samples of a recording, from its start to the first gap in any group, as a recording.

    Every complete chunk whose checksum is right is read. What was kept and lost of each group is returned, and written
    into the provenance; channels, attachments and metadata of other programs are kept. Raises RigError if there is no
    rig.json, no complete chunk, or the result cannot be written.
    """
    check_target(target_path, damaged_path)
    contents, foreign, blocks_by_group = FileContents(), ForeignRecords(), defaultdict[str, list[Block]](list)
    with container.open_recording(damaged_path) as file:
        try:
            for group, block in blocks_with_group_names(
                foreign.collect_while_reading(container.undamaged_records(file)), contents
            ):
                blocks_by_group[group].append(block.with_copied_values())
        except RigError as error:
            raise RigError(f"{damaged_path}: {error}") from error
        except container.DAMAGE as error:
            reason = container.reason_of(error)
            raise RigError(f"{damaged_path}: cannot be recovered ({reason}); restore it from a copy") from error
    rig, groups = rig_of(damaged_path, contents), contents.channels_by_group
    blocks = {group: _undisputed_blocks(blocks_by_group[group]) for group in groups}
    kept_count = min(map(_gap_free_sample_count, blocks.values()), default=0)
    if not kept_count:
        raise RigError(
            f"{damaged_path}: holds no complete chunk of every group with its checksum; there is nothing to recover"
        )
    requested_s = _requested_duration_s(contents.provenance)
    losses = tuple(_group_loss(channels, blocks[group], kept_count, requested_s) for group, channels in groups.items())
    values_by_group = {}
    for group, channels in groups.items():
        kept_blocks = [block for first_sample, block in blocks[group].items() if first_sample < kept_count]
        values_by_group[group] = assemble(damaged_path, group, channels, kept_blocks)[:, :kept_count]
    if set(values_by_group) != set(truth_groups(rig)):
        check_channels(damaged_path, rig, groups, channel_groups(rig))
    step = f"recovered from {damaged_path.name}; " + "; ".join(map(str, losses))
    with writing(
        target_path, rig, groups, with_processing_steps(contents.provenance, step), foreign
    ) as recording_writer:
        recording_writer.append_all(values_by_group)
    return losses


def _undisputed_blocks(blocks: list[Block]) -> dict[int, Block]:
    """Blocks by first sample, without those that contradict another block at the same place."""
    block_by_start: dict[int, Block] = {}
    disputed_starts = set()
    for block in blocks:
        earlier_block = block_by_start.setdefault(block.first_sample, block)
        if not np.array_equal(earlier_block.values, block.values):
            disputed_starts.add(block.first_sample)
    return {start: block for start, block in block_by_start.items() if start not in disputed_starts}


def _gap_free_sample_count(block_by_start: dict[int, Block]) -> int:
    """Number of samples from the start to the first gap."""
    stop_sample = 0
    while stop_sample in block_by_start and block_by_start[stop_sample].values.size:
        stop_sample += block_by_start[stop_sample].values.shape[1]
    return stop_sample


def _requested_duration_s(provenance: Mapping[str, str]) -> float | None:
    """Requested duration, s; None if the file does not state it."""
    try:
        return float(provenance["asked_duration_s"])
    except (KeyError, ValueError):
        return None


def _group_loss(
    channels: Channels, block_by_start: dict[int, Block], kept_count: int, requested_duration_s: float | None
) -> GroupLoss:
    return GroupLoss(
        group=channels.quantity,
        sample_rate_hz=channels.sample_rate_hz,
        kept=kept_count,
        found=sum(block.values.shape[1] for block in block_by_start.values()),
        asked=None if requested_duration_s is None else round(requested_duration_s * channels.sample_rate_hz),
    )
