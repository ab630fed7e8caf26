"""The channels of a group: as metadata of an MCAP channel, and their agreement with rig.json."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.errors import RigError
from rig.limits import dict_with_unique_keys
from rig.model.description import Rig, Station, check_name

_JSON_TEXT_KEYS = ("names", "stations", "sample_rate_hz")


@dataclass(frozen=True)
class Channels:
    """The channels of one group: same quantity, same clock. `stations` is None where a channel has no single place."""

    quantity: str
    unit: str
    names: tuple[str, ...]
    stations: tuple[Station | None, ...]
    sample_rate_hz: float


def to_metadata(channels: Channels) -> dict[str, str]:
    """MCAP channel metadata of a group; lists and numbers as JSON."""
    station_objects = [None if station is None else _station_json(station) for station in channels.stations]
    return {
        "quantity": channels.quantity,
        "unit": channels.unit,
        "sample_rate_hz": json.dumps(channels.sample_rate_hz),
        "names": json.dumps(channels.names),
        "stations": json.dumps(station_objects),
    }


def _station_json(station: Station) -> dict[str, str | float]:
    station_json: dict[str, str | float] = {"body": station.body, "position_m": station.position_m}
    return station_json if station.direction == "y" else station_json | {"direction": station.direction}


def _station_from_json(value: Mapping[str, Any]) -> Station:
    return Station(str(value["body"]), float(value["position_m"]), value.get("direction", "y"))


def from_metadata(topic: str, metadata: Mapping[str, str]) -> Channels:
    """Group described by MCAP channel metadata; raises RigError if they are incomplete or inconsistent."""
    if missing_keys := [key for key in ("quantity", "unit", *_JSON_TEXT_KEYS) if key not in metadata]:
        raise RigError(f"the metadata of channel {topic} lack {missing_keys[0]!r}; see rig/recording/README.md")
    try:
        names = tuple(str(json_name) for json_name in json.loads(metadata["names"]))
        station_values = json.loads(metadata["stations"], object_pairs_hook=dict_with_unique_keys)
        stations = tuple(
            None if station_json is None else _station_from_json(station_json) for station_json in station_values
        )
        for channel_name in names:
            check_name("channel", channel_name)
        rate_hz = float(json.loads(metadata["sample_rate_hz"]))
        if not names or len(names) != len(stations) or len(set(names)) < len(names) or not 0 < rate_hz < math.inf:
            raise RigError(
                f"{len(names)} names ({len(set(names))} different), {len(stations)} stations and {rate_hz:g} Hz; give "
                "each channel a name of its own and a station or null, and a rate above zero"
            )
    except RigError as error:
        raise RigError(f"the metadata of channel {topic} cannot be used: {error}") from error
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RigError(
            f"the metadata of channel {topic} cannot be read: give {', '.join(_JSON_TEXT_KEYS)} as JSON, as "
            "rig/recording/README.md says"
        ) from error
    return Channels(metadata["quantity"], metadata["unit"], names, stations, rate_hz)


def check_channels(
    path: Path, rig: Rig, channels_by_group: Mapping[str, Channels], expected_by_group: Mapping[str, Channels]
) -> None:
    """Raise RigError unless all groups have the rig's sampling rate and the expected ones hold its sensors in SI.

    `expected_by_group` are those of a recording of this rig (`channel_groups`); others are only checked for the rate.
    """
    sensor_by_name = {sensor.name: sensor for sensor in rig.sensors}
    for group_name, channels in channels_by_group.items():
        if channels.sample_rate_hz != rig.sample_rate_hz:
            raise RigError(
                f"{path}: group {group_name} is sampled at {channels.sample_rate_hz} Hz, "
                f"rig.json says {rig.sample_rate_hz} Hz; make them agree"
            )
        if group_name not in expected_by_group:
            continue
        expected_unit = expected_by_group[group_name].unit
        if (channels.quantity, channels.unit) != (group_name, expected_unit):
            raise RigError(
                f"{path}: group {group_name} holds {channels.quantity!r} in {channels.unit!r}; write {group_name} in "
                f"{expected_unit}"
            )
        if group_name == "force":
            station_pairs = zip(channels.stations, rig.forces, strict=False)
            if len(channels.names) != len(rig.forces) or any(
                measured_station not in (None, believed_station) for measured_station, believed_station in station_pairs
            ):
                force_words = f"one at {rig.force_at}" if len(rig.forces) == 1 else f"{len(rig.forces)} at {rig.forces}"
                raise RigError(
                    f"{path}: group force has the channels {channels.names} at {channels.stations}, rig.json "
                    f"{force_words}; make them agree"
                )
            continue
        for channel_name, station in zip(channels.names, channels.stations, strict=True):
            if channel_name not in sensor_by_name or sensor_by_name[channel_name].station != station:
                raise RigError(
                    f"{path}: channel {channel_name!r} of group {group_name} is no sensor of rig.json, or stands "
                    "elsewhere there; make them agree"
                )
    for sensor in rig.sensors:
        if sensor.quantity not in channels_by_group or sensor.name not in channels_by_group[sensor.quantity].names:
            raise RigError(f"{path}: sensor {sensor.name!r} of rig.json has no channel; record it or take it out")
