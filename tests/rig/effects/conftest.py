"""Both plants, and short runs of the reference rigs through them."""

import numpy as np
import pytest

from rig.simulation.motion import concatenated
from rig.simulation.plants import PLANTS, plant_named


@pytest.fixture(params=PLANTS)
def run(request):
    """Simulates a rig with one plant."""

    def simulate(rig, force_n, step_s):
        return concatenated(plant_named(request.param)(rig, np.asarray(force_n, dtype=float), step_s, lambda _: None))

    return simulate
