"""Functions that a package offers to `identify` by entry points: simulators, and predictors from measured states."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from rig.model.description import Rig, Station
from rig.recording import Recording

Simulate = Callable[[Rig, Rig, Float[np.ndarray, "forces samples"], int], Recording]
"""Recording of the actual rig (second) under a measured force, in the channels of the nominal rig (first), with noise
from a seed; as `rig.simulation.replay.modal`."""
Predict = Callable[
    [
        Rig,
        Float[np.ndarray, "forces samples"],
        Int[np.ndarray, " windows"],
        int,
        tuple[Station, ...],
        Float[np.ndarray, "windows 2 stations"],
    ],
    Float[np.ndarray, "windows 2 stations times"],
]
"""Displacement and velocity at stations over a number of samples, of a rig under the measured forces from the states at
the first sample of each window; arguments are rig, forces, starts, samples, stations, states; as
`rig.simulation.prediction.modal`."""
