"""Single effects that no slope shows: screened over their whole range, fitted, the likeliest first."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import chain

import numpy as np

from identify.gaps.residual.residual import Linearization, Residual, residual_of
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import (
    WORTH,
    Search,
    Tried,
    fit_afresh,
    fit_briefly,
    fit_effects,
    fit_spectrum,
    refined,
    reset_saturated_nuisance,
)
from identify.gaps.search.ringing_screening import ringing_screening
from identify.gaps.search.screening import Screened, grid_screening, law_screening, of_laws, score_screening
from rig.errors import RigError

BY_SCORE, BY_GRID, FRESH, BY_LAW, BY_MODES = 3, 2, 2, 1, 5
"""So many candidates of each screening are fitted for a few steps."""
KEPT, RIVAL = 3, 0.5
"""So many of those are fitted to the end, if they gained this share of what the best one did."""


def _cost(tried: Tried) -> float:
    return tried.cost


class _Kept:
    """The best few hypotheses of different effects, as each takes memory."""

    def __init__(self) -> None:
        self.by_name: dict[str, Tried] = {}

    def take(self, tried: Tried) -> None:
        name = tried.hypothesis.parts[0].name
        if name not in self.by_name or tried.cost < self.by_name[name].cost:
            self.by_name[name] = tried
        for worse in sorted(self.by_name, key=lambda n: self.by_name[n].cost)[KEPT:]:
            del self.by_name[worse]


def single_effects(context: Search, nothing: Tried) -> list[Tried]:
    """Single effects fitted to the end, the likeliest first."""
    linearization, residual = context.linearization, reset_saturated_nuisance(context.at)
    fresh = residual_of(linearization, linearization.rig, residual.nuisance)
    steady = [c for c in context.known if not c.kind.stochastic]
    laws = of_laws(linearization.rig, steady)
    kept = _Kept()
    for tried in chain(
        _screened_fits(context, nothing, residual, fresh, steady, laws),
        _law_fits(context, fresh, laws),
        _spectrum_fits(context, nothing),
    ):
        kept.take(tried)
    refined = _refined_all(context, _rivals(kept.by_name.values(), nothing))
    if not min(refined, key=_cost, default=nothing).hypothesis.at_limit:
        return refined
    kept.by_name = {one.hypothesis.parts[0].name: one for one in refined}
    for tried in _typical_fits(context, fresh, steady, laws):
        kept.take(tried)
    return sorted(kept.by_name.values(), key=_cost)


def _screened_fits(
    context: Search,
    nothing: Tried,
    residual: Residual,
    fresh: Residual,
    steady: Sequence[Candidate],
    laws: Sequence[Candidate],
) -> Iterator[Tried]:
    """Fits of a few steps of the candidates that the screenings promise most of."""
    linearization = context.linearization
    screened: Iterator[tuple[Screened, Residual | None]] = chain(
        ((s, residual) for s in _by_score(linearization, residual, steady, nothing, BY_SCORE)),
        ((s, fresh) for s in _worth(linearization, score_screening(linearization, fresh, laws), FRESH)),
        ((s, None) for s in _worth(linearization, grid_screening(linearization, steady), BY_GRID)),
        ((s, None) for s in ringing_screening(linearization.record, linearization.rig, steady)[:BY_MODES]),
    )
    for one, start in screened:
        with suppress(RigError):
            yield fit_briefly(context, (one.candidate,), one.values, start)


def _law_fits(context: Search, fresh: Residual, laws: Sequence[Candidate]) -> Iterator[Tried]:
    """Contact laws that the contact residual promises, far from where the believed law's scales hold."""
    linearization = context.linearization
    for one in _worth(linearization, law_screening(linearization, fresh, laws), BY_LAW):
        with suppress(RigError):
            yield fit_effects(context, (one.candidate,), one.values, fresh)
            if not linearization.record.forced:
                yield fit_afresh(context, (one.candidate,), one.values)


def _spectrum_fits(context: Search, nothing: Tried) -> Iterator[Tried]:
    """Effects of which only the spectrum is known."""
    for candidate in context.known:
        if candidate.kind.stochastic and (shaken := fit_spectrum(context, nothing, candidate)):
            yield shaken


def _typical_fits(
    context: Search, fresh: Residual, steady: Sequence[Candidate], laws: Sequence[Candidate]
) -> Iterator[Tried]:
    """Ratios and linear effects from their typical size, whatever they promise; those of single sensors left out."""
    placed = [c for c in steady if "sensor" not in c.place]
    for candidate in (c for c in placed if c.neutral == 1 or (c not in laws and len(c.starts()) == 1)):
        with suppress(RigError):
            yield fit_effects(context, (candidate,), candidate.default, fresh)


def _worth(linearization: Linearization, screened: Sequence[Screened], most: int) -> list[Screened]:
    """The best of a screening, as far as they are worth a fit."""
    return [one for one in screened[:most] if one.gain > WORTH * linearization.record.sample_ratio]


def _by_score(
    linearization: Linearization, residual: Residual, candidates: Sequence[Candidate], nominal: Tried, most: int
) -> list[Screened]:
    """The best by score; and where lines stand out of what is left, a tone on each body, which raises one line only.

    Where much is left the best is worth a fit whatever it promises: scales that what is left made itself hide its gain.
    """
    found = score_screening(linearization, residual, candidates)
    tones = [one for one in found if one.candidate.kind.grid_screened]
    others = [one for one in found if not one.candidate.kind.grid_screened]
    promising = _worth(linearization, others, most) or (others[:1] if nominal.hypothesis.leaves_something else [])
    return promising + (tones if nominal.hypothesis.misfit.sharp > WORTH else [])


def _rivals(found: Iterable[Tried], before: Tried) -> list[Tried]:
    """Fits that gained about as much as the best one."""
    gains = [(before.cost - one.cost, one) for one in found]
    least = max(WORTH / 2, RIVAL * max((gain for gain, _ in gains), default=0.0))
    return [one for gain, one in gains if gain > least]


def _refined_all(context: Search, rivals: Iterable[Tried], least: float = np.inf) -> list[Tried]:
    """The best to the end, the others as far as they stay near it."""
    found = []
    for one in sorted(rivals, key=_cost):
        found.append(refined(context, one, least))
        least = min(least, found[-1].cost)
    return sorted(found, key=_cost)
