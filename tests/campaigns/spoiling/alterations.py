"""Ways in which instruments, cables, clocks, rig.json and other programs spoil a recording."""

from collections.abc import Iterator

import numpy as np

from rig.model.description import Rig
from tests.campaigns.spoiling.alteration import Alteration
from tests.campaigns.spoiling.description import of_description
from tests.campaigns.spoiling.one_channel import of_one_channel
from tests.campaigns.spoiling.several_channels import of_clocks, of_processing, of_several, of_the_force


def alterations(rig: Rig, rng: np.random.Generator) -> Iterator[Alteration]:
    """All that a rig allows, each on channels that are drawn."""
    yield from of_one_channel(rig, rng)
    yield from of_several(rig, rng)
    yield from of_the_force(rig, rng)
    yield from of_clocks(rig)
    yield from of_description(rig, rng)
    yield from of_processing(rig)
