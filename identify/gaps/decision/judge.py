"""Judgement of hypotheses, and of something unmeasured, on the validation record.

The verdict may be vetoed by prediction: the rig with the named effects has to move as the machine does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identify.gaps.decision.bounds import Difference, contact_distances, share_bounds
from identify.gaps.decision.comparison import (
    TEMPERATURE,
    ValidatedHypothesis,
    explained_share,
    log_priors,
    nominal_of,
    validate_hypotheses,
)
from identify.gaps.decision.contact_evidence import with_contact_evidence
from identify.gaps.decision.notes import Attempt, attempted
from identify.gaps.decision.null_reference import combined_p_value, p_values, with_bound
from identify.gaps.decision.prepare import Prepared, PreparedRecording, Searched
from identify.gaps.decision.verdict import (
    RIVAL_PROBABILITY,
    Decision,
    ForceRivals,
    acts_at_effects,
    decide,
    strengths_exclude_neutral,
)
from identify.gaps.decision_table import DIFFERENCE_P_VALUE, PARTLY_EXPLAINED_SHARE, Verdict, all_hold
from identify.gaps.residual.likelihood import Misfit, misfit
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.residual.spectra import record_of
from identify.gaps.results import Matters, Note
from identify.gaps.rollout.judge import confirm_by_simulations, judge_correction, log_ratio_of
from identify.gaps.rollout.results import Rollout
from identify.gaps.search.contact_laws import with_contact_fit
from identify.gaps.search.hypothesis import MIN_GAIN
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force import UnmeasuredForceFit, likeliest_force
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation, clearance_modulation
from identify.linear.joined import joined
from rig.model.description import Rig

CERTAIN_P_VALUE = DIFFERENCE_P_VALUE / 10
"""p-value below which no further part of the combination raises it above `DIFFERENCE_P_VALUE`."""
INCOMPLETE_VERDICTS = (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)
"""Verdicts that leave something to be described."""
CONFIRMING_SIMULATIONS = 3
"""Simulations with the named effects, made where their prediction improves by less than expected. Effort."""


@dataclass(frozen=True)
class PredictedDecision:
    """Decision among hypotheses, and the prediction with its named effects.

    ruled_out are likelier hypotheses whose effects do not improve the prediction of the motion.
    """

    ranked: Sequence[ValidatedHypothesis]
    decision: Decision
    rollout: Attempt[Rollout] = field(default_factory=Attempt)
    ruled_out: tuple[ValidatedHypothesis, ...] = ()

    @property
    def vetoed(self) -> bool:
        return self.rollout.value is not None and self.rollout.value.vetoed


@dataclass(frozen=True)
class Unmeasured:
    """Unmeasured force or modulated clearance, in the nominal rig or beside named effects that explain a part.

    minus_two_log_decrease is that of the nominal rig's -2 ln p by the force that explains it best; None where none was
    looked for.
    """

    force: UnmeasuredForceFit | None = None
    modulation: ClearanceModulation | None = None
    minus_two_log_decrease: float | None = None
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class Judgement:
    """Decision on the validation record, and the predicted decision before an unmeasured force was looked for.

    linearization and residual are those of the nominal rig on that record.
    """

    decision: Decision
    prediction: PredictedDecision
    unmeasured: Unmeasured
    linearization: Linearization
    residual: Residual


def judge(
    prepared: Prepared, searched: Searched, matters: Matters, progress: Callable[[float], None] = lambda _: None
) -> Judgement:
    """Judge the difference, every hypothesis and the prediction with the named effects on the validation record.

    Where named effects do not suffice, an unmeasured force and a modulated clearance are looked for.
    """
    validation = prepared.validation
    record = validation.record
    linearization, residual = fit_nuisance(record, record.rig)
    priors = log_priors(searched.hypotheses, searched.candidates)
    ranked = validate_hypotheses(record, validation.nominal_variances, residual, searched.hypotheses, priors, progress)
    ranked = _refit_contact_laws(prepared, ranked, residual)
    difference = difference_of(prepared, searched.nominal_misfit, residual, matters, split_p_value(ranked))
    ranked = with_contact_evidence(prepared, searched.candidates, ranked, difference, residual)
    basis = _Basis(prepared, difference, residual, matters)
    outcome = predicted_decision(
        ranked, basis.decide, lambda named: attempted("rollout", lambda: predicted_rollout(prepared, residual, named))
    )
    decision, unmeasured = outcome.decision, Unmeasured()
    if decision.verdict in INCOMPLETE_VERDICTS:
        decision, unmeasured = _decide_with_force(basis, outcome.ranked, decision)
    return Judgement(decision, outcome, unmeasured, linearization, residual)


@dataclass(frozen=True)
class _Basis:
    """Evidence common to all decisions on the hypotheses."""

    prepared: Prepared
    difference: Difference
    residual: Residual
    matters: Matters

    def decide(
        self, ranked: Sequence[ValidatedHypothesis], vetoed: bool = False, rivals: ForceRivals | None = None
    ) -> Decision:
        return decide(ranked, self.difference, self.prepared.null_reference, self.matters, rivals, vetoed)


def split_p_value(ranked: Sequence[ValidatedHypothesis]) -> float:
    """p-value of the nominal rig against n hypotheses that were fitted on another record.

    With S = -2 ln p on the record that was not fitted, the split likelihood ratio gives p <= n exp((S_hypothesis -
    S_nominal) / (2 TEMPERATURE)) (Wasserman, Ramdas and Balakrishnan, Proc. Natl. Acad. Sci. 117, 2020).
    """
    nominal = nominal_of(ranked).misfit.minus_two_log
    gains = [nominal - item.misfit.minus_two_log for item in ranked if item.hypothesis.candidates]
    return float(min(1.0, len(gains) * np.exp(-max(gains, default=0.0) / (2 * TEMPERATURE)))) if gains else 1.0


def difference_of(
    prepared: Prepared, searched_misfit: Misfit, residual: Residual, matters: Matters, p_split: float
) -> Difference:
    """Difference of the nominal rig and all records; `residual` is that of the validation record, `searched_misfit` the
    nominal rig's on the one that was searched.

    Contact parameters are not compared where the other p-values already prove a difference that is not bounded.
    """
    validation = prepared.validation

    def nominal_misfit(observation: PreparedRecording) -> Misfit:
        if observation is prepared.searched and observation is not validation:
            return searched_misfit
        fit = residual if observation is validation else fit_nuisance(observation.record, observation.record.rig)[1]
        return misfit(observation.record, observation.nominal_variances, fit)

    misfits = [nominal_misfit(observation) for observation in prepared.observations]
    p_parts = p_values(list(zip(prepared.null_references, misfits, strict=True)))
    p_value = with_bound(combined_p_value(p_parts), p_split)
    rig = validation.record.rig
    names = [f"force of {contact.name}" for contact in joined(rig).contacts]
    motion, *contacts = share_bounds(misfits[prepared.validation_index], names, matters)
    if p_value < CERTAIN_P_VALUE and not all_hold((motion, *contacts)):
        return Difference(p_value, motion, tuple(contacts))
    recordings = [observation.recording for observation in prepared.observations]
    distances = contact_distances(recordings, rig, validation.record.tolerances)
    p_value = with_bound(combined_p_value(np.append(p_parts, distances.p_values)), p_split)
    return Difference(p_value, motion, tuple(contacts), distances.bounds, distances.estimates)


def _refit_contact_laws(
    prepared: Prepared, ranked: list[ValidatedHypothesis], residual: Residual
) -> list[ValidatedHypothesis]:
    """Replace the likeliest hypothesis by one with contact laws fitted as `identify contact` fits them.

    It is kept where the refit raises -2 ln p of the validation record by `WORTH` or more, or where it is the nominal
    rig.
    """
    best, *lower_ranked = ranked
    recordings, record = [observation.recording for observation in prepared.fitted], prepared.validation.record
    hypothesis = with_contact_fit(best.hypothesis, recordings, record.tolerances)
    if hypothesis is best.hypothesis:
        return ranked
    priors = {hypothesis.key: best.log_prior}
    fitted = validate_hypotheses(record, prepared.validation.nominal_variances, residual, [hypothesis], priors)
    better = [item for item in fitted if item.misfit.minus_two_log < best.misfit.minus_two_log + MIN_GAIN]
    return sorted([*(better or [best]), *lower_ranked], key=lambda item: -item.log_posterior)


def _decide_with_force(
    basis: _Basis, ranked: Sequence[ValidatedHypothesis], decision: Decision
) -> tuple[Decision, Unmeasured]:
    """Decide with an unmeasured force as a rival of effects, or as their companion where they explain half."""
    prepared, residual, validation = basis.prepared, basis.residual, basis.prepared.validation
    record, vetoed = validation.record, decision.evidence.vetoed
    force_in_nominal = attempted(
        "unmeasured_force", lambda: likeliest_force(prepared.searched.record, record.rig, record)
    )
    nominal = nominal_of(ranked)
    minus_two_log = (
        minus_two_log_with_force(validation, record.rig, force_in_nominal.value, nominal.misfit)
        if force_in_nominal.value
        else None
    )
    decrease = None if minus_two_log is None else nominal.misfit.minus_two_log - minus_two_log
    decision = basis.decide(ranked, vetoed, ForceRivals(minus_two_log))
    force, named = force_in_nominal, decision.named
    if named and explained_share(named.nominal_misfit, named.misfit, basis.matters) >= PARTLY_EXPLAINED_SHARE:
        rig = named.rig
        force_beside = attempted("unmeasured_force", lambda: likeliest_force(prepared.searched.record, rig, record))
        companion = force_beside.value
        if companion and acts_at_effects(companion.on_fit.candidate, record.rig, rig):
            companion = None
        minus_two_log_beside = minus_two_log_with_force(validation, rig, companion, named.misfit) if companion else None
        decision = basis.decide(ranked, vetoed, ForceRivals(minus_two_log, named, minus_two_log_beside))
        if decision.verdict == Verdict.PARTLY_EXPLAINED:
            force, residual = force_beside, fit_nuisance(record, rig)[1]
    modulation = attempted("clearance_modulation", lambda: clearance_modulation(record, residual))
    return decision, Unmeasured(force.value, modulation.value, decrease, (*force.notes, *modulation.notes))


def minus_two_log_with_force(
    validation: PreparedRecording, rig: Rig, force: UnmeasuredForceFit, misfit_without: Misfit
) -> float:
    """-2 ln p of a validation record with an unmeasured force beside a rig whose misfit without it is given.

    The force is subtracted from the delivered signals, and the rig is fitted to the rest. The gain is reduced by the
    share of the residual's directions that a free time history of the force can follow. There is no gain where the
    records show different forces.
    """
    if not force.same_place:
        return misfit_without.minus_two_log
    record = validation.record
    cleared = replace(record, delivered=record.delivered - force.delivered())
    misfit_with = misfit(cleared, validation.nominal_variances, fit_nuisance(cleared, rig)[1])
    followed_share = force.directions / force.held.whitened.rows
    return misfit_with.minus_two_log + followed_share * (
        misfit_without.linear + misfit_without.line_cost - misfit_with.linear - misfit_with.line_cost
    )


def predicted_rollout(prepared: Prepared, nominal_residual: Residual, named: ValidatedHypothesis) -> Rollout:
    """Prediction of the validation record by the nominal rig, whose residual there is given, and with the named
    effects."""
    if prepared.predict is None:
        return Rollout(code="not_simulated")
    validation, predict = prepared.validation, prepared.predict
    corrected_residual = fit_nuisance(validation.record, named.rig)[1]
    nulls = prepared.null_reference.predictions
    rollout = judge_correction(validation.recording, nominal_residual, corrected_residual, nulls, predict)
    if not rollout.falls_short:
        return rollout
    samples = round(rollout.horizon_s * validation.recording.rig.sample_rate_hz)
    log_ratios = []
    for seed in range(CONFIRMING_SIMULATIONS):
        simulated = prepared.simulate(
            validation.recording.rig, named.corrected_rig, validation.recording.forces_n, seed
        )
        record = record_of(simulated, tolerances=validation.record.tolerances)
        nominal_fit, corrected_fit = (fit_nuisance(record, rig)[1] for rig in (record.rig, named.rig))
        log_ratios.append(log_ratio_of(simulated, nominal_fit, corrected_fit, samples, predict))
    return confirm_by_simulations(rollout, log_ratios)


def predicted_decision(
    ranked: Sequence[ValidatedHypothesis],
    decide: Callable[[Sequence[ValidatedHypothesis], bool], Decision],
    predict: Callable[[ValidatedHypothesis], Attempt[Rollout]],
) -> PredictedDecision:
    """Decide among hypotheses; veto the named effects if they predict the motion worse.

    After a veto the decision is repeated without the vetoed hypothesis, among those likelier than `RIVAL_PROBABILITY`
    whose strengths exclude their neutral values, until one is not vetoed. If all are, the first decision stays, with
    its veto. decide takes hypotheses, and whether their named effects are vetoed.
    """
    first = outcome = _decision_with_rollout(ranked, decide, predict)
    rivals = [item.validated for item in first.decision.weighted if item.probability > RIVAL_PROBABILITY]
    rivals = [rival for rival in rivals if strengths_exclude_neutral(rival.hypothesis)]
    ruled_out: list[ValidatedHypothesis] = []
    while outcome.vetoed:
        vetoed = outcome.decision.named
        ruled_out += [hypothesis for hypothesis in outcome.ranked if hypothesis is vetoed]
        rivals = [rival for rival in rivals if rival is not vetoed]
        if not rivals:
            return first
        outcome = _decision_with_rollout([nominal_of(ranked), *rivals], decide, predict)
    return replace(outcome, ruled_out=tuple(ruled_out)) if outcome.decision.corrects_rig else first


def _decision_with_rollout(
    ranked: Sequence[ValidatedHypothesis],
    decide: Callable[[Sequence[ValidatedHypothesis], bool], Decision],
    predict: Callable[[ValidatedHypothesis], Attempt[Rollout]],
) -> PredictedDecision:
    decision = decide(ranked, False)
    if not decision.corrects_rig or decision.named is None:
        return PredictedDecision(ranked, decision)
    outcome = PredictedDecision(ranked, decision, predict(decision.named))
    return PredictedDecision(ranked, decide(ranked, True), outcome.rollout) if outcome.vetoed else outcome
