"""Channels that deliver nothing or too little: dead or clipped. They are named, and left out."""

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.gaps.residual.channel_noise import read_sensors, sensor_densities
from identify.gaps.residual.ringing import rings_to_hz
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
PARTS = 4
"""Of a record that is shorter than so many seconds, parts of equal length stand for the seconds."""
RANGE = 1.6
"""Its motion is looked at up to this multiple of the frequency up to which it rings."""
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

    Likewise if it is one with contacts, of masses beside other bodies, or of elastic bodies without displacement
    sensors. Displacements are judged by their velocity, up to where the rig rings, as slow swings between stops may
    grow while the energy falls, and what noise leaves of a decay does not fall.
    """
    rig = recording.rig
    elastic = not any(b.is_mass for b in rig.bodies)
    if rig.contacts and len(rig.bodies) > 1 and not elastic:
        raise RigError(WITHOUT_FORCE)
    if rig.contacts and elastic and "displacement" not in recording.signals:
        raise RigError(UNSEEN)
    sensors = read_sensors(recording)
    rate_hz, order = rig.sample_rate_hz, sensors[0].measures.order
    rows = np.stack([recording.values_of(s) for s in sensors])
    highest_hz = RANGE * rings_to_hz(rows, rate_hz, order, sensor_densities(recording, sensors, 0))
    rows = _velocities(rows, rate_hz, order, highest_hz)
    part = round(min(1.0, recording.duration_s / PARTS) * rate_hz)
    parts = rows[:, : rows.shape[1] // part * part].reshape(len(rows), -1, part)
    level = np.linalg.norm(parts.std(axis=2), axis=0)
    earlier = np.maximum(np.minimum.accumulate(level), LITTLE * level.max())
    if np.any(level > LOUDER * earlier) or level.min() > FALLEN * level.max():
        raise RigError(NO_DECAY)


def _velocities(
    rows: Float[np.ndarray, "sensors samples"], rate_hz: float, order: int, highest_hz: float
) -> Float[np.ndarray, "sensors fewer"]:
    """Displacements differentiated, up to a frequency; other motion up to it."""
    if order == 0:
        rows = np.diff(rows) * rate_hz
    spectra = np.fft.rfft(rows)
    spectra[:, np.fft.rfftfreq(rows.shape[1], 1 / rate_hz) > highest_hz] = 0.0
    return np.fft.irfft(spectra, rows.shape[1])


def fault_of(row: Float[np.ndarray, " samples"]) -> str | None:
    """ "dead" if a channel never moves, "clipped" if it stands at its extremes, None if it is sound."""
    low, high = float(row.min()), float(row.max())
    if low == high:
        return "dead"
    stuck = max(np.mean(row == high), np.mean(row == low))
    return "clipped" if stuck > STUCK else None
