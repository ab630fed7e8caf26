"""Single effects too large for a slope: screened over their whole range, fitted, and ranked by likelihood."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain

import numpy as np

from identify.gaps.residual.residual import Linearization, Residual, residual_of
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import (
    MIN_GAIN,
    FittedHypothesis,
    Search,
    fit_afresh,
    fit_briefly,
    fit_effects,
    fit_spectrum,
    refined,
    reset_saturated_nuisance,
)
from identify.gaps.search.screening import (
    Screened,
    grid_screening,
    law_candidates,
    law_screening,
    mode_screening,
    score_screening,
)
from rig.errors import RigError

BY_SCORE, BY_GRID, BY_LAW_SCORE, BY_LAW, BY_MODES = 3, 2, 2, 1, 5
"""Numbers of candidates of each screening that are fitted for a few steps. Effort."""
MAX_REFINED, RIVAL_GAIN = 3, 0.5
"""Number of these that are refined, and share of the best one's gain that they must reach. Effort."""


def _cost_of(fit: FittedHypothesis) -> float:
    return fit.cost


class _BestFits:
    """Best few fits of different effects, as each takes much memory."""

    def __init__(self) -> None:
        self.by_name: dict[str, FittedHypothesis] = {}

    def take(self, fit: FittedHypothesis) -> None:
        name = fit.hypothesis.candidates[0].name
        if name not in self.by_name or fit.cost < self.by_name[name].cost:
            self.by_name[name] = fit
        for dropped_name in sorted(self.by_name, key=lambda n: self.by_name[n].cost)[MAX_REFINED:]:
            del self.by_name[dropped_name]


def single_effects(search: Search, nominal_fit: FittedHypothesis) -> list[FittedHypothesis]:
    """Refined fits of single effects, the likeliest first."""
    linearization, residual = search.linearization, reset_saturated_nuisance(search.residual)
    law_free_residual = residual_of(linearization, linearization.rig, residual.nuisance)
    steady = [candidate for candidate in search.candidates if not candidate.kind.stochastic]
    laws = law_candidates(linearization.rig, steady)
    best_fits = _BestFits()
    for fit in chain(
        _screened_fits(search, nominal_fit, residual, law_free_residual, steady, laws),
        _law_fits(search, law_free_residual, laws),
        _spectrum_fits(search, nominal_fit),
    ):
        best_fits.take(fit)
    refined_fits = _refined_all(search, _rivals(best_fits.by_name.values(), nominal_fit))
    if not min(refined_fits, key=_cost_of, default=nominal_fit).hypothesis.at_limit:
        return refined_fits
    best_fits.by_name = {fit.hypothesis.candidates[0].name: fit for fit in refined_fits}
    for fit in _typical_fits(search, law_free_residual, steady, laws):
        best_fits.take(fit)
    return sorted(best_fits.by_name.values(), key=_cost_of)


def _screened_fits(
    search: Search,
    nominal_fit: FittedHypothesis,
    residual: Residual,
    law_free_residual: Residual,
    steady: Sequence[Candidate],
    laws: Sequence[Candidate],
) -> Iterator[FittedHypothesis]:
    """Brief fits of the candidates of which the screenings promise most."""
    linearization = search.linearization
    screened: Iterator[tuple[Screened, Residual | None]] = chain(
        ((s, residual) for s in _score_screened(linearization, residual, steady, nominal_fit, BY_SCORE)),
        (
            (s, law_free_residual)
            for s in _worthwhile(linearization, score_screening(linearization, law_free_residual, laws), BY_LAW_SCORE)
        ),
        ((s, None) for s in _worthwhile(linearization, grid_screening(linearization, steady), BY_GRID)),
        ((s, None) for s in mode_screening(linearization.record, linearization.rig, steady)[:BY_MODES]),
    )
    for item, start in screened:
        with suppress(RigError):
            yield fit_briefly(search, (item.candidate,), item.values, start)


def _law_fits(search: Search, law_free_residual: Residual, laws: Sequence[Candidate]) -> Iterator[FittedHypothesis]:
    """Fits of contact laws that the contact residual promises, far from where the scales of the nominal law hold."""
    linearization = search.linearization
    for item in _worthwhile(linearization, law_screening(linearization, law_free_residual, laws), BY_LAW):
        with suppress(RigError):
            yield fit_effects(search, (item.candidate,), item.values, law_free_residual)
            if not linearization.record.forced:
                yield fit_afresh(search, (item.candidate,), item.values)


def _spectrum_fits(search: Search, nominal_fit: FittedHypothesis) -> Iterator[FittedHypothesis]:
    """Fits of effects that are known by their spectrum alone."""
    for candidate in search.candidates:
        if candidate.kind.stochastic and (fit := fit_spectrum(search, nominal_fit, candidate)):
            yield fit


def _typical_fits(
    search: Search, law_free_residual: Residual, steady: Sequence[Candidate], laws: Sequence[Candidate]
) -> Iterator[FittedHypothesis]:
    """Fits of ratios and linear effects from their typical size, those of single sensors left out."""
    not_of_sensors = [c for c in steady if "sensor" not in c.place]
    for candidate in (c for c in not_of_sensors if c.neutral == 1 or (c not in laws and len(c.starts()) == 1)):
        with suppress(RigError):
            yield fit_effects(search, (candidate,), candidate.default, law_free_residual)


def _worthwhile(linearization: Linearization, screened: Sequence[Screened], count: int) -> list[Screened]:
    """Best candidates of a screening, as far as they gain enough for a fit."""
    return [item for item in screened[:count] if item.cost_decrease > MIN_GAIN * linearization.record.sample_ratio]


def _score_screened(
    linearization: Linearization,
    residual: Residual,
    candidates: Sequence[Candidate],
    nominal_fit: FittedHypothesis,
    count: int,
) -> list[Screened]:
    """Best candidates by score and, where lines stand out of the residual, a tone on each body.

    Where the misfit is large the best candidate is fitted whatever it promises: scales that the misfit itself raised
    hide its gain.
    """
    screened = score_screening(linearization, residual, candidates)
    tones = [item for item in screened if item.candidate.kind.grid_screened]
    steady = [item for item in screened if not item.candidate.kind.grid_screened]
    promising = _worthwhile(linearization, steady, count) or (
        steady[:1] if nominal_fit.hypothesis.is_incomplete else []
    )
    return promising + (tones if nominal_fit.hypothesis.misfit.line_cost > MIN_GAIN else [])


def _rivals(fits: Iterable[FittedHypothesis], nominal_fit: FittedHypothesis) -> list[FittedHypothesis]:
    """Fits whose gain is near that of the best one."""
    gains = [(nominal_fit.cost - fit.cost, fit) for fit in fits]
    min_gain = max(MIN_GAIN / 2, RIVAL_GAIN * max((gain for gain, _ in gains), default=0.0))
    return [fit for gain, fit in gains if gain > min_gain]


def _refined_all(
    search: Search, rivals: Iterable[FittedHypothesis], best_cost: float = np.inf
) -> list[FittedHypothesis]:
    """Refined fits by cost; refinement ends for those that stay far above the best."""
    refined_fits = []
    for fit in sorted(rivals, key=_cost_of):
        refined_fits.append(refined(search, fit, best_cost))
        best_cost = min(best_cost, refined_fits[-1].cost)
    return sorted(refined_fits, key=_cost_of)
