"""The search over the library, jointly: single effects, and pairs that do not depend on which of the two came first."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from identify.gap.candidates import Candidate
from identify.gap.fit import fit
from identify.gap.likelihood import Misfit, Reference, misfit
from identify.gap.nuisance import LIMIT
from identify.gap.residual import Base, Residual, base_of, rescaled, residual_of, scales_at
from identify.gap.search.base_excitation import fit_base_excitation
from identify.gap.search.nominal import fitted, singly_bent
from identify.gap.search.screening import Screened, grid_screening, law_screening, of_laws, score_screening
from rig.description import Rig
from rig.errors import RigError

BY_SCORE, BY_GRID, FRESH, BY_LAW = 5, 3, 3, 1
"""So many candidates of each screening are fitted for a few steps."""
WORTH = 20.0
"""An effect that gains less of -2 ln p is not fitted: half of what the priors of one among some 26, at some 4 places,
and the temperature of the comparison ask of it, 2 * 4 * ln(0.3 * 26 * 4 / 0.35) = 36."""
SHORT, ROUNDS, SETTLED = 3, 4, 1.0
"""Steps of a first fit; at most so many rounds to the end, until one gains less than this of -2 ln p."""
KEPT, RIVAL = 3, 0.5
"""So many of those are fitted to the end, if they gained this share of what the best one did."""
FIRSTS, SECONDS = 3, 2
"""So many effects at most are followed by a search for another, of which so many are fitted together with it."""
FAR, SHOWN = 200.0, 2
"""Hypotheses whose -2 ln p is larger by so much are not compared on another record, where the odds of a single one are
e^(200 / (2 * 4)) = 7e10; the best so many always are."""


@dataclass(frozen=True)
class Hypothesis:
    """Effects in the rig, with their parameters fitted on a record one after the other; none: the believed rig."""

    parts: tuple[Candidate, ...]
    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    misfit: Misfit

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(p.kind.name for p in self.parts)

    @property
    def key(self) -> frozenset[str]:
        return frozenset(p.name for p in self.parts)

    @property
    def cost(self) -> float:
        """On the record that it was fitted to."""
        return self.misfit.minus_two_log

    @property
    def leaves_something(self) -> bool:
        """Whether more is left above noise and tolerated shares than an effect must gain."""
        return self.misfit.excess > WORTH

    def split(self) -> list[Float[np.ndarray, " parameters"]]:
        """The values of each part."""
        ends = np.cumsum([len(p.parameters) for p in self.parts])
        return np.split(self.values, ends[:-1])

    def applied_to(self, rig: Rig) -> Rig:
        return applied(rig, self.parts, self.values)


@dataclass(frozen=True)
class Tried:
    """A hypothesis while it is fitted: with the base and the residual, which take much memory."""

    hypothesis: Hypothesis
    base: Base
    residual: Residual

    @property
    def cost(self) -> float:
        return self.hypothesis.cost


def applied(rig: Rig, parts: Sequence[Candidate], values: Float[np.ndarray, " parameters"]) -> Rig:
    """The rig with several effects, whose parameters stand one after the other."""
    at = 0
    for part in parts:
        count = len(part.parameters)
        rig = part.applied(rig, values[at : at + count])
        at += count
    return rig


@dataclass(frozen=True)
class Search:
    """What a search on one record shares: its base and residual under the believed rig, and the reference variances."""

    reference: Reference
    base: Base
    at: Residual
    known: tuple[Candidate, ...]

    def nothing(self) -> Tried:
        return _tried(self, (), np.zeros(0), np.zeros((0, 0)), self.base, self.at)


def search(begun: Search, progress: Callable[[float], None]) -> list[Hypothesis]:
    """The believed rig, and the single effects and pairs that explain most, the likeliest on this record first.

    Every effect is screened, those that promise most are fitted for a few steps, the best of them to the end. Behind
    the best the library is screened again, and a pair is fitted together. Each part of the best pair is in turn taken
    first, so that a pair does not depend on which of the two was found first.
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


def _singles(begun: Search, nothing: Tried) -> list[Tried]:
    base, at = begun.base, straightened(begun.at)
    fresh = residual_of(base, base.rig, at.nuisance)
    steady = [c for c in begun.known if not c.kind.stochastic]
    laws = of_laws(base.rig, steady)
    screened = chain(
        [(s, at) for s in _screened(base, at, steady, nothing, BY_SCORE)],
        [(s, fresh) for s in score_screening(base, fresh, laws)[:FRESH]],
        [(s, None) for s in grid_screening(base, steady)[:BY_GRID]],
    )
    found: dict[str, Tried] = {}

    def take(name: str, tried: Tried) -> None:
        """The best few alone are kept, as each takes memory."""
        if name not in found or tried.cost < found[name].cost:
            found[name] = tried
        for worse in sorted(found, key=lambda n: found[n].cost)[KEPT:]:
            del found[worse]

    for one, start in screened:
        if one.gain > WORTH * base.record.strictness or one.candidate.kind.scanned:
            with suppress(RigError):
                take(one.candidate.name, _fitted(begun, (one.candidate,), one.values, start))
    for one in law_screening(base, fresh, laws)[:BY_LAW]:  # far from where the scales are those of the believed law
        if one.gain > WORTH * base.record.strictness:
            with suppress(RigError):
                take(one.candidate.name, fit_effects(begun, (one.candidate,), one.values, fresh))
    for candidate in begun.known:
        if candidate.kind.stochastic and (shaken := _stochastic(begun, nothing, candidate)):
            take(candidate.name, shaken)
    return _refined_all(begun, _rivals(found.values(), nothing))


def _screened(base: Base, at: Residual, candidates: Sequence[Candidate], left: Tried, most: int) -> list[Screened]:
    """The best by score; and the best tone, which raises one line only, where lines stand out of what is left."""
    found = score_screening(base, at, candidates)
    tones = [one for one in found if one.candidate.kind.scanned]
    best = [one for one in found if one not in tones][:most]
    return best + (tones[:1] if left.hypothesis.misfit.sharp > WORTH else [])


def _rivals(found: Iterable[Tried], before: Tried) -> list[Tried]:
    """Those that gained about as much as the best one did."""
    gains = [(before.cost - one.cost, one) for one in found]
    least = max(WORTH / 2, RIVAL * max((gain for gain, _ in gains), default=0.0))
    return [one for gain, one in gains if gain > least]


def _seconds(begun: Search, first: Tried, least: float) -> list[Hypothesis]:
    """Pairs of a first effect with what the library holds best for what it leaves; no effect pairs with itself.

    least is the cost of the best pair so far.
    """
    rig = first.hypothesis.applied_to(begun.base.rig)
    base = base_of(begun.base.record, rig, first.residual, first.base.scales)
    at = fitted(base, first.residual).residual
    others = [c for c in begun.known if c.kind.name not in first.hypothesis.effects and _joins(c, rig)]
    inner = Search(begun.reference, base, at, ())
    held = any(p.kind.stochastic for p in first.hypothesis.parts)
    steady = [c for c in others if not c.kind.stochastic]
    fresh = residual_of(base, base.rig, at.nuisance)  # its slow motion did not follow another law yet
    laws = of_laws(base.rig, steady)
    screened = [(s, at) for s in _screened(base, at, steady, first, SECONDS)]
    screened += [(s, fresh) for s in law_screening(base, fresh, laws)[:BY_LAW]]
    found: dict[str, Tried] = {}
    for one, start in screened:
        if one.gain > WORTH * base.record.strictness or one.candidate.kind.scanned:
            with suppress(RigError):  # two effects may make no rig where each makes one
                if held:
                    pair = _fitted(inner, (one.candidate,), one.values, straightened(start))
                else:
                    pair = _together(begun, first, one, start)
                name = one.candidate.name
                found[name] = min(found.get(name, pair), pair, key=_cost)
    rivals = _refined_all(inner if held else begun, _rivals(found.values(), first), least)
    pairs = [_beside(first, one) if held else one.hypothesis for one in rivals]
    for candidate in others:
        if candidate.kind.stochastic and (shaken := _stochastic(inner, inner.nothing(), candidate)):
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
    return _fitted(begun, parts, values, straightened(start), first.base)


def _parts(begun: Search, pair: Hypothesis, known: Mapping[frozenset[str], Tried]) -> list[Tried]:
    """Each part of a pair alone, fitted by itself unless it is known."""
    least = min((one.cost for one in known.values()), default=np.inf)
    parts = zip(pair.parts, pair.split(), strict=True)
    return [
        known.get(frozenset({part.name})) or fit_effects(begun, (part,), values, begun.at, least)
        for part, values in parts
        if not part.kind.stochastic
    ]


def fit_effects(
    begun: Search,
    parts: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    start: Residual,
    least: float = np.inf,
) -> Tried:
    """Effects fitted to the end from some values, and from the nuisance parameters and drifts of a residual."""
    return refined(begun, _fitted(begun, parts, values, straightened(start)), least)


def _fitted(
    begun: Search,
    parts: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    start: Residual | None,
    about: Base | None = None,
) -> Tried:
    """Gauss-Newton for a few steps at the scales of a base (the believed rig's unless one is given).

    Without a start, nothing was bent to do without the effects: then the linearisation is about their values.
    """
    about, build = about or begun.base, partial(applied, begun.base.rig, parts)
    if start is None:
        about = base_of(about.record, build(values), None, about.scales, about.seen)
    done = fit(about, build, values, steps_of(parts), bounds_of(parts), start, SHORT)
    return _tried(begun, parts, done.values, done.covariance, about, done.residual)


def refined(begun: Search, one: Tried, least: float = np.inf) -> Tried:
    """Fitted to the end, with scales and linearisation renewed about where the parameters have come to.

    What is known by its spectrum alone keeps its values. It ends where the cost stays `FAR` above the least of others.
    """
    parts = one.hypothesis.parts
    if any(p.kind.stochastic for p in parts):
        return one
    build = partial(applied, begun.base.rig, parts)
    for _ in range(ROUNDS + singly_bent(begun.base.rig)):
        values = one.hypothesis.values
        about = base_of(one.base.record, build(values), one.residual, scales_at(one.base, one.residual))
        done = fit(about, build, values, steps_of(parts), bounds_of(parts), one.residual)
        better = _tried(begun, parts, done.values, done.covariance, about, done.residual)
        gained = one.cost - better.cost
        one = better if gained > 0 else one
        if gained < SETTLED or one.cost > least + FAR:
            break
    return one


def _refined_all(begun: Search, rivals: Iterable[Tried], least: float = np.inf) -> list[Tried]:
    """The best to the end, the others as far as they stay near it."""
    found = []
    for one in sorted(rivals, key=_cost):
        found.append(refined(begun, one, least))
        least = min(least, found[-1].cost)
    return sorted(found, key=_cost)


def steps_of(parts: tuple[Candidate, ...]) -> Float[np.ndarray, " parameters"]:
    return np.concatenate([p.steps for p in parts])


def bounds_of(
    parts: tuple[Candidate, ...],
) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
    low, high = (np.concatenate(ends) for ends in zip(*(p.bounds for p in parts), strict=True))
    return low, high


def _tried(
    begun: Search,
    parts: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    base: Base,
    at: Residual,
) -> Tried:
    left = misfit(base.record, begun.reference, at)
    return Tried(Hypothesis(parts, values, covariance, left), base, at)


def _stochastic(begun: Search, nothing: Tried, candidate: Candidate) -> Tried | None:
    """An effect of which only the spectrum is known: its values are not fitted over time."""
    found = fit_base_excitation(nothing.base, nothing.residual, candidate, WORTH)
    if found is None:
        return None
    values, spread = found
    try:
        rig = candidate.applied(begun.base.rig, values)
    except RigError:
        return None
    base = base_of(begun.base.record, rig, nothing.residual, nothing.base.scales)
    base = rescaled(base, fitted(base, nothing.residual).residual)
    at = fitted(base, nothing.residual).residual
    return _tried(begun, (candidate,), values, np.diag(spread**2), base, at)


def straightened(at: Residual) -> Residual:
    """Where to start with an effect: nuisance parameters that were bent to do without it are straight again.

    They stay as they are where none is at its limit.
    """
    if np.max(np.abs(at.pulls), initial=0.0) < LIMIT - 1e-6:
        return at
    straight = tuple(replace(c, unknowns=np.append(c.unknowns[:-3], np.zeros(3))) for c in at.contacts)
    return replace(at, nuisance=np.zeros_like(at.nuisance), contacts=straight)


def _joins(candidate: Candidate, rig: Rig) -> bool:
    try:
        candidate.applied(rig, candidate.default)
    except RigError:
        return False
    return True
