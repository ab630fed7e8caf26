"""Channels that deliver nothing or too little: dead or clipped. They are named, and left out."""

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from rig.errors import RigError
from rig.recording import Recording, Signals, channel_groups

STUCK = 1e-3
"""A channel that stands at its largest or smallest value for more than this share of the record is clipped."""
LOUDER = 1.2
LITTLE = 0.03
"""In a free decay no second is louder by this factor than an earlier one, as the energy only falls; of elastic bodies,
or than little: this share of the loudest, below which no second counts."""
FALLEN = 0.5
"""And the quietest second has no more than this share of the loudest."""
WITHOUT_FORCE = (
    "the exciting force is zero throughout: identify gap reads free decays of one mass or of elastic bodies, not of "
    "masses beside other bodies; measure the force of a shaker or a hammer, or take identify contact, which reads them"
)
UNSEEN = (
    "the exciting force is zero throughout: in a free decay of elastic bodies identify gap reads displacement sensors, "
    "as accelerometers do not show the slow motion well enough; measure displacements or the force, or take identify "
    "contact, which reads accelerometers"
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
    """Raises RigError if a record without a force is no free decay, by the level of all sensors of a quantity.

    Likewise if it is one of masses beside other bodies, or of elastic bodies without displacement sensors. Of elastic
    bodies the velocity must fall, as slow swings between their stops may grow while the energy falls.
    """
    bodies = recording.rig.bodies
    elastic = not any(b.is_mass for b in bodies)
    if len(bodies) > 1 and not elastic:
        raise RigError(WITHOUT_FORCE)
    if elastic and "displacement" not in recording.signals:
        raise RigError(UNSEEN)
    if elastic:
        motions = [np.diff(recording.signals["displacement"].values)]
    else:
        motions = [signals.values for name, signals in recording.signals.items() if name != "force"]
    second = round(recording.rig.sample_rate_hz)
    for rows in motions:
        seconds = rows[:, : rows.shape[1] // second * second].reshape(len(rows), -1, second)
        level = np.linalg.norm(seconds.std(axis=2), axis=0)
        earlier = np.maximum(np.minimum.accumulate(level), LITTLE * level.max() if elastic else 0.0)
        if np.any(level > LOUDER * earlier) or level.min() > FALLEN * level.max():
            raise RigError(NO_DECAY)


def fault_of(row: Float[np.ndarray, " samples"]) -> str | None:
    """ "dead" if a channel never moves, "clipped" if it stands at its extremes, None if it is sound."""
    low, high = float(row.min()), float(row.max())
    if low == high:
        return "dead"
    stuck = max(np.mean(row == high), np.mean(row == low))
    return "clipped" if stuck > STUCK else None
