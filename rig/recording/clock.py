"""The clock of a recording: when its samples were taken, which every block says and all groups share."""

from rig.errors import RigError
from rig.recording.messages import Block

TOLERANCE_SAMPLES, TOLERANCE_NS = 0.5, 1000.0
"""A time stamp may be off by half a sample, or a microsecond if that is more."""


class Clock:
    """The time of sample 0, t0 = t(k) - k / f of the first block that comes; every block of any group must give it."""

    def __init__(self) -> None:
        self._zero_ns: float | None = None
        self._group = ""

    def check(self, group: str, sample_rate_hz: float, block: Block) -> None:
        """Raises RigError, without the name of the file, if a block's time does not follow from its first sample."""
        after_ns = block.first_sample * 1e9 / sample_rate_hz
        if self._zero_ns is None:
            self._zero_ns, self._group = block.time_ns - after_ns, group
        expected_ns = self._zero_ns + after_ns
        if not abs(block.time_ns - expected_ns) <= max(TOLERANCE_NS, TOLERANCE_SAMPLES * 1e9 / sample_rate_hz):
            raise RigError(
                f"group {group}: sample {block.first_sample} is stamped {block.time_ns * 1e-9:.9g} s where "
                f"{expected_ns * 1e-9:.9g} s follows from its number, {sample_rate_hz:g} Hz and the first block (of "
                f"group {self._group}); stamp every block with first_sample / sample_rate_hz, or record again"
            )
