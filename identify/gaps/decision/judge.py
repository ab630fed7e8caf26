"""Judgement of hypotheses, and of something unmeasured, on the validation record.

The verdict may be vetoed by prediction (`predicted`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identify.gaps.decision.bounds import NominalDifference, contact_parameter_distances, share_bounds
from identify.gaps.decision.comparison import (
    ValidatedHypothesis,
    explained_share,
    log_priors,
    nominal_hypothesis_of,
    split_likelihood_ratio_p_value,
    validate_hypotheses,
    with_model_averaged_covariance,
)
from identify.gaps.decision.contact_evidence import with_contact_evidence
from identify.gaps.decision.notes import Attempt, attempted
from identify.gaps.decision.null_reference import (
    NullReference,
    combined_p_value,
    p_value,
    p_value_combined_with_bound,
    p_values,
)
from identify.gaps.decision.predicted import (
    PredictionCheckedDecision,
    prediction_checked_decision,
    rollout_with_named_effects,
)
from identify.gaps.decision.prepare import PreparedRecording, PreparedRecordings, SearchResult
from identify.gaps.decision.verdict import Decision, ForceRivals, decide, is_force_at_effects, strengths_exclude_neutral
from identify.gaps.decision_table import (
    DIFFERENCE_P_VALUE,
    PARTLY_EXPLAINED_SHARE,
    USUAL_P_VALUE,
    Evidence,
    Verdict,
    are_all_below_threshold,
)
from identify.gaps.residual.likelihood import Misfit, misfit
from identify.gaps.residual.residual import Linearization, Residual, SearchCache
from identify.gaps.results import FailedAnalysis, Matters
from identify.gaps.search.candidates import Candidate
from identify.gaps.search.contact_laws import with_contact_fit
from identify.gaps.search.hypothesis import MIN_GAIN, Hypothesis
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force import UnmeasuredForceFit, likeliest_force
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation, clearance_modulation
from identify.linear.joined import rig_with_joined_contacts
from rig.model.description import Rig

CERTAIN_P_VALUE = DIFFERENCE_P_VALUE / 10
"""p-value below which no further part of the combination raises it above `DIFFERENCE_P_VALUE`."""
INCOMPLETE_VERDICTS = (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)
"""Verdicts that leave something to be described."""


@dataclass(frozen=True)
class UnmeasuredCauses:
    """Unmeasured force or modulated clearance, in the nominal rig or beside named effects that explain a part.

    cost_decrease is that of the nominal rig's -2 ln p by the force that explains it best; None where none was
    looked for.
    """

    force_fit: UnmeasuredForceFit | None = None
    clearance_swing: ClearanceModulation | None = None
    cost_decrease: float | None = None
    notes: tuple[FailedAnalysis, ...] = ()


@dataclass(frozen=True)
class Judgement:
    """Decision on the validation record, and the predicted decision before an unmeasured force was looked for.

    linearization and nominal_residual are on that record.
    """

    decision: Decision
    prediction: PredictionCheckedDecision
    unmeasured: UnmeasuredCauses
    linearization: Linearization
    nominal_residual: Residual


def judge(
    prepared: PreparedRecordings,
    search_result: SearchResult,
    matters: Matters,
    progress: Callable[[float], None] = lambda _: None,
) -> Judgement:
    """Judge the difference, every hypothesis and the prediction with the named effects on the validation record.

    Where an unmeasured force may be behind it (`is_unmeasured_force_possible`), it and a modulated clearance are looked
    for.
    """
    validation = prepared.validation_recording
    record, candidates = validation.record, search_result.candidates
    linearization, nominal_residual = fit_nuisance(record, record.rig)
    linearization = replace(linearization, cache=SearchCache(record))  # its columns are large, and done with
    ranked = validated_hypotheses(prepared, search_result.hypotheses, candidates, nominal_residual, progress)
    ranked = _refit_likeliest_contact_laws(prepared, ranked, nominal_residual, prepared.fitted_recordings)
    difference = nominal_difference_of(
        prepared, search_result.nominal_misfit, nominal_residual, matters, split_likelihood_ratio_p_value(ranked)
    )
    ranked = with_contact_evidence(prepared, candidates, ranked, difference, nominal_residual)
    if not strengths_exclude_neutral(ranked[0].hypothesis):  # the fitted records leave it uncertain
        ranked = _refit_likeliest_contact_laws(prepared, ranked, nominal_residual, prepared.observations)
    ranked = with_model_averaged_covariance(ranked)
    basis = _DecisionBasis(prepared, difference, nominal_residual, matters)
    prediction = prediction_checked_decision(
        ranked,
        basis.decide,
        lambda named_set: attempted(
            "rollout", lambda: rollout_with_named_effects(prepared, nominal_residual, named_set)
        ),
    )
    decision, unmeasured_causes = prediction.decision, UnmeasuredCauses()
    if is_unmeasured_force_possible(decision.evidence):
        decision, unmeasured_causes = _decide_with_force(basis, prediction.ranked_hypotheses, decision)
    return Judgement(decision, prediction, unmeasured_causes, linearization, nominal_residual)


def validated_hypotheses(
    prepared: PreparedRecordings,
    hypotheses: Sequence[Hypothesis],
    candidates: Sequence[Candidate],
    nominal_residual: Residual,
    progress: Callable[[float], None] = lambda _: None,
) -> list[ValidatedHypothesis]:
    """Hypotheses on the validation record with their lasting errors, the likeliest first; candidates are all that were
    tried, and residual that of the nominal rig on this record."""
    validation, log_prior_by_effects = prepared.validation_recording, log_priors(hypotheses, candidates)
    ranked = validate_hypotheses(
        validation.record, validation.nominal_variances, nominal_residual, hypotheses, log_prior_by_effects, progress
    )
    return [with_birge_ratio_errors(validated, prepared.null_reference) for validated in ranked]


def with_birge_ratio_errors(validated: ValidatedHypothesis, null_reference: NullReference) -> ValidatedHypothesis:
    """Hypothesis whose standard errors grow by what it leaves of the validation record beyond tolerances and noise.

    Weights that follow the misfit count what is left as scatter, but it lasts, and biases the values. With the
    unexplained shares s_b of the bands and s_0b, the limits of what null simulations leave, the standard errors grow by
    max(1, median of s_b / s_0b, weighted by the power of the bands) where p < `USUAL_P_VALUE`, after Birge (Phys. Rev.
    40, 1932). The median keeps a tone that nothing names from widening all else.
    """
    corrected_misfit = validated.misfit
    if p_value(null_reference, corrected_misfit) >= USUAL_P_VALUE:
        return validated
    shares = zip(corrected_misfit.share_by_band, null_reference.null_share_upper_limits(), strict=False)
    growth_by_band = np.array([share / usual_share if usual_share else 1.0 for share, usual_share in shares])
    band_order = np.argsort(growth_by_band)
    power_below = np.cumsum(corrected_misfit.power_by_band[band_order])
    error_growth = max(1.0, growth_by_band[band_order][np.searchsorted(power_below, power_below[-1] / 2)])
    hypothesis = replace(validated.hypothesis, covariance=error_growth**2 * validated.hypothesis.covariance)
    return replace(validated, hypothesis=hypothesis)


def is_unmeasured_force_possible(evidence: Evidence) -> bool:
    """True if an unmeasured force may be the rival of named effects, or of none: where something is left to be
    described, and where a small effect is named that leaves more than tolerances and noise do."""
    names_small_effect = evidence.verdict == Verdict.SMALL and bool(evidence.named)
    return evidence.verdict in INCOMPLETE_VERDICTS or (names_small_effect and evidence.p_value_after < USUAL_P_VALUE)


@dataclass(frozen=True)
class _DecisionBasis:
    """Evidence common to all decisions on the hypotheses."""

    prepared: PreparedRecordings
    difference: NominalDifference
    nominal_residual: Residual
    matters: Matters

    def decide(
        self, ranked: Sequence[ValidatedHypothesis], is_vetoed: bool = False, force_rivals: ForceRivals | None = None
    ) -> Decision:
        null_reference = self.prepared.null_reference
        return decide(ranked, self.difference, null_reference, self.matters, force_rivals, is_vetoed)


def nominal_difference_of(
    prepared: PreparedRecordings, searched_misfit: Misfit, residual: Residual, matters: Matters, split_bound: float
) -> NominalDifference:
    """Difference of the nominal rig and all records; `residual` is that of the validation record, `searched_misfit` the
    nominal rig's on the one that was searched.

    Contact parameters are not compared where the other p-values already prove a difference that is not bounded.
    """
    validation = prepared.validation_recording
    rig, tolerances = validation.record.rig, validation.record.tolerances
    misfits = nominal_misfits_of(prepared, searched_misfit, residual)
    record_p_values = p_values(prepared.null_references, misfits)
    p_value = p_value_combined_with_bound(combined_p_value(record_p_values), split_bound)
    force_names = [f"force of {contact.name}" for contact in rig_with_joined_contacts(rig).contacts]
    motion_bound, *contact_bounds = share_bounds(misfits[prepared.validation_index], force_names, matters)
    difference = NominalDifference(p_value, motion_bound, tuple(contact_bounds))
    if p_value < CERTAIN_P_VALUE and not are_all_below_threshold((motion_bound, *contact_bounds)):
        return difference
    recordings = [observation.recording for observation in prepared.observations]
    distances = contact_parameter_distances(recordings, rig, tolerances)
    return replace(
        difference,
        p_value=p_value_combined_with_bound(
            combined_p_value(np.append(record_p_values, distances.p_values)), split_bound
        ),
        parameter_bounds=distances.parameter_bounds,
        contact_estimates=distances.law_estimates,
    )


def nominal_misfits_of(prepared: PreparedRecordings, searched_misfit: Misfit, residual: Residual) -> list[Misfit]:
    """Misfit of the nominal rig to every record, from the two that `nominal_difference_of` is given."""
    validation = prepared.validation_recording

    def nominal_misfit(observation: PreparedRecording) -> Misfit:
        if observation is prepared.searched_recording and observation is not validation:
            return searched_misfit
        record = observation.record
        nominal_residual = residual if observation is validation else fit_nuisance(record, record.rig)[1]
        return misfit(record, observation.nominal_variances, nominal_residual)

    return [nominal_misfit(observation) for observation in prepared.observations]


def _refit_likeliest_contact_laws(
    prepared: PreparedRecordings,
    ranked: list[ValidatedHypothesis],
    nominal_residual: Residual,
    observations: Sequence[PreparedRecording],
) -> list[ValidatedHypothesis]:
    """Replace the likeliest hypothesis by one with contact laws fitted to recordings as `identify contact` fits them.

    It is kept where the refit raises -2 ln p of the validation record by `MIN_GAIN` or more, or where it is the nominal
    rig.
    """
    likeliest, *lower_ranked = ranked
    record, variances = prepared.validation_recording.record, prepared.validation_recording.nominal_variances
    recordings = [observation.recording for observation in observations]
    refit = with_contact_fit(likeliest.hypothesis, recordings, record.tolerances)
    if refit is likeliest.hypothesis:
        return ranked
    log_prior_by_effects = {refit.effect_names: likeliest.log_prior}
    highest_cost = likeliest.misfit.minus_two_log + MIN_GAIN
    validated_refits = validate_hypotheses(record, variances, nominal_residual, [refit], log_prior_by_effects)
    kept_refits = [
        replace(validated, contact_minus_two_log=likeliest.contact_minus_two_log)
        for validated in validated_refits
        if validated.misfit.minus_two_log < highest_cost
    ]
    return sorted([*(kept_refits or [likeliest]), *lower_ranked], key=lambda validated: -validated.log_posterior)


def _decide_with_force(
    basis: _DecisionBasis, ranked: Sequence[ValidatedHypothesis], decision: Decision
) -> tuple[Decision, UnmeasuredCauses]:
    """Decide with an unmeasured force as a rival of effects, or as their companion where they explain half."""
    residual, validation, matters = basis.nominal_residual, basis.prepared.validation_recording, basis.matters
    record, searched, is_vetoed = validation.record, basis.prepared.searched_recording.record, decision.evidence.vetoed

    def force_in(rig: Rig) -> Attempt[UnmeasuredForceFit]:
        return attempted("unmeasured_force", lambda: likeliest_force(searched, rig, record))

    force, nominal_misfit = force_in(record.rig), nominal_hypothesis_of(ranked).misfit
    force_cost = cost_decrease = None
    if force.result:
        force_cost = minus_two_log_with_force(validation, record.rig, force.result, nominal_misfit)
        cost_decrease = nominal_misfit.minus_two_log - force_cost
    decision = basis.decide(ranked, is_vetoed, ForceRivals(force_cost))
    named_set = decision.named_hypothesis
    if named_set and explained_share(named_set.nominal_misfit, named_set.misfit, matters) >= PARTLY_EXPLAINED_SHARE:
        companion_attempt, companion_cost = force_in(named_set.rig), None
        companion_force = companion_attempt.result
        if companion_force and not is_force_at_effects(
            companion_force.on_fit_record.force_place, record.rig, named_set.rig
        ):
            companion_cost = minus_two_log_with_force(validation, named_set.rig, companion_force, named_set.misfit)
        decision = basis.decide(ranked, is_vetoed, ForceRivals(force_cost, named_set, companion_cost))
        if decision.verdict == Verdict.PARTLY_EXPLAINED:
            force, residual = companion_attempt, fit_nuisance(record, named_set.rig)[1]
    swing = attempted("clearance_modulation", lambda: clearance_modulation(record, residual))
    return decision, UnmeasuredCauses(force.result, swing.result, cost_decrease, (*force.notes, *swing.notes))


def minus_two_log_with_force(
    validation_recording: PreparedRecording, rig: Rig, force_fit: UnmeasuredForceFit, misfit_without: Misfit
) -> float:
    """-2 ln p of a validation record with an unmeasured force beside a rig whose misfit without it is given.

    The force is subtracted from the delivered signals, and the rig is fitted to the rest. The gain is reduced by the
    share of the residual's directions that a free time history of the force can follow. There is no gain where the
    records show different forces.
    """
    if not force_fit.same_place:
        return misfit_without.minus_two_log
    record, nominal_variances = validation_recording.record, validation_recording.nominal_variances
    cleared_record = replace(record, acceleration_signals=record.acceleration_signals - force_fit.sensor_signals())
    misfit_with = misfit(cleared_record, nominal_variances, fit_nuisance(cleared_record, rig)[1])
    followed_share = force_fit.free_direction_count / force_fit.at_fit_place.whitened_record.row_count
    return misfit_with.minus_two_log + followed_share * (
        misfit_without.band_cost + misfit_without.line_cost - misfit_with.band_cost - misfit_with.line_cost
    )
