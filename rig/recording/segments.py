"""Reading a recording of any length segment by segment."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from rig.errors import RigError
from rig.model.description import Rig, check_shapes_known
from rig.recording import container
from rig.recording.assembly import assemble
from rig.recording.channels import check_channels
from rig.recording.file import (
    FileContents,
    Recording,
    Signals,
    blocks_with_group_names,
    channel_groups,
    has_sample_blocks,
    rig_of,
)
from rig.recording.foreign import RIG_NAME
from rig.recording.messages import Block


def segments(path: Path, segment_s: float, overlap_s: float) -> Iterator[Recording]:
    """Segments of segment_s, each overlapping the one before by overlap_s; the last is up to half longer.

    Only one segment is in memory at a time. Raises RigError as `read` does, once it reaches the fault, and if the rig's
    description comes after the samples.
    """
    contents, blocks_by_group = FileContents(), defaultdict[str, list[Block]](list)
    rig, start_sample = None, 0
    with container.open_recording(path) as file:
        for group_name, block in container.with_path_in_error(
            path, blocks_with_group_names(container.records_of_complete_file(file, has_sample_blocks), contents)
        ):
            rig = rig or _checked_rig(path, contents)
            blocks_by_group[group_name].append(block.with_copied_values())
            segment_samples, overlap_samples = (round(x_s * rig.sample_rate_hz) for x_s in (segment_s, overlap_s))
            if (
                min(_stop_sample(blocks_by_group[group_name]) for group_name in contents.channels_by_group)
                >= start_sample + segment_samples + segment_samples // 2
            ):
                yield _segment(path, rig, contents, blocks_by_group, start_sample, start_sample + segment_samples)
                start_sample += segment_samples - overlap_samples
                for remaining_blocks in blocks_by_group.values():
                    remaining_blocks[:] = [b for b in remaining_blocks if _stop_sample([b]) > start_sample]
    rig = rig or _checked_rig(path, contents)
    stop_by_group = {group_name: _stop_sample(blocks_by_group[group_name]) for group_name in contents.channels_by_group}
    if len(set(stop_by_group.values())) > 1:
        raise RigError(f"{path}: its groups differ in length ({stop_by_group}); every group needs the same samples")
    yield _segment(path, rig, contents, blocks_by_group, start_sample, stop_by_group["force"])


def bytes_per_second(path: Path) -> float:
    """Bytes of samples per second of record, over all channels, from the records before the first block.

    Raises RigError as `segments` does.
    """
    contents = FileContents()
    with container.open_recording(path) as file:
        for _ in container.with_path_in_error(
            path, blocks_with_group_names(container.records_of_complete_file(file, has_sample_blocks), contents)
        ):
            break
    rig = _checked_rig(path, contents)
    return 8 * rig.sample_rate_hz * sum(len(channels.names) for channels in contents.channels_by_group.values())


def _checked_rig(path: Path, contents: FileContents) -> Rig:
    """Rig of a file, checked against its channels; raises RigError if it is missing or does not match them."""
    rig = rig_of(path, contents)
    if "force" not in contents.channels_by_group:
        raise RigError(f"{path}: has no channel /rig/force/block in front; record the exciting force too")
    check_shapes_known(rig, f"{path}: {RIG_NAME}")
    check_channels(path, rig, contents.channels_by_group, channel_groups(rig))
    return rig


def _stop_sample(blocks: list[Block]) -> int:
    """Number of the sample after the last block."""
    return blocks[-1].first_sample + blocks[-1].values.shape[1] if blocks else 0


def _segment(
    path: Path,
    rig: Rig,
    contents: FileContents,
    blocks_by_group: defaultdict[str, list[Block]],
    start_sample: int,
    stop_sample: int,
) -> Recording:
    signals = {}
    for group_name, channels in contents.channels_by_group.items():
        stored_blocks = blocks_by_group[group_name]
        first_stored_sample = stored_blocks[0].first_sample if stored_blocks else start_sample
        values = assemble(path, group_name, channels, stored_blocks, first_stored_sample)[
            :, start_sample - first_stored_sample : stop_sample - first_stored_sample
        ]
        signals[group_name] = Signals(channels, start_sample / rig.sample_rate_hz, values.copy())
    return Recording(rig, signals, contents.provenance)
