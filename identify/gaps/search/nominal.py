"""A rig fitted to a record by its nuisance parameters alone, with the scale of what it does not explain."""

import numpy as np

from identify.gaps.residual.fit import Fit, fit
from identify.gaps.residual.likelihood import misfit, reference_of
from identify.gaps.residual.residual import Linearization, Residual, linearized, rescaled
from identify.gaps.residual.spectra import Record
from rig.model.description import Rig

ROUNDS, MOST, SETTLED = 2, 6, 1.0
"""Scales and fit follow each other so many times, and more often while more is left than noise and tolerated shares,
and -2 ln p falls by more than this: a slow motion in a wrong minimum takes some rounds out of it."""


def fit_nuisance(record: Record, rig: Rig, rounds: int = ROUNDS) -> tuple[Linearization, Residual]:
    """The linearisation at the estimated scales, and the residual fitted in it."""
    linearization = linearized(record, rig)
    reference = reference_of(linearization)
    at = fitted(linearization).residual
    left = misfit(record, reference, at)
    for k in range(MOST):
        linearization = rescaled(linearization, at)
        at = fitted(linearization, at).residual
        before, left = left, misfit(record, reference, at)
        falls = left.excess > SETTLED and before.minus_two_log - left.minus_two_log > SETTLED
        if k + 1 >= max(rounds, singly_bent(rig)) and not falls:
            break
    return linearization, at


def fitted(linearization: Linearization, start: Residual | None = None) -> Fit:
    """The linearised rig itself with nuisance parameters, drifts and contact tolerances fitted."""
    nothing = np.zeros(0)
    return fit(linearization, lambda _: linearization.rig, nothing, nothing, (nothing, nothing), start)


def singly_bent(rig: Rig) -> int:
    """So many linearisations more, as the resonance of a single mass is no linear matter."""
    return 3 if any(b.is_mass for b in rig.bodies) else 0
