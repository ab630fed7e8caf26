"""Single effects too large for a slope: screened over their whole range, fitted, and ranked by likelihood."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain
from operator import attrgetter

import numpy as np

from identify.gaps.residual.residual import Linearization, Residual, residual_of
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import (
    MIN_GAIN,
    FittedHypothesis,
    Search,
    fit_briefly,
    fit_effects,
    fit_from_prior_scales,
    fit_stochastic_effect,
    refined,
    reset_saturated_nuisance,
)
from identify.gaps.search.screening import (
    ScreenedCandidate,
    grid_screening,
    law_candidates,
    law_screening,
    mode_screening,
    rao_score_screening,
)
from rig.errors import RigError

FITS_BY_SCORE, FITS_BY_GRID, FITS_BY_LAW_SCORE, FITS_BY_LAW, FITS_BY_MODES = 3, 2, 2, 1, 5
"""Numbers of candidates of each screening that are fitted for a few steps. Effort."""
MAX_REFINED, RIVAL_GAIN = 3, 0.5
"""Number of these that are refined, and share of the best one's gain that they must reach. Effort."""


class _BestFits:
    """Best few fits of different effects, as each takes much memory."""

    def __init__(self) -> None:
        self.by_name: dict[str, FittedHypothesis] = {}

    def keep_if_better(self, new_fit: FittedHypothesis) -> None:
        name = new_fit.hypothesis.candidates[0].name
        if name not in self.by_name or new_fit.cost < self.by_name[name].cost:
            self.by_name[name] = new_fit
        for dropped_name in sorted(self.by_name, key=lambda kept_name: self.by_name[kept_name].cost)[MAX_REFINED:]:
            del self.by_name[dropped_name]


def single_effect_fits(search: Search, nominal_fit: FittedHypothesis) -> list[FittedHypothesis]:
    """Refined fits of single effects, the likeliest first."""
    linearization, residual = search.linearization, reset_saturated_nuisance(search.nominal_residual)
    law_free_residual = residual_of(linearization, linearization.rig, residual.nuisance_pulls)
    time_fitted = [candidate for candidate in search.candidates if not candidate.kind.stochastic]
    law_effects = law_candidates(linearization.rig, time_fitted)
    best_fits = _BestFits()
    for single_fit in chain(
        _screened_fits(search, nominal_fit, residual, law_free_residual, time_fitted, law_effects),
        _law_fits(search, law_free_residual, law_effects),
        _spectrum_fits(search, nominal_fit),
    ):
        best_fits.keep_if_better(single_fit)
    refined_fits = _refined_all(search, _rival_fits(best_fits.by_name.values(), nominal_fit))
    if not min(refined_fits, key=attrgetter("cost"), default=nominal_fit).hypothesis.has_tolerance_at_limit:
        return refined_fits
    best_fits.by_name = {fit.hypothesis.candidates[0].name: fit for fit in refined_fits}
    for single_fit in _fits_from_typical_size(search, law_free_residual, time_fitted, law_effects):
        best_fits.keep_if_better(single_fit)
    return sorted(best_fits.by_name.values(), key=attrgetter("cost"))


def _screened_fits(
    search: Search,
    nominal_fit: FittedHypothesis,
    residual: Residual,
    law_free_residual: Residual,
    time_fitted: Sequence[Candidate],
    law_effects: Sequence[Candidate],
) -> Iterator[FittedHypothesis]:
    """Brief fits of the candidates of which the screenings promise most."""
    linearization = search.linearization
    by_law_score = rao_score_screening(linearization, law_free_residual, law_effects)
    by_grid = grid_screening(linearization, time_fitted)
    by_modes = mode_screening(linearization.record, linearization.rig, time_fitted)
    by_score = _best_by_score_and_tones(linearization, residual, time_fitted, nominal_fit, FITS_BY_SCORE)
    starts: list[tuple[ScreenedCandidate, Residual | None]] = [
        *((screened, residual) for screened in by_score),
        *((screened, law_free_residual) for screened in _worth_fitting(linearization, by_law_score, FITS_BY_LAW_SCORE)),
        *((screened, None) for screened in _worth_fitting(linearization, by_grid, FITS_BY_GRID)),
        *((screened, None) for screened in by_modes[:FITS_BY_MODES]),
    ]
    for screened, start_residual in starts:
        with suppress(RigError):
            yield fit_briefly(search, (screened.candidate,), screened.start_values, start_residual)


def _law_fits(
    search: Search, law_free_residual: Residual, law_effects: Sequence[Candidate]
) -> Iterator[FittedHypothesis]:
    """Fits of contact laws that the contact residual promises, far from where the scales of the nominal law hold."""
    linearization = search.linearization
    by_law = law_screening(linearization, law_free_residual, law_effects)
    for screened in _worth_fitting(linearization, by_law, FITS_BY_LAW):
        with suppress(RigError):
            yield fit_effects(search, (screened.candidate,), screened.start_values, law_free_residual)
            if not linearization.record.has_force:
                yield fit_from_prior_scales(search, (screened.candidate,), screened.start_values)


def _spectrum_fits(search: Search, nominal_fit: FittedHypothesis) -> Iterator[FittedHypothesis]:
    """Fits of effects that are known by their spectrum alone."""
    for candidate in search.candidates:
        if candidate.kind.stochastic and (spectrum_fit := fit_stochastic_effect(search, nominal_fit, candidate)):
            yield spectrum_fit


def _fits_from_typical_size(
    search: Search, law_free_residual: Residual, time_fitted: Sequence[Candidate], law_effects: Sequence[Candidate]
) -> Iterator[FittedHypothesis]:
    """Fits of ratios and linear effects from their typical size, those of single sensors left out."""
    for candidate in time_fitted:
        is_linear = candidate not in law_effects and len(candidate.start_values()) == 1
        if "sensor" not in candidate.place and (candidate.neutral_strength == 1 or is_linear):
            with suppress(RigError):
                yield fit_effects(search, (candidate,), candidate.typical_values, law_free_residual)


def _worth_fitting(
    linearization: Linearization, ranked_candidates: Sequence[ScreenedCandidate], fit_count: int
) -> list[ScreenedCandidate]:
    """Best candidates of a screening, as far as they gain enough for a fit."""
    least_gain = MIN_GAIN * linearization.record.oversampling
    return [screened for screened in ranked_candidates[:fit_count] if screened.cost_decrease > least_gain]


def _best_by_score_and_tones(
    linearization: Linearization,
    residual: Residual,
    candidates: Sequence[Candidate],
    nominal_fit: FittedHypothesis,
    fit_count: int,
) -> list[ScreenedCandidate]:
    """Best candidates by score and, where lines stand out of the residual, a tone on each body.

    Where the misfit is large the best candidate is fitted whatever it promises: scales that the misfit itself raised
    hide its gain.
    """
    screened = rao_score_screening(linearization, residual, candidates)
    tone_candidates = [start for start in screened if start.candidate.kind.grid_screened]
    other_candidates = [start for start in screened if not start.candidate.kind.grid_screened]
    promising = _worth_fitting(linearization, other_candidates, fit_count)
    if not promising and nominal_fit.hypothesis.has_unexplained_misfit:
        promising = other_candidates[:1]
    return promising + (tone_candidates if nominal_fit.hypothesis.misfit.line_cost > MIN_GAIN else [])


def _rival_fits(fits: Iterable[FittedHypothesis], nominal_fit: FittedHypothesis) -> list[FittedHypothesis]:
    """Fits whose gain is near that of the best one."""
    gains_and_fits = [(nominal_fit.cost - single_fit.cost, single_fit) for single_fit in fits]
    least_gain = max(MIN_GAIN / 2, RIVAL_GAIN * max((gain for gain, _ in gains_and_fits), default=0.0))
    return [single_fit for gain, single_fit in gains_and_fits if gain > least_gain]


def _refined_all(
    search: Search, rival_fits: Iterable[FittedHypothesis], best_cost: float = np.inf
) -> list[FittedHypothesis]:
    """Refined fits by cost; refinement ends for those that stay far above the best."""
    refined_fits = []
    for rival_fit in sorted(rival_fits, key=attrgetter("cost")):
        refined_fits.append(refined(search, rival_fit, best_cost))
        best_cost = min(best_cost, refined_fits[-1].cost)
    return sorted(refined_fits, key=attrgetter("cost"))
