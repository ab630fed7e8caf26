"""Import map: which column of a file is which sensor, its unit, and its place where rig.json does not say it."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from msgspec.structs import replace

from rig.errors import RigError, hint
from rig.files import check_target
from rig.lab.csv_text import TextForm
from rig.model.description import Rig, Sensor, Station, read_rig
from rig.model.quantities import QuantityName
from rig.model.toml_file import read_toml
from rig.recording import RIG_NAME

PLACEHOLDER = "?"
"""Value that a proposed map leaves where only the owner knows it."""


class TimeSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Column of time stamps, by name or number from 1, with its unit (s if neither says one) and an extra factor."""

    column: str | int
    unit: str | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        _check_scale(self.column, self.scale)


class Source(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Column of a file, by name or number from 1, with its unit (if the file has none) and an extra factor.

    body and position_m place a sensor or force; without them rig.json does. quantity is that of a sensor which rig.json
    does not have. time is its own column of time, where that is not the map's.
    """

    column: str | int
    unit: str | None = None
    scale: float = 1.0
    quantity: QuantityName | None = None
    body: str | None = None
    position_m: float | None = None
    time: TimeSource | None = None

    @property
    def station(self) -> Station | None:
        """Place that the map gives; None if rig.json does."""
        return None if self.body is None else Station(self.body, self.position_m or 0.0)

    def __post_init__(self) -> None:
        if (self.body is None) != (self.position_m is None):
            raise RigError(f"column {self.column!r}: only one of body and position_m is given; give both or none")
        _check_scale(self.column, self.scale)


def _check_scale(column: str | int, scale: float) -> None:
    if not (np.isfinite(scale) and scale != 0):
        raise RigError(f"column {column!r}: scale is {scale}; give a finite value other than zero")


class Map(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Import map of measured data, a TOML file. rig is a path relative to the map's folder.

    force is a list if several act at once, in the order of rig.json, and "none" for a free decay without a force
    column. If any of the sensors has a place, the recording has the sensors of the map, and no others of rig.json.
    """

    rig: str = RIG_NAME
    force: Source | tuple[Source, ...] | Literal["none"]
    sensors: dict[str, Source]
    time: TimeSource | None = None
    sample_rate_hz: float | None = None
    resample: bool = False
    csv: TextForm = TextForm()

    def __post_init__(self) -> None:
        if self.time is not None and self.sample_rate_hz is not None:
            raise RigError("time and sample_rate_hz are both given; leave one out")
        if self.sample_rate_hz is not None and not 0 < self.sample_rate_hz < np.inf:
            raise RigError(f"sample_rate_hz is {self.sample_rate_hz}; give a value above zero")

    @property
    def columns(self) -> list[str | int]:
        """Columns of forces, sensors and times."""
        sources = (*self.forces, *self.sensors.values())
        times = (self.time, *(source.time for source in sources))
        return [source.column for source in (*sources, *times) if source is not None]

    @property
    def forces(self) -> tuple[Source, ...]:
        if isinstance(self.force, str):
            return ()
        return self.force if isinstance(self.force, tuple) else (self.force,)


def read_map(path: Path, out: Path) -> tuple[Map, Rig]:
    """Map, and its rig with the sensors and forces where the map places them.

    Raises RigError if a placeholder is left, if either file is invalid, or if their sensors or forces differ.
    """
    column_map = read_toml(path, Map, "map", "rig/lab/README.md", lambda map_values: _check_filled(path, map_values))
    rig_path = path.parent / column_map.rig
    check_target(out, rig_path)
    if not rig_path.exists():
        raise RigError(
            f"{rig_path}: cannot be opened (No such file or directory), and {path} names it as the description of the "
            f"machine; write it by `rig init` (rig init mass --help), or correct rig = {column_map.rig!r}"
        )
    try:
        return column_map, _placed_rig(column_map, read_rig(rig_path), path)
    except RigError as error:
        raise error if str(error).startswith((str(path), str(rig_path))) else RigError(f"{path}: {error}") from error


def _placed_rig(column_map: Map, rig: Rig, path: Path) -> Rig:
    forces = column_map.forces
    is_placed = bool(forces) and all(force.station for force in forces)
    if column_map.force != "none" and len(forces) != len(rig.forces) and not is_placed:
        raise RigError(
            f"{path}: force has {len(forces)} columns, and its rig.json {len(rig.forces)} forces; make them agree, or "
            "give each column body and position_m"
        )
    force_places = tuple(force.station or rig.forces[k if k < len(rig.forces) else 0] for k, force in enumerate(forces))
    force_places = force_places or rig.forces
    if any(source.body for source in column_map.sensors.values()):
        sensors = tuple(_mapped_sensor(name, source, rig) for name, source in column_map.sensors.items())
    else:
        sensors = rig.sensors
        rig_names, map_sensor_names = {sensor.name for sensor in sensors}, set(column_map.sensors)
        if differing := map_sensor_names - rig_names or rig_names - map_sensor_names:
            fault = "is no sensor of the rig" if map_sensor_names - rig_names else "is missing"
            raise RigError(
                f"{path}: sensor {min(differing)!r} {fault}; [sensors] needs {', '.join(sorted(rig_names))}, or give "
                "each column body, position_m and quantity"
            )
    if sensors == rig.sensors and force_places == rig.forces:
        return rig
    return replace(rig, sensors=sensors, force_at=force_places if len(force_places) > 1 else force_places[0])


def _mapped_sensor(name: str, source: Source, rig: Rig) -> Sensor:
    """Sensor of rig.json by this name, at the map's place if it gives one; or else a new one at that place.

    A new one has the noise that all sensors of its quantity in rig.json have in common.
    """
    described = next((sensor for sensor in rig.sensors if sensor.name == name), None)
    station, quantity = source.station, source.quantity
    if described is not None:
        if quantity not in (None, described.quantity):
            raise RigError(
                f"sensor {name!r} measures {described.quantity} in rig.json and {quantity} in the map; give it another "
                "name here"
            )
        return replace(described, station=station or described.station)
    if station is None:
        raise RigError(
            f"sensor {name!r} is no sensor of the rig{hint(name, [sensor.name for sensor in rig.sensors])}, and has "
            "no place; give it body, position_m and quantity"
        )
    if quantity is None:
        raise RigError(f"sensor {name!r} has a place and no quantity; give quantity = ..., e.g. acceleration")
    noise_densities = {sensor.noise_density for sensor in rig.sensors if sensor.quantity == quantity}
    noise_density = noise_densities.pop() if len(noise_densities) == 1 else 0.0
    return Sensor(name=name, station=station, quantity=quantity, noise_density=noise_density)


def _check_filled(path: Path, map_values: dict[str, Any]) -> None:
    """Raise RigError, with every entry, if placeholders are left in a map."""
    keys_by_entry: dict[str, list[str]] = {}
    for entry, key in _placeholders(map_values):
        keys_by_entry.setdefault(entry, []).append(key)
    if keys_by_entry:
        texts = (f"{_enumeration(keys)}{f' of {entry}' if entry else ''}" for entry, keys in keys_by_entry.items())
        count = sum(map(len, keys_by_entry.values()))
        raise RigError(
            f"{path}: {count} {'value is' if count == 1 else 'values are'} left to fill in, marked {PLACEHOLDER!r}: "
            f"{'; '.join(texts)}; a sensor that is not needed may be deleted"
        )


def _enumeration(words: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _placeholders(map_values: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Entry ("sensor 'acc'", "force", or empty for a value of its own) and key of every placeholder."""
    for key, value in map_values.items():
        if value == PLACEHOLDER:
            yield "", key
        elif key == "sensors" and isinstance(value, dict):
            for sensor_name, entry in value.items():
                yield from ((f"sensor {sensor_name!r}", entry_key) for entry_key in _placeholder_keys(entry))
        elif isinstance(value, list):
            for entry_number, entry in enumerate(value, start=1):
                yield from ((f"{key} {entry_number}", entry_key) for entry_key in _placeholder_keys(entry))
        else:
            yield from ((key, entry_key) for entry_key in _placeholder_keys(value))


def _placeholder_keys(entry: object) -> list[str]:
    if isinstance(entry, dict):
        keys = [key for key, value in entry.items() if value == PLACEHOLDER and key != "column"]
        nested_keys = (
            [f"{k} of {key}" for k in _placeholder_keys(v)] for key, v in entry.items() if isinstance(v, dict)
        )
        return [*keys, *chain.from_iterable(nested_keys)]
    return ["column"] if entry == PLACEHOLDER else []
