"""Recordings as SEP005 channels, the dictionaries by which the packages of SDyPy exchange time series."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.errors import RigError
from rig.lab.column import Column
from rig.lab.importing import import_columns
from rig.recording import Recording

QUANTITY_LETTERS = {"force": "f", "displacement": "d", "velocity": "v", "acceleration": "a", "strain": "e"}


def to_sep005(recording: Recording) -> list[dict[str, Any]]:
    """Dictionary per channel: data in SI, name, unit_str, fs in Hz, quantity and group."""
    return [
        {
            "data": samples,
            "name": channel_name,
            "unit_str": signals.channels.unit,
            "fs": signals.channels.sample_rate_hz,
            "quantity": QUANTITY_LETTERS.get(group),
            "group": group,
        }
        for group, signals in recording.signals.items()
        for channel_name, samples in zip(signals.channels.names, signals.values, strict=True)
    ]


def import_sep005(
    channels: Sequence[Mapping[str, Any]] | Mapping[str, Any], map_path: Path, out: Path
) -> tuple[str, ...]:
    """Write a recording of SEP005 channels by a map, as `import_file` does, and return the processing steps.

    A channel is called by its name; the time stamps of one without fs are the column NAME time. Raises RigError with
    one sentence if a channel is none, or the map, the rig or the data cannot be used; nothing is written then.
    """
    channel_list = [channels] if isinstance(channels, Mapping) else list(channels)
    columns = [
        column
        for channel_number, channel in enumerate(channel_list, start=1)
        for column in _columns_of_channel(channel, channel_number)
    ]
    return import_columns(columns, "SEP005 channels", map_path, out)


def _columns_of_channel(channel: Mapping[str, Any], channel_number: int) -> list[Column]:
    missing_keys = [key for key in ("data", "name", "unit_str") if key not in channel]
    if missing_keys or not {"fs", "time"} & set(channel):
        raise RigError(
            f"channel {channel_number} of SEP005 lacks {missing_keys[0] if missing_keys else 'fs or time'!r}; add it"
        )
    name, unit, rate_hz = str(channel["name"]), str(channel["unit_str"]) or None, channel.get("fs")
    try:
        values = np.asarray(channel["data"], dtype=float).reshape(-1)
        stamps_s = None if rate_hz else np.asarray(channel["time"], dtype=float).reshape(-1)
        column = Column(name, values, unit, float(rate_hz) if rate_hz else None)
    except (TypeError, ValueError) as error:
        raise RigError(f"channel {name!r} of SEP005 is not of numbers ({error}); correct it") from error
    return [column] if stamps_s is None else [Column(f"{name} time", stamps_s, "s"), column]
