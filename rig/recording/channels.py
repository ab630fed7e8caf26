"""The channels of a group, and how an MCAP file tells what they are: as the metadata of its MCAP channel."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

from rig.errors import RigError
from rig.limits import unique_keys
from rig.model.description import Station, check_name


@dataclass(frozen=True)
class Channels:
    """The channels of one group: same quantity, same clock. `stations` is None where a channel has no single place."""

    quantity: str
    unit: str
    names: tuple[str, ...]
    stations: tuple[Station | None, ...]
    sample_rate_hz: float


def described(channels: Channels) -> dict[str, str]:
    """A group as MCAP channel metadata (values are JSON)."""
    places = [None if s is None else {"body": s.body, "position_m": s.position_m} for s in channels.stations]
    return {
        "quantity": channels.quantity,
        "unit": channels.unit,
        "sample_rate_hz": json.dumps(channels.sample_rate_hz),
        "names": json.dumps(channels.names),
        "stations": json.dumps(places),
    }


def understood(topic: str, metadata: Mapping[str, str]) -> Channels:
    try:
        names = tuple(str(n) for n in json.loads(metadata["names"]))
        places = json.loads(metadata["stations"], object_pairs_hook=unique_keys)
        stations = tuple(None if p is None else Station(str(p["body"]), float(p["position_m"])) for p in places)
        for name in names:
            check_name("channel", name)
        rate = float(json.loads(metadata["sample_rate_hz"]))
        if not names or len(names) != len(stations) or len(set(names)) < len(names) or not 0 < rate < math.inf:
            raise ValueError(f"{len(names)} names, {len(stations)} stations, {rate} Hz")
        return Channels(metadata["quantity"], metadata["unit"], names, stations, rate)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RigError(
            f"the metadata of channel {topic} cannot be read ({error!r}); see rig/recording/README.md"
        ) from error
