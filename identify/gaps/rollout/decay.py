"""A free decay compared by the frequencies and damping ratios of its modes, measured and predicted from the blow on."""

from collections.abc import Sequence

import numpy as np

from identify.gaps.rollout.results import DecayMode
from identify.signals.ringing import RingingMode

SAME = 0.2
"""A predicted mode is the measured one if their frequencies differ by a smaller share."""


def compared_modes(
    measured: Sequence[RingingMode], nominal: Sequence[RingingMode], corrected: Sequence[RingingMode]
) -> tuple[DecayMode, ...]:
    """Each measured mode with the nearest of the predicted ones."""

    def nearest(mode: RingingMode, among: Sequence[RingingMode]) -> tuple[float, float] | None:
        best = min(among, key=lambda one: abs(np.log(one.frequency_hz / mode.frequency_hz)), default=None)
        if best is None or abs(best.frequency_hz / mode.frequency_hz - 1) > SAME:
            return None
        return best.frequency_hz, best.damping_ratio

    return tuple(
        DecayMode(
            measured=(mode.frequency_hz, mode.damping_ratio),
            nominal=nearest(mode, nominal),
            corrected=nearest(mode, corrected),
        )
        for mode in measured
    )
