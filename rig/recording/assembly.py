"""Assembly of a group's samples into one array from its blocks."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.limits import MAX_NUMBER
from rig.recording.channels import Channels
from rig.recording.messages import Block


class SampleAssembly:
    """Array of a group's samples that grows block by block; a block that comes early is kept until its turn."""

    def __init__(
        self, path: Path, group_name: str, channels: Channels, first_sample: int = 0, capacity: int = 0
    ) -> None:
        """Start at sample `first_sample`, with memory for `capacity` samples."""
        self._path, self._group_name, self._channels = path, group_name, channels
        self._first_sample = self._end_sample = first_sample
        self._values = np.empty((len(channels.names), capacity))
        self._early_blocks: list[Block] = []
        self._start_ns = 0
        self._suspect_spans: list[slice] = []

    def add(self, block: Block) -> None:
        """Copy the values of a block; raise RigError if its channels or its rate are not those of the group."""
        channels = self._channels
        if block.values.shape[0] != len(channels.names) or block.sample_rate_hz != channels.sample_rate_hz:
            raise RigError(
                f"{self._path}: a block of group {self._group_name} does not fit its channel's metadata; see "
                "rig/recording/README.md"
            )
        if block.first_sample == self._end_sample:
            self._store(block)
        else:
            self._early_blocks.append(block.with_copied_values())

    def finish(self) -> tuple[float, Float[np.ndarray, "channels samples"]]:
        """Time of the first sample (s), and the values (channels x samples).

        Raises RigError if there are none, there is a gap, or a value is not finite or beyond MAX_NUMBER.
        """
        for block in sorted(self._early_blocks, key=lambda b: b.first_sample):
            if block.first_sample != self._end_sample:
                raise RigError(
                    f"{self._path}: group {self._group_name} has samples {self._end_sample} to {block.first_sample} "
                    "missing or doubled; record it again"
                )
            self._store(block)
        if self._end_sample == self._first_sample:
            raise RigError(f"{self._path}: group {self._group_name} holds no samples; record it again")
        for suspect_span in self._suspect_spans:
            self._check_finite(suspect_span)
        return self._start_ns * 1e-9, self._values[:, : self._end_sample - self._first_sample]

    def _store(self, block: Block) -> None:
        start_index = self._end_sample - self._first_sample
        stop_index = start_index + block.values.shape[1]
        if stop_index > self._values.shape[1]:
            larger_values = np.empty((len(self._values), max(stop_index, 3 * self._values.shape[1] // 2)))
            larger_values[:, :start_index] = self._values[:, :start_index]
            self._values = larger_values
        stored_values = self._values[:, start_index:stop_index]
        stored_values[:] = block.values
        square_sum = np.einsum("ij,ij->", stored_values, stored_values)  # the fastest sum, without warnings
        if not square_sum < MAX_NUMBER**2:  # or only together
            self._suspect_spans.append(slice(start_index, stop_index))
        if self._end_sample == self._first_sample:
            self._start_ns = block.time_ns
        self._end_sample += stop_index - start_index

    def _check_finite(self, suspect_span: slice) -> None:
        faulty_indices = np.argwhere(~(np.abs(self._values[:, suspect_span]) <= MAX_NUMBER))
        if faulty_indices.size:
            sample = self._first_sample + suspect_span.start + faulty_indices[0, 1]
            value = self._values[faulty_indices[0, 0], suspect_span.start + faulty_indices[0, 1]]
            fault_words = f"{value:g}, which nothing measures," if math.isfinite(value) else "not a finite number"
            raise RigError(
                f"{self._path}: channel {self._channels.names[faulty_indices[0, 0]]!r} is {fault_words} at sample "
                f"{sample} ({sample / self._channels.sample_rate_hz:.4f} s); repair or leave out that channel"
            )


def assemble(
    path: Path, group_name: str, channels: Channels, blocks: list[Block], first_sample: int = 0
) -> Float[np.ndarray, "channels samples"]:
    """Samples of a group from its blocks in any order."""
    assembly = SampleAssembly(
        path, group_name, channels, first_sample, capacity=sum(block.values.shape[1] for block in blocks)
    )
    for block in blocks:
        assembly.add(block)
    return assembly.finish()[1]
