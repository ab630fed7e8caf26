"""Measured data: recordings of a force and a displacement, free runs under measured forces, and their simulator."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.gaps.decision.answer import Simulator
from rig.model.description import Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals, channel_groups, read, writing
from rig.simulation import prediction
from rig.simulation.plants.modal import simulate as modal
from rig.simulation.replay import replayed_recording

STEPS_PER_SAMPLE = 8
"""Steps of the plant `modal` in a sample of the recording, whose force is interpolated by a cubic."""


def one_mass_rig(
    name: str, mass: Oscillator, sample_rate_hz: float, sensor: str = "displacement", **components: Any
) -> Rig:
    """Rig of one mass with a force and a displacement sensor on it, and other components by their fields of `Rig`."""
    station = Station(mass.name)
    return Rig(
        name=name,
        bodies=(mass,),
        force_at=station,
        sensors=(Sensor(name=sensor, station=station, quantity="displacement"),),
        sample_rate_hz=sample_rate_hz,
        **{"contacts": ()} | components,
    )


def recording_of(rig: Rig, signals: Iterable[Float[np.ndarray, " samples"]], source: str) -> Recording:
    """Recording of one force (N) and one displacement (m), in this order."""
    groups = zip(channel_groups(rig).items(), signals, strict=True)
    signals_by_group = {name: Signals(channels, 0.0, row[None]) for (name, channels), row in groups}
    return Recording(rig, signals_by_group, {"source": source})


def write_and_read(recording: Recording, path: Path) -> Recording:
    """Recording as it reads from the file that it is written to."""
    with writing(path, recording.rig, channel_groups(recording.rig), recording.provenance) as file:
        for name, signals in recording.signals.items():
            file.append(name, signals.values)
    return read(path)


def simulated(nominal: Rig, actual: Rig, force_n: Float[np.ndarray, " samples"], seed: int) -> Recording:
    """Recording of the actual rig from rest under a measured force; it states the rig `nominal`."""
    return replayed_recording(nominal, actual, force_n, modal, 1 / (STEPS_PER_SAMPLE * nominal.sample_rate_hz), seed)


def free_run(rig: Rig, force_n: Float[np.ndarray, " samples"]) -> Recording:
    """Recording of a rig from rest under a measured force, without the sensors' noise."""
    silent_rig = replace(rig, sensors=tuple(replace(sensor, noise_density=0.0) for sensor in rig.sensors))
    return simulated(silent_rig, silent_rig, force_n, 1)


SIMULATOR = Simulator("measured data", simulated, prediction.modal)
