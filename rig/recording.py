"""A recording and its MCAP file: the only thing that passes between rig and identify. Sole owner of the layout."""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from jaxtyping import Float
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata
from mcap.writer import CompressionType, Writer

from rig import container, messages
from rig.description import UNITS, Rig, Station, from_json, stations_of, to_json
from rig.errors import CutOffError, RigError
from rig.sensors import quantities_of, sensors_of

BLOCK = 1024
CHUNK_BYTES = 128 * 1024
PREVIEW_HZ = 100.0
RIG_NAME = "rig.json"


@dataclass(frozen=True)
class Channels:
    """The channels of one group: same quantity, same clock. `stations` is None where a channel has no single place."""

    quantity: str
    unit: str
    names: tuple[str, ...]
    stations: tuple[Station | None, ...]
    sample_rate_hz: float


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
class Recording:
    """A rig as its owner believes it to be, what its sensors delivered, and where the record comes from."""

    rig: Rig
    signals: Mapping[str, Signals]
    provenance: Mapping[str, str]

    @property
    def force_n(self) -> Float[np.ndarray, " samples"]:
        return self.signals["force"].values[0]

    @property
    def samples(self) -> int:
        return self.force_n.size

    @property
    def duration_s(self) -> float:
        return self.samples / self.rig.sample_rate_hz


class RecordingWriter:
    """Appends samples group by group and stores them as blocks of 1024 samples, with a decimated preview beside."""

    def __init__(
        self, stream: IO[bytes], rig: Rig, groups: Mapping[str, Channels], provenance: Mapping[str, str]
    ) -> None:
        self._stream = stream
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4, enable_data_crcs=True)
        self._writer.start(profile="", library="rig")
        self._writer.add_attachment(0, 0, RIG_NAME, "application/json", to_json(rig))
        self._writer.add_metadata("provenance", dict(provenance))
        stream.flush()
        block = self._writer.register_schema(messages.BLOCK_NAME, "protobuf", messages.BLOCK_SCHEMA)
        preview = self._writer.register_schema(messages.PREVIEW_NAME, "ros2msg", messages.PREVIEW_SCHEMA)
        self._groups = dict(groups)
        self._ids = {
            name: (
                self._writer.register_channel(f"/rig/{name}/block", "protobuf", block, _described(group)),
                self._writer.register_channel(f"/rig/{name}/preview", "cdr", preview, _described(group)),
            )
            for name, group in groups.items()
        }
        self._pending = {name: np.zeros((len(group.names), 0)) for name, group in groups.items()}
        self._written = dict.fromkeys(groups, 0)

    def append(self, group: str, values: Float[np.ndarray, "channels samples"]) -> None:
        pending = np.concatenate([self._pending[group], values], axis=1)
        whole = pending.shape[1] // BLOCK * BLOCK
        for first in range(0, whole, BLOCK):
            self._write(group, pending[:, first : first + BLOCK])
        self._pending[group] = pending[:, whole:]
        self._stream.flush()  # a kill loses nothing but the chunk in the making

    def finish(self) -> None:
        """Writes what is left, and the index: from here on the file is complete."""
        for group, rest in self._pending.items():
            if rest.shape[1]:
                self._write(group, rest)
        self._writer.finish()

    def _write(self, group: str, values: Float[np.ndarray, "channels samples"]) -> None:
        channels, first = self._groups[group], self._written[group]
        time_ns = round(first / channels.sample_rate_hz * 1e9)
        block_id, preview_id = self._ids[group]
        data = messages.encode_block(time_ns, first, channels.sample_rate_hz, values)
        self._writer.add_message(block_id, time_ns, data, time_ns, first // BLOCK)
        stride = max(1, round(channels.sample_rate_hz / PREVIEW_HZ))
        for k in range(0, values.shape[1], stride):
            moment_ns = round((first + k) / channels.sample_rate_hz * 1e9)
            mean = values[:, k : k + stride].mean(axis=1)  # a look for people, not for computing
            self._writer.add_message(preview_id, moment_ns, messages.encode_preview(mean), moment_ns)
        self._written[group] += values.shape[1]


@contextmanager
def writing(
    path: Path, rig: Rig, groups: Mapping[str, Channels], provenance: Mapping[str, str]
) -> Iterator[RecordingWriter]:
    """A writer for a recording at `path`, which appears there only when it is complete.

    An interruption (Ctrl-C) completes the file with what was written so far. A full disk leaves what was written under
    the name FILE.part, as a kill does, for rig.recovery. Any other error removes it.
    """
    part = container.part_of(path)
    try:
        with part.open("wb") as stream:
            writer = RecordingWriter(stream, rig, groups, provenance)
            try:
                yield writer
            except KeyboardInterrupt:
                writer.finish()
                stream.flush()
                part.replace(path)
                raise
            writer.finish()
    except (OSError, CutOffError) as error:  # CutOffError: the disk failed another file of the same recording
        why = error.strerror or str(error)
        if not part.exists():
            raise RigError(f"{path}: cannot be written ({why}); choose another place") from error
        sentence = f"{path}: cannot be written to its end ({why}); make room and save what there is: rig recover {part}"
        raise CutOffError(sentence, why) from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    part.replace(path)


def channel_groups(rig: Rig) -> dict[str, Channels]:
    """The channels that a recording of this rig has."""
    groups = {"force": Channels("force", UNITS["force"], ("force",), (rig.force_at,), rig.sample_rate_hz)}
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
        "force": Channels("force", "N", ("force",), (rig.force_at,), rate),
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
    _check_against(path, recording)
    return recording


def read_truth(path: Path) -> Recording:
    """The truth file of a simulated recording: its groups are those of `truth_groups`. Not for identification."""
    return _loaded(path)


def with_history(provenance: Mapping[str, str], *steps: str) -> dict[str, str]:
    """The provenance with what was done to the record since, one numbered entry a step."""
    done = sum(key.startswith("history ") for key in provenance)
    return {**provenance, **{f"history {done + k}": step for k, step in enumerate(steps, start=1)}}


def truth_path(path: Path) -> Path:
    return path.with_name(path.name.removesuffix(".mcap") + ".truth.mcap")


@dataclass(frozen=True)
class Contents:
    """What the records of a file hold: the blocks of every group in the order of the file."""

    attachments: dict[str, bytes]
    provenance: dict[str, str]
    groups: dict[str, Channels]
    blocks: dict[str, list[messages.Block]]


def gathered(records: Iterable[McapRecord]) -> Contents:
    """Sorts the records of a file; raises ValueError or RigError, without the name of the file, if one is wrong."""
    found = Contents({}, {}, {}, {})
    numbers: dict[int, str] = {}
    for record in records:
        if isinstance(record, Attachment):
            found.attachments[record.name] = record.data
        elif isinstance(record, Metadata) and record.name == "provenance":
            found.provenance.update(record.metadata)
        elif isinstance(record, Channel) and record.id not in numbers:
            parts = record.topic.split("/")
            if len(parts) == 4 and parts[1] == "rig" and parts[3] == "block":
                numbers[record.id] = parts[2]
                found.groups[parts[2]] = _understood(record.topic, record.metadata)
                found.blocks[parts[2]] = []
        elif isinstance(record, Message) and record.channel_id in numbers:
            found.blocks[numbers[record.channel_id]].append(messages.decode_block(record.data))
    return found


def rig_of(path: Path, contents: Contents) -> Rig:
    if RIG_NAME not in contents.attachments:
        raise RigError(f"{path}: has no attachment {RIG_NAME}; add the description of the rig (see the README)")
    return from_json(contents.attachments[RIG_NAME], f"{path}: {RIG_NAME}")


def _loaded(path: Path) -> Recording:
    with container.opened(path) as content:
        try:
            contents = gathered(container.whole(content))
        except RigError as error:
            raise RigError(f"{path}: {error}") from error
        except container.DAMAGE as error:
            state = "damaged" if isinstance(error, ValueError) else "cut off or damaged"
            reason = str(error) or type(error).__name__
            raise RigError(f"{path}: is {state} ({reason}); try `rig recover`, or restore a copy") from error
    rig = rig_of(path, contents)
    signals = {name: assembled(path, name, group, contents.blocks[name]) for name, group in contents.groups.items()}
    if "force" not in signals:
        raise RigError(f"{path}: has no channel /rig/force/block; record the exciting force too")
    lengths = {name: s.values.shape[1] for name, s in signals.items()}
    if len(set(lengths.values())) > 1:
        raise RigError(f"{path}: its groups differ in length ({lengths}); every group needs the same samples")
    return Recording(rig, signals, contents.provenance)


def assembled(path: Path, name: str, channels: Channels, blocks: list[messages.Block]) -> Signals:
    """The samples of a group in one piece; raises RigError if there is a gap, or a value that is not finite."""
    blocks = sorted(blocks, key=lambda b: b.first_sample)
    expected = 0
    for block in blocks:
        if block.first_sample != expected:
            raise RigError(
                f"{path}: group {name} has samples {expected} to {block.first_sample} missing or doubled; "
                "record it again"
            )
        if block.values.shape[0] != len(channels.names) or block.sample_rate_hz != channels.sample_rate_hz:
            raise RigError(f"{path}: a block of group {name} does not fit its channel's metadata; see the README")
        expected += block.values.shape[1]
    if not expected:
        raise RigError(f"{path}: group {name} holds no samples; record it again")
    values = np.concatenate([b.values for b in blocks], axis=1)
    if not np.isfinite(values).all():
        row, sample = np.argwhere(~np.isfinite(values))[0]
        raise RigError(
            f"{path}: channel {channels.names[row]!r} is not a finite number at sample {sample} "
            f"({sample / channels.sample_rate_hz:.4f} s); repair or leave out that channel"
        )
    return Signals(channels, blocks[0].time_ns * 1e-9, values)


def _check_against(path: Path, recording: Recording) -> None:
    rig, signals = recording.rig, recording.signals
    believed = {s.name: s for s in rig.sensors}
    for name, signal in signals.items():
        if signal.channels.sample_rate_hz != rig.sample_rate_hz:
            raise RigError(
                f"{path}: group {name} is sampled at {signal.channels.sample_rate_hz} Hz, "
                f"{RIG_NAME} says {rig.sample_rate_hz} Hz; make them agree"
            )
        if name not in quantities_of(rig):
            continue
        for channel, station in zip(signal.channels.names, signal.channels.stations, strict=True):
            if channel not in believed or believed[channel].station != station:
                raise RigError(
                    f"{path}: channel {channel!r} of group {name} is no sensor of {RIG_NAME}, or stands elsewhere "
                    "there; make them agree"
                )
    for sensor in rig.sensors:
        if sensor.quantity not in signals or sensor.name not in signals[sensor.quantity].channels.names:
            raise RigError(f"{path}: sensor {sensor.name!r} of {RIG_NAME} has no channel; record it or take it out")


def _described(channels: Channels) -> dict[str, str]:
    """A group as MCAP channel metadata (values are JSON)."""
    places = [None if s is None else {"body": s.body, "position_m": s.position_m} for s in channels.stations]
    return {
        "quantity": channels.quantity,
        "unit": channels.unit,
        "sample_rate_hz": json.dumps(channels.sample_rate_hz),
        "names": json.dumps(channels.names),
        "stations": json.dumps(places),
    }


def _understood(topic: str, metadata: Mapping[str, str]) -> Channels:
    try:
        names = tuple(str(n) for n in json.loads(metadata["names"]))
        places = json.loads(metadata["stations"])
        stations = tuple(None if p is None else Station(str(p["body"]), float(p["position_m"])) for p in places)
        rate = float(json.loads(metadata["sample_rate_hz"]))
        if len(names) != len(stations) or not rate > 0:
            raise ValueError(f"{len(names)} names, {len(stations)} stations, {rate} Hz")
        return Channels(metadata["quantity"], metadata["unit"], names, stations, rate)
    except (KeyError, TypeError, ValueError) as error:
        raise RigError(f"the metadata of channel {topic} cannot be read ({error!r}); see the README") from error
