"""Which channel does not fit the others, and in which way."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Cause, Finding
from identify.checks.spectra import Spectra

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
BANDS = 8


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
    """By the delay of highest coherence; the gain has the sign that makes it positive at that delay."""
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
    """Which mistake of units makes a channel deliver so many times too much."""
    for name, factor in FACTORS.items():
        if any(abs(abs(gain) * f - 1) < NEAR for f in (factor, 1 / factor)):
            return name
    return None


def channel_finding(
    spectra: Spectra,
    channel: int,
    predicted: Complex[np.ndarray, "sensors lines"],
    weight: Float[np.ndarray, " lines"],
) -> Finding:
    """The likeliest reason why a channel is not what all others predict; predicted is of every station."""
    sensor, measured, omega = spectra.sensors[channel], spectra.acceleration[channel], spectra.omega
    own = relation(omega, measured, predicted[channel], weight)
    others = {
        k: relation(omega, measured, predicted[k], weight, 0.0) for k in range(len(spectra.sensors)) if k != channel
    }
    turned = {n: relation(omega, measured * (1j * omega) ** -n, predicted[channel], weight, 0.0) for n in (-2, -1, 1, 2)}
    place, there = max(others.items(), key=lambda one: one[1].coherence, default=(channel, own))
    order, differs = max(turned.items(), key=lambda one: one[1].coherence)
    missing = 1 - own.coherence
    name = sensor.name
    if there.coherence > 0.9 and 1 - there.coherence < 0.3 * missing and 0.8 < abs(there.gain) < 1.25:
        other = spectra.sensors[place]
        return Finding(
            cause="station",
            channels=(name,),
            evidence=f"{name} shows the motion at {other.station.position_m:g} m of {other.station.body} "
            f"({100 * there.coherence:.4g} % of its power), not that of its station",
            mend=f"check its place, its cable and its column; it may be a copy of {other.name} or swapped with it",
        )
    if differs.coherence > 0.8 and 1 - differs.coherence < 0.3 * missing:
        what = {1: "differentiated", 2: "differentiated twice", -1: "integrated", -2: "integrated twice"}[order]
        return Finding(
            cause="derivative",
            channels=(name,),
            evidence=f"{name} is the motion that the others predict, {what} ({100 * differs.coherence:.4g} % of it)",
            mend="correct its quantity in rig.json and in the import map",
        )
    if own.coherence < FOLLOWS:
        return Finding(
            cause="unrelated",
            channels=(name,),
            evidence=f"{name} follows {100 * max(own.coherence, 0):.2g} % of what all other channels predict there",
            mend="check its cable, its mounting and which column it was imported from, or take it out of rig.json",
        )
    if missing > 0.05 and (fall := _filtered(spectra, channel, predicted[channel], weight)):
        return Finding(cause="filtered", channels=(name,), evidence=f"{name} {fall}", mend="undo its filter")
    return _simple(name, own, f"{name}", sensor.quantity)


def _simple(name: str, own: Relation, subject: str, quantity: str) -> Finding:
    """Sign, gain or delay."""
    says = "the linear model and all other channels"
    if own.gain < 0:
        return Finding(
            cause="polarity",
            channels=(name,),
            evidence=f"{subject} has the opposite sign of what {says} predict (gain {own.gain:.4g})",
            mend="turn it with scale = -1 in the import map",
        )
    units = usual_factor(own.gain)
    if units or abs(own.gain - 1) > 0.3:
        return Finding(
            cause="units" if units else "gain",
            channels=(name,),
            evidence=f"{subject} delivers {own.gain:.4g} times what {says} predict",
            mend=f"correct its unit or scale in the import map, it looks like {units}" if units else "correct its gain",
        )
    if abs(own.delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=(name,),
            evidence=f"{subject} comes {1e3 * abs(own.delay_s):.3g} ms {'late' if own.delay_s > 0 else 'early'} "
            f"against what {says} predict",
            mend=f"set delay_s = {own.delay_s:.3g} in rig.json, or synchronise its clock",
        )
    return Finding(
        cause="gain",
        channels=(name,),
        evidence=f"{subject} delivers {own.gain:.4g} times what {says} predict",
        mend=f"calibrate it again, or set gain = {own.gain:.4g}",
    )


def _filtered(
    spectra: Spectra,
    channel: int,
    predicted: Complex[np.ndarray, " lines"],
    weight: Float[np.ndarray, " lines"],
) -> str | None:
    """How a filter changes the channel over frequency, if one does: coherent in every band, with a gain that falls."""
    parts = np.array_split(np.arange(spectra.omega.size), BANDS)
    found = [
        relation(spectra.omega[p], spectra.acceleration[channel][p], predicted[p], weight[p], 0.02) for p in parts
    ]
    if min(r.coherence for r in found) < 0.7:
        return None
    gains = np.array([abs(r.gain) for r in found])
    if gains.max() < 1.3 * gains.min():
        return None
    low, high = (spectra.omega[p[len(p) // 2]] / (2 * np.pi) for p in (parts[0], parts[-1]))
    return f"passes {100 * gains[0]:.3g} % of the predicted motion at {low:.3g} Hz and {100 * gains[-1]:.3g} % at {high:.3g} Hz"


def force_finding(
    spectra: Spectra, implied: Complex[np.ndarray, " lines"], weight: Float[np.ndarray, " lines"]
) -> Finding:
    """What is wrong with the measured force, by the force that all sensors imply."""
    own = relation(spectra.omega, spectra.force, implied, weight)
    if own.coherence < FOLLOWS:
        return Finding(
            cause="force",
            channels=("force",),
            evidence=f"the force channel explains {100 * max(own.coherence, 0):.2g} % of the force that moves the rig "
            "by all sensors",
            mend="check that it is the channel of the load cell, and of this record",
        )
    if own.gain < 0:
        return Finding(
            cause="polarity",
            channels=("force",),
            evidence=f"the force has the opposite sign of what all sensors imply (gain {own.gain:.4g})",
            mend="turn the force with scale = -1 in the import map, or all sensors",
        )
    units = usual_factor(own.gain)
    if units:
        return Finding(
            cause="units",
            evidence=f"all sensors deliver {1 / own.gain:.4g} times what the force and the masses of rig.json make",
            mend=f"correct the unit of the sensors or of the force in the import map; it looks like {units}",
        )
    if abs(own.delay_s) > 1e-4:
        return Finding(
            cause="delay",
            channels=("force",),
            evidence=f"the force comes {1e3 * abs(own.delay_s):.3g} ms {'late' if own.delay_s > 0 else 'early'} against "
            "all sensors",
            mend="synchronise the force's clock with the sensors', or shift its column",
        )
    return Finding(
        cause="gain",
        channels=("force",),
        evidence=f"the force is {own.gain:.4g} times what all sensors and the masses of rig.json imply",
        mend="calibrate the load cell, or check all masses of rig.json",
    )
