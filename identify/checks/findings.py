"""Findings of a check: one sentence with the channel, the evidence and the most likely remedy."""

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
    "repeated values",
    "windowed",
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
    "two clocks",
    "swapped",
    "station",
    "filtered",
    "derivative",
    "turned",
    "unrelated",
    "unexplained",
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
    """One fault of a recording or of rig.json.

    `channels` names the channels concerned ("force", or "force_1" of several), none if the whole record or rig.json is.
    `of` is the body, mode or contact concerned, if there is one.
    """

    cause: Cause
    channels: tuple[str, ...] = ()
    of: str = ""
    evidence: str
    mend: str

    @property
    def sentence(self) -> str:
        return f"{self.evidence}: {self.mend}."


def force_in_words(force_name: str) -> str:
    """A force's channel in a sentence."""
    return "the force" if force_name == "force" else force_name


def two_clocks_finding(
    name: str, reference_words: str, first_delay_s: float, delay_growth: float, record_s: float
) -> Finding:
    """Finding: a channel's delay grows steadily, by delay_growth seconds a second, over a record of record_s."""
    place_words = [
        f"{1e3 * abs(delay_s):.3g} ms {'late' if delay_s > 0 else 'early'} at the record's {place}"
        for place, delay_s in (("beginning", first_delay_s), ("end", first_delay_s + delay_growth * record_s))
    ]
    ppm_words = f"{1e6 * abs(delay_growth):.3g} ppm"
    return Finding(
        cause="two clocks",
        channels=(name,),
        evidence=f"{name} comes {' and '.join(place_words)} against {reference_words}: its delay grows by {ppm_words} "
        "of the time, as of two clocks",
        mend=f"record both on one clock or with a common signal, or resample {name}, whose samples lie {ppm_words} "
        f"{'closer together' if delay_growth > 0 else 'further apart'} than the others; a constant delay_s does not "
        "mend it",
    )


def slipped_samples_finding(name: str, delay_change_s: float) -> Finding:
    """Finding: the delay of a channel changes within the record by delay_change_s."""
    return Finding(
        cause="slipped samples",
        channels=(name,),
        evidence=f"{name} is {1e3 * abs(delay_change_s):.3g} ms {'later' if delay_change_s > 0 else 'earlier'} "
        "against the others at the record's end than at its beginning",
        mend="it lost or doubled samples: synchronise it and record again",
    )


def names_in_words(names: tuple[str, ...], max_count: int = 3) -> str:
    """Names in a sentence; of more than max_count, the first two and the number of the others."""
    if len(names) <= max_count:
        return " and ".join(names)
    return f"{names[0]}, {names[1]} and {len(names) - 2} more"


def merge_by_cause(findings: Sequence[Finding], rig: Rig) -> tuple[Finding, ...]:
    """Merge three or more findings of the same cause into one."""
    merged: list[Finding] = []
    for cause in dict.fromkeys(finding.cause for finding in findings):
        alike = [finding for finding in findings if finding.cause == cause]
        if len(alike) < 3:
            merged += alike
            continue
        names = tuple(dict.fromkeys(name for finding in alike for name in finding.channels))
        body_names = {sensor.station.body for sensor in rig.sensors if sensor.name in names}
        body = body_names.pop() if len(body_names) == 1 else ""
        evidence = f"{len(names)} channels{f' of {body}' if body else ''} have the same fault; {alike[0].evidence}"
        merged.append(Finding(cause=cause, channels=names, of=body, evidence=evidence, mend=alike[0].mend))
    return tuple(merged)
