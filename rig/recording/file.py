"""A recording, and its MCAP file read: the only thing that passes between rig and identify. `writer` writes it."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from mcap.records import Attachment, McapRecord, Message, Metadata
from mcap.records import Channel as ChannelRecord
from numpy.typing import DTypeLike

from rig.errors import RigError
from rig.model.description import UNITS, Rig, Sensor, Station, check_given, from_json, stations_of
from rig.model.sensing import quantities_of, sensors_of
from rig.recording import container, messages
from rig.recording.agreement import check_channels
from rig.recording.assembly import Assembly
from rig.recording.channels import Channels, understood
from rig.recording.clock import Clock
from rig.recording.foreign import PROVENANCE, RIG_NAME

TRUTH = ".truth.mcap"
"""How the name of a file ends that holds what only a simulator knows."""
RECORDED = "recorded"
"""In the provenance: the date at which the record begins, in ISO 8601."""


@dataclass(frozen=True)
class Signals:
    """Channels with their samples; sample k was taken at start_s + k / sample_rate."""

    channels: Channels
    start_s: float
    values: Float[np.ndarray, "channels samples"]

    @property
    def time_s(self) -> Float[np.ndarray, " samples"]:
        return self.start_s + np.arange(self.values.shape[1]) / self.channels.sample_rate_hz


@dataclass(frozen=True)
class Channel:
    """One channel: an array with its name, unit, place and times. numpy takes it for its values."""

    name: str
    unit: str
    station: Station | None
    time_s: Float[np.ndarray, " samples"]
    values: Float[np.ndarray, " samples"]

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype, copy=copy)

    def to_pandas(self) -> Any:
        """A pandas Series over the time in seconds; needs the package pandas."""
        from pandas import Index, Series

        return Series(self.values, Index(self.time_s, name="time_s"), name=f"{self.name}, {self.unit}")


@dataclass(frozen=True)
class Recording:
    """A rig as its owner believes it to be, what its sensors delivered, and where the record comes from."""

    rig: Rig
    signals: Mapping[str, Signals]
    provenance: Mapping[str, str]

    def __getitem__(self, name: str) -> Channel:
        """The channel of that name; raises RigError if there is none."""
        known = {}
        for signals in self.signals.values():
            about = signals.channels
            for one, station, row in zip(about.names, about.stations, signals.values, strict=True):
                known[one] = Channel(one, about.unit, station, signals.time_s, row)
        if name not in known:
            raise RigError(f"the recording has no channel {name!r}; it has {', '.join(known)}")
        return known[name]

    def values_of(self, sensor: Sensor) -> Float[np.ndarray, " samples"]:
        """Values that a sensor of the rig delivered."""
        signals = self.signals[sensor.quantity]
        return signals.values[signals.channels.names.index(sensor.name)]

    @property
    def forces_n(self) -> Float[np.ndarray, "forces samples"]:
        return self.signals["force"].values

    @property
    def force_names(self) -> tuple[str, ...]:
        return self.signals["force"].channels.names

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """The force; raises RigError if several act at once."""
        if len(self.forces_n) > 1:
            raise RigError(f"the recording has {len(self.forces_n)} forces at once, where one is taken; see forces_n")
        return self.forces_n[0]

    @property
    def samples(self) -> int:
        return self.forces_n.shape[1]

    @property
    def start_s(self) -> float:
        """Above zero in a segment of a longer record, which does not begin at rest."""
        return self.signals["force"].start_s

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s

    @property
    def duration_s(self) -> float:
        return self.samples / self.rig.sample_rate_hz


def recorded_at(provenance: Mapping[str, str]) -> datetime | None:
    """The date at which a record begins, in UTC; None where it is not known."""
    try:
        began = datetime.fromisoformat(provenance[RECORDED])
        return began.astimezone(UTC) if began.tzinfo else began.replace(tzinfo=UTC)
    except (KeyError, ValueError, OverflowError):
        return None


def _forces(rig: Rig) -> Channels:
    return Channels("force", UNITS["force"], rig.force_names, rig.forces, rig.sample_rate_hz)


def channel_groups(rig: Rig) -> dict[str, Channels]:
    """The channels that a recording of this rig has."""
    groups = {"force": _forces(rig)}
    for quantity in quantities_of(rig):
        sensors = sensors_of(rig, quantity)
        groups[quantity] = Channels(
            quantity,
            UNITS[quantity],
            tuple(s.name for s in sensors),
            tuple(s.station for s in sensors),
            rig.sample_rate_hz,
        )
    return groups


def truth_groups(rig: Rig) -> dict[str, Channels]:
    """The channels of the truth file: what only a simulator knows."""
    stations, contacts, rate = stations_of(rig), tuple(c.name for c in rig.contacts), rig.sample_rate_hz
    names = tuple(f"{s.body}_{round(s.position_m * 1000):04d}mm" for s in stations)
    nowhere = (None,) * len(contacts)
    return {
        "force": _forces(rig),
        "displacement": Channels("displacement", "m", names, stations, rate),
        "relative_displacement": Channels("relative displacement", "m", contacts, nowhere, rate),
        "contact_force": Channels("contact force", "N", contacts, nowhere, rate),
    }


def read(path: Path) -> Recording:
    """The recording in a file, all of it, checked.

    Raises RigError with one sentence if the file is no recording, is cut or damaged, has no rig.json or no force
    channel, has a gap in its samples, or holds values that are not finite.
    """
    recording = _loaded(path)
    check_given(recording.rig, f"{path}: {RIG_NAME}")
    check_channels(
        path, recording.rig, {n: s.channels for n, s in recording.signals.items()}, channel_groups(recording.rig)
    )
    return recording


def read_truth(path: Path) -> Recording:
    """The truth file of a simulated recording: its groups are those of `truth_groups`. Not for identification."""
    return _loaded(path)


def with_history(provenance: Mapping[str, str], *steps: str) -> dict[str, str]:
    """The provenance with what was done to the record since, one numbered entry a step."""
    done = sum(key.startswith("history ") for key in provenance)
    return {**provenance, **{f"history {done + k}": step for k, step in enumerate(steps, start=1)}}


def truth_path(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(".mcap") + TRUTH)


def recordings_in(folder: Path) -> list[Path]:
    """Recordings of a folder: its .mcap files without those of a simulator's truth."""
    return [path for path in folder.glob("*.mcap") if not path.name.endswith(TRUTH)]


@dataclass(frozen=True)
class Contents:
    """Content of a file's records beside the blocks of every group; of the attachments rig.json alone is kept."""

    attachments: dict[str, bytes] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    groups: dict[str, Channels] = field(default_factory=dict)


def is_of_blocks(channel: ChannelRecord) -> bool:
    parts = channel.topic.split("/")
    return len(parts) == 4 and parts[1] == "rig" and parts[3] == "block"


def gathering(records: Iterable[McapRecord], found: Contents) -> Iterator[tuple[str, messages.Block]]:
    """Sorts the records of a file into what is given, and yields every block with the name of its group.

    Its values are there until the next is asked for. Raises ValueError or RigError, without the name of the file, if a
    record is wrong, an attachment or an entry of the provenance is given twice, or a block's time is not that of its
    samples.
    """
    numbers: dict[int, str] = {}
    channels: dict[int, ChannelRecord] = {}
    clock = Clock()
    for record in records:
        if isinstance(record, ChannelRecord) and (before := channels.setdefault(record.id, record)) != record:
            raise ValueError(f"channel {record.id} is described in two ways: {before.topic} and {record.topic}")
        if isinstance(record, Attachment):
            if record.name in found.attachments:
                raise RigError(f"more than one attachment is named {record.name!r}; keep the one that is meant")
            found.attachments[record.name] = record.data if record.name == RIG_NAME else b""
        elif isinstance(record, Metadata) and record.name == PROVENANCE:
            _add_provenance(record, found)
        elif isinstance(record, ChannelRecord) and record.id not in numbers and is_of_blocks(record):
            group = record.topic.split("/")[2]
            numbers[record.id] = group
            found.groups[group] = understood(record.topic, record.metadata)
        elif isinstance(record, Message) and record.channel_id in numbers:
            group, block = numbers[record.channel_id], messages.decode_block(record.data)
            clock.check(group, found.groups[group].sample_rate_hz, block)
            yield group, block


def _add_provenance(record: Metadata, found: Contents) -> None:
    for key, value in record.metadata.items():
        if found.provenance.setdefault(key, value) != value:
            raise RigError(f"the provenance gives {key!r} twice; keep the one that is meant")


def rig_of(path: Path, contents: Contents) -> Rig:
    if RIG_NAME not in contents.attachments:
        raise RigError(
            f"{path}: has no attachment {RIG_NAME}; add the description of the rig (see rig/recording/README.md)"
        )
    return from_json(contents.attachments[RIG_NAME], f"{path}: {RIG_NAME}")


def _loaded(path: Path) -> Recording:
    contents, held = Contents(), dict[str, Assembly]()
    with container.opened(path) as file:
        doubles = path.stat().st_size // 8
        for name, block in container.with_path_in_error(path, gathering(container.whole(file, is_of_blocks), contents)):
            if name not in held:
                room = doubles // sum(len(group.names) for group in contents.groups.values())
                held[name] = Assembly(path, name, contents.groups[name], room=room)
            held[name].add(block)
    rig = rig_of(path, contents)
    signals = {
        name: Signals(group, *held.get(name, Assembly(path, name, group)).finished())
        for name, group in contents.groups.items()
    }
    if "force" not in signals:
        raise RigError(f"{path}: has no channel /rig/force/block; record the exciting force too")
    lengths = {name: s.values.shape[1] for name, s in signals.items()}
    if len(set(lengths.values())) > 1:
        raise RigError(f"{path}: its groups differ in length ({lengths}); every group needs the same samples")
    return Recording(rig, signals, contents.provenance)
