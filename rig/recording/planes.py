"""The part of a recording in space that belongs to one of its two plane rigs."""

from dataclasses import replace

import numpy as np

from rig.model.description import Direction
from rig.model.space import in_plane
from rig.recording.file import Recording, Signals, channel_groups


def plane_recording(recording: Recording, direction: Direction) -> Recording:
    """Recording of the plane rig of one direction (`in_plane`): its sensors, and the forces in that direction.

    Where no force acts in the direction, the force's channel is zero. A plane recording is its own.
    """
    rig = recording.rig
    if not rig.in_space:
        return recording
    plane_rig = in_plane(rig, direction)
    channels_by_group = {
        name: channels for name, channels in channel_groups(plane_rig).items() if name in recording.signals
    }
    signals = {}
    for name, channels in channels_by_group.items():
        channels_in_space = recording.signals[name]
        if name == "force":
            channel_rows = [k for k, station in enumerate(rig.forces) if station.direction == direction]
        else:
            channel_rows = [channels_in_space.channels.names.index(channel_name) for channel_name in channels.names]
        channel_values = (
            channels_in_space.values[channel_rows] if channel_rows else np.zeros((1, channels_in_space.values.shape[1]))
        )
        signals[name] = Signals(channels, channels_in_space.start_s, channel_values)
    return replace(recording, rig=plane_rig, signals=signals)
