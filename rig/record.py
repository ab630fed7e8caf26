"""Recording a rig: force, plant, sensors and file in one go."""

import importlib.metadata
from pathlib import Path

import numpy as np

from rig.description import Rig
from rig.excitation import Excitation, force_history
from rig.motion import Plant, Progress
from rig.recording import channel_groups, truth_groups, truth_path, writing
from rig.sensors import digitised, needed_duration_s


def record(
    rig: Rig,
    excitation: Excitation,
    *,
    plant: Plant,
    duration_s: float,
    step_s: float,
    path: Path,
    progress: Progress,
) -> None:
    """Simulates the rig and writes the recording to `path` and what only a simulator knows to the truth file beside.

    The plant runs a little longer than duration_s, as the anti-aliasing filter needs samples on both sides. The
    sensors' noise comes from the excitation's seed. Raises RigError where the rig cannot be simulated so or the file
    not written.
    """
    samples = round(duration_s * rig.sample_rate_hz)
    force = force_history(excitation, needed_duration_s(rig, samples / rig.sample_rate_hz), step_s)
    plant_name = getattr(plant, "__module__", "").rsplit(".", 1)[-1]
    provenance = {
        "made_by": "rig record",
        "plant": plant_name,
        "step_s": repr(step_s),
        "excitation": repr(excitation),
        "seed": str(excitation.seed),
        **{f"version of {name}": importlib.metadata.version(name) for name in ("rig-identify", "exudyn", "numpy")},
    }
    rng = np.random.default_rng([excitation.seed, 1])
    written = 0
    with (
        writing(path, rig, channel_groups(rig), provenance) as recording,
        writing(truth_path(path), rig, truth_groups(rig), provenance) as truth,
    ):
        for block in digitised(rig, plant(rig, force, step_s, progress), rng):
            keep = slice(0, samples - written)
            for group, values in {"force": block.force_n[None, :], **block.sensed}.items():
                recording.append(group, values[:, keep])
            for group, values in {"force": block.force_n[None, :], **block.truth}.items():
                truth.append(group, values[:, keep])
            written += block.force_n[keep].size
