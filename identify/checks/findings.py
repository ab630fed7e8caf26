"""What a check says: one sentence with the channel, the evidence and the likeliest mend."""

from typing import Literal

import msgspec

Cause = Literal[
    "dead",
    "clipped",
    "copy",
    "quantised",
    "held samples",
    "spikes",
    "hum",
    "offset",
    "drift",
    "not at rest",
    "polarity",
    "units",
    "gain",
    "delay",
    "slipped samples",
    "swapped",
    "station",
    "filtered",
    "derivative",
    "unrelated",
    "force",
    "clock",
    "mass",
    "frequency",
    "damping",
    "ends",
    "mirrored",
    "model",
    "fit",
]


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """`channels` are those concerned, by name ("the force" is "force"); empty where the whole record or rig.json is.

    `of` is the body, mode or contact that is concerned, if one is.
    """

    cause: Cause
    channels: tuple[str, ...] = ()
    of: str = ""
    evidence: str
    mend: str

    @property
    def sentence(self) -> str:
        return f"{self.evidence}: {self.mend}."


def named(channels: tuple[str, ...], most: int = 3) -> str:
    """The names, or the first of them and how many more."""
    if len(channels) <= most:
        return " and ".join(channels)
    return f"{channels[0]}, {channels[1]} and {len(channels) - 2} more"
