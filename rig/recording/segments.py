"""A recording of any length, read segment by segment."""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from rig.errors import RigError
from rig.model.description import Rig, check_given
from rig.recording import container
from rig.recording.agreement import check_channels
from rig.recording.assembly import assembled
from rig.recording.file import (
    Contents,
    Recording,
    Signals,
    channel_groups,
    gathering,
    is_of_blocks,
    rig_of,
)
from rig.recording.foreign import RIG_NAME
from rig.recording.messages import Block


def segments(path: Path, length_s: float, overlap_s: float) -> Iterator[Recording]:
    """The recording in segments of length_s, each with overlap_s of the one before; the last is up to half longer.

    Holds no more than one of them. Raises RigError as `read` does, when it comes to what is wrong; and if the rig's
    description stands behind the samples.
    """
    contents, blocks = Contents(), defaultdict[str, list[Block]](list)
    rig, begin = None, 0
    with container.opened(path) as file:
        for name, block in container.with_path_in_error(path, gathering(container.whole(file, is_of_blocks), contents)):
            rig = rig or _checked_rig(path, contents)
            blocks[name].append(block.copied())
            length, overlap = (round(s * rig.sample_rate_hz) for s in (length_s, overlap_s))
            if min(_end(blocks[name]) for name in contents.groups) >= begin + length + length // 2:
                yield _segment(path, rig, contents, blocks, begin, begin + length)
                begin += length - overlap
                for held in blocks.values():
                    held[:] = [b for b in held if _end([b]) > begin]
    rig = rig or _checked_rig(path, contents)
    ends = {name: _end(blocks[name]) for name in contents.groups}
    if len(set(ends.values())) > 1:
        raise RigError(f"{path}: its groups differ in length ({ends}); every group needs the same samples")
    yield _segment(path, rig, contents, blocks, begin, ends["force"])


def bytes_per_second(path: Path) -> float:
    """Bytes of samples a second of all channels, by what stands before the first of them.

    Raises RigError as `segments` does.
    """
    contents = Contents()
    with container.opened(path) as file:
        for _ in container.with_path_in_error(path, gathering(container.whole(file, is_of_blocks), contents)):
            break
    rig = _checked_rig(path, contents)
    return 8 * rig.sample_rate_hz * sum(len(group.names) for group in contents.groups.values())


def _checked_rig(path: Path, contents: Contents) -> Rig:
    """The description, once all channels are known; raises RigError if it is not there, or they do not fit."""
    rig = rig_of(path, contents)
    if "force" not in contents.groups:
        raise RigError(f"{path}: has no channel /rig/force/block in front; record the exciting force too")
    check_given(rig, f"{path}: {RIG_NAME}")
    check_channels(path, rig, contents.groups, channel_groups(rig))
    return rig


def _end(blocks: list[Block]) -> int:
    """The sample behind the last block."""
    return blocks[-1].first_sample + blocks[-1].values.shape[1] if blocks else 0


def _segment(
    path: Path, rig: Rig, contents: Contents, blocks: defaultdict[str, list[Block]], begin: int, end: int
) -> Recording:
    signals = {}
    for name, channels in contents.groups.items():
        held = blocks[name]
        first = held[0].first_sample if held else begin
        values = assembled(path, name, channels, held, first)[:, begin - first : end - first]
        signals[name] = Signals(channels, begin / rig.sample_rate_hz, values.copy())
    return Recording(rig, signals, contents.provenance)
