"""A rig fitted to a record by its nuisance parameters alone, with the scale of what it does not explain."""

import numpy as np

from identify.gaps.residual.fit import Fit, fit
from identify.gaps.residual.likelihood import misfit, reference_of
from identify.gaps.residual.residual import Base, Residual, base_of, rescaled
from identify.gaps.residual.spectra import Record
from rig.model.description import Rig

ROUNDS, MOST, SETTLED = 2, 6, 1.0
"""Scales and fit follow each other so many times, and more often while more is left than noise and tolerated shares,
and -2 ln p falls by more than this: a slow motion in a wrong minimum takes some rounds out of it."""


def fit_nuisance(record: Record, rig: Rig, rounds: int = ROUNDS) -> tuple[Base, Residual]:
    """The base at the estimated scales, and the residual fitted in it."""
    base = base_of(record, rig)
    reference = reference_of(base)
    at = fitted(base).residual
    left = misfit(record, reference, at)
    for k in range(MOST):
        base = rescaled(base, at)
        at = fitted(base, at).residual
        before, left = left, misfit(record, reference, at)
        falls = left.excess > SETTLED and before.minus_two_log - left.minus_two_log > SETTLED
        if k + 1 >= max(rounds, singly_bent(rig)) and not falls:
            break
    return base, at


def fitted(base: Base, start: Residual | None = None) -> Fit:
    """The base's own rig with nuisance parameters, drifts and contact tolerances fitted."""
    nothing = np.zeros(0)
    return fit(base, lambda _: base.rig, nothing, nothing, (nothing, nothing), start)


def singly_bent(rig: Rig) -> int:
    """So many linearisations more, as the resonance of a single mass is no linear matter."""
    return 3 if any(b.is_mass for b in rig.bodies) else 0
