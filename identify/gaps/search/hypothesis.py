"""Hypotheses on a record: sets of effects in the rig, their fit, and the misfit that they leave."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from identify.gaps.residual.fit import MAX_STEPS, BuildRig, Values, fit
from identify.gaps.residual.likelihood import Misfit, NominalVariances, misfit
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.residual import Linearization, Residual, scales_from_residual, with_estimated_scales
from identify.gaps.residual.scales import Scales, prior_scales
from identify.gaps.residual.tuning import TUNED_KINDS
from identify.gaps.search.base_spectrum import fit_base_spectrum
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.nominal import nuisance_fit, relinearizations, stated_refits
from identify.signals.refit import refit_until_settled
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.parameters import ParameterSet

MIN_GAIN = 20.0
"""Gain in -2 ln p below which an effect is not fitted: a good third of what the prior of one among some 26 effects at
some 4 places, and the temperature of the comparison, demand: 2 * 6 * ln(0.3 * 26 * 4 / 0.35) = 54."""
FIRST_STEPS, REFIT_ROUNDS, COST_TOLERANCE, SCALE_TOLERANCE = 3, 4, 1.0, 0.1
"""Steps of a first fit; rounds of the following refits at most; gain in -2 ln p, and relative change of the scales,
below which they have settled. Effort."""
MAX_EXCESS_COST = 200.0
"""Excess in -2 ln p over the best hypothesis from which one is neither fitted until it settles nor compared on another
record: odds of e^(200 / (2 * 6)) = 2e7 on a single record."""
PULL_LIMIT_SHARE = 0.99
"""Share of `PULL_LIMIT` from which a tolerance stands at its limit."""
MODE_RESET_PULL = 1.0
"""Deviation of a mode's tolerance, in standard deviations, from which a refit begins without any. Set by hand: a decay
that rubs was explained by damping beyond its tolerance, and the friction was placed elsewhere."""
CHANCE_PULL = 3.0
"""Stated standard deviations beyond which a tolerance is not off by chance: an effect may pull it. Derived: a normal
variable exceeds it once in 370."""
TWIN_DEVIATIONS = 2.0
"""Standard deviations below which the places of two equal effects do not differ. Convention."""


@dataclass(frozen=True)
class Hypothesis:
    """Set of effects in the rig with the fitted values of their parameters; the empty set is the nominal rig."""

    candidates: tuple[Candidate, ...]
    values: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    misfit: Misfit

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(candidate.kind.name for candidate in self.candidates)

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Names of the effects with their places, sorted; one may occur twice."""
        return tuple(sorted(candidate.name for candidate in self.candidates))

    @property
    def cost(self) -> float:
        """-2 ln p of the record to which it was fitted."""
        return self.misfit.minus_two_log

    @property
    def has_unexplained_misfit(self) -> bool:
        """True if the misfit above noise and tolerated shares exceeds what an effect must gain, or if a tolerance is
        pulled far off, so that it hides the misfit."""
        return self.misfit.excess_cost > MIN_GAIN or float(np.max(np.abs(self.misfit.pulls), initial=0.0)) > CHANCE_PULL

    @property
    def has_tolerance_at_limit(self) -> bool:
        """True if a tolerance stands at its limit."""
        return bool(np.any(np.abs(self.misfit.pulls) > PULL_LIMIT_SHARE * PULL_LIMIT))

    def values_by_candidate(self) -> list[Float[np.ndarray, " parameters"]]:
        """Fitted parameters of each effect."""
        return _values_by_candidate(self.candidates, self.values)

    def values_of(self, member_indices: Sequence[int]) -> Values:
        """Parameters of some members; one of them adds the strength of an equal at its place that is not among them.

        Strengths of effects that have a place are zero where they are neutral.
        """
        values = self.values_by_candidate()
        retained_values = {index: values[index].copy() for index in member_indices}
        for dropped_index in set(range(len(values))) - set(member_indices):
            candidate = self.candidates[dropped_index]
            twins = [k for k in member_indices if self.candidates[k].name == candidate.name]
            if (twin := next((k for k in twins if self._are_at_one_place(k, dropped_index)), None)) is not None:
                strengths = candidate.parameters.strengths
                retained_values[twin][strengths] += values[dropped_index][strengths]
        return np.concatenate(list(retained_values.values()))

    def _are_at_one_place(self, first_index: int, second_index: int) -> bool:
        """True if two equal effects are at places that differ by less than `TWIN_DEVIATIONS`."""
        values, variances = (_values_by_candidate(self.candidates, v) for v in (self.values, np.diag(self.covariance)))
        distances = values[first_index] - values[second_index]
        deviations = np.sqrt(variances[first_index] + variances[second_index])
        strengths = self.candidates[first_index].parameters.strengths
        return bool(np.all(np.delete(np.abs(distances) < TWIN_DEVIATIONS * deviations, strengths)))

    @property
    def parameters(self) -> ParameterSet:
        return parameters_of(self.candidates)

    def applied_to(self, rig: Rig) -> Rig:
        return with_effects(rig, self.candidates, self.values)


@dataclass(frozen=True)
class FittedHypothesis:
    """Hypothesis with the linearisation and the residual of its fit, which take much memory."""

    hypothesis: Hypothesis
    linearization: Linearization
    residual: Residual

    @property
    def cost(self) -> float:
        return self.hypothesis.cost


def with_effects(rig: Rig, candidates: Sequence[Candidate], values: Values) -> Rig:
    """Rig with several effects, whose parameter values follow each other."""
    for candidate, candidate_values in zip(candidates, _values_by_candidate(candidates, values), strict=True):
        rig = candidate.applied(rig, candidate_values)
    return rig


def _values_by_candidate(candidates: Sequence[Candidate], values: Values) -> list[Float[np.ndarray, " _"]]:
    end_indices = np.cumsum([len(candidate.parameters) for candidate in candidates])
    return np.split(values, end_indices[:-1]) if candidates else []


@dataclass(frozen=True)
class Search:
    """Search on one record: the nominal variances, the nominal rig's linearisation and fit, and the candidates."""

    nominal_variances: NominalVariances
    linearization: Linearization
    nominal_residual: Residual
    candidates: tuple[Candidate, ...]

    def nominal_fit(self) -> FittedHypothesis:
        return _fitted_hypothesis(self, (), np.zeros(0), np.zeros((0, 0)), self.linearization, self.nominal_residual)


def fit_effects(
    search: Search,
    candidates: tuple[Candidate, ...],
    start_values: Values,
    start_residual: Residual,
    best_cost: float = np.inf,
) -> FittedHypothesis:
    """Fit of effects until it settles, from given values and the nuisance parameters and drifts of a residual."""
    start_residual = reset_saturated_nuisance(start_residual)
    return refined(search, fit_briefly(search, candidates, start_values, start_residual), best_cost)


def fit_briefly(
    search: Search,
    candidates: tuple[Candidate, ...],
    start_values: Values,
    start_residual: Residual | None,
    linearization: Linearization | None = None,
) -> FittedHypothesis:
    """Fit of effects by `FIRST_STEPS` Gauss-Newton steps at the scales of a linearisation (default: the nominal rig's).

    Without a start no nuisance parameter has compensated the effects, so the linearisation is about their values.
    """
    linearization, build_rig = linearization or search.linearization, _rig_builder(search, candidates)
    if start_residual is None:
        start_rig, scales, observations = build_rig(start_values), linearization.scales, linearization.observations
        linearization = linearization.relinearized(start_rig, None, scales, observations)
    return _gauss_newton(search, build_rig, candidates, start_values, linearization, start_residual, FIRST_STEPS)


def fit_from_prior_scales(search: Search, candidates: tuple[Candidate, ...], start_values: Values) -> FittedHypothesis:
    """Fit of effects from the contact scales that the tolerances state, and from a slow motion that follows no law yet.

    A decay counts for few seconds: scales made by the nominal law would not come down in the rounds of `refined`.
    """
    build_rig = _rig_builder(search, candidates)
    contact_variances = prior_scales(search.linearization.record).contact_variances
    initial_scales = replace(search.linearization.scales, contact_variances=contact_variances)
    linearization = search.linearization.relinearized(build_rig(start_values), None, initial_scales)
    return _gauss_newton(search, build_rig, candidates, start_values, linearization)


def refined(search: Search, initial_fit: FittedHypothesis, best_cost: float = np.inf) -> FittedHypothesis:
    """Fit continued until it settles, with scales and linearisation renewed at the parameters of each round.

    An effect that is known by its spectrum alone keeps its values. The rounds end where the cost stays
    `MAX_EXCESS_COST` above `best_cost`, the least of other hypotheses.
    """
    candidates, rig = initial_fit.hypothesis.candidates, search.linearization.rig
    if any(candidate.kind.stochastic for candidate in candidates):
        return initial_fit
    round_limit = REFIT_ROUNDS + relinearizations(rig)
    return best_refit(search, _rig_builder(search, candidates), initial_fit, round_limit, best_cost)


def fit_from(
    search: Search, build_rig: BuildRig, candidates: tuple[Candidate, ...], start_values: Values, round_limit: int
) -> FittedHypothesis:
    """Fit of effects in the rigs of `build_rig` until it settles, from the fit of another rig."""
    linearization = search.linearization.relinearized(build_rig(start_values), None, search.linearization.scales)
    start_residual = reset_saturated_nuisance(search.nominal_residual)
    initial_fit = _gauss_newton(search, build_rig, candidates, start_values, linearization, start_residual)
    return best_refit(search, build_rig, initial_fit, round_limit)


def best_refit(
    search: Search, build_rig: BuildRig, initial_fit: FittedHypothesis, round_limit: int, best_cost: float = np.inf
) -> FittedHypothesis:
    """Best of successive refits, each linearised at the parameters and with the scales of the one before.

    Scales that an effect has made superfluous come down over some refits, of which the first may gain nothing. Without
    contacts, refits at the stated scales follow: larger ones absorb the error of a linearised resonance.
    """
    candidates, likeliest, record = initial_fit.hypothesis.candidates, initial_fit, search.linearization.record
    stated_scale_rounds = stated_refits(search.linearization.rig)

    def refit(earlier: FittedHypothesis) -> FittedHypothesis:
        return refit_at(earlier, scales_from_residual(earlier.linearization, earlier.residual))

    def refit_at(earlier: FittedHypothesis, scales: Scales) -> FittedHypothesis:
        nonlocal likeliest
        earlier_values = earlier.hypothesis.values
        start_residual = reset_mode_nuisance(earlier.residual) if stated_scale_rounds else earlier.residual
        linearization = earlier.linearization.relinearized(build_rig(earlier_values), start_residual, scales)
        later = _gauss_newton(search, build_rig, candidates, earlier_values, linearization, start_residual)
        likeliest = min(likeliest, later, key=lambda fitted_hypothesis: fitted_hypothesis.cost)
        return later

    def settled(earlier: FittedHypothesis, later: FittedHypothesis) -> bool:
        scale_change = earlier.linearization.scales.log_share_distance(later.linearization.scales)
        is_settled = scale_change < SCALE_TOLERANCE and abs(earlier.cost - later.cost) < COST_TOLERANCE
        return is_settled or later.cost > best_cost + MAX_EXCESS_COST

    latest_fit = refit_until_settled(initial_fit, refit, settled, max_rounds=round_limit)
    if stated_scale_rounds and latest_fit.cost <= best_cost + MAX_EXCESS_COST:
        latest_fit = refit_until_settled(
            likeliest, lambda earlier: refit_at(earlier, prior_scales(record)), max_rounds=stated_scale_rounds
        )
        refit_until_settled(latest_fit, refit, settled, max_rounds=round_limit)
    return likeliest


def _rig_builder(search: Search, candidates: tuple[Candidate, ...]) -> BuildRig:
    return partial(with_effects, search.linearization.rig, candidates)


def _gauss_newton(
    search: Search,
    build_rig: BuildRig,
    candidates: tuple[Candidate, ...],
    start_values: Values,
    linearization: Linearization,
    start_residual: Residual | None = None,
    max_steps: int = MAX_STEPS,
) -> FittedHypothesis:
    """Gauss-Newton fit of effects and nuisance parameters in a linearisation."""
    bounds = parameters_of(candidates).bounds
    fitted = fit(linearization, build_rig, start_values, step_sizes_of(candidates), bounds, start_residual, max_steps)
    return _fitted_hypothesis(search, candidates, fitted.values, fitted.covariance, linearization, fitted.residual)


def step_sizes_of(candidates: tuple[Candidate, ...]) -> Float[np.ndarray, " parameters"]:
    return np.concatenate([np.zeros(0), *(candidate.step_sizes for candidate in candidates)])


def parameters_of(candidates: Sequence[Candidate]) -> ParameterSet:
    """Parameters of several effects in sequence, each marked with the name of its candidate."""
    return sum((candidate.parameters.with_owner(candidate.name) for candidate in candidates), ParameterSet())


def _fitted_hypothesis(
    search: Search,
    candidates: tuple[Candidate, ...],
    values: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    linearization: Linearization,
    residual: Residual,
) -> FittedHypothesis:
    record_misfit = misfit(linearization.record, search.nominal_variances, residual)
    return FittedHypothesis(Hypothesis(candidates, values, covariance, record_misfit), linearization, residual)


def fit_stochastic_effect(
    search: Search, nominal_fit: FittedHypothesis, candidate: Candidate, beside_set: bool = False
) -> FittedHypothesis | None:
    """Fit of an effect that is known by its spectrum alone, so that its values are not fitted over time;
    `beside_set` as in `fit_base_spectrum`."""
    if not nominal_fit.hypothesis.has_unexplained_misfit:
        return None
    estimate = fit_base_spectrum(nominal_fit.linearization, nominal_fit.residual, candidate, MIN_GAIN, beside_set)
    return None if estimate is None else fit_nuisance_at_values(search, nominal_fit, candidate, *estimate)


def fit_nuisance_at_values(
    search: Search,
    nominal_fit: FittedHypothesis,
    candidate: Candidate,
    values: Float[np.ndarray, " parameters"],
    standard_errors: Float[np.ndarray, " parameters"],
) -> FittedHypothesis | None:
    """Fit of the nuisance parameters beside an effect of given values; None where the rig does not take it."""
    try:
        rig = candidate.applied(search.linearization.rig, values)
    except RigError:
        return None
    scales = nominal_fit.linearization.scales
    linearization = search.linearization.relinearized(rig, nominal_fit.residual, scales)
    linearization = with_estimated_scales(linearization, nuisance_fit(linearization, nominal_fit.residual).residual)
    residual = nuisance_fit(linearization, nominal_fit.residual).residual
    return _fitted_hypothesis(search, (candidate,), values, np.diag(standard_errors**2), linearization, residual)


def reset_saturated_nuisance(residual: Residual) -> Residual:
    """Residual from which an effect is fitted: all nuisance parameters are reset if one stands at its limit."""
    if np.max(np.abs(residual.pulls), initial=0.0) < PULL_LIMIT - 1e-6:
        return residual
    reset_contacts = tuple(replace(contact, unknowns=contact.unknowns_without_pulls) for contact in residual.contacts)
    return replace(residual, nuisance_pulls=np.zeros_like(residual.nuisance_pulls), contacts=reset_contacts)


def reset_mode_nuisance(residual: Residual) -> Residual:
    """Residual with the tolerances of all modes reset to nominal, if one of them is strained.

    An effect on frequencies and these tolerances are nearly the same change of the rig: fitted together they advance by
    only part of the resonance's width per step.
    """
    is_mode_parameter = np.array([parameter.kind in TUNED_KINDS for parameter in residual.parameters], dtype=bool)
    if np.max(np.abs(residual.nuisance_pulls[is_mode_parameter]), initial=0.0) < MODE_RESET_PULL:
        return residual
    return replace(residual, nuisance_pulls=np.where(is_mode_parameter, 0.0, residual.nuisance_pulls))


def combined_hypothesis(base_fit: FittedHypothesis, added_fit: FittedHypothesis) -> Hypothesis:
    """Union of two hypotheses, of which the second was fitted with the first held."""
    base, added = base_fit.hypothesis, added_fit.hypothesis
    values, covariance = np.concatenate([base.values, added.values]), block_diag(base.covariance, added.covariance)
    return Hypothesis((*base.candidates, *added.candidates), values, covariance, added.misfit)
