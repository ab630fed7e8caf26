"""Assembly of a group's samples into one array from its blocks."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.limits import LARGEST
from rig.recording.channels import Channels
from rig.recording.messages import Block


class Assembly:
    """Array of a group's samples that grows block by block; a block that comes early is kept until its turn."""

    def __init__(self, path: Path, name: str, channels: Channels, first: int = 0, room: int = 0) -> None:
        """Start at sample `first`, with memory for `room` samples."""
        self._path, self._name, self._channels = path, name, channels
        self._first = self._end = first
        self._values = np.empty((len(channels.names), room))
        self._early: list[Block] = []
        self._start_ns = 0
        self._suspect: list[slice] = []

    def add(self, block: Block) -> None:
        """Copy the values of a block; raise RigError if its channels or its rate are not those of the group."""
        channels = self._channels
        if block.values.shape[0] != len(channels.names) or block.sample_rate_hz != channels.sample_rate_hz:
            raise RigError(
                f"{self._path}: a block of group {self._name} does not fit its channel's metadata; see "
                "rig/recording/README.md"
            )
        if block.first_sample == self._end:
            self._store(block)
        else:
            self._early.append(block.copied())

    def finished(self) -> tuple[float, Float[np.ndarray, "channels samples"]]:
        """Time of the first sample (s), and the values (channels x samples).

        Raises RigError if there are none, there is a gap, or a value is not finite or beyond LARGEST.
        """
        for block in sorted(self._early, key=lambda b: b.first_sample):
            if block.first_sample != self._end:
                raise RigError(
                    f"{self._path}: group {self._name} has samples {self._end} to {block.first_sample} missing or "
                    "doubled; record it again"
                )
            self._store(block)
        if self._end == self._first:
            raise RigError(f"{self._path}: group {self._name} holds no samples; record it again")
        for span in self._suspect:
            self._check_finite(span)
        return self._start_ns * 1e-9, self._values[:, : self._end - self._first]

    def _store(self, block: Block) -> None:
        start = self._end - self._first
        stop = start + block.values.shape[1]
        if stop > self._values.shape[1]:
            larger = np.empty((len(self._values), max(stop, 3 * self._values.shape[1] // 2)))
            larger[:, :start] = self._values[:, :start]
            self._values = larger
        place = self._values[:, start:stop]
        place[:] = block.values
        if not np.einsum("ij,ij->", place, place) < LARGEST**2:  # or only together; the fastest sum, without warnings
            self._suspect.append(slice(start, stop))
        if self._end == self._first:
            self._start_ns = block.time_ns
        self._end += stop - start

    def _check_finite(self, span: slice) -> None:
        faulty = np.argwhere(~(np.abs(self._values[:, span]) <= LARGEST))
        if faulty.size:
            sample = self._first + span.start + faulty[0, 1]
            value = self._values[faulty[0, 0], span.start + faulty[0, 1]]
            fault = f"{value:g}, which nothing measures," if math.isfinite(value) else "not a finite number"
            raise RigError(
                f"{self._path}: channel {self._channels.names[faulty[0, 0]]!r} is {fault} at sample {sample} "
                f"({sample / self._channels.sample_rate_hz:.4f} s); repair or leave out that channel"
            )


def assembled(
    path: Path, name: str, channels: Channels, blocks: list[Block], first: int = 0
) -> Float[np.ndarray, "channels samples"]:
    """Samples of a group from its blocks in any order."""
    assembly = Assembly(path, name, channels, first, room=sum(b.values.shape[1] for b in blocks))
    for block in blocks:
        assembly.add(block)
    return assembly.finished()[1]
