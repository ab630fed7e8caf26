"""Relation of a measured signal to a predicted one: gain, delay, coherence, and the gain over frequency."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

FACTORS = {
    "g instead of m/s^2, or the reverse": 9.80665,
    "thousandths (mm, kN, mV)": 1e3,
    "millionths": 1e6,
    "inches": 1 / 0.0254,
    "feet": 1 / 0.3048,
    "pounds": 4.4482216,
    "centimetres or Gal": 100.0,
    "root mean square for peak": float(np.sqrt(2)),
}
"""Usual mistakes of units; each may be made in either direction."""
NEAR = 0.03
"""A factor within this share of a usual one is taken for it."""
FOLLOWS = 0.5
"""A channel with a lower coherence with what the others predict does not follow the motion."""
LATEST_S = 0.1
BANDS = 10


@dataclass(frozen=True)
class Relation:
    """measured = gain predicted e^(-i omega delay), with what share of the measured power it explains."""

    gain: float
    delay_s: float
    coherence: float


def relation(
    omega: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, " lines"],
    predicted: Complex[np.ndarray, " lines"],
    weight: Float[np.ndarray, " lines"],
    latest_s: float = LATEST_S,
) -> Relation:
    """Relation at the delay of highest coherence; the gain has the sign that makes it positive there."""
    cross = predicted.conj() * measured * weight**2
    power = float(np.sum((np.abs(predicted) * weight) ** 2))
    own = float(np.sum((np.abs(measured) * weight) ** 2))
    if not (power > 0 and own > 0):
        return Relation(0.0, 0.0, 0.0)
    step_s = 0.25 * np.pi / float(omega[-1])
    late = step_s * np.arange(-int(latest_s / step_s), int(latest_s / step_s) + 1)
    sums = np.concatenate([(np.exp(1j * part[:, None] * omega) @ cross).real for part in np.array_split(late, 8)])
    best = int(np.argmax(np.abs(sums)))
    delay = late[best]
    for _ in range(4):  # of the real part's slope
        turned = np.exp(1j * delay * omega) * cross
        slope, bend = float(np.sum((1j * omega * turned).real)), float(np.sum((-(omega**2) * turned).real))
        if bend:
            delay -= float(np.clip(slope / bend, -step_s, step_s))
    total = float(np.sum((np.exp(1j * delay * omega) * cross).real))
    return Relation(total / power, float(delay), total**2 / (power * own))


def usual_factor(gain: float) -> str | None:
    """Mistake of units that makes a channel deliver this multiple."""
    for name, factor in FACTORS.items():
        if any(abs(abs(gain) * f - 1) < NEAR for f in (factor, 1 / factor)):
            return name
    return None


def bandwise(
    omega: Float[np.ndarray, " lines"],
    measured: Complex[np.ndarray, " lines"],
    expected: Complex[np.ndarray, " lines"],
    weight: Float[np.ndarray, " lines"],
) -> tuple[Complex[np.ndarray, " bands"], float, Float[np.ndarray, " bands"]]:
    """The complex gain in each band, what share of the power they leave, and the bands' middles."""
    edges = np.searchsorted(omega, np.geomspace(omega[0], omega[-1], BANDS + 1)[1:-1])
    bands = [p for p in np.split(np.arange(omega.size), edges) if p.size > 5]
    gains, left = [], 0.0
    for p in bands:
        of, by = measured[p] * weight[p], expected[p] * weight[p]
        gain = np.vdot(by, of) / max(float(np.vdot(by, by).real), 1e-300)
        gains.append(gain)
        left += float(np.sum(np.abs(of - gain * by) ** 2))
    whole = float(np.sum(np.abs(measured * weight) ** 2)) or 1.0
    return np.array(gains), left / whole, np.array([omega[p[p.size // 2]] for p in bands])
