"""Fit of a rig to a record by its nuisance parameters alone, with the scales of the residual."""

from dataclasses import dataclass

import numpy as np

from identify.gaps.residual.fit import Fit, fit
from identify.gaps.residual.likelihood import Misfit, misfit, nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, linearized, rescaled
from identify.signals.refit import refit_until_settled
from rig.model.description import Rig

MAX_ROUNDS, COST_TOLERANCE, RESONANT_REFITS = 6, 1.0, 3
"""Rounds of scales and fit, at most; further rounds follow while the misfit exceeds noise and tolerated
shares and -2 ln p falls by more than `COST_TOLERANCE`, as a slow motion leaves a wrong minimum in some rounds only. The
last is the number of linearisations at the stated scales of a rig without contacts."""


def fit_nuisance(record: Record, rig: Rig) -> tuple[Linearization, Residual]:
    """Linearisation at the estimated scales, and the residual fitted in it."""
    nominal_variances = nominal_variances_of(linearization := linearized(record, rig))

    def fit_in(linearization: Linearization, start: Residual | None) -> _NuisanceFit:
        residual = fitted_nuisance(linearization, start).residual
        return _NuisanceFit(linearization, residual, misfit(record, nominal_variances, residual))

    def refit(estimate: _NuisanceFit) -> _NuisanceFit:
        return fit_in(rescaled(estimate.linearization, estimate.residual), estimate.residual)

    def relinearize(estimate: _NuisanceFit) -> _NuisanceFit:
        relinearized = linearization.relinearized(rig, estimate.residual, scales=estimate.linearization.scales)
        return fit_in(relinearized, estimate.residual)

    def settled(before: _NuisanceFit, after: _NuisanceFit) -> bool:
        fall = before.misfit.minus_two_log - after.misfit.minus_two_log
        return not (after.misfit.excess > COST_TOLERANCE and fall > COST_TOLERANCE)

    estimate = fit_in(linearization, None)
    estimate = refit_until_settled(estimate, relinearize, rounds=stated_scale_refits(rig))
    estimate = refit_until_settled(estimate, refit, settled, rounds=MAX_ROUNDS, at_least=extra_relinearizations(rig))
    return estimate.linearization, estimate.residual


@dataclass(frozen=True)
class _NuisanceFit:
    linearization: Linearization
    residual: Residual
    misfit: Misfit


def fitted_nuisance(linearization: Linearization, start: Residual | None = None) -> Fit:
    """Fit of nuisance parameters, drifts and contact tolerances in the linearised rig."""
    no_parameters = np.zeros(0)
    return fit(
        linearization, lambda _: linearization.rig, no_parameters, no_parameters, (no_parameters, no_parameters), start
    )


def stated_scale_refits(rig: Rig) -> int:
    """Number of refits at the scales that the tolerances state, for elastic bodies without contacts.

    Their residual is nonlinear near resonances. Single masses have `extra_relinearizations`.
    """
    return 0 if rig.contacts or any(b.is_mass for b in rig.bodies) else RESONANT_REFITS


def extra_relinearizations(rig: Rig) -> int:
    """Number of further linearisations for the resonance of a single mass, where the residual is nonlinear."""
    return 3 if any(b.is_mass for b in rig.bodies) else 0
