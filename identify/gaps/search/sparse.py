"""The search for any number of effects: joint sparse selection in the local model, refined by fits of the set.

Notes for maintainers
1. Select (`selected`): from the local model about the fitted rig, candidates enter one at a time, the six that promise
   most solved with all others free; one enters if S falls by `WORTH`, one leaves if S then rises by less. A candidate
   may stand at two places of a body (two cables are two masses).
2. Refine (`refined_set`): the whole set is fitted by Gauss-Newton, the local model is made anew about it, and more is
   selected beside it, until nothing enters or a fit does not lower S by `GAINED`. Where nothing is selected, the three
   that gain most are fitted whatever they gain, as tolerances that stand far off bend the model.
3. Begin elsewhere (`_begun_by_single`): where a set leaves more than half of the mismatch, an effect is so large, or a
   line so sharp, that slopes say nothing of it. Then single effects are screened over their whole range.
4. Leave out (`without_each`): linear removal of strong effects misleads, so the set is fitted again without each of its
   members. A member without which S rises by less than `WORTH` leaves the set. Then members leave one after the other,
   the least first, so that the record that was not fitted may ask for fewer.
5. Exchange (`look_alikes`): a member that another candidate replaces at little cost is fitted exchanged too, so that
   both are compared on the record that was not fitted.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.search.candidates import Candidate, joins
from identify.gaps.search.hypothesis import (
    FAR,
    WORTH,
    Hypothesis,
    Search,
    Tried,
    beside,
    fit_briefly,
    fit_spectrum,
    refined,
    straightened,
)
from identify.gaps.search.local_model import CandidateTerm, LocalModel, Solution, local_model
from identify.gaps.search.nominal import fitted
from identify.gaps.search.singles import single_effects
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig

SOLVED = 6
"""Candidates solved for each entry: those that promise most, at two places of an effect at most."""
PLACES = 2
LARGEST_SET = 8
SAME_PLACE = 2
"""Effects of one kind on one body at most."""
ROUNDS = 4
GAINED = 3.0
"""A refined set must lower S by so much, or the last one stands: odds of e^(3/12) on this record."""
HINT, HINTS = WORTH / 3, 3
"""So many candidates that gain so much less than `WORTH` in the local model are fitted all the same."""
DOMINANT = 0.5
"""A set that leaves more than this share of the mismatch is tried against one that begins with a single effect."""

Progress = Callable[[float], None]
Values = Float[np.ndarray, " parameters"]


@dataclass(frozen=True)
class Selection:
    """Candidates chosen in a local model with the values of their parameters; of each the candidates that could stand
    in its place. hints are those that gain something, though less than is asked for."""

    parts: tuple[Candidate, ...]
    values: tuple[Values, ...]
    exchanges: dict[str, tuple[Candidate, Values]]
    hints: tuple[tuple[Candidate, Values], ...] = ()


@dataclass(frozen=True)
class FittedSet:
    """A set of effects fitted together; exchanges are look-alikes of its members, by the members' names."""

    tried: Tried
    exchanges: dict[str, tuple[Candidate, Values]]

    @property
    def hypothesis(self) -> Hypothesis:
        return self.tried.hypothesis


def search(context: Search, progress: Progress = lambda _: None) -> list[Hypothesis]:
    """The nominal rig, the best set of effects, that set without each of its members, and its look-alikes.

    The one of least -2 ln p on this record first.
    """
    nothing = FittedSet(context.nothing(), {})
    best = _refined_from(context, nothing)
    progress(0.4)
    best = _begun_by_single(context, nothing, best)
    progress(0.6)
    best, without = without_each(context, _with_base_motion(context, best))
    progress(0.8)
    found = (nothing.hypothesis, best.hypothesis, *without, *look_alikes(context, best))
    progress(1.0)
    return sorted({h.key: h for h in reversed(found)}.values(), key=lambda hypothesis: hypothesis.cost)


def _refined_from(context: Search, start: FittedSet) -> FittedSet:
    """The set that rounds of selection and refinement end at."""
    return refit_until_settled(
        start, lambda best: refined_set(context, best), lambda before, after: before is after, rounds=ROUNDS
    )


def _begun_by_single(context: Search, nothing: FittedSet, best: FittedSet) -> FittedSet:
    """The better of a set and one that begins with the best single effect, where the set leaves most of the misfit."""
    before, after = nothing.hypothesis.misfit, best.hypothesis.misfit
    if after.sharp <= WORTH and (after.excess < FAR or after.excess < DOMINANT * before.excess):
        return best
    singles = single_effects(context, nothing.tried)
    if not singles or singles[0].cost >= best.tried.cost:
        return best
    return _refined_from(context, FittedSet(singles[0], _runner_up(singles)))


def _runner_up(ranked: Sequence[Tried]) -> dict[str, tuple[Candidate, Values]]:
    """The last member of the second-best set as the exchange of that of the best, where it is nearly as good."""
    if len(ranked) < 2 or ranked[1].cost - ranked[0].cost > WORTH:
        return {}
    best, second = (one.hypothesis for one in ranked[:2])
    return {best.parts[-1].name: (second.parts[-1], second.split()[-1])}


def refined_set(context: Search, best: FittedSet) -> FittedSet:
    """The set with what the local model selects beside it, fitted together; itself where nothing more is worth it."""
    tried, rig = best.tried, best.hypothesis.applied_to(context.linearization.rig)
    if not best.hypothesis.leaves_something:
        return best
    linearization, at = _about(tried, rig)
    steady = [c for c in context.known if not (c.kind.stochastic or c.kind.grid_screened) and joins(c, rig)]
    selection = selected(local_model(linearization, at, context.reference, best.hypothesis, steady), best.hypothesis)
    more = [(selection.parts, selection.values)] if selection.parts else [((c,), (v,)) for c, v in selection.hints]
    brief = [
        one
        for parts, values in more
        if (one := _fitted_beside(context, best.hypothesis, parts, values, at, linearization)) is not None
    ]
    if not brief:
        return best
    ranked = sorted(brief, key=lambda one: one.cost)
    asked = GAINED if selection.parts else WORTH
    if not selection.parts and tried.cost - ranked[0].cost <= asked:
        return best
    better = refined(context, ranked[0])
    if tried.cost - better.cost <= asked:
        return best
    exchanges = selection.exchanges if selection.parts else _runner_up(ranked)
    return FittedSet(better, best.exchanges | exchanges)


def _fitted_beside(
    context: Search,
    present: Hypothesis,
    parts: tuple[Candidate, ...],
    values: tuple[Values, ...],
    at: Residual,
    linearization: Linearization,
) -> Tried | None:
    """A set with more members, fitted for a few steps; None where no rig has them all."""
    together = np.concatenate([present.values, *values])
    try:
        return fit_briefly(context, (*present.parts, *parts), together, straightened(at), linearization)
    except RigError:
        return None


def _about(tried: Tried, rig: Rig) -> tuple[Linearization, Residual]:
    """A fitted set linearised about its own rig, tolerances fitted there."""
    linearization = tried.linearization.about(rig, tried.residual, tried.linearization.scales)
    return linearization, fitted(linearization, tried.residual).residual


def selected(model: LocalModel, present: Hypothesis) -> Selection:
    """The candidates that together lower S most, each by `WORTH` or more beside the others."""
    chosen: list[CandidateTerm] = []
    solution = model.solved(chosen)
    hints: tuple[tuple[Candidate, Values], ...] = ()
    while len(present.parts) + len(chosen) < LARGEST_SET:
        promising = _promising(model, chosen, present, solution)
        tried = [(model.solved([*chosen, term], solution.theta), term) for term in promising]
        if not tried:
            break
        better, term = min(tried, key=lambda pair: pair[0].statistic)
        if solution.statistic - better.statistic < WORTH:
            hints = _hints(tried, solution)
            break
        dominates = solution.statistic - better.statistic > FAR
        chosen, solution = _pruned(model, [*chosen, term], better)
        if dominates:  # so large a change bends the model: it is fitted before others are selected
            break
    exchanges = {}
    for term in chosen:
        if (other := _exchange(model, [t for t in chosen if t is not term], term, present, solution)) is not None:
            exchanges[term.candidate.name] = other
    return Selection(
        tuple(term.candidate for term in chosen),
        tuple(term.values(solution.theta) for term in chosen),
        exchanges,
        hints,
    )


def _hints(tried: Sequence[tuple[Solution, CandidateTerm]], before: Solution) -> tuple[tuple[Candidate, Values], ...]:
    """The best candidates that gain `HINT`, each at one place."""
    ranked = sorted(tried, key=lambda pair: pair[0].statistic)
    worth = {
        term.candidate.name: (term.candidate, term.values(solution.theta))
        for solution, term in reversed(ranked)
        if before.statistic - solution.statistic > HINT
    }
    return tuple(reversed(worth.values()))[:HINTS]


def _exchange(
    model: LocalModel, rest: list[CandidateTerm], member: CandidateTerm, present: Hypothesis, solution: Solution
) -> tuple[Candidate, Values] | None:
    """What stands best in a member's place, if S then rises by less than `WORTH`."""
    without = model.solved(rest, solution.theta)
    others = [t for t in _promising(model, rest, present, without) if t.candidate.name != member.candidate.name]
    tried = [(model.solved([*rest, term], without.theta), term) for term in others]
    if not tried:
        return None
    best, term = min(tried, key=lambda pair: pair[0].statistic)
    close = best.statistic - solution.statistic < WORTH
    return (term.candidate, term.values(best.theta)) if close else None


def _promising(
    model: LocalModel, chosen: Sequence[CandidateTerm], present: Hypothesis, solution: Solution
) -> list[CandidateTerm]:
    """The terms that promise most, at most `PLACES` of any candidate and none too often in the set."""
    taken = [*present.parts, *(term.candidate for term in chosen)]
    promised = model.promised(chosen, solution)
    found: list[CandidateTerm] = []
    for k in np.argsort(-promised):
        term = model.terms[k]
        same = [c for c in taken if c.name == term.candidate.name]
        most = SAME_PLACE if len(term.candidate.parameters) > len(term.strengths) else 1
        if len(found) == SOLVED or promised[k] <= 0:
            break
        if len(same) < most and sum(f.candidate is term.candidate for f in found) < PLACES:
            found.append(term)
    return found


def _pruned(model: LocalModel, chosen: list[CandidateTerm], solution: Solution) -> tuple[list[CandidateTerm], Solution]:
    """Without the members that the others have made superfluous."""
    for term in chosen[:-1]:
        rest = [other for other in chosen if other is not term]
        without = model.solved(rest, solution.theta)
        if without.statistic - solution.statistic < WORTH:
            chosen, solution = rest, without
    return chosen, solution


def without_each(context: Search, best: FittedSet) -> tuple[FittedSet, list[Hypothesis]]:
    """The set, less members that are not worth it; and it fitted again without each of those that stay, and without the
    least two, three and so on."""
    parts = best.hypothesis.parts
    if len(parts) < 2 or any(part.kind.stochastic for part in parts):  # without its only member it is the nominal rig
        return best, []
    every = range(len(parts))
    costs: list[float] = []
    fitted_without: list[Hypothesis] = []
    for k in every:
        without = _with_members(context, best.tried, [i for i in every if i != k])
        if without.cost - best.tried.cost < WORTH:
            return without_each(context, FittedSet(without, best.exchanges))
        costs.append(without.cost)
        fitted_without.append(without.hypothesis)
    order = np.argsort(costs)  # the least important first
    for leaving in range(2, len(parts)):
        rest = sorted(order[leaving:].tolist())
        fitted_without.append(_with_members(context, best.tried, rest).hypothesis)
    return best, fitted_without


def _with_members(context: Search, best: Tried, members: Sequence[int]) -> Tried:
    """Some members of the set, fitted again without the others."""
    parts, values = best.hypothesis.parts, best.hypothesis.split()
    rest = tuple(parts[k] for k in members)
    start = straightened(best.residual)
    brief = fit_briefly(context, rest, np.concatenate([values[k] for k in members]), start, best.linearization)
    return refined(context, brief, best.cost)


def look_alikes(context: Search, best: FittedSet) -> list[Hypothesis]:
    """The set with a member exchanged for what the local model holds nearly as good, fitted."""
    parts, values = best.hypothesis.parts, best.hypothesis.split()
    if any(part.kind.stochastic for part in parts):
        return []
    found = []
    for k, part in enumerate(parts):
        if (other := best.exchanges.get(part.name)) is None or other[0] in parts:
            continue
        exchanged = (*parts[:k], other[0], *parts[k + 1 :])
        start = np.concatenate([*values[:k], other[1], *values[k + 1 :]])
        with suppress(RigError):
            tried = fit_briefly(context, exchanged, start, straightened(best.tried.residual), best.tried.linearization)
            if tried.cost < best.tried.cost + FAR:
                found.append(refined(context, tried, best.tried.cost).hypothesis)
    return found


def _with_base_motion(context: Search, best: FittedSet) -> FittedSet:
    """A base motion beside the settled set, where its own likelihood is strong."""
    stochastic = [c for c in context.known if c.kind.stochastic]
    if not stochastic or not best.hypothesis.leaves_something:
        return best
    inner = Search(context.reference, *_about(best.tried, best.hypothesis.applied_to(context.linearization.rig)), ())
    for candidate in stochastic:
        shaken = fit_spectrum(inner, inner.nothing(), candidate)
        if shaken and best.tried.cost - shaken.cost > WORTH:
            return FittedSet(Tried(beside(best.tried, shaken), shaken.linearization, shaken.residual), best.exchanges)
    return best
