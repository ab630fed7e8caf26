"""The search over the library, jointly: single effects, and pairs that do not depend on which of the two came first."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain

import numpy as np
from scipy.linalg import block_diag

from identify.gaps.residual.residual import Linearization, Residual, residual_of
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import (
    FAR,
    WORTH,
    Hypothesis,
    Search,
    Tried,
    fit_afresh,
    fit_briefly,
    fit_effects,
    fit_spectrum,
    refined,
    straightened,
)
from identify.gaps.search.nominal import fitted
from identify.gaps.search.screening import Screened, grid_screening, law_screening, of_laws, score_screening
from rig.errors import RigError
from rig.model.description import Rig

BY_SCORE, BY_GRID, FRESH, BY_LAW = 5, 3, 3, 1
"""So many candidates of each screening are fitted for a few steps."""
KEPT, RIVAL = 3, 0.5
"""So many of those are fitted to the end, if they gained this share of what the best one did."""
FIRSTS, SECONDS = 3, 2
"""So many effects at most are followed by a search for another, of which so many are fitted together with it."""
SHOWN = 2
"""So many hypotheses are compared on another record, however far they are."""


def search(begun: Search, progress: Callable[[float], None]) -> list[Hypothesis]:
    """The believed rig, and the single effects and pairs that explain most, the likeliest on this record first.

    Every effect is screened, those that promise most are fitted for a few steps, the best of them to the end. Where a
    tolerance stays at its limit, factors and linear effects are fitted whatever they promise, from their typical size.
    Behind the best the library is screened again, and a pair is fitted together. Each part of the best pair is in turn
    taken first, so that a pair does not depend on which of the two was found first.
    """
    nothing = begun.nothing()
    singles = _singles(begun, nothing)
    progress(0.5)
    pairs: dict[frozenset[str], Hypothesis] = {}
    followed: set[frozenset[str]] = set()
    queue = singles[:1]
    while queue and len(followed) < FIRSTS:
        first = queue.pop(0)
        if first.hypothesis.key in followed or not first.hypothesis.leaves_something:
            continue
        followed.add(first.hypothesis.key)
        for pair in _seconds(begun, first, min((p.cost for p in pairs.values()), default=np.inf)):
            if pair.key not in pairs or pair.cost < pairs[pair.key].cost:
                pairs[pair.key] = pair
        progress(0.5 + 0.5 * len(followed) / FIRSTS)
        best = min(pairs.values(), key=_cost, default=None)
        if best and best.leaves_something and not queue:
            known = {one.hypothesis.key: one for one in singles}
            parts = _parts(begun, best, known)
            singles += [one for one in parts if one.hypothesis.key not in known]
            queue = _rivals([singles[0], *parts], nothing)
    found = sorted([*(one.hypothesis for one in singles), *pairs.values()], key=_cost)
    near = [one for i, one in enumerate(found) if i < SHOWN or one.cost < found[0].cost + FAR]
    return sorted([nothing.hypothesis, *near], key=_cost)


def _cost(one: Tried | Hypothesis) -> float:
    return one.cost


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


def _singles(begun: Search, nothing: Tried) -> list[Tried]:
    """Single effects fitted to the end, the likeliest first."""
    linearization, at = begun.linearization, straightened(begun.at)
    fresh = residual_of(linearization, linearization.rig, at.nuisance)
    steady = [c for c in begun.known if not c.kind.stochastic]
    laws = of_laws(linearization.rig, steady)
    kept = _Kept()
    for tried in chain(
        _screened_fits(begun, nothing, at, fresh, steady, laws),
        _law_fits(begun, fresh, laws),
        _spectrum_fits(begun, nothing),
    ):
        kept.take(tried)
    refined = _refined_all(begun, _rivals(kept.by_name.values(), nothing))
    if not min(refined, key=_cost, default=nothing).hypothesis.at_limit:
        return refined
    kept.by_name = {one.hypothesis.parts[0].name: one for one in refined}
    for tried in _typical_fits(begun, fresh, steady, laws):
        kept.take(tried)
    return sorted(kept.by_name.values(), key=_cost)


def _screened_fits(
    begun: Search,
    nothing: Tried,
    at: Residual,
    fresh: Residual,
    steady: Sequence[Candidate],
    laws: Sequence[Candidate],
) -> Iterator[Tried]:
    """What the screenings promise most of, fitted for a few steps."""
    linearization = begun.linearization
    screened: Iterator[tuple[Screened, Residual | None]] = chain(
        ((s, at) for s in _by_score(linearization, at, steady, nothing, BY_SCORE)),
        ((s, fresh) for s in _worth(linearization, score_screening(linearization, fresh, laws), FRESH)),
        ((s, None) for s in _worth(linearization, grid_screening(linearization, steady), BY_GRID)),
    )
    for one, start in screened:
        with suppress(RigError):
            yield fit_briefly(begun, (one.candidate,), one.values, start)


def _law_fits(begun: Search, fresh: Residual, laws: Sequence[Candidate]) -> Iterator[Tried]:
    """Contact laws that the contact residual promises, far from where the believed law's scales hold."""
    linearization = begun.linearization
    for one in _worth(linearization, law_screening(linearization, fresh, laws), BY_LAW):
        with suppress(RigError):
            yield fit_effects(begun, (one.candidate,), one.values, fresh)
            if not linearization.record.forced:
                yield fit_afresh(begun, (one.candidate,), one.values)


def _spectrum_fits(begun: Search, nothing: Tried) -> Iterator[Tried]:
    """Effects of which only the spectrum is known."""
    for candidate in begun.known:
        if candidate.kind.stochastic and (shaken := fit_spectrum(begun, nothing, candidate)):
            yield shaken


def _typical_fits(
    begun: Search, fresh: Residual, steady: Sequence[Candidate], laws: Sequence[Candidate]
) -> Iterator[Tried]:
    """Ratios and linear effects from their typical size, whatever they promise; those of single sensors left out."""
    placed = [c for c in steady if "sensor" not in c.place]
    for candidate in (c for c in placed if c.neutral == 1 or (c not in laws and len(c.starts()) == 1)):
        with suppress(RigError):
            yield fit_effects(begun, (candidate,), candidate.default, fresh)


def _worth(linearization: Linearization, screened: Sequence[Screened], most: int) -> list[Screened]:
    """The best of a screening, as far as they are worth a fit."""
    return [one for one in screened[:most] if one.gain > WORTH * linearization.record.sample_ratio]


def _by_score(
    linearization: Linearization, at: Residual, candidates: Sequence[Candidate], left: Tried, most: int
) -> list[Screened]:
    """The best by score; and where lines stand out of what is left, a tone on each body, which raises one line only.

    Where much is left the best is worth a fit whatever it promises: scales that what is left made itself hide its gain.
    """
    found = score_screening(linearization, at, candidates)
    tones = [one for one in found if one.candidate.kind.grid_screened]
    others = [one for one in found if not one.candidate.kind.grid_screened]
    promising = _worth(linearization, others, most) or (others[:1] if left.hypothesis.leaves_something else [])
    return promising + (tones if left.hypothesis.misfit.sharp > WORTH else [])


def _rivals(found: Iterable[Tried], before: Tried) -> list[Tried]:
    """Those that gained about as much as the best one did."""
    gains = [(before.cost - one.cost, one) for one in found]
    least = max(WORTH / 2, RIVAL * max((gain for gain, _ in gains), default=0.0))
    return [one for gain, one in gains if gain > least]


def _seconds(begun: Search, first: Tried, least: float) -> list[Hypothesis]:
    """Pairs of a first effect with what the library holds best for what it leaves; no effect pairs with itself.

    least is the cost of the best pair so far.
    """
    rig = first.hypothesis.applied_to(begun.linearization.rig)
    linearization = begun.linearization.about(rig, first.residual, first.linearization.scales)
    at = fitted(linearization, first.residual).residual
    others = [c for c in begun.known if c.kind.name not in first.hypothesis.effects and _joins(c, rig)]
    inner = Search(begun.reference, linearization, at, ())
    held = any(p.kind.stochastic for p in first.hypothesis.parts)
    steady = [c for c in others if not c.kind.stochastic]
    fresh = residual_of(linearization, linearization.rig, at.nuisance)  # its slow motion did not follow another law yet
    laws = of_laws(linearization.rig, steady)
    screened = [(s, at) for s in _by_score(linearization, at, steady, first, SECONDS)]
    screened += [(s, fresh) for s in _worth(linearization, law_screening(linearization, fresh, laws), BY_LAW)]
    found: dict[str, Tried] = {}
    for one, start in screened:
        with suppress(RigError):  # two effects may make no rig where each makes one
            if held:
                pair = fit_briefly(inner, (one.candidate,), one.values, straightened(start))
            else:
                pair = _together(begun, first, one, start)
            name = one.candidate.name
            found[name] = min(found.get(name, pair), pair, key=_cost)
    rivals = _refined_all(inner if held else begun, _rivals(found.values(), first), least)
    pairs = [_beside(first, one) if held else one.hypothesis for one in rivals]
    for candidate in others:
        if candidate.kind.stochastic and (shaken := fit_spectrum(inner, inner.nothing(), candidate)):
            pairs.append(_beside(first, shaken))
    return pairs


def _beside(first: Tried, second: Tried) -> Hypothesis:
    """A pair of which the second was fitted with the first held, as one is known by its spectrum alone."""
    one, other = first.hypothesis, second.hypothesis
    values = np.concatenate([one.values, other.values])
    return Hypothesis((*one.parts, *other.parts), values, block_diag(one.covariance, other.covariance), other.misfit)


def _together(begun: Search, first: Tried, second: Screened, start: Residual) -> Tried:
    """Both fitted for a few steps, from where the first stands."""
    parts = (*first.hypothesis.parts, second.candidate)
    values = np.concatenate([first.hypothesis.values, second.values])
    return fit_briefly(begun, parts, values, straightened(start), first.linearization)


def _parts(begun: Search, pair: Hypothesis, known: Mapping[frozenset[str], Tried]) -> list[Tried]:
    """Each part of a pair alone, fitted by itself unless it is known."""
    least = min((one.cost for one in known.values()), default=np.inf)
    parts = zip(pair.parts, pair.split(), strict=True)
    return [
        known.get(frozenset({part.name})) or fit_effects(begun, (part,), values, begun.at, least)
        for part, values in parts
        if not part.kind.stochastic
    ]


def _refined_all(begun: Search, rivals: Iterable[Tried], least: float = np.inf) -> list[Tried]:
    """The best to the end, the others as far as they stay near it."""
    found = []
    for one in sorted(rivals, key=_cost):
        found.append(refined(begun, one, least))
        least = min(least, found[-1].cost)
    return sorted(found, key=_cost)


def _joins(candidate: Candidate, rig: Rig) -> bool:
    try:
        candidate.applied(rig, candidate.default)
    except RigError:
        return False
    return True
