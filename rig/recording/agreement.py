"""Agreement of a recording's channels with its rig.json."""

from collections.abc import Mapping
from pathlib import Path

from rig.errors import RigError
from rig.model.description import Rig
from rig.recording.channels import Channels


def check_channels(path: Path, rig: Rig, found: Mapping[str, Channels], expected: Mapping[str, Channels]) -> None:
    """Raises RigError unless every group is of the rig's rate, and those expected hold its sensors, in place and in SI.

    `expected` are the groups that a recording of the rig has; others are let be.
    """
    believed = {s.name: s for s in rig.sensors}
    for name, about in found.items():
        if about.sample_rate_hz != rig.sample_rate_hz:
            raise RigError(
                f"{path}: group {name} is sampled at {about.sample_rate_hz} Hz, "
                f"rig.json says {rig.sample_rate_hz} Hz; make them agree"
            )
        if name not in expected:
            continue
        unit = expected[name].unit
        if (about.quantity, about.unit) != (name, unit):
            raise RigError(f"{path}: group {name} holds {about.quantity!r} in {about.unit!r}; write {name} in {unit}")
        if name == "force":
            places = zip(about.stations, rig.forces, strict=False)
            if len(about.names) != len(rig.forces) or any(at not in (None, believed_at) for at, believed_at in places):
                said = f"one at {rig.force_at}" if len(rig.forces) == 1 else f"{len(rig.forces)} at {rig.forces}"
                raise RigError(
                    f"{path}: group force has the channels {about.names} at {about.stations}, rig.json {said}; make "
                    "them agree"
                )
            continue
        for channel, station in zip(about.names, about.stations, strict=True):
            if channel not in believed or believed[channel].station != station:
                raise RigError(
                    f"{path}: channel {channel!r} of group {name} is no sensor of rig.json, or stands elsewhere "
                    "there; make them agree"
                )
    for sensor in rig.sensors:
        if sensor.quantity not in found or sensor.name not in found[sensor.quantity].names:
            raise RigError(f"{path}: sensor {sensor.name!r} of rig.json has no channel; record it or take it out")
