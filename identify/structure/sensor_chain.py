"""What is not known exactly of a sensor's chain: how its gain, its delay and its high-pass change what it delivers."""

from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from rig.model.description import Sensor
from rig.model.tolerances import Tolerances

ChainKind = Literal["gain", "delay", "high-pass"]


def chain_sensitivities(
    sensor: Sensor, tolerances: Tolerances, omega: Float[np.ndarray, " lines"]
) -> dict[ChainKind, Complex[np.ndarray, " lines"]]:
    """The relative change of what a sensor delivers by one tolerance each of its gain g, its delay tau, and the corner
    w of a first-order high-pass i omega / (i omega + w) that an AC-coupled one has: g, -i omega tau, -w / (i omega + w)
    """
    own, turning = tolerances.of_sensor(sensor.name), 1j * omega
    corner = 2 * np.pi * own.high_pass_hz if sensor.measures.ac_coupled else 0.0
    return {
        "gain": np.full(omega.size, own.gain, dtype=complex),
        "delay": -own.delay_s * turning,
        "high-pass": -corner / (turning + corner) if corner else np.zeros_like(turning),
    }
