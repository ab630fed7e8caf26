"""Findings of a check: one sentence with the channel, the evidence and the likeliest mend."""

from collections.abc import Sequence
from typing import Literal

import msgspec

from rig.model.description import Rig

Cause = Literal[
    "dead",
    "clipped",
    "copy",
    "quantised",
    "held samples",
    "spikes",
    "jump",
    "glitch",
    "noise",
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
    "force place",
    "contact place",
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
    """`channels` are those concerned, by name ("the force" is "force", one of several "force_1"); empty where the whole
    record or rig.json is.

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


def spoken(force: str) -> str:
    """Name of a force's channel in a sentence."""
    return "the force" if force == "force" else force


def named(channels: tuple[str, ...], most: int = 3) -> str:
    """The names, or the first of them and how many more."""
    if len(channels) <= most:
        return " and ".join(channels)
    return f"{channels[0]}, {channels[1]} and {len(channels) - 2} more"


def merged(findings: Sequence[Finding], rig: Rig) -> tuple[Finding, ...]:
    """Findings of one cause on three channels or more become one."""
    found: list[Finding] = []
    for cause in dict.fromkeys(f.cause for f in findings):
        own = [f for f in findings if f.cause == cause]
        names = tuple(dict.fromkeys(n for f in own for n in f.channels))
        if len(own) < 3:
            found += own
            continue
        bodies = {s.station.body for s in rig.sensors if s.name in names}
        body = bodies.pop() if len(bodies) == 1 else ""
        first = own[0]
        evidence = f"{len(names)} channels{f' of {body}' if body else ''} have the same fault; {first.evidence}"
        found.append(Finding(cause=cause, channels=names, of=body, evidence=evidence, mend=first.mend))
    return tuple(found)
