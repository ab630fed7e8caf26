"""The search for any number of effects: joint sparse selection in the local model, refined by fits of the set.

Notes for maintainers
1. Select (`selected`): from the local model about the fitted rig, candidates enter one at a time, the six that promise
   most solved with all others free; one enters if S falls by `WORTH`, one leaves if S then rises by less. A candidate
   may stand at two places of a body (two cables are two masses).
2. Refine (`refined_set`): the whole set is fitted by Gauss-Newton, the local model is made anew about it, and more is
   selected beside it, until nothing enters or a fit does not lower S by `GAINED`. Where nothing is selected, the three
   that gain most are fitted whatever they gain, as tolerances that stand far off bend the model.
3. Begin elsewhere (`_begun_by_single`): where a set leaves more than half of the mismatch, an effect is so large, or a
   line so sharp, that slopes say nothing of it. Then single effects are screened over their whole range. A free decay
   whose modes are told begins so at once: no slope leads from one resonance to another.
4. Leave out (`without_each`): linear removal of strong effects misleads, so the set is fitted again without each of its
   members. A member without which S rises by less than `WORTH` leaves the set. Then members leave one after the other,
   the least first, so that the record that was not fitted may ask for fewer.
5. Exchange (`_exchanged`): about the set without a member, the candidate that then lowers S most is fitted in its
   place, so that look-alikes are compared on the record that was not fitted.
"""

from collections.abc import Callable, Sequence
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
    reset_saturated_nuisance,
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
Values = Float[np.ndarray, " _"]
"""Parameters of one effect, whose number differs among effects."""


@dataclass(frozen=True)
class Selection:
    """Candidates chosen in a local model with the values of their parameters. hints are those that gain something,
    though less than is asked for."""

    parts: tuple[Candidate, ...]
    values: tuple[Values, ...]
    hints: tuple[tuple[Candidate, Values], ...] = ()


def search(context: Search, progress: Progress = lambda _: None) -> list[Hypothesis]:
    """The nominal rig, the best set of effects, that set without each of its members, and its look-alikes.

    The one of least -2 ln p on this record first.
    """
    nominal = context.nothing()
    best = nominal if context.linearization.record.modes else _refined_from(context, nominal)
    progress(0.4)
    best = _begun_by_single(context, nominal, best)
    progress(0.6)
    best, others = without_each(context, _with_base_motion(context, best))
    progress(1.0)
    hypotheses = (nominal.hypothesis, best.hypothesis, *others)
    return sorted({h.key: h for h in reversed(hypotheses)}.values(), key=lambda hypothesis: hypothesis.cost)


def _refined_from(context: Search, start: Tried) -> Tried:
    """The set that rounds of selection and refinement end at."""
    return refit_until_settled(
        start, lambda best: refined_set(context, best), lambda before, after: before is after, rounds=ROUNDS
    )


def _begun_by_single(context: Search, nominal: Tried, best: Tried) -> Tried:
    """The better of a set and one that begins with the best single effect, where the set leaves most of the misfit, or
    the record tells modes."""
    before, after = nominal.hypothesis.misfit, best.hypothesis.misfit
    if context.linearization.record.modes:
        leaves_most = best.hypothesis.leaves_something
    else:
        leaves_most = after.sharp > WORTH or after.excess >= max(FAR, DOMINANT * before.excess)
    singles = single_effects(context, nominal) if leaves_most else []
    if not singles or singles[0].cost >= best.cost:
        return best
    first, *_ = singles
    return _with_set_beside(context, first) if _is_stochastic(first.hypothesis) else _refined_from(context, first)


def _is_stochastic(hypothesis: Hypothesis) -> bool:
    return any(part.kind.stochastic for part in hypothesis.parts)


def _with_set_beside(context: Search, base: Tried) -> Tried:
    """A base motion, and the set beside it, searched on the shaken rig: a spectrum is not fitted by Gauss-Newton."""
    shaken = _search_about(context, base, [c for c in context.known if not c.kind.stochastic])
    settled = _refined_from(shaken, shaken.nothing())
    return Tried(beside(base, settled), settled.linearization, settled.residual) if settled.hypothesis.parts else base


def _search_about(context: Search, tried: Tried, candidates: Sequence[Candidate]) -> Search:
    """A search whose nominal rig is that of a fitted set."""
    rig = tried.hypothesis.applied_to(context.linearization.rig)
    return Search(context.reference, *_about(tried, rig), tuple(candidates))


def refined_set(context: Search, best: Tried) -> Tried:
    """The set with what the local model selects beside it, fitted together; itself where nothing more is worth it."""
    if not best.hypothesis.leaves_something:
        return best
    linearization, residual, model = _model_about(context, best)
    selection = selected(model, best.hypothesis)
    more = [(selection.parts, selection.values)] if selection.parts else [((c,), (v,)) for c, v in selection.hints]
    fits = (_fitted_beside(context, best.hypothesis, *one, residual, linearization) for one in more)
    brief = min((one for one in fits if one is not None), key=lambda one: one.cost, default=None)
    asked = GAINED if selection.parts else WORTH
    if brief is None or (not selection.parts and best.cost - brief.cost <= asked):
        return best
    better = refined(context, brief)
    return better if best.cost - better.cost > asked else best


def _model_about(context: Search, tried: Tried) -> tuple[Linearization, Residual, LocalModel]:
    """The local model about a fitted set, of every candidate that its rig can have beside."""
    rig = tried.hypothesis.applied_to(context.linearization.rig)
    linearization, residual = _about(tried, rig)
    steady = [c for c in context.known if not (c.kind.stochastic or c.kind.grid_screened) and joins(c, rig)]
    nominal, present = context.linearization.rig, tried.hypothesis
    return linearization, residual, local_model(linearization, residual, context.reference, nominal, present, steady)


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
        return fit_briefly(context, (*present.parts, *parts), together, reset_saturated_nuisance(at), linearization)
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
    return Selection(
        tuple(term.candidate for term in chosen), tuple(term.values(solution.theta) for term in chosen), hints
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
    """Set without the members that the others have made superfluous."""
    for term in chosen[:-1]:
        rest = [other for other in chosen if other is not term]
        without = model.solved(rest, solution.theta)
        if without.statistic - solution.statistic < WORTH:
            chosen, solution = rest, without
    return chosen, solution


def without_each(context: Search, best: Tried) -> tuple[Tried, list[Hypothesis]]:
    """The set, less members that are not worth it; and it fitted again without each of those that stay, with a
    look-alike in the place of each, and without the least two, three and so on."""
    parts = best.hypothesis.parts
    if not parts or _is_stochastic(best.hypothesis):
        return best, []
    every = range(len(parts))
    costs: list[float] = []
    hypotheses: list[Hypothesis] = []
    for k in every:
        without = _with_members(context, best, [i for i in every if i != k])
        if len(parts) > 1 and without.cost - best.cost < WORTH:
            return without_each(context, without)
        costs.append(without.cost)
        hypotheses.append(without.hypothesis)
        if (exchanged := _exchanged(context, without, parts[k], best)) is not None:
            hypotheses.append(exchanged.hypothesis)
    order = np.argsort(costs)  # the least important first
    for leaving in range(2, len(parts)):
        rest = sorted(order[leaving:].tolist())
        hypotheses.append(_with_members(context, best, rest).hypothesis)
    return best, hypotheses


def _exchanged(context: Search, without: Tried, member: Candidate, best: Tried) -> Tried | None:
    """The set with what stands best in a member's place; None where nothing comes near it."""
    linearization, residual, model = _model_about(context, without)
    nominal = model.solved([])
    others = [t for t in _promising(model, [], without.hypothesis, nominal) if t.candidate.name != member.name]
    solved = [(model.solved([term], nominal.theta), term) for term in others]
    if not solved:
        return None
    solution, term = min(solved, key=lambda pair: pair[0].statistic)
    values = (term.values(solution.theta),)
    brief = _fitted_beside(context, without.hypothesis, (term.candidate,), values, residual, linearization)
    if brief is None or brief.cost > best.cost + FAR:
        return None
    return refined(context, brief, best.cost)


def _with_members(context: Search, best: Tried, members: Sequence[int]) -> Tried:
    """Some members of the set, fitted again without the others; the nominal rig where there are none."""
    if not members:
        return context.nothing()
    parts, values = best.hypothesis.parts, best.hypothesis.split()
    rest = tuple(parts[k] for k in members)
    start = reset_saturated_nuisance(best.residual)
    brief = fit_briefly(context, rest, np.concatenate([values[k] for k in members]), start, best.linearization)
    return refined(context, brief, best.cost)


def _with_base_motion(context: Search, best: Tried) -> Tried:
    """A base motion beside the settled set, where its own likelihood is strong."""
    stochastic = [c for c in context.known if c.kind.stochastic]
    if not stochastic or _is_stochastic(best.hypothesis) or not best.hypothesis.leaves_something:
        return best
    about = _search_about(context, best, ())
    for candidate in stochastic:
        shaken = fit_spectrum(about, about.nothing(), candidate)
        if shaken and best.cost - shaken.cost > WORTH:
            return Tried(beside(best, shaken), shaken.linearization, shaken.residual)
    return best
