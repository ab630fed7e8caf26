"""The Silverbox benchmark's record as recordings of a one-mass rig: where it comes from, its parts, its units."""

from importlib import import_module
from pathlib import Path

import numpy as np
from jaxtyping import Float

from rig.errors import RigError
from rig.model.description import Rig
from rig.model.oscillator import Oscillator
from rig.recording import Recording, Signals, channel_groups, read, writing

FILE = "SNLS80mV.csv"
SAMPLE_RATE_HZ = 610.35
SAMPLES = 131072
FORCE_N_PER_V, DISPLACEMENT_M_PER_V = 1e4, 0.1
"""What a volt of the input and one of the output stand for: these make a rig of half a kilogram that moves by 5 mm."""
ARROW, FIT, VALIDATION = slice(0, 40575), slice(40575, 84000), slice(84000, 127400)
"""Noise that grows; then ten multisines, of which one half is for searching and the other for deciding."""
MILLIVOLTS = 1e3 / DISPLACEMENT_M_PER_V


def measured(folder: Path | None) -> Float[np.ndarray, "2 samples"]:
    """Input and output, V, all of the record; raises RigError where it is not to be had."""
    if folder is not None:
        path = folder / FILE
        try:
            volts = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 1)).T
        except OSError as error:
            raise RigError(f"{path}: cannot be opened ({error.strerror}); give the folder that holds it") from error
        except ValueError as error:
            raise RigError(f"{path}: is not the benchmark's file ({error}); fetch it again") from error
    else:
        try:
            nonlinear_benchmarks = import_module("nonlinear_benchmarks")
        except ImportError as error:
            raise RigError(
                f"no data: give --data FOLDER with {FILE}, or pip install nonlinear_benchmarks, which fetches it"
            ) from error
        try:
            whole = nonlinear_benchmarks.Silverbox(train_test_split=False)
        except Exception as error:  # whatever a download raises
            raise RigError(
                f"nonlinear_benchmarks could not fetch the data ({error}); give --data FOLDER with {FILE}"
            ) from error
        volts = np.stack([whole.u, whole.y])
    if volts.shape[1] != SAMPLES:
        raise RigError(f"{FILE}: has {volts.shape[1]} samples instead of {SAMPLES}; give the benchmark's own file")
    return volts


def recording_of(rig: Rig, signals: Float[np.ndarray, "2 samples"]) -> Recording:
    """Of a force (N) and a displacement (m)."""
    rows = zip(channel_groups(rig).items(), signals, strict=True)
    named = {name: Signals(channels, 0.0, row[None]) for (name, channels), row in rows}
    return Recording(rig, named, {"source": f"Silverbox benchmark, {FILE}"})


def displacement_m(recording: Recording) -> Float[np.ndarray, " samples"]:
    return recording.signals["displacement"].values[0]


def mass_of(rig: Rig) -> Oscillator:
    (body,) = rig.bodies
    assert isinstance(body, Oscillator)
    return body


def written(recording: Recording, path: Path) -> Recording:
    """What is read back from the file."""
    with writing(path, recording.rig, channel_groups(recording.rig), recording.provenance) as file:
        for name, signals in recording.signals.items():
            file.append(name, signals.values)
    return read(path)
