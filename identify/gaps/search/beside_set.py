"""Unmeasured excitation beside a settled set: a tone, or a base motion.

Neither has a slope in the local model: the frequency of a tone is found on a grid, and a base motion is known by its
spectrum alone.
"""

from collections.abc import Sequence

import numpy as np

from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import (
    MIN_GAIN,
    FittedHypothesis,
    Hypothesis,
    Search,
    combined_hypothesis,
    fit_briefly,
    fit_nuisance_at_values,
    fit_stochastic_effect,
    refined,
    reset_saturated_nuisance,
)
from identify.gaps.search.nominal import nuisance_fit
from identify.gaps.search.singles import single_effect_fits
from rig.model.description import Rig


def is_stochastic(hypothesis: Hypothesis) -> bool:
    return any(candidate.kind.stochastic for candidate in hypothesis.candidates)


def linearized_about(set_fit: FittedHypothesis, set_rig: Rig) -> tuple[Linearization, Residual]:
    """Linearisation about the rig of a fitted set, with the tolerances fitted in it."""
    linearization = set_fit.linearization.relinearized(set_rig, set_fit.residual, set_fit.linearization.scales)
    return linearization, nuisance_fit(linearization, set_fit.residual).residual


def search_about(search: Search, set_fit: FittedHypothesis, remaining_candidates: Sequence[Candidate]) -> Search:
    """Search whose nominal rig is that of a fitted set."""
    set_rig = set_fit.hypothesis.applied_to(search.linearization.rig)
    return Search(search.nominal_variances, *linearized_about(set_fit, set_rig), tuple(remaining_candidates))


def with_tone(search: Search, best_set: FittedHypothesis) -> FittedHypothesis:
    """Settled set with a tone beside it, where lines stand out of what the set leaves and the tone lowers the cost by
    `MIN_GAIN`: strong effects hide such lines in what the nominal rig leaves."""
    tone_candidates = [candidate for candidate in search.candidates if candidate.kind.grid_screened]
    if not tone_candidates or is_stochastic(best_set.hypothesis) or best_set.hypothesis.misfit.line_cost <= MIN_GAIN:
        return best_set
    tone_search = search_about(search, best_set, tone_candidates)
    tone_fits = single_effect_fits(tone_search, tone_search.nominal_fit())
    if not tone_fits:
        return best_set
    joined_hypothesis = combined_hypothesis(best_set, tone_fits[0])
    start_residual = reset_saturated_nuisance(best_set.residual)
    brief_fit = fit_briefly(
        search, joined_hypothesis.candidates, joined_hypothesis.values, start_residual, best_set.linearization
    )
    joint_fit = refined(search, brief_fit)
    return joint_fit if best_set.cost - joint_fit.cost > MIN_GAIN else best_set


def with_base_motion(search: Search, best_set: FittedHypothesis) -> FittedHypothesis:
    """Settled set with a base motion beside it, where that lowers the cost by `MIN_GAIN`.

    The tolerances of the set have taken up a part of the base motion, so that its values in the nominal rig are tried,
    too.
    """
    base_candidates = [candidate for candidate in search.candidates if candidate.kind.stochastic]
    if not base_candidates or is_stochastic(best_set.hypothesis) or not best_set.hypothesis.has_unexplained_misfit:
        return best_set
    base_search = search_about(search, best_set, ())
    set_fit = base_search.nominal_fit()
    for candidate in base_candidates:
        base_motion_fit = fit_stochastic_effect(base_search, set_fit, candidate, beside_set=True)
        if base_motion_fit is None:
            continue
        if in_nominal_rig := fit_stochastic_effect(search, search.nominal_fit(), candidate, beside_set=True):
            values, variances = in_nominal_rig.hypothesis.values, np.diag(in_nominal_rig.hypothesis.covariance)
            other_fit = fit_nuisance_at_values(base_search, set_fit, candidate, values, np.sqrt(variances))
            base_motion_fit = min(filter(None, (base_motion_fit, other_fit)), key=lambda fitted: fitted.cost)
        if best_set.cost - base_motion_fit.cost > MIN_GAIN:
            joined_hypothesis = combined_hypothesis(best_set, base_motion_fit)
            return FittedHypothesis(joined_hypothesis, base_motion_fit.linearization, base_motion_fit.residual)
    return best_set
