"""A rig fitted to a record by its nuisance parameters alone, with the scale of what it does not explain."""

import numpy as np

from identify.gap.fit import Fit, fit
from identify.gap.residual import Base, Residual, base_of, rescaled
from identify.gap.spectra import Record
from rig.description import Rig
from rig.oscillator import Oscillator

ROUNDS = 2
"""Scales and fit each follow the other; after two rounds neither moves by what would matter."""


def fit_nuisance(record: Record, rig: Rig, rounds: int = ROUNDS) -> tuple[Base, Residual]:
    """The base at the estimated scales, and the residual fitted in it."""
    base = base_of(record, rig)
    at = fitted(base).residual
    for _ in range(max(rounds, singly_bent(rig))):
        base = rescaled(base, at)
        at = fitted(base, at).residual
    return base, at


def fitted(base: Base, start: Residual | None = None) -> Fit:
    """The base's own rig with nuisance parameters, drifts and contact tolerances fitted."""
    nothing = np.zeros(0)
    return fit(base, lambda _: base.rig, nothing, nothing, (nothing, nothing), start)


def singly_bent(rig: Rig) -> int:
    """So many linearisations more, as the resonance of a single mass is no linear matter."""
    return 3 if any(isinstance(b, Oscillator) for b in rig.bodies) else 0
