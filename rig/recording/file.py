"""Recordings in memory, and reading them from MCAP files: the interface between rig and identify.

`rig.recording.writer` writes the files.
"""

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

from rig.errors import RigError, one_line
from rig.model.description import (
    UNITS,
    Rig,
    Sensor,
    Station,
    check_shapes_known,
    contact_rows,
    from_json,
    rig_stations,
)
from rig.model.sensing import quantities_of, sensors_of
from rig.recording import container, messages
from rig.recording.assembly import SampleAssembly
from rig.recording.channels import Channels, check_channels, from_metadata
from rig.recording.foreign import PROVENANCE, RIG_NAME
from rig.recording.messages import Block

TRUTH_SUFFIX = ".truth.mcap"
"""Suffix of a truth file, which holds what only a simulator knows."""
RECORDED = "recorded"
"""Key of the provenance: the date at which the record begins, in ISO 8601."""


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
    """Name of the sensor, or of the force."""
    unit: str
    """SI unit of the values."""
    station: Station | None
    """Place on a body; None where the channel has no single one."""
    time_s: Float[np.ndarray, " samples"]
    """Time of each sample, s."""
    values: Float[np.ndarray, " samples"]
    """Samples, in `unit`."""

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype, copy=copy)

    def to_pandas(self) -> Any:
        """Pandas Series over the time in seconds; needs the package pandas."""
        from pandas import Index, Series

        return Series(self.values, Index(self.time_s, name="time_s"), name=f"{self.name}, {self.unit}")


@dataclass(frozen=True)
class Recording:
    """Nominal rig, signals of its sensors by group, and provenance of a record."""

    rig: Rig
    """Nominal rig: the machine as its owner believes it."""
    signals: Mapping[str, Signals]
    """Channels of one quantity as a matrix, by the quantity's name: force, acceleration, ..."""
    provenance: Mapping[str, str]
    """Origin and processing steps of the record."""

    def __getitem__(self, name: str) -> Channel:
        """Channel of that name; raises RigError if there is none."""
        channel_by_name = {}
        for signals in self.signals.values():
            channels = signals.channels
            for channel_name, station, samples in zip(channels.names, channels.stations, signals.values, strict=True):
                channel_by_name[channel_name] = Channel(channel_name, channels.unit, station, signals.time_s, samples)
        if name not in channel_by_name:
            raise RigError(f"the recording has no channel {name!r}; it has {', '.join(channel_by_name)}")
        return channel_by_name[name]

    def to_pandas(self) -> Any:
        """Pandas DataFrame of all channels over the time in seconds, a column "NAME, UNIT" each; needs pandas."""
        from pandas import concat

        channel_names = [name for signals in self.signals.values() for name in signals.channels.names]
        return concat([self[name].to_pandas() for name in channel_names], axis=1)

    def values_of(self, sensor: Sensor) -> Float[np.ndarray, " samples"]:
        """Samples of a sensor of the rig."""
        signals = self.signals[sensor.quantity]
        return signals.values[signals.channels.names.index(sensor.name)]

    @property
    def forces_n(self) -> Float[np.ndarray, "forces samples"]:
        """Samples of every force, N."""
        return self.signals["force"].values

    @property
    def force_names(self) -> tuple[str, ...]:
        """Channel names of the forces."""
        return self.signals["force"].channels.names

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        """Samples of the only force, N; raises RigError if several act at once."""
        if len(self.forces_n) > 1:
            raise RigError(f"the recording has {len(self.forces_n)} forces at once, where one is taken; see forces_n")
        return self.forces_n[0]

    @property
    def samples(self) -> int:
        """Number of samples of every channel."""
        return self.forces_n.shape[1]

    @property
    def start_s(self) -> float:
        """Time of the first sample, s; above zero in a segment of a longer record, which does not begin at rest."""
        return self.signals["force"].start_s

    @property
    def end_s(self) -> float:
        """Time after the last sample, s."""
        return self.start_s + self.duration_s

    @property
    def duration_s(self) -> float:
        """Length of the record, s."""
        return self.samples / self.rig.sample_rate_hz


def recorded_at(provenance: Mapping[str, str]) -> datetime | None:
    """Date at which a record begins, in UTC; None where it is unknown."""
    try:
        start_date = datetime.fromisoformat(provenance[RECORDED])
        return start_date.astimezone(UTC) if start_date.tzinfo else start_date.replace(tzinfo=UTC)
    except (KeyError, ValueError, OverflowError):
        return None


def _force_channels(rig: Rig) -> Channels:
    return Channels("force", UNITS["force"], rig.force_names, rig.forces, rig.sample_rate_hz)


def channel_groups(rig: Rig) -> dict[str, Channels]:
    """Channels by group of a recording of this rig."""
    channels_by_group = {"force": _force_channels(rig)}
    for quantity in quantities_of(rig):
        sensors = sensors_of(rig, quantity)
        sensor_names, stations = tuple(sensor.name for sensor in sensors), tuple(sensor.station for sensor in sensors)
        channels_by_group[quantity] = Channels(quantity, UNITS[quantity], sensor_names, stations, rig.sample_rate_hz)
    return channels_by_group


def truth_groups(rig: Rig) -> dict[str, Channels]:
    """Channels by group of the truth file: signals that only a simulator has."""
    stations = rig_stations(rig)
    contact_names = tuple(contact.name for contact in contact_rows(rig))
    rate_hz = rig.sample_rate_hz
    station_names = tuple(station.label for station in stations)
    no_station_per_contact = (None,) * len(contact_names)
    return {
        "force": _force_channels(rig),
        "displacement": Channels("displacement", "m", station_names, stations, rate_hz),
        "relative_displacement": Channels("relative displacement", "m", contact_names, no_station_per_contact, rate_hz),
        "contact_force": Channels("contact force", "N", contact_names, no_station_per_contact, rate_hz),
    }


def read(path: Path) -> Recording:
    """Whole recording in a file, checked.

    Raises RigError with one sentence if the file is no recording, is cut or damaged, has no rig.json or no force
    channel, has a gap in its samples, or holds values that are not finite.
    """
    recording = _load(path)
    check_shapes_known(recording.rig, f"{path}: {RIG_NAME}")
    channels_by_group = {group_name: signals.channels for group_name, signals in recording.signals.items()}
    check_channels(path, recording.rig, channels_by_group, channel_groups(recording.rig))
    return recording


def read_truth(path: Path) -> Recording:
    """Truth file of a simulated recording, with the groups of `truth_groups`. Not for identification."""
    return _load(path)


def with_processing_steps(provenance: Mapping[str, str], *steps: str) -> dict[str, str]:
    """Provenance with further processing steps, one numbered entry each."""
    earlier_count = sum(key.startswith("history ") for key in provenance)
    return {**provenance, **{f"history {earlier_count + number}": step for number, step in enumerate(steps, start=1)}}


def truth_path(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(".mcap") + TRUTH_SUFFIX)


def recordings_in(folder: Path) -> list[Path]:
    """Recordings in a folder: its .mcap files except truth files."""
    return [path for path in folder.glob("*.mcap") if not path.name.endswith(TRUTH_SUFFIX)]


@dataclass(frozen=True)
class FileContents:
    """Content of a file except the blocks of samples; of the attachments, only rig.json keeps its data."""

    attachments: dict[str, bytes] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    channels_by_group: dict[str, Channels] = field(default_factory=dict)
    foreign_topics: dict[str, str] = field(default_factory=dict)
    """Encoding of the messages of topics that are no rig's."""

    @property
    def is_foreign(self) -> bool:
        """True if it is of another recorder: without rig.json and a rig's signals, with other topics."""
        return bool(self.foreign_topics) and not self.channels_by_group and RIG_NAME not in self.attachments


def has_sample_blocks(channel: ChannelRecord) -> bool:
    topic_parts = channel.topic.split("/")
    return len(topic_parts) == 4 and topic_parts[1] == "rig" and topic_parts[3] == "block"


def blocks_with_group_names(
    records: Iterable[McapRecord], contents: FileContents
) -> Iterator[tuple[str, messages.Block]]:
    """Every block of samples with the name of its group; all other records are collected in `contents`.

    The values of a block are valid until the next one is requested. Raises ValueError or RigError, without the name of
    the file, if a record is wrong, an attachment or an entry of the provenance is given twice, or a block's time does
    not follow from its first sample.
    """
    group_by_channel_id: dict[int, str] = {}
    channel_by_id: dict[int, ChannelRecord] = {}
    time_stamps = TimeStampCheck()
    for record in records:
        if isinstance(record, ChannelRecord) and (earlier := channel_by_id.setdefault(record.id, record)) != record:
            raise ValueError(f"channel {record.id} is described in two ways: {earlier.topic} and {record.topic}")
        if isinstance(record, Attachment):
            if record.name in contents.attachments:
                raise RigError(f"more than one attachment is named {record.name!r}; keep the one that is meant")
            contents.attachments[record.name] = record.data if record.name == RIG_NAME else b""
        elif isinstance(record, Metadata) and record.name == PROVENANCE:
            _add_provenance(record, contents)
        elif isinstance(record, ChannelRecord) and record.id not in group_by_channel_id and has_sample_blocks(record):
            group_name = record.topic.split("/")[2]
            group_by_channel_id[record.id] = group_name
            contents.channels_by_group[group_name] = from_metadata(record.topic, record.metadata)
        elif isinstance(record, ChannelRecord) and not record.topic.startswith("/rig/"):
            contents.foreign_topics[record.topic] = record.message_encoding
        elif isinstance(record, Message) and record.channel_id in group_by_channel_id:
            group_name, block = group_by_channel_id[record.channel_id], messages.decode_block(record.data)
            time_stamps.check(group_name, contents.channels_by_group[group_name].sample_rate_hz, block)
            yield group_name, block


def _add_provenance(record: Metadata, contents: FileContents) -> None:
    for key, entry in record.metadata.items():
        if contents.provenance.setdefault(key, entry) != entry:
            raise RigError(f"the provenance gives {key!r} twice; keep the one that is meant")


def rig_of(path: Path, contents: FileContents) -> Rig:
    if contents.is_foreign:
        raise RigError(f"{path}: {_foreign_sentence(contents)}")
    if RIG_NAME not in contents.attachments:
        raise RigError(
            f"{path}: has no attachment {RIG_NAME}; add the description of the rig (see rig/recording/README.md)"
        )
    return from_json(contents.attachments[RIG_NAME], f"{path}: {RIG_NAME}")


def _foreign_sentence(contents: FileContents) -> str:
    topics = [f"{topic} ({encoding or 'no encoding'})" for topic, encoding in contents.foreign_topics.items()]
    listed_topics = ", ".join(topics[:6]) + (f" and {len(topics) - 6} more" if len(topics) > 6 else "")
    topics_text = f"topics: {listed_topics or 'none is whole'}"
    return one_line(
        f"is an MCAP file of another recorder, without {RIG_NAME} ({topics_text}); export their numbers with their "
        "times to CSV, as PlotJuggler does, and import that by `rig import`"
    )


def check_is_no_mcap(path: Path) -> None:
    """Raise RigError, which says what an MCAP file holds, where a file of measured data is asked for."""
    if path.suffix.lower() != ".mcap":
        return
    contents = FileContents()
    with container.open_recording(path) as file:
        for record in container.undamaged_records(file):
            if isinstance(record, ChannelRecord) and not has_sample_blocks(record):
                contents.foreign_topics[record.topic] = record.message_encoding
            elif isinstance(record, ChannelRecord) or (isinstance(record, Attachment) and record.name == RIG_NAME):
                raise RigError(f"{path}: is a recording already, which needs no import; see `rig info {path}`")
    raise RigError(f"{path}: {_foreign_sentence(contents)}")


def _load(path: Path) -> Recording:
    contents, assemblies = FileContents(), dict[str, SampleAssembly]()
    with container.open_recording(path) as file:
        max_value_count = path.stat().st_size // 8
        blocks = blocks_with_group_names(container.records_of_complete_file(file, has_sample_blocks), contents)
        for group_name, block in container.with_path_in_error(path, blocks):
            if group_name not in assemblies:
                group_channels = contents.channels_by_group
                capacity = max_value_count // sum(len(channels.names) for channels in group_channels.values())
                assemblies[group_name] = SampleAssembly(path, group_name, group_channels[group_name], capacity=capacity)
            assemblies[group_name].add(block)
    nominal_rig = rig_of(path, contents)
    signals = {
        group_name: Signals(channels, *assemblies.get(group_name, SampleAssembly(path, group_name, channels)).finish())
        for group_name, channels in contents.channels_by_group.items()
    }
    if "force" not in signals:
        raise RigError(f"{path}: has no channel /rig/force/block; record the exciting force too")
    sample_counts = {group_name: group_signals.values.shape[1] for group_name, group_signals in signals.items()}
    if len(set(sample_counts.values())) > 1:
        raise RigError(f"{path}: its groups differ in length ({sample_counts}); every group needs the same samples")
    return Recording(nominal_rig, signals, contents.provenance)


TOLERANCE_SAMPLES, TOLERANCE_NS = 0.5, 1000.0
"""A time stamp may be off by half a sample, or a microsecond if that is more."""


class TimeStampCheck:
    """Check of time stamps: t0 = t(k) - k / f of the first block must hold for every block of every group."""

    def __init__(self) -> None:
        self._start_ns: float | None = None
        self._first_group = ""

    def check(self, group_name: str, sample_rate_hz: float, block: Block) -> None:
        """Raise RigError, without the name of the file, if a block's time does not follow from its first sample."""
        first_sample_time_ns = block.first_sample * 1e9 / sample_rate_hz
        if self._start_ns is None:
            self._start_ns, self._first_group = block.time_ns - first_sample_time_ns, group_name
        expected_ns = self._start_ns + first_sample_time_ns
        if not abs(block.time_ns - expected_ns) <= max(TOLERANCE_NS, TOLERANCE_SAMPLES * 1e9 / sample_rate_hz):
            raise RigError(
                f"group {group_name}: sample {block.first_sample} is stamped {block.time_ns * 1e-9:.9g} s where "
                f"{expected_ns * 1e-9:.9g} s follows from its number, {sample_rate_hz:g} Hz and the first block (of "
                f"group {self._first_group}); stamp every block with first_sample / sample_rate_hz, or record again"
            )
