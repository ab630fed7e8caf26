"""A rig fitted to a record by its nuisance parameters alone, with the scale of what it does not explain."""

from dataclasses import dataclass

import numpy as np

from identify.gaps.residual.fit import Fit, fit
from identify.gaps.residual.likelihood import Misfit, misfit, reference_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, linearized, rescaled
from identify.signals.refit import refit_until_settled
from rig.model.description import Rig

ROUNDS, MOST, SETTLED, RESONANT = 2, 6, 1.0, 3
"""Scales and fit follow each other so many times, and more often while more is left than noise and tolerated shares,
and -2 ln p falls by more than this: a slow motion in a wrong minimum takes some rounds out of it."""


def fit_nuisance(record: Record, rig: Rig, rounds: int = ROUNDS) -> tuple[Linearization, Residual]:
    """The linearisation at the estimated scales, and the residual fitted in it."""
    reference = reference_of(linearization := linearized(record, rig))

    def fit_in(linearization: Linearization, start: Residual | None) -> _NuisanceFit:
        residual = fitted(linearization, start).residual
        return _NuisanceFit(linearization, residual, misfit(record, reference, residual))

    def refit(estimate: _NuisanceFit) -> _NuisanceFit:
        return fit_in(rescaled(estimate.linearization, estimate.residual), estimate.residual)

    def relinearize(estimate: _NuisanceFit) -> _NuisanceFit:
        there = linearization.about(rig, estimate.residual, scales=estimate.linearization.scales)
        return fit_in(there, estimate.residual)

    def settled(before: _NuisanceFit, after: _NuisanceFit) -> bool:
        fall = before.misfit.minus_two_log - after.misfit.minus_two_log
        return not (after.misfit.excess > SETTLED and fall > SETTLED)

    estimate = fit_in(linearization, None)
    estimate = refit_until_settled(estimate, relinearize, rounds=stated_scale_refits(rig))
    estimate = refit_until_settled(
        estimate, refit, settled, rounds=MOST, at_least=max(rounds, extra_relinearizations(rig))
    )
    return estimate.linearization, estimate.residual


@dataclass(frozen=True)
class _NuisanceFit:
    linearization: Linearization
    residual: Residual
    misfit: Misfit


def fitted(linearization: Linearization, start: Residual | None = None) -> Fit:
    """The linearised rig itself with nuisance parameters, drifts and contact tolerances fitted."""
    nothing = np.zeros(0)
    return fit(linearization, lambda _: linearization.rig, nothing, nothing, (nothing, nothing), start)


def stated_scale_refits(rig: Rig) -> int:
    """Refits at the scales that the tolerances state: of elastic bodies without contacts, whose resonances bend the
    residual. Single masses have rounds of their own."""
    return 0 if rig.contacts or any(b.is_mass for b in rig.bodies) else RESONANT


def extra_relinearizations(rig: Rig) -> int:
    """Count of further linearisations, as the resonance of a single mass is no linear matter."""
    return 3 if any(b.is_mass for b in rig.bodies) else 0
