"""Free runs of rigs under measured forces, and the simulator of a diagnosis of measured data."""

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.gaps.decision.answer import Simulator
from rig.model.description import Rig
from rig.recording import Recording
from rig.simulation import prediction
from rig.simulation.plants.modal import simulate as modal
from rig.simulation.replay import replayed_recording

STEPS_PER_SAMPLE = 8
"""Steps of the plant `modal` in a sample of the recording, whose force is interpolated by a cubic."""


def simulated(nominal: Rig, actual: Rig, force_n: Float[np.ndarray, " samples"], seed: int) -> Recording:
    """The recording, with the rig `nominal` in it, that the actual rig makes from rest under a measured force."""
    return replayed_recording(nominal, actual, force_n, modal, 1 / (STEPS_PER_SAMPLE * nominal.sample_rate_hz), seed)


def free_run(rig: Rig, force_n: Float[np.ndarray, " samples"]) -> Recording:
    """The motion of a rig from rest under a measured force, without the sensors' noise."""
    silent = replace(rig, sensors=tuple(replace(s, noise_density=0.0) for s in rig.sensors))
    return simulated(silent, silent, force_n, 1)


SIMULATOR = Simulator("measured data", simulated, prediction.modal)
