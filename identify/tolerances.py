"""How exactly the rig's description is believed: what a laboratory never knows exactly."""

import msgspec
import numpy as np

from rig.description import Body, Rig, Station
from rig.oscillator import Oscillator


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


def jittered(rig: Rig, rng: np.random.Generator) -> Rig:
    """The rig with E off by up to 0.3 %, damping by 20 %, sensor stations by 1 mm and gains by 0.2 %, all uniform.

    Sensors at one station move together, as they sit on one block; on a beam's end they move inwards.
    """
    bodies = tuple(_body(body, rng) for body in rig.bodies)
    moved = {
        station: Station(
            station.body, float(np.clip(station.position_m + rng.uniform(-1e-3, 1e-3), 0, _length(rig, station)))
        )
        for station in dict.fromkeys(s.station for s in rig.sensors)
    }
    sensors = tuple(
        msgspec.structs.replace(s, station=moved[s.station], gain=s.gain * (1 + rng.uniform(-2e-3, 2e-3)))
        for s in rig.sensors
    )
    return msgspec.structs.replace(rig, bodies=bodies, sensors=sensors)


def _body(body: Body, rng: np.random.Generator) -> Body:
    """All frequencies of a beam or a structure go with the root of E."""
    damped = body.damped(1 + rng.uniform(-0.2, 0.2))
    if isinstance(body, Oscillator):
        return damped.tuned(1 + rng.uniform(-1.5e-3, 1.5e-3))
    return damped.tuned(float(np.sqrt(1 + rng.uniform(-3e-3, 3e-3))))


def _length(rig: Rig, station: Station) -> float:
    return rig.body(station.body).length_m
