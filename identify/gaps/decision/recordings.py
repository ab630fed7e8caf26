"""Recordings of one rig: their sound channels, and which of them validates."""

from collections.abc import Sequence

import numpy as np

from identify.gaps.faults import check_decay, sound_channels
from rig.errors import RigError
from rig.model.description import Rig, to_json
from rig.recording import Recording, Signals

FIT_SHARE = 0.55
"""Of a single record, what is fitted on; the rest validates."""


def sound(*recordings: Recording) -> tuple[list[Recording], dict[str, str]]:
    """All recordings without the channels that are dead or clipped in any.

    Raises RigError if one that has no force is no free decay.
    """
    faults: dict[str, str] = {}
    for one in recordings:
        faults |= sound_channels(one, without=tuple(faults))[1]
    found = [sound_channels(one, without=tuple(faults))[0] for one in recordings]
    for one in found:
        if not np.any(one.forces_n):
            check_decay(one)
    return found, faults


def parts_of(recordings: Recording | Sequence[Recording], validation: Recording | None) -> tuple[list[Recording], int]:
    """All recordings in their order, and which of them validates."""
    parts = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not parts:
        raise RigError("no recording to diagnose; give one or more of the rig")
    if validation is None and len(parts) == 1:
        return list(_halves(parts[0])), 1
    if validation is not None and not any(validation is one for one in parts):
        parts.append(validation)
    _check_shaken(parts[0].rig)
    for k, one in enumerate(parts):
        if to_json(one.rig) != to_json(parts[0].rig):
            raise RigError(f"recording {k + 1} is of another rig (their rig.json differ); give recordings of one rig")
        if any(_same(one, earlier) for earlier in parts[:k]):
            raise RigError(f"recording {k + 1} is the same as an earlier one; give each recording once")
    last = next((k for k, one in enumerate(parts) if one is validation), len(parts) - 1)
    if len(parts) == 1:
        raise RigError("the only recording cannot validate itself; leave --validate out, or give another recording")
    return parts, last


def _check_shaken(rig: Rig) -> None:
    """Raises RigError if the null reference cannot shake a body: by its modes, as it is drawn there, a held one."""
    held = [b.name for b in rig.bodies if not b.is_mass and b.rigid_modes < 2] if rig.base_motion else []
    if held:
        raise RigError(
            f"rig.json of {rig.name!r} has base_motion, and {held[0]!r} is held to the base: identify gap knows how "
            "single masses and free bodies follow a base; leave base_motion out of rig.json, and it is looked for"
        )


def _same(one: Recording, other: Recording) -> bool:
    """True if two recordings hold the same samples."""
    return all(np.array_equal(s.values, other.signals[name].values) for name, s in one.signals.items())


def _halves(recording: Recording) -> tuple[Recording, Recording]:
    """One record cut in two."""
    cut = round(FIT_SHARE * recording.samples)
    return part_of(recording, slice(0, cut)), part_of(recording, slice(cut, None))


def part_of(recording: Recording, keep: slice) -> Recording:
    """The samples of a recording that are kept, from time zero on."""
    signals = {n: Signals(s.channels, 0.0, s.values[:, keep]) for n, s in recording.signals.items()}
    return Recording(recording.rig, signals, recording.provenance)
