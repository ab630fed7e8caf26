"""Channels that deliver nothing or too little: dead or clipped. They are named, and left out."""

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from rig.errors import RigError
from rig.recording import Recording, Signals, channel_groups

STUCK = 1e-3
"""A channel that stands at its largest or smallest value for more than this share of the record is clipped."""
LOUDER = 1.2
"""In a free decay no second is that much louder than an earlier one, as the energy only falls."""
FALLEN = 0.5
"""And the quietest second has no more than this share of the loudest."""
WITHOUT_FORCE = (
    "the exciting force is zero throughout: of beams identify gap compares the motion with what rig.json makes of a "
    "measured force; measure the force of a shaker or a hammer, or take identify contact, which reads free decays"
)
NO_DECAY = (
    "the exciting force is zero throughout, and this is no free decay, whose motion only falls; measure the force (of "
    "one mass on a shaking base: minus its mass times the base's acceleration), or let the record begin when the rig "
    "has been released"
)


def sound_channels(recording: Recording, without: tuple[str, ...] = ()) -> tuple[Recording, dict[str, str]]:
    """The recording without its faulty channels and those of `without`, and what is wrong with each of the former.

    Raises RigError if the force channel is clipped, or no sensor is left.
    """
    faults: dict[str, str] = {}
    for name, signals in recording.signals.items():
        for channel, row in zip(signals.channels.names, signals.values, strict=True):
            fault = fault_of(row)
            if name == "force" and not np.any(row):
                continue
            if fault and name == "force":
                raise RigError(f"the force channel is {fault}; the diagnosis needs the force: mend it and record again")
            if fault and channel not in without:
                faults[channel] = fault
    dropped = {*faults, *without}
    if not dropped:
        return recording, faults
    sensors = tuple(s for s in recording.rig.sensors if s.name not in dropped)
    if not sensors:
        raise RigError("every channel is dead or clipped; check the sensors' cables and ranges, and record again")
    rig = replace(recording.rig, sensors=sensors)
    kept = {}
    for name, channels in channel_groups(rig).items():
        old = recording.signals[name]
        kept[name] = Signals(channels, old.start_s, old.values[[old.channels.names.index(n) for n in channels.names]])
    return Recording(rig, kept, recording.provenance), faults


def check_decay(recording: Recording) -> None:
    """Raises RigError if a record without a force is not the free decay of a single mass."""
    rig = recording.rig
    if len(rig.bodies) > 1 or not rig.bodies[0].is_mass:
        raise RigError(WITHOUT_FORCE)
    second = round(rig.sample_rate_hz)
    for sensor in rig.sensors:
        signals = recording.signals[sensor.quantity]
        row = signals.values[signals.channels.names.index(sensor.name)]
        level = row[: row.size // second * second].reshape(-1, second).std(axis=1)
        if np.any(level > LOUDER * np.minimum.accumulate(level)) or level.min() > FALLEN * level.max():
            raise RigError(NO_DECAY)


def fault_of(row: Float[np.ndarray, " samples"]) -> str | None:
    """ "dead" if a channel never moves, "clipped" if it stands at its extremes, None if it is sound."""
    low, high = float(row.min()), float(row.max())
    if low == high:
        return "dead"
    stuck = max(np.mean(row == high), np.mean(row == low))
    return "clipped" if stuck > STUCK else None
