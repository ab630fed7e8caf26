"""Search for any number of effects: joint sparse selection in the local model, refined by fits of the set.

Notes for maintainers
1. Select (`best_selection`): from the local model about the fitted rig, candidates enter one at a time, the six that
   promise most solved with all others free. One enters if S falls by `MIN_GAIN`; one leaves if S then rises by less. A
   candidate may stand at two places of a body (two cables are two masses).
2. Refine (`set_extended_by_selection`): the whole set is fitted by Gauss-Newton, the local model is made anew about it,
   and more is selected beside it, until nothing enters or a fit does not lower S by `MIN_REFINED_GAIN`. Where nothing
   is selected, the three that gain most are fitted whatever they gain, as tolerances that stand far off bend the model.
3. Start from a single effect (`_with_single_start`): where a set leaves more than half of the mismatch, an effect is
   so large, or a line so sharp, that slopes say nothing of it. Then single effects are screened over their whole range;
   so they are beside sets of three and more, which may stand for one large effect, and so are pairs on bodies without
   contacts (`far_sets`). A free decay whose modes are known starts so at once: no slope leads from one resonance to
   another.
4. Leave out (`reduced_and_variants`): linear removal of strong effects misleads, so the set is fitted again without
   each of its members. A member without which S rises by less than `MIN_GAIN` leaves the set. Then members leave one
   after the other, the least important first, so that the record that was not fitted may demand fewer.
5. Exchange (`_look_alike_fit`): about the set without a member, the candidate that then lowers S most is fitted in its
   place, so that look-alikes are compared on the record that was not fitted. A look-alike that makes others
   superfluous is fitted without them too, and is the best set if S then rises by less than `MIN_GAIN`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from jaxtyping import Float

from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.search.beside_set import is_stochastic, linearized_about, search_about, with_base_motion, with_tone
from identify.gaps.search.candidates import Candidate, contains, equivalent_names, is_possible
from identify.gaps.search.far_sets import large_effect_fits
from identify.gaps.search.hypothesis import (
    MAX_EXCESS_COST,
    MIN_GAIN,
    FittedHypothesis,
    Hypothesis,
    Search,
    combined_hypothesis,
    fit_briefly,
    refined,
    reset_saturated_nuisance,
)
from identify.gaps.search.local_model import CandidateTerm, LocalModel, Solution, local_model
from identify.gaps.search.singles import single_effect_fits
from identify.pages.wording import COVERED
from identify.signals.refit import refit_until_settled
from rig.errors import RigError

SOLVED_CANDIDATE_COUNT = 6
"""Candidates solved for each entry, those that promise most. Effort."""
MAX_PLACES_PER_CANDIDATE = 2
"""Places of one candidate among these at most. Effort."""
MAX_SET_SIZE = 8
"""Effects of a set at most. Set by hand."""
MAX_EQUAL_EFFECTS = 2
"""Effects of one kind on one body at most. Set by hand."""
MAX_SELECTION_ROUNDS = 4
"""Refinements at most. Effort."""
MIN_REFINED_GAIN = 3.0
"""Decrease of S below which a refined set is dropped: odds of e^(3/12) on this record. Set by hand."""
HINT_GAIN, MAX_HINTS = MIN_GAIN / 3, 3
"""Gain in the local model from which a candidate is fitted if none gains `MIN_GAIN`; number at most. Set by hand: a
third of `MIN_GAIN`."""
DOMINANT_MISFIT_SHARE = 0.5
"""Share of the mismatch above which a set is compared with one that starts from a single effect. Derived: more is left
than removed."""
DOUBTFUL_SET_SIZE = 3
"""Number of effects in a set from which single effects are compared with it. Set by hand: a supported beam that was
10 % softer was taken for two masses, a gain and a base motion."""

EffectValues = Float[np.ndarray, " _"]
"""Parameters of one effect, whose number differs among effects."""


@dataclass(frozen=True)
class Selection:
    """Candidates chosen in a local model with the values of their parameters; hint_candidates gain too little."""

    candidates: tuple[Candidate, ...]
    values_by_candidate: tuple[EffectValues, ...]
    hint_candidates: tuple[tuple[Candidate, EffectValues], ...] = ()


def ranked_hypotheses(search: Search, progress: Callable[[float], None] = lambda _: None) -> list[Hypothesis]:
    """Hypotheses by their -2 ln p on this record, least first.

    These are the nominal rig, the best set of effects, this set without some of its members, and its look-alikes.
    """
    nominal_fit = search.nominal_fit()
    likeliest = nominal_fit if search.linearization.record.measured_modes else _settled_set(search, nominal_fit)
    progress(0.4)
    likeliest, rivals = _with_single_start(search, nominal_fit, likeliest)
    progress(0.6)
    likeliest, variants = reduced_and_variants(search, with_base_motion(search, with_tone(search, likeliest)))
    progress(1.0)
    hypotheses = (nominal_fit.hypothesis, likeliest.hypothesis, *variants, *rivals)
    by_effects = {equivalent_names(hypothesis.candidates): hypothesis for hypothesis in reversed(hypotheses)}
    return sorted(by_effects.values(), key=attrgetter("cost"))


def _settled_set(search: Search, start_set: FittedHypothesis) -> FittedHypothesis:
    """Set at which rounds of selection and refinement end."""
    return refit_until_settled(
        start_set,
        lambda fitted: set_extended_by_selection(search, fitted),
        lambda before, after: before is after,
        max_rounds=MAX_SELECTION_ROUNDS,
    )


def _with_single_start(
    search: Search, nominal_fit: FittedHypothesis, best_set: FittedHypothesis
) -> tuple[FittedHypothesis, list[Hypothesis]]:
    """Better one of a set and of the set started from the best single effect, and that effect where the set is better.

    Single effects are fitted where the set leaves most of the misfit, where it is so large that one effect may stand
    behind it or, if the modes of a decay are known, where it leaves any of the misfit.
    """
    nominal_misfit, set_misfit = nominal_fit.hypothesis.misfit, best_set.hypothesis.misfit
    if search.linearization.record.measured_modes:
        is_doubtful = best_set.hypothesis.has_unexplained_misfit
    else:
        dominant_excess = max(MAX_EXCESS_COST, DOMINANT_MISFIT_SHARE * nominal_misfit.excess_cost)
        is_mostly_unexplained = set_misfit.line_cost > MIN_GAIN or set_misfit.excess_cost >= dominant_excess
        is_doubtful = is_mostly_unexplained or len(best_set.hypothesis.candidates) >= DOUBTFUL_SET_SIZE
    start_fits = [*single_effect_fits(search, nominal_fit), *large_effect_fits(search)] if is_doubtful else []
    if not start_fits:
        return best_set, []
    likeliest = min(start_fits, key=attrgetter("cost"))
    if likeliest.cost >= best_set.cost:
        return best_set, [likeliest.hypothesis]
    continue_fit = _base_motion_with_set if is_stochastic(likeliest.hypothesis) else _settled_set
    return continue_fit(search, likeliest), []


def _base_motion_with_set(search: Search, base_motion: FittedHypothesis) -> FittedHypothesis:
    """Base motion with the set found on the shaken rig, as a spectrum is not fitted by Gauss-Newton."""
    further_candidates = [candidate for candidate in search.candidates if not candidate.kind.stochastic]
    shaken_search = search_about(search, base_motion, further_candidates)
    best_set = _settled_set(shaken_search, shaken_search.nominal_fit())
    if not best_set.hypothesis.candidates:
        return base_motion
    return FittedHypothesis(combined_hypothesis(base_motion, best_set), best_set.linearization, best_set.residual)


def set_extended_by_selection(search: Search, best_set: FittedHypothesis) -> FittedHypothesis:
    """Set fitted together with what the local model selects beside it; the set itself where that gains too little."""
    if not best_set.hypothesis.has_unexplained_misfit:
        return best_set
    linearization, residual, model = _linearized_local_model(search, best_set)
    selection = best_selection(model, best_set.hypothesis)
    del model  # it is large, and so are the fits
    hint_additions = [((candidate,), (values,)) for candidate, values in selection.hint_candidates]
    additions = [(selection.candidates, selection.values_by_candidate)] if selection.candidates else hint_additions
    fits = (_brief_fit_with(search, best_set.hypothesis, *addition, residual, linearization) for addition in additions)
    brief_fit = min((fit for fit in fits if fit is not None), key=attrgetter("cost"), default=None)
    min_gain = MIN_REFINED_GAIN if selection.candidates else MIN_GAIN
    if brief_fit is None or (not selection.candidates and best_set.cost - brief_fit.cost <= min_gain):
        return best_set
    refined_fit = refined(search, brief_fit)
    return refined_fit if best_set.cost - refined_fit.cost > min_gain else best_set


def _linearized_local_model(search: Search, set_fit: FittedHypothesis) -> tuple[Linearization, Residual, LocalModel]:
    """Local model about a fitted set, with every further candidate that its rig can have."""
    nominal_rig, present_set = search.linearization.rig, set_fit.hypothesis
    rig = present_set.applied_to(nominal_rig)
    linearization, residual = linearized_about(set_fit, rig)
    further_candidates = [
        candidate
        for candidate in search.candidates
        if not (candidate.kind.stochastic or candidate.kind.grid_screened) and is_possible(candidate, rig)
    ]
    model = local_model(linearization, residual, search.nominal_variances, nominal_rig, present_set, further_candidates)
    return linearization, residual, model


def _brief_fit_with(
    search: Search,
    present_set: Hypothesis,
    candidates: tuple[Candidate, ...],
    values: tuple[EffectValues, ...],
    residual: Residual,
    linearization: Linearization,
) -> FittedHypothesis | None:
    """Fit of a set with further members by a few steps, without those that others contain; None where no rig has them
    all."""
    values_by_member = list(
        zip((*present_set.candidates, *candidates), (*present_set.values_by_candidate(), *values), strict=True)
    )
    kept_members = [
        (member, member_values)
        for member, member_values in values_by_member
        if not any(contains(container, member) for container, _ in values_by_member)
    ]
    members, start_values = zip(*kept_members, strict=True)
    try:
        return fit_briefly(
            search, members, np.concatenate(start_values), reset_saturated_nuisance(residual), linearization
        )
    except RigError:
        return None


def best_selection(model: LocalModel, present_set: Hypothesis) -> Selection:
    """Candidates that together lower S most, each by `MIN_GAIN` or more beside the others."""
    chosen_terms: list[CandidateTerm] = []
    solution = model.minimum(chosen_terms)
    hint_candidates: tuple[tuple[Candidate, EffectValues], ...] = ()
    while len(present_set.candidates) + len(chosen_terms) < MAX_SET_SIZE:
        promising_terms = _promising_terms(model, chosen_terms, present_set, solution)
        trials = [(model.minimum([*chosen_terms, term], solution.theta), term) for term in promising_terms]
        if not trials:
            break
        best_solution, term = min(trials, key=lambda pair: pair[0].statistic)
        if solution.statistic - best_solution.statistic < MIN_GAIN:
            hint_candidates = _hint_candidates(trials, solution)
            break
        is_dominant = solution.statistic - best_solution.statistic > MAX_EXCESS_COST
        chosen_terms, solution = model.without_superfluous([*chosen_terms, term], best_solution, MIN_GAIN)
        if is_dominant:  # the local model does not hold that far: fit first, then select further
            break
    values_by_candidate = tuple(term.values_at(solution.theta) for term in chosen_terms)
    return Selection(tuple(term.candidate for term in chosen_terms), values_by_candidate, hint_candidates)


def _hint_candidates(
    trials: Sequence[tuple[Solution, CandidateTerm]], current_solution: Solution
) -> tuple[tuple[Candidate, EffectValues], ...]:
    """Best candidates that gain `HINT_GAIN`, each at one place."""
    ranked_trials = sorted(trials, key=lambda pair: pair[0].statistic)
    values_by_hint = {
        term.candidate.name: (term.candidate, term.values_at(solution.theta))
        for solution, term in reversed(ranked_trials)
        if current_solution.statistic - solution.statistic > HINT_GAIN
    }
    return tuple(reversed(values_by_hint.values()))[:MAX_HINTS]


def _promising_terms(
    model: LocalModel, chosen_terms: Sequence[CandidateTerm], present_set: Hypothesis, solution: Solution
) -> list[CandidateTerm]:
    """Terms that promise most: of each candidate at most `MAX_PLACES_PER_CANDIDATE`, and none too often in the set."""
    selected_candidates = [*present_set.candidates, *(term.candidate for term in chosen_terms)]
    promised_decreases = model.promised_decreases(chosen_terms, solution)
    promising: list[CandidateTerm] = []
    for term_index in np.argsort(-promised_decreases):
        if len(promising) == SOLVED_CANDIDATE_COUNT or promised_decreases[term_index] <= 0:
            break
        term = model.candidate_terms[term_index]
        candidate = term.candidate
        equal_count = sum(member.name == candidate.name for member in selected_candidates)
        max_equal_count = MAX_EQUAL_EFFECTS if len(candidate.parameters) > len(term.strength_indices) else 1
        place_count = sum(chosen_term.candidate is candidate for chosen_term in promising)
        is_contained = any(contains(member, candidate) for member in selected_candidates)
        if not is_contained and equal_count < max_equal_count and place_count < MAX_PLACES_PER_CANDIDATE:
            promising.append(term)
    return promising


def reduced_and_variants(search: Search, best_set: FittedHypothesis) -> tuple[FittedHypothesis, list[Hypothesis]]:
    """Best set without members that gain too little, and its variants.

    The variants are the set without each member, with a look-alike in the place of each, and without the two, three and
    more least important ones.
    """
    candidates = best_set.hypothesis.candidates
    if not candidates or is_stochastic(best_set.hypothesis):
        return best_set, []
    member_indices = range(len(candidates))
    costs_without_member, variants = list[float](), list[Hypothesis]()
    for member_index in member_indices:
        reduced_fit = _subset_fit(search, best_set, [index for index in member_indices if index != member_index])
        if reduced_fit is None:
            costs_without_member.append(np.inf)
            continue
        if len(candidates) > 1 and reduced_fit.cost - best_set.cost < MIN_GAIN:
            return reduced_and_variants(search, reduced_fit)
        costs_without_member.append(reduced_fit.cost)
        variants.append(reduced_fit.hypothesis)
        if (look_alike_fit := _look_alike_fit(search, reduced_fit, candidates[member_index], best_set)) is not None:
            variants.append(look_alike_fit.hypothesis)
            strong_indices = _significant_member_indices(look_alike_fit.hypothesis)
            if 0 < len(strong_indices) < len(candidates):
                smaller_fit = _subset_fit(search, look_alike_fit, strong_indices)
                if smaller_fit is None:
                    continue
                if smaller_fit.cost - best_set.cost < MIN_GAIN:
                    return reduced_and_variants(search, smaller_fit)
                variants.append(smaller_fit.hypothesis)
    indices_by_importance = np.argsort(costs_without_member)  # the least important first
    for dropped_count in range(2, len(candidates)):
        retained_indices = sorted(indices_by_importance[dropped_count:].tolist())
        if (retained_fit := _subset_fit(search, best_set, retained_indices)) is not None:
            variants.append(retained_fit.hypothesis)
    return best_set, variants


def _significant_member_indices(hypothesis: Hypothesis) -> list[int]:
    """Indices of the members that have a strength whose 95 % interval excludes its neutral value."""
    neutral_values = [parameter.neutral for member in hypothesis.candidates for parameter in member.parameters]
    half_widths = COVERED * np.sqrt(np.diag(hypothesis.covariance))
    is_strong = [
        neutral is not None and abs(value - neutral) > half_width
        for neutral, value, half_width in zip(neutral_values, hypothesis.values, half_widths, strict=True)
    ]
    column_stops = np.cumsum([len(member.parameters) for member in hypothesis.candidates])
    return [index for index, strengths in enumerate(np.split(is_strong, column_stops[:-1])) if np.any(strengths)]


def _look_alike_fit(
    search: Search, reduced_fit: FittedHypothesis, member: Candidate, best_set: FittedHypothesis
) -> FittedHypothesis | None:
    """Set with the best look-alike in a member's place; None where its cost is far above the best."""
    linearization, residual, model = _linearized_local_model(search, reduced_fit)
    solution_without = model.minimum([])
    terms = _promising_terms(model, [], reduced_fit.hypothesis, solution_without)
    trials = [
        (model.minimum([term], solution_without.theta), term) for term in terms if term.candidate.name != member.name
    ]
    if not trials:
        return None
    solution, term = min(trials, key=lambda pair: pair[0].statistic)
    del model
    term_values = (term.values_at(solution.theta),)
    brief_fit = _brief_fit_with(search, reduced_fit.hypothesis, (term.candidate,), term_values, residual, linearization)
    if brief_fit is None or brief_fit.cost > best_set.cost + MAX_EXCESS_COST:
        return None
    return refined(search, brief_fit, best_set.cost)


def _subset_fit(search: Search, best_set: FittedHypothesis, member_indices: Sequence[int]) -> FittedHypothesis | None:
    """Fit of some members of the set without the others; the nominal rig where there are none. None where no rig has
    them alone, as a spring of negative stiffness without the one that holds it."""
    if not member_indices:
        return search.nominal_fit()
    members = tuple(best_set.hypothesis.candidates[index] for index in member_indices)
    start_values = best_set.hypothesis.values_of(member_indices)
    start_residual = reset_saturated_nuisance(best_set.residual)
    try:
        brief_fit = fit_briefly(search, members, start_values, start_residual, best_set.linearization)
    except RigError:
        return None
    return refined(search, brief_fit, best_set.cost)
