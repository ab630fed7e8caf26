"""Sets of one or two large effects on the linear model, from the minima of a cost that no line dominates.

Two effects that shift resonances by more than their widths hide each other: no slope leads to either, and neither alone
explains enough to be a start for the other. With the linear residuals r of a thinned record at the stated scales and
without nuisance parameters, the cost sum ln(1 + |r|^2) falls towards the right resonances from afar, as a wrong one
costs no more than its logarithm.

Notes for maintainers
1. Each effect alone, over a grid of strengths and places, then from its best point by a simplex.
2. The best of these with each further effect over its grid, the best of the pairs then together by a simplex.
3. The best few are fitted to the record, from nominal nuisance parameters at their values.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import attrgetter, itemgetter

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import same_except_laws
from identify.gaps.residual.scales import prior_scales
from identify.gaps.residual.windowed import has_nonlinear_ground_forces
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import FittedHypothesis, Search, fit_briefly, parameters_of, refined, with_effects
from identify.gaps.search.nominal import stated_refits
from identify.gaps.search.screening import LINE_STRIDE, grid_values_of, thinned_record
from identify.linear.model import ResponseCache
from rig.errors import RigError
from rig.model.description import Rig

FOLLOWED_SINGLES, REFINED_PAIRS, FITTED_PAIRS = 3, 4, 2
"""Effects that are paired with all others, pairs that are minimised, and those that are fitted beside the best effect
alone. Effort."""
MAX_EVALUATIONS_PER_PARAMETER = 40
"""Evaluations of the cost per parameter of a simplex at most. Effort."""

Values = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class LargeEffectSet:
    """Set of effects with their values, and its cost on the thinned record."""

    candidates: tuple[Candidate, ...]
    values: Values
    cost: float


@dataclass(frozen=True)
class _CostLandscape:
    """Cost of a thinned record over the rigs that effects make of the nominal one."""

    record: Record
    rig: Rig
    unmodelled_shares: Float[np.ndarray, "sensors lines"]
    cache: ResponseCache

    def cost(self, candidates: tuple[Candidate, ...], effect_values: Values) -> float:
        """Cost sum ln(1 + |r|^2); infinite where there is no such rig."""
        lower_bounds, upper_bounds = parameters_of(candidates).bounds
        if np.any(effect_values < lower_bounds) or np.any(effect_values > upper_bounds):
            return np.inf
        try:
            rig = with_effects(self.rig, candidates, effect_values)
            model = linear_model(self.record, rig, self.unmodelled_shares, self.cache)
        except RigError:
            return np.inf
        return float(np.sum(np.log1p(np.abs(model.residual) ** 2)))

    def minimum(self, start_set: LargeEffectSet) -> LargeEffectSet:
        """Set at the minimum that a simplex reaches."""
        candidates, values = start_set.candidates, start_set.values
        lower_bounds, upper_bounds = parameters_of(candidates).bounds
        ranges = upper_bounds - lower_bounds
        optimum = minimize(
            lambda shares: self.cost(candidates, lower_bounds + shares * ranges),
            (values - lower_bounds) / ranges,
            method="Nelder-Mead",
            options={"maxfev": MAX_EVALUATIONS_PER_PARAMETER * values.size, "xatol": 1e-4, "fatol": 1.0},
        )
        reached_set = LargeEffectSet(candidates, lower_bounds + optimum.x * ranges, float(optimum.fun))
        return min(start_set, reached_set, key=attrgetter("cost"))


def large_effect_fits(search: Search) -> list[FittedHypothesis]:
    """Refined fits of the best sets, the likeliest first; none for rigs with contacts, single masses or free motion."""
    record, rig = search.linearization.record, search.linearization.rig
    if record.fits_initial_state or not stated_refits(rig) or has_nonlinear_ground_forces(rig):
        return []
    thin_record = thinned_record(record)
    unmodelled_shares = prior_scales(record).unmodelled_shares[:, 1::LINE_STRIDE]
    landscape = _CostLandscape(thin_record, rig, unmodelled_shares, ResponseCache(thin_record.omega))
    linear_effects = [candidate for candidate in search.candidates if _is_linear_effect(candidate, rig)]
    by_cost = attrgetter("cost")
    single_starts = [start for effect in linear_effects for start in _best_on_grid(landscape, (), effect)]
    single_sets = sorted((landscape.minimum(start) for start in single_starts), key=by_cost)
    pair_starts = [
        start
        for single in single_sets[:FOLLOWED_SINGLES]
        for effect in linear_effects
        for start in _best_on_grid(landscape, (single,), effect)
    ]
    pair_starts = sorted(pair_starts, key=by_cost)[:REFINED_PAIRS]
    pair_sets = sorted((landscape.minimum(start) for start in pair_starts), key=by_cost)
    return sorted(_refined_fits(search, [*pair_sets[:FITTED_PAIRS], *single_sets[:1]]), key=by_cost)


def _is_linear_effect(candidate: Candidate, rig: Rig) -> bool:
    """True of an effect on the linear model, but for those of a single sensor and of lines, which slopes find."""
    if candidate.kind.stochastic or candidate.kind.grid_screened or "sensor" in candidate.place:
        return False
    try:
        changed_rig = candidate.applied(rig, candidate.typical_values)
    except RigError:
        return False
    return (
        not (same_except_laws(rig, changed_rig) or has_nonlinear_ground_forces(changed_rig))
        and changed_rig.loads == rig.loads
    )


def _best_on_grid(
    landscape: _CostLandscape, present_sets: tuple[LargeEffectSet, ...], candidate: Candidate
) -> Iterator[LargeEffectSet]:
    """Best set of present effects and a further one on its grid; none where no point of it makes a rig, or where the
    further one stands nowhere and is there already."""
    present_candidates = tuple(member for far_set in present_sets for member in far_set.candidates)
    if candidate in present_candidates and len(candidate.parameters) == len(candidate.parameters.strengths):
        return
    present_values = np.concatenate([np.zeros(0), *(far_set.values for far_set in present_sets)])
    members = (*present_candidates, candidate)
    grid_points = (np.append(present_values, grid_values) for grid_values in grid_values_of(candidate))
    trials = [(landscape.cost(members, point), point) for point in grid_points]
    cost, point = min(trials, key=itemgetter(0), default=(np.inf, present_values))
    if np.isfinite(cost):
        yield LargeEffectSet(members, point, cost)


def _refined_fits(search: Search, far_sets: Sequence[LargeEffectSet]) -> Iterator[FittedHypothesis]:
    """Refined fits of those sets of which there are rigs; refinement ends for those that stay far above the best."""
    best_cost = np.inf
    for far_set in far_sets:
        with suppress(RigError):
            fitted_set = refined(search, fit_briefly(search, far_set.candidates, far_set.values, None), best_cost)
            best_cost = min(best_cost, fitted_set.cost)
            yield fitted_set
