"""The channels of a group, and how an MCAP file tells what they are: as the metadata of its MCAP channel."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

from rig.errors import RigError
from rig.limits import unique_keys
from rig.model.description import Station, check_name

_JSON = ("names", "stations", "sample_rate_hz")


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
    if missing := [key for key in ("quantity", "unit", *_JSON) if key not in metadata]:
        raise RigError(f"the metadata of channel {topic} lack {missing[0]!r}; see rig/recording/README.md")
    try:
        names = tuple(str(n) for n in json.loads(metadata["names"]))
        places = json.loads(metadata["stations"], object_pairs_hook=unique_keys)
        stations = tuple(None if p is None else Station(str(p["body"]), float(p["position_m"])) for p in places)
        for name in names:
            check_name("channel", name)
        rate = float(json.loads(metadata["sample_rate_hz"]))
        if not names or len(names) != len(stations) or len(set(names)) < len(names) or not 0 < rate < math.inf:
            raise RigError(
                f"{len(names)} names ({len(set(names))} different), {len(stations)} stations and {rate:g} Hz; give "
                "each channel a name of its own and a station or null, and a rate above zero"
            )
    except RigError as error:
        raise RigError(f"the metadata of channel {topic} cannot be used: {error}") from error
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise RigError(
            f"the metadata of channel {topic} cannot be read: give {', '.join(_JSON)} as JSON, as "
            "rig/recording/README.md says"
        ) from error
    return Channels(metadata["quantity"], metadata["unit"], names, stations, rate)
