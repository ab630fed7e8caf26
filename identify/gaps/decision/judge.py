"""Judgement of hypotheses, and of something unmeasured, on the validation record.

The verdict may be vetoed by prediction (`predicted`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identify.gaps.decision.bounds import NominalDifference, contact_distances, share_bounds
from identify.gaps.decision.comparison import (
    ValidatedHypothesis,
    explained_share,
    log_priors,
    nominal_of,
    split_p_value,
    validate_hypotheses,
    with_rival_spread,
)
from identify.gaps.decision.contact_evidence import with_contact_evidence
from identify.gaps.decision.notes import attempted
from identify.gaps.decision.null_reference import NullReference, combined_p_value, p_value, p_values, with_bound
from identify.gaps.decision.predicted import PredictedDecision, predicted_decision, predicted_rollout
from identify.gaps.decision.prepare import PreparedRecording, PreparedRecordings, SearchResult
from identify.gaps.decision.verdict import (
    Decision,
    ForceRivals,
    acts_at_effects,
    decide,
)
from identify.gaps.decision_table import (
    DIFFERENCE_P_VALUE,
    PARTLY_EXPLAINED_SHARE,
    USUAL_P_VALUE,
    Evidence,
    Verdict,
    all_hold,
)
from identify.gaps.residual.likelihood import Misfit, misfit
from identify.gaps.residual.residual import Linearization, Residual, SearchCache
from identify.gaps.results import FailedAnalysis, Matters
from identify.gaps.search.contact_laws import with_contact_fit
from identify.gaps.search.hypothesis import MIN_GAIN
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force import UnmeasuredForceFit, likeliest_force
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation, clearance_modulation
from identify.linear.joined import group_rig_of
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
    prediction: PredictedDecision
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

    Where an unmeasured force may be behind it (`may_hide_force`), it and a modulated clearance are looked for.
    """
    validation = prepared.validation_recording
    record = validation.record
    linearization, residual = fit_nuisance(record, record.rig)
    linearization = replace(linearization, cache=SearchCache(record))  # its columns are large, and done with
    log_prior_by_effects = log_priors(search_result.hypotheses, search_result.candidates)
    ranked_hypotheses = validate_hypotheses(
        record, validation.nominal_variances, residual, search_result.hypotheses, log_prior_by_effects, progress
    )
    ranked_hypotheses = [
        with_lasting_error(ranked_hypothesis, prepared.null_reference) for ranked_hypothesis in ranked_hypotheses
    ]
    ranked_hypotheses = _refit_contact_laws(prepared, ranked_hypotheses, residual)
    difference = difference_of(
        prepared, search_result.nominal_misfit, residual, matters, split_p_value(ranked_hypotheses)
    )
    ranked_hypotheses = with_rival_spread(
        with_contact_evidence(prepared, search_result.candidates, ranked_hypotheses, difference, residual)
    )
    basis = _DecisionBasis(prepared, difference, residual, matters)
    prediction = predicted_decision(
        ranked_hypotheses,
        basis.decide,
        lambda named_set: attempted("rollout", lambda: predicted_rollout(prepared, residual, named_set)),
    )
    decision, unmeasured_causes = prediction.decision, UnmeasuredCauses()
    if may_hide_force(decision.evidence):
        decision, unmeasured_causes = _decide_with_force(basis, prediction.ranked, decision)
    return Judgement(decision, prediction, unmeasured_causes, linearization, residual)


def with_lasting_error(validated: ValidatedHypothesis, null_reference: NullReference) -> ValidatedHypothesis:
    """Hypothesis whose standard errors grow by what it leaves of the validation record beyond tolerances and noise.

    Weights that follow the misfit count what is left as scatter, but it lasts, and biases the values. With the
    unexplained shares s_b of the bands and s_0b, the limits of what null simulations leave, the standard errors grow by
    max(1, median of s_b / s_0b, weighted by the power of the bands) where p < `USUAL_P_VALUE`, after Birge (Phys. Rev.
    40, 1932). The median keeps a tone that nothing names from widening all else.
    """
    remaining_misfit = validated.misfit
    if p_value(null_reference, remaining_misfit) >= USUAL_P_VALUE:
        return validated
    shares_and_limits = zip(remaining_misfit.share_by_band, null_reference.usual_shares(), strict=False)
    growth_by_band = np.array(
        [remaining_share / usual_share if usual_share else 1.0 for remaining_share, usual_share in shares_and_limits]
    )
    band_order = np.argsort(growth_by_band)
    power_below = np.cumsum(remaining_misfit.power_by_band[band_order])
    error_growth = max(1.0, growth_by_band[band_order][np.searchsorted(power_below, power_below[-1] / 2)])
    hypothesis = replace(validated.hypothesis, covariance=error_growth**2 * validated.hypothesis.covariance)
    return replace(validated, hypothesis=hypothesis)


def may_hide_force(evidence: Evidence) -> bool:
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
        self,
        ranked_hypotheses: Sequence[ValidatedHypothesis],
        is_vetoed: bool = False,
        force_rivals: ForceRivals | None = None,
    ) -> Decision:
        return decide(
            ranked_hypotheses, self.difference, self.prepared.null_reference, self.matters, force_rivals, is_vetoed
        )


def difference_of(
    prepared: PreparedRecordings, searched_misfit: Misfit, residual: Residual, matters: Matters, split_bound: float
) -> NominalDifference:
    """Difference of the nominal rig and all records; `residual` is that of the validation record, `searched_misfit` the
    nominal rig's on the one that was searched.

    Contact parameters are not compared where the other p-values already prove a difference that is not bounded.
    """
    validation = prepared.validation_recording
    nominal_misfits = nominal_misfits_of(prepared, searched_misfit, residual)
    p_value_parts = p_values(list(zip(prepared.null_references, nominal_misfits, strict=True)))
    p_value = with_bound(combined_p_value(p_value_parts), split_bound)
    rig = validation.record.rig
    force_names = [f"force of {contact.name}" for contact in group_rig_of(rig).contacts]
    motion_bound, *contact_bounds = share_bounds(nominal_misfits[prepared.validation_index], force_names, matters)
    if p_value < CERTAIN_P_VALUE and not all_hold((motion_bound, *contact_bounds)):
        return NominalDifference(p_value, motion_bound, tuple(contact_bounds))
    recordings = [observation.recording for observation in prepared.observations]
    parameter_distances = contact_distances(recordings, rig, validation.record.tolerances)
    p_value = with_bound(combined_p_value(np.append(p_value_parts, parameter_distances.p_values)), split_bound)
    return NominalDifference(
        p_value,
        motion_bound,
        tuple(contact_bounds),
        parameter_distances.parameter_bounds,
        parameter_distances.law_estimates,
    )


def nominal_misfits_of(prepared: PreparedRecordings, searched_misfit: Misfit, residual: Residual) -> list[Misfit]:
    """Misfit of the nominal rig to every record, from the two that `difference_of` is given."""
    validation = prepared.validation_recording

    def nominal_misfit(observation: PreparedRecording) -> Misfit:
        if observation is prepared.searched_recording and observation is not validation:
            return searched_misfit
        fitted_residual = (
            residual if observation is validation else fit_nuisance(observation.record, observation.record.rig)[1]
        )
        return misfit(observation.record, observation.nominal_variances, fitted_residual)

    return [nominal_misfit(observation) for observation in prepared.observations]


def _refit_contact_laws(
    prepared: PreparedRecordings, ranked_hypotheses: list[ValidatedHypothesis], residual: Residual
) -> list[ValidatedHypothesis]:
    """Replace the likeliest hypothesis by one with contact laws fitted as `identify contact` fits them.

    It is kept where the refit raises -2 ln p of the validation record by `MIN_GAIN` or more, or where it is the nominal
    rig.
    """
    likeliest_hypothesis, *lower_ranked = ranked_hypotheses
    recordings = [observation.recording for observation in prepared.fitted_recordings]
    record = prepared.validation_recording.record
    refitted_hypothesis = with_contact_fit(likeliest_hypothesis.hypothesis, recordings, record.tolerances)
    if refitted_hypothesis is likeliest_hypothesis.hypothesis:
        return ranked_hypotheses
    log_prior_by_effects = {refitted_hypothesis.effect_names: likeliest_hypothesis.log_prior}
    validated_refits = validate_hypotheses(
        record, prepared.validation_recording.nominal_variances, residual, [refitted_hypothesis], log_prior_by_effects
    )
    kept_refits = [
        refit
        for refit in validated_refits
        if refit.misfit.minus_two_log < likeliest_hypothesis.misfit.minus_two_log + MIN_GAIN
    ]
    return sorted([*(kept_refits or [likeliest_hypothesis]), *lower_ranked], key=lambda refit: -refit.log_posterior)


def _decide_with_force(
    basis: _DecisionBasis, ranked_hypotheses: Sequence[ValidatedHypothesis], decision: Decision
) -> tuple[Decision, UnmeasuredCauses]:
    """Decide with an unmeasured force as a rival of effects, or as their companion where they explain half."""
    prepared, residual, validation = (basis.prepared, basis.nominal_residual, basis.prepared.validation_recording)
    record, is_vetoed = validation.record, decision.evidence.vetoed
    force_in_nominal = attempted(
        "unmeasured_force", lambda: likeliest_force(prepared.searched_recording.record, record.rig, record)
    )
    nominal_hypothesis = nominal_of(ranked_hypotheses)
    force_cost = (
        minus_two_log_with_force(validation, record.rig, force_in_nominal.result, nominal_hypothesis.misfit)
        if force_in_nominal.result
        else None
    )
    cost_decrease = None if force_cost is None else nominal_hypothesis.misfit.minus_two_log - force_cost
    decision = basis.decide(ranked_hypotheses, is_vetoed, ForceRivals(force_cost))
    force_attempt, named_set = force_in_nominal, decision.named_hypothesis
    if (
        named_set
        and explained_share(named_set.nominal_misfit, named_set.misfit, basis.matters) >= PARTLY_EXPLAINED_SHARE
    ):
        named_rig = named_set.rig
        force_beside = attempted(
            "unmeasured_force", lambda: likeliest_force(prepared.searched_recording.record, named_rig, record)
        )
        companion_force = force_beside.result
        if companion_force and acts_at_effects(companion_force.on_fit.force_place, record.rig, named_rig):
            companion_force = None
        companion_cost = (
            minus_two_log_with_force(validation, named_rig, companion_force, named_set.misfit)
            if companion_force
            else None
        )
        decision = basis.decide(ranked_hypotheses, is_vetoed, ForceRivals(force_cost, named_set, companion_cost))
        if decision.verdict == Verdict.PARTLY_EXPLAINED:
            force_attempt, residual = force_beside, fit_nuisance(record, named_rig)[1]
    swing_attempt = attempted("clearance_modulation", lambda: clearance_modulation(record, residual))
    return decision, UnmeasuredCauses(
        force_attempt.result, swing_attempt.result, cost_decrease, (*force_attempt.notes, *swing_attempt.notes)
    )


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
    record = validation_recording.record
    cleared_record = replace(record, acceleration_signals=record.acceleration_signals - force_fit.sensor_signals())
    misfit_with = misfit(cleared_record, validation_recording.nominal_variances, fit_nuisance(cleared_record, rig)[1])
    followed_share = force_fit.free_directions / force_fit.at_fit_place.whitened_record.row_count
    return misfit_with.minus_two_log + followed_share * (
        misfit_without.band_cost + misfit_without.line_cost - misfit_with.band_cost - misfit_with.line_cost
    )
