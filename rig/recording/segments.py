"""Reading a recording of any length segment by segment."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from rig.errors import RigError
from rig.model.description import Rig, check_given
from rig.recording import container
from rig.recording.assembly import assembled
from rig.recording.channels import check_channels
from rig.recording.file import (
    Contents,
    Recording,
    Signals,
    channel_groups,
    group_blocks,
    is_of_blocks,
    rig_of,
)
from rig.recording.foreign import RIG_NAME
from rig.recording.messages import Block


def segments(path: Path, length_s: float, overlap_s: float) -> Iterator[Recording]:
    """Segments of length_s of a recording, each overlapping the one before by overlap_s; the last is up to half longer.

    Only one segment is in memory at a time. Raises RigError as `read` does, once it reaches the fault, and if the rig's
    description comes after the samples.
    """
    contents, blocks = Contents(), defaultdict[str, list[Block]](list)
    rig, start = None, 0
    with container.open_recording(path) as file:
        for name, block in container.with_path_in_error(
            path, group_blocks(container.read_complete(file, is_of_blocks), contents)
        ):
            rig = rig or _checked_rig(path, contents)
            blocks[name].append(block.copied())
            length, overlap = (round(s * rig.sample_rate_hz) for s in (length_s, overlap_s))
            if min(_stop_sample(blocks[name]) for name in contents.groups) >= start + length + length // 2:
                yield _segment(path, rig, contents, blocks, start, start + length)
                start += length - overlap
                for group in blocks.values():
                    group[:] = [b for b in group if _stop_sample([b]) > start]
    rig = rig or _checked_rig(path, contents)
    stops = {name: _stop_sample(blocks[name]) for name in contents.groups}
    if len(set(stops.values())) > 1:
        raise RigError(f"{path}: its groups differ in length ({stops}); every group needs the same samples")
    yield _segment(path, rig, contents, blocks, start, stops["force"])


def bytes_per_second(path: Path) -> float:
    """Bytes of samples per second of record, over all channels, from the records before the first block.

    Raises RigError as `segments` does.
    """
    contents = Contents()
    with container.open_recording(path) as file:
        for _ in container.with_path_in_error(
            path, group_blocks(container.read_complete(file, is_of_blocks), contents)
        ):
            break
    rig = _checked_rig(path, contents)
    return 8 * rig.sample_rate_hz * sum(len(group.names) for group in contents.groups.values())


def _checked_rig(path: Path, contents: Contents) -> Rig:
    """Rig of a file whose channels are all known; raises RigError if it is missing or does not match them."""
    rig = rig_of(path, contents)
    if "force" not in contents.groups:
        raise RigError(f"{path}: has no channel /rig/force/block in front; record the exciting force too")
    check_given(rig, f"{path}: {RIG_NAME}")
    check_channels(path, rig, contents.groups, channel_groups(rig))
    return rig


def _stop_sample(blocks: list[Block]) -> int:
    """Number of the sample after the last block."""
    return blocks[-1].first_sample + blocks[-1].values.shape[1] if blocks else 0


def _segment(
    path: Path, rig: Rig, contents: Contents, blocks: defaultdict[str, list[Block]], start: int, stop: int
) -> Recording:
    signals = {}
    for name, channels in contents.groups.items():
        stored = blocks[name]
        first = stored[0].first_sample if stored else start
        values = assembled(path, name, channels, stored, first)[:, start - first : stop - first]
        signals[name] = Signals(channels, start / rig.sample_rate_hz, values.copy())
    return Recording(rig, signals, contents.provenance)
