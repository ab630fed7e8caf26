"""Continuity of the linear model's fit: lost samples break it off for as long as the beams ring."""

import numpy as np
from jaxtyping import Float

from identify.checks.findings import Finding
from identify.checks.prediction import linear_check
from identify.checks.pulls import Projector
from identify.checks.spectra import Spectra
from rig.model.description import Rig

PART_S = 0.25
BREAK = 40.0
"""A part whose residual is so many times that of most parts, in power over the motion's, is a break."""
QUIET = 0.02
"""Of the mean power of the motion: beside less, a part's residual is not counted."""


def breaks(rig: Rig, spectra: Spectra, kept: list[int]) -> list[Finding]:
    """A break that all channels show, or the one channel without which there is none; spectra on all lines.

    None where it is one of several forces that breaks off: a hammer's.
    """
    ratio, at_s = break_ratio(rig, spectra, kept)
    if ratio < BREAK or len(kept) < len(rig.contacts) + 3:
        return []
    several = len(spectra.forces) if len(spectra.forces) > 1 else 0
    if any(break_ratio(rig, spectra, kept, doubted)[0] < BREAK for doubted in range(several)):
        return []
    without = {k: break_ratio(rig, spectra, [i for i in kept if i != k])[0] for k in kept}
    best = min(without, key=lambda k: without[k])
    if without[best] < BREAK:
        name = spectra.sensors[best].name
        return [
            Finding(
                cause="glitch",
                channels=(name,),
                evidence=f"{name} leaves what all others predict at {at_s:.2f} s",
                mend="check its cable and connector, or leave that part of the record out",
            )
        ]
    return [
        Finding(
            cause="jump",
            channels=tuple(spectra.sensors[i].name for i in kept),
            evidence=f"all channels together leave the linear model at {at_s:.2f} s, and only there",
            mend="samples were lost there, records were joined, or something struck the rig: use the part before it",
        )
    ]


def break_ratio(rig: Rig, spectra: Spectra, kept: list[int], doubted: int | None = None) -> tuple[float, float]:
    """The largest part's share of residual in the motion, over that which 30 % of the parts stay below; and when."""
    check = linear_check(rig, spectra, kept)
    left = Projector(check, kept, doubted)((spectra.acceleration - check.by_force)[kept])
    moved = spectra.in_time((spectra.acceleration / check.scale)[kept])
    shares = _powers(left, spectra.per_s)
    motion = _powers(moved, spectra.per_s)
    shares = shares / (motion + QUIET * motion.mean())
    k = int(np.argmax(shares))
    usual = float(np.quantile(shares, 0.3))
    return float(shares[k]) / max(usual, 1e-300), spectra.taken_s[0] + (k + 0.5) * PART_S


def _powers(rows: Float[np.ndarray, "sensors times"], per_s: float) -> Float[np.ndarray, " parts"]:
    width = max(1, round(PART_S * per_s))
    whole = rows.shape[1] // width
    return np.asarray(np.mean(rows[:, : whole * width].reshape(len(rows), whole, width) ** 2, axis=(0, 2)))
