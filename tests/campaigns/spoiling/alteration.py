"""One way to spoil a recording, with what a check has to say of it."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.checks.findings import Cause
from rig.model.description import Rig, Sensor, Station
from rig.recording import Recording, Signals
from rig.recording.channels import Channels

G = 9.80665
Row = Float[np.ndarray, " samples"]
Change = Callable[[Recording], Recording]


@dataclass(frozen=True)
class Alteration:
    """What is done to a recording. A finding names it if it is of one of `causes` and names one of `channels` or `of`.

    Without channels and body any finding of such a cause does.
    """

    name: str
    change: Change
    causes: frozenset[Cause]
    channels: tuple[str, ...] = ()
    of: tuple[str, ...] = ()
    group: str = field(default="instruments")


def with_rows(recording: Recording, rows: Mapping[str, Row]) -> Recording:
    """The recording with some channels changed; all may be of another length, if all are given."""
    signals = {}
    for group, old in recording.signals.items():
        values = np.stack([rows.get(n, v) for n, v in zip(old.channels.names, old.values, strict=True)])
        signals[group] = Signals(old.channels, old.start_s, values)
    return Recording(recording.rig, signals, recording.provenance)


def mapped(names: tuple[str, ...], change: Callable[[Row], Row]) -> Change:
    """Some channels, each by the same function; the force is "force"."""
    return lambda recording: with_rows(recording, {n: change(recording[n].values) for n in names})


def with_rig(change: Callable[[Rig], Rig]) -> Change:
    """Another rig.json with the same channels."""

    def changed(recording: Recording) -> Recording:
        rig = change(recording.rig)
        believed = {s.name: s.station for s in rig.sensors}
        signals = {
            group: Signals(
                _placed(
                    s, tuple(believed.get(n, p) for n, p in zip(s.channels.names, s.channels.stations, strict=True))
                ),
                s.start_s,
                s.values,
            )
            for group, s in recording.signals.items()
        }
        return Recording(rig, signals, recording.provenance)

    return changed


def _placed(signals: Signals, stations: tuple[Station | None, ...]) -> Channels:
    return dataclasses.replace(signals.channels, stations=stations)


def with_sensors(change: Callable[[Sensor], Sensor]) -> Change:
    return with_rig(lambda rig: replace(rig, sensors=tuple(change(s) for s in rig.sensors)))


def delayed(row: Row, seconds: float, rate_hz: float) -> Row:
    """By a linear phase, with silence behind."""
    length = 2 * row.size
    omega = 2 * np.pi * np.fft.rfftfreq(length, 1 / rate_hz)
    return np.asarray(np.fft.irfft(np.fft.rfft(row, length) * np.exp(-1j * omega * seconds), length)[: row.size])
