"""How exactly the rig's description is believed: what a laboratory never knows exactly."""

import msgspec


class Tolerances(msgspec.Struct, frozen=True, kw_only=True):
    """Standard deviations of sensor gains (relative), positions (m), natural frequencies and damping (relative)."""

    gain: float
    position_m: float
    frequency: float
    damping: float


LABORATORY = Tolerances(gain=1.2e-3, position_m=0.6e-3, frequency=1e-3, damping=0.12)
"""A carefully built rig: gains within 0.2 %, stations within 1 mm, E within 0.3 %, damping within 20 %, uniformly."""
EXACT = Tolerances(gain=0.0, position_m=0.0, frequency=0.0, damping=0.0)
"""The description holds exactly: a simulation of the very rig."""
NAMED = {"laboratory": LABORATORY, "exact": EXACT}
