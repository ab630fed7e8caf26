"""The samples of a group in one piece, put together from its blocks."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.largest import LARGEST
from rig.recording.channels import Channels
from rig.recording.messages import Block


class Assembly:
    """Takes blocks as they come; one that comes too early waits for its place."""

    def __init__(self, path: Path, name: str, channels: Channels, first: int = 0, room: int = 0) -> None:
        """Assembly of the group of that name, from the first sample on; memory for `room` samples is kept ready."""
        self._path, self._name, self._channels = path, name, channels
        self._first = self._end = first
        self._values = np.empty((len(channels.names), room))
        self._early: list[Block] = []
        self._start_ns = 0
        self._suspect: list[slice] = []

    def add(self, block: Block) -> None:
        """Copies its values; raises RigError if it does not fit the group."""
        channels = self._channels
        if block.values.shape[0] != len(channels.names) or block.sample_rate_hz != channels.sample_rate_hz:
            raise RigError(
                f"{self._path}: a block of group {self._name} does not fit its channel's metadata; see "
                "rig/recording/README.md"
            )
        if block.first_sample == self._end:
            self._put(block)
        else:
            self._early.append(block.copied())

    def finished(self) -> tuple[float, Float[np.ndarray, "channels samples"]]:
        """Start of the samples, s, and their values.

        Raises RigError if there are none, there is a gap, or a value is not finite or beyond LARGEST.
        """
        for block in sorted(self._early, key=lambda b: b.first_sample):
            if block.first_sample != self._end:
                raise RigError(
                    f"{self._path}: group {self._name} has samples {self._end} to {block.first_sample} missing or "
                    "doubled; record it again"
                )
            self._put(block)
        if self._end == self._first:
            raise RigError(f"{self._path}: group {self._name} holds no samples; record it again")
        for part in self._suspect:
            self._check_finite(part)
        return self._start_ns * 1e-9, self._values[:, : self._end - self._first]

    def _put(self, block: Block) -> None:
        begin = self._end - self._first
        end = begin + block.values.shape[1]
        if end > self._values.shape[1]:
            grown = np.empty((len(self._values), max(end, 3 * self._values.shape[1] // 2)))
            grown[:, :begin] = self._values[:, :begin]
            self._values = grown
        place = self._values[:, begin:end]
        place[:] = block.values
        if not np.einsum("ij,ij->", place, place) < LARGEST**2:  # or only together; the fastest sum, without warnings
            self._suspect.append(slice(begin, end))
        if self._end == self._first:
            self._start_ns = block.time_ns
        self._end += end - begin

    def _check_finite(self, part: slice) -> None:
        bad = np.argwhere(~(np.abs(self._values[:, part]) <= LARGEST))
        if bad.size:
            sample = self._first + part.start + bad[0, 1]
            value = self._values[bad[0, 0], part.start + bad[0, 1]]
            what = f"{value:g}, which nothing measures," if math.isfinite(value) else "not a finite number"
            raise RigError(
                f"{self._path}: channel {self._channels.names[bad[0, 0]]!r} is {what} at sample {sample} "
                f"({sample / self._channels.sample_rate_hz:.4f} s); repair or leave out that channel"
            )


def assembled(
    path: Path, name: str, channels: Channels, blocks: list[Block], first: int = 0
) -> Float[np.ndarray, "channels samples"]:
    """Assembled samples of blocks in any order."""
    assembly = Assembly(path, name, channels, first, room=sum(b.values.shape[1] for b in blocks))
    for block in blocks:
        assembly.add(block)
    return assembly.finished()[1]
