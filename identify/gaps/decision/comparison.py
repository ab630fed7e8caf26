"""Comparison of hypotheses on the validation record: posterior probabilities, explained and unexplained shares.

Notes for maintainers
1. The effects keep the parameters of the fitted record; nuisance parameters, and what every record has of its own (the
   phase of a tone), are fitted anew:

       ln posterior = ln prior - (-2 ln p) / (2 TEMPERATURE)

   The temperature accounts for model error that neighbouring bands and both records share.
2. Priors: `PRIOR_NOTHING`; k effects `PRIOR_EFFECTS` (1 - a) a^(k - 1) with a = `FURTHER_EFFECT_SHARE`, shared equally
   by the sets of k effects, then by their places; something unmeasured `PRIOR_UNKNOWN`, shared by its places.
3. The inclusion probability of an effect is that of all sets that hold it, or a look-alike in its place.
4. Where the records differ from the rig and the validation record alone does not show it, the fitted record counts
   too.
5. Size of a mismatch in units of what matters, and the share that effects remove of it, with nuisance parameters as
   fitted beside the effects, so that no effect is credited with what tolerances absorb:

       size = sqrt((share / matters)^2 + sum_j (share_j / matters_contact)^2),   removed = 1 - size_with / size_without

   Its interval is a bootstrap over the seconds of the record.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.special import logsumexp

from identify.gaps.residual.fit import fit
from identify.gaps.residual.likelihood import Misfit, NominalVariances, misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.residual import Linearization, Residual, residual_of
from identify.gaps.results import Matters
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.hypothesis import Hypothesis, step_sizes_of, with_effects
from identify.gaps.search.nominal import fit_nuisance
from rig.errors import RigError
from rig.model.description import Rig

TEMPERATURE = 6.0
"""Divisor of -2 ln p between hypotheses: neighbouring bands and both records share model error that lasts. On tuning
cases the likelihood of the right hypotheses is largest at 7.9, the Brier score least at 5.1; on the worlds bench (seed
97002), own (97001) and wide (95003) it is largest at 12 (7.5 to 19.3, `blind_gap calibrate`), by one drag that was
called a damper, as no force of its law was judged then."""
PRIOR_NOTHING, PRIOR_EFFECTS, PRIOR_UNKNOWN = 0.3, 0.5, 0.2
"""Prior probabilities of no difference, of effects of the library, and of something outside the library. Set by
hand."""
FURTHER_EFFECT_SHARE = 0.43
"""Prior probability of k + 1 effects over that of k: as 0.15 to 0.35, two effects to one. Set by hand."""
BOOTSTRAP_DRAW_COUNT = 400
"""Bootstrap draws. Derived: the 2.5 % quantile is known to sqrt(0.025 * 0.975/400) = 0.8 %."""


@dataclass(frozen=True)
class ValidatedHypothesis:
    """A hypothesis on the validation record, with nuisance parameters fitted to that record.

    rig is the nominal rig with the effects; corrected_rig also holds the nuisance parameters, and has the misfit.
    nominal_misfit is that of the nominal rig with the same nuisance parameters (with its own where a base moves, whose
    motion is no function of time), so that its fall is due to the effects alone. contact_minus_two_log is -2 ln p of
    the contact laws by the contact fit of all records, where that was made.
    """

    hypothesis: Hypothesis
    rig: Rig
    corrected_rig: Rig
    misfit: Misfit
    nominal_misfit: Misfit
    log_prior: float
    contact_minus_two_log: float = 0.0

    @property
    def log_posterior(self) -> float:
        """Log posterior, up to a constant, given the validation record and the contact fit, whose covariance needs no
        temperature."""
        return self.log_prior - self.misfit.minus_two_log / (2 * TEMPERATURE) - self.contact_minus_two_log / 2

    @property
    def log_posterior_of_both_records(self) -> float:
        """Log posterior, up to a constant, given the fitted record too."""
        return self.log_posterior - self.hypothesis.cost / (2 * TEMPERATURE)


def nominal_hypothesis_of(ranked: Sequence[ValidatedHypothesis]) -> ValidatedHypothesis:
    """Hypothesis of the nominal rig."""
    return next(validated for validated in ranked if not validated.hypothesis.candidates)


def validate_hypotheses(
    record: Record,
    nominal_variances: NominalVariances,
    nominal_residual: Residual,
    hypotheses: Sequence[Hypothesis],
    log_prior_by_effects: Mapping[tuple[str, ...], float],
    progress: Callable[[float], None] = lambda _: None,
) -> list[ValidatedHypothesis]:
    """Validate hypotheses on a record that was not fitted; the likeliest first, without those that it cannot hold.

    nominal_residual is that of the nominal rig on this record. Parameters that every record has of its own (the phase
    of a tone) are fitted anew.
    """
    validated_hypotheses = []
    unchanged_misfit = misfit(record, nominal_variances, nominal_residual)
    for index, hypothesis in enumerate(hypotheses):
        rigs_and_misfits = (record.rig, record.rig, unchanged_misfit, unchanged_misfit)
        if hypothesis.candidates:
            try:
                rigs_and_misfits = _rigs_and_misfits(record, nominal_variances, unchanged_misfit, hypothesis)
            except RigError:
                continue
        prior = log_prior_by_effects[hypothesis.effect_names]
        validated_hypotheses.append(ValidatedHypothesis(hypothesis, *rigs_and_misfits, prior))
        progress((index + 1) / len(hypotheses))
    return sorted(validated_hypotheses, key=lambda validated: -validated.log_posterior)


def _rigs_and_misfits(
    record: Record, nominal_variances: NominalVariances, unchanged_misfit: Misfit, hypothesis: Hypothesis
) -> tuple[Rig, Rig, Misfit, Misfit]:
    """Rig with the effects, corrected rig, its misfit and that of the nominal rig, of a `ValidatedHypothesis`."""
    rig = record_specific_rig(record, hypothesis)
    linearization, residual = fit_nuisance(record, rig)
    nominal_misfit = nominal_misfit_with_same_nuisance(record, nominal_variances, linearization, residual)
    effects_misfit = misfit(record, nominal_variances, residual)
    return rig, residual.corrected_rig, effects_misfit, nominal_misfit or unchanged_misfit


def nominal_misfit_with_same_nuisance(
    record: Record, nominal_variances: NominalVariances, linearization: Linearization, residual: Residual
) -> Misfit | None:
    """Misfit of the nominal rig with the nuisance parameters of a rig with effects.

    None where the residuals differ in their rows: a moving base adds one.
    """
    if (linearization.rig.base_motion is None) != (record.rig.base_motion is None):
        return None
    contact_unknowns = tuple(contact.unknowns for contact in residual.contacts)
    nominal_residual = residual_of(linearization, record.rig, residual.nuisance_pulls, contact_unknowns)
    return misfit(record, nominal_variances, nominal_residual)


def record_specific_rig(record: Record, hypothesis: Hypothesis) -> Rig:
    """Rig with the hypothesis, with its record-specific parameters (the phase of a tone) fitted to this record."""
    specific_names = {candidate.name: candidate.kind.of_a_record for candidate in hypothesis.candidates}
    column_indices = [
        index for index, parameter in enumerate(hypothesis.parameters) if parameter.name in specific_names[parameter.of]
    ]
    if not column_indices:
        return hypothesis.applied_to(record.rig)

    def build(specific_values: Float[np.ndarray, " specific"]) -> Rig:
        all_values = hypothesis.values.copy()
        all_values[column_indices] = specific_values
        return with_effects(record.rig, hypothesis.candidates, all_values)

    start_rig = record.rig  # with a base motion's row, if there is one
    for candidate, values in zip(hypothesis.candidates, hypothesis.values_by_candidate(), strict=True):
        start_rig = candidate.applied(start_rig, values) if candidate.kind.stochastic else start_rig
    linearization, residual = fit_nuisance(record, start_rig)
    steps = step_sizes_of(hypothesis.candidates)[column_indices]
    lower, upper = (bounds[column_indices] for bounds in hypothesis.parameters.bounds)
    return build(fit(linearization, build, hypothesis.values[column_indices], steps, (lower, upper), residual).values)


def log_priors(hypotheses: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> dict[tuple[str, ...], float]:
    """Log prior of every hypothesis by its key: all effects of the library are as likely, at all of their places."""
    place_counts = Counter(candidate.kind.name for candidate in candidates)
    return {hypothesis.effect_names: log_prior(hypothesis.effects, place_counts) for hypothesis in hypotheses}


def log_prior(effect_kinds: Sequence[str], place_counts: Mapping[str, int]) -> float:
    """Log prior of effects at one place each, one of which may stand twice; place_counts are their numbers of places.

    K effects in the library have C(K + k - 1, k) sets of k, all as likely.
    """
    effect_count = len(effect_kinds)
    if not effect_count:
        return float(np.log(PRIOR_NOTHING))
    size_prior = PRIOR_EFFECTS * (1 - FURTHER_EFFECT_SHARE) * FURTHER_EFFECT_SHARE ** (effect_count - 1)
    set_prior = size_prior / comb(max(1, len(place_counts)) + effect_count - 1, effect_count)
    return float(np.log(set_prior) - sum(np.log(place_counts[name]) for name in effect_kinds))


def probabilities(log_posteriors: Float[np.ndarray, " hypotheses"]) -> Float[np.ndarray, " hypotheses"]:
    """Probabilities from log posteriors that are known up to a constant."""
    likelihood_ratios = np.exp(log_posteriors - log_posteriors.max())
    return np.asarray(likelihood_ratios / likelihood_ratios.sum())


def with_model_averaged_covariance(ranked: Sequence[ValidatedHypothesis]) -> list[ValidatedHypothesis]:
    """Hypotheses whose covariances of the effects hold the values of their rivals, too.

    With the values v and the covariance C of an effect in a hypothesis, and v_i in those that hold it too, of the
    probabilities P_i: C + sum_i P_i (v_i - v)(v_i - v)' / sum_i P_i, the mean square about the hypothesis' own values
    of model averaging (Hoeting et al., Statistical Science 14, 1999). Several effects of one name are paired so that
    they are nearest in standard errors.
    """
    weights = probabilities(np.array([validated.log_posterior for validated in ranked]))
    return [
        replace(validated, hypothesis=_with_between_model_covariance(validated.hypothesis, ranked, weights))
        for validated in ranked
    ]


def _with_between_model_covariance(
    hypothesis: Hypothesis, rivals: Sequence[ValidatedHypothesis], rival_probabilities: Float[np.ndarray, " hypotheses"]
) -> Hypothesis:
    spread = np.zeros_like(hypothesis.covariance)
    weight_sums = np.full(len(hypothesis.values), 1e-300)
    for rival, rival_probability in zip(rivals, rival_probabilities, strict=True):
        for columns, deviation in _deviations_of_same_effects(hypothesis, rival.hypothesis):
            spread[columns, columns] += rival_probability * np.outer(deviation, deviation)
            weight_sums[columns] += rival_probability
    return replace(hypothesis, covariance=hypothesis.covariance + spread / weight_sums)


def _deviations_of_same_effects(
    hypothesis: Hypothesis, rival: Hypothesis
) -> Iterator[tuple[slice, Float[np.ndarray, " parameters"]]]:
    """Columns of each effect that a rival holds too, and its values there less those of the hypothesis."""
    standard_errors = np.sqrt(np.diag(hypothesis.covariance))
    standard_errors = np.maximum(standard_errors, 1e-9 * np.abs(hypothesis.values) + 1e-12)  # zero at a limit
    for effect_name in dict.fromkeys(candidate.name for candidate in hypothesis.candidates):
        columns, rival_columns = (_columns_of(effect_name, holder.candidates) for holder in (hypothesis, rival))
        deviations = [[rival.values[theirs] - hypothesis.values[ours] for theirs in rival_columns] for ours in columns]
        squared_distances = np.zeros((len(columns), len(rival_columns)))
        for row, column in np.ndindex(squared_distances.shape):
            squared_distances[row, column] = np.sum((deviations[row][column] / standard_errors[columns[row]]) ** 2)
        for row, column in zip(*linear_sum_assignment(squared_distances), strict=True):
            yield columns[row], deviations[row][column]


def _columns_of(effect_name: str, candidates: Sequence[Candidate]) -> list[slice]:
    """Columns of the parameters of each effect of this name."""
    stops = np.cumsum([len(candidate.parameters) for candidate in candidates], dtype=int)
    return [
        slice(stop - len(candidate.parameters), stop)
        for stop, candidate in zip(stops, candidates, strict=True)
        if candidate.name == effect_name
    ]


def split_likelihood_ratio_p_value(ranked: Sequence[ValidatedHypothesis]) -> float:
    """p-value of the nominal rig against hypotheses that were fitted on another record.

    With S = -2 ln p on the record that was not fitted, the split likelihood ratio of their mixture gives (Wasserman,
    Ramdas and Balakrishnan, Proc. Natl. Acad. Sci. 117, 2020)

        1 / p >= sum_i w_i exp((S_nominal - S_i) / (2 TEMPERATURE))

    for any weights w_i that the record did not choose: here the probabilities of the hypotheses by their priors and the
    fitted record.
    """
    hypotheses_with_effects = [validated for validated in ranked if validated.hypothesis.candidates]
    if not hypotheses_with_effects:
        return 1.0
    priors = np.array([validated.log_prior for validated in hypotheses_with_effects])
    fitted_costs = np.array([validated.hypothesis.cost for validated in hypotheses_with_effects])
    validation_costs = np.array([validated.misfit.minus_two_log for validated in hypotheses_with_effects])
    mixture_weights = probabilities(priors - fitted_costs / (2 * TEMPERATURE))
    cost_gains = nominal_hypothesis_of(ranked).misfit.minus_two_log - validation_costs
    return float(min(1.0, np.exp(-logsumexp(cost_gains / (2 * TEMPERATURE), b=mixture_weights))))


def mismatch_size(misfit: Misfit, matters: Matters) -> float:
    """Size of a mismatch in units of what matters."""
    return matters.times(misfit.unexplained_share, misfit.unexplained_contact_shares.tolist())


def explained_share(nominal_misfit: Misfit, corrected_misfit: Misfit, matters: Matters) -> float:
    """Share of the mismatch that effects remove: 1 - size with them / size without; zero where there is no mismatch."""
    nominal_size = mismatch_size(nominal_misfit, matters)
    return 1 - mismatch_size(corrected_misfit, matters) / nominal_size if nominal_size > 0 else 0.0


def removed_share(
    nominal_misfit: Misfit, nominal_beside_misfit: Misfit, corrected_misfit: Misfit, matters: Matters
) -> float:
    """Share of the mismatch that effects remove, or of the strain where there is none beyond noise without them.

    Tolerances or free contact forces have then absorbed the mismatch; their strain is |pulls|^2 plus the excess of
    -2 ln p. nominal_beside_misfit is the misfit of the nominal rig with the nuisance parameters of the corrected one.
    """
    if mismatch_size(nominal_beside_misfit, matters) > 0:
        return explained_share(nominal_beside_misfit, corrected_misfit, matters)
    nominal_strain, corrected_strain = (
        float(misfit.pulls @ misfit.pulls) + misfit.excess_cost for misfit in (nominal_misfit, corrected_misfit)
    )
    return 1 - corrected_strain / nominal_strain if nominal_strain > 0 else 0.0


def explained_share_interval(nominal_misfit: Misfit, corrected_misfit: Misfit, matters: Matters) -> tuple[float, float]:
    """95 % interval of the explained share: bootstrap over the seconds of the record."""
    rng = np.random.default_rng(0)
    second_count = len(corrected_misfit.variance_by_second)
    drawn_shares = [
        explained_share(nominal_misfit.resampled(second_indices), corrected_misfit.resampled(second_indices), matters)
        for second_indices in rng.integers(0, second_count, (BOOTSTRAP_DRAW_COUNT, second_count))
    ]
    lower, upper = np.quantile(drawn_shares, [0.025, 0.975])
    return float(lower), float(upper)
