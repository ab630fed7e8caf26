"""Fit of a rig to a record by its nuisance parameters alone, with the scales of the residual."""

from dataclasses import dataclass

import numpy as np

from identify.gaps.residual.fit import ParameterFit, fit
from identify.gaps.residual.likelihood import Misfit, misfit, nominal_variances_of
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, linearized, with_estimated_scales
from identify.signals.refit import refit_until_settled
from rig.model.description import Rig

MAX_ROUNDS, COST_TOLERANCE, RESONANT_REFITS = 6, 1.0, 3
"""Rounds of scales and fit, at most; further rounds follow while the misfit exceeds noise and tolerated
shares and -2 ln p falls by more than `COST_TOLERANCE`, as a slow motion leaves a wrong minimum in some rounds only. The
last is the number of linearisations at the stated scales of a rig without contacts."""


def fit_nuisance(record: Record, rig: Rig) -> tuple[Linearization, Residual]:
    """Linearisation at the estimated scales, and the residual fitted in it."""
    # let go once it is fitted, as all before the last: they are large
    initial_linearizations = [linearized(record, rig)]
    nominal_variances = nominal_variances_of(initial_linearizations[0])

    def fit_in(linearization: Linearization, start_residual: Residual | None) -> _NuisanceFit:
        residual = nuisance_fit(linearization, start_residual).residual
        return _NuisanceFit(linearization, residual, misfit(record, nominal_variances, residual))

    def refit(previous_fit: _NuisanceFit) -> _NuisanceFit:
        return fit_in(with_estimated_scales(previous_fit.linearization, previous_fit.residual), previous_fit.residual)

    def relinearize(previous_fit: _NuisanceFit) -> _NuisanceFit:
        previous_linearization = previous_fit.linearization
        new_linearization = previous_linearization.relinearized(
            rig, previous_fit.residual, scales=previous_linearization.scales
        )
        return fit_in(new_linearization, previous_fit.residual)

    def settled(earlier_fit: _NuisanceFit, later_fit: _NuisanceFit) -> bool:
        cost_decrease = earlier_fit.misfit.minus_two_log - later_fit.misfit.minus_two_log
        return not (later_fit.misfit.excess_cost > COST_TOLERANCE and cost_decrease > COST_TOLERANCE)

    settled_fit = refit_until_settled(
        refit_until_settled(fit_in(initial_linearizations.pop(), None), relinearize, max_rounds=stated_refits(rig)),
        refit,
        settled,
        max_rounds=MAX_ROUNDS,
        min_rounds=relinearizations(rig),
    )
    return settled_fit.linearization, settled_fit.residual


@dataclass(frozen=True)
class _NuisanceFit:
    linearization: Linearization
    residual: Residual
    misfit: Misfit


def nuisance_fit(linearization: Linearization, start_residual: Residual | None = None) -> ParameterFit:
    """Fit of nuisance parameters, drifts and contact tolerances in the linearised rig."""
    no_values = np.zeros(0)
    return fit(linearization, lambda _: linearization.rig, no_values, no_values, (no_values, no_values), start_residual)


def stated_refits(rig: Rig) -> int:
    """Number of refits at the scales that the tolerances state, for elastic bodies without contacts.

    Their residual is nonlinear near resonances. Single masses have `relinearizations`.
    """
    return 0 if rig.contacts or any(body.is_mass for body in rig.bodies) else RESONANT_REFITS


def relinearizations(rig: Rig) -> int:
    """Number of further linearisations for the resonance of a single mass, where the residual is nonlinear."""
    return 3 if any(body.is_mass for body in rig.bodies) else 0
