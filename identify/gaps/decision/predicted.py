"""Decision among hypotheses under the veto of prediction: the rig with the named effects has to move as the machine
does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from identify.gaps.decision.channel_errors import channel_errors_of
from identify.gaps.decision.comparison import ValidatedHypothesis, nominal_hypothesis_of
from identify.gaps.decision.notes import Attempt
from identify.gaps.decision.null_simulations import simulated_machines
from identify.gaps.decision.prepare import PreparedRecordings
from identify.gaps.decision.verdict import RIVAL_PROBABILITY, Decision, strengths_exclude_neutral
from identify.gaps.residual.residual import Residual
from identify.gaps.residual.spectra import record_of
from identify.gaps.rollout.judge import judge_correction, mean_error_log_ratio, with_simulation_veto
from identify.gaps.rollout.results import Rollout
from identify.gaps.search.nominal import fit_nuisance

CONFIRMING_SIMULATION_COUNT = 3
"""Simulated machines with the named effects, within the tolerances, made where the prediction improves by less than
expected. Effort."""


@dataclass(frozen=True)
class PredictionCheckedDecision:
    """Decision among hypotheses, and the prediction with its named effects.

    ruled_out are likelier hypotheses whose effects do not improve the prediction of the motion as expected.
    """

    ranked_hypotheses: Sequence[ValidatedHypothesis]
    decision: Decision
    rollout_attempt: Attempt[Rollout] = field(default_factory=Attempt)
    ruled_out: tuple[ValidatedHypothesis, ...] = ()

    @property
    def is_vetoed(self) -> bool:
        return self.rollout_attempt.result is not None and self.rollout_attempt.result.vetoed

    @property
    def is_prediction_poor(self) -> bool:
        """True if the prediction is vetoed or falls short of what the named effects let expect."""
        return self.is_vetoed or (self.rollout_attempt.result is not None and self.rollout_attempt.result.falls_short)


def rollout_with_named_effects(
    prepared: PreparedRecordings, nominal_residual: Residual, named_set: ValidatedHypothesis
) -> Rollout:
    """Prediction of the validation record by the nominal rig, whose residual there is given, and with the named
    effects."""
    if prepared.predict is None:
        return Rollout(code="not_simulated")
    validation, predict, named_rig = prepared.validation_recording, prepared.predict, named_set.rig
    corrected_residual = fit_nuisance(validation.record, named_rig)[1]
    null_errors = prepared.null_reference.predictions
    rollout = judge_correction(validation.recording, nominal_residual, corrected_residual, null_errors, predict)
    if not rollout.falls_short:
        return rollout
    horizon_samples = round(rollout.horizon_s * validation.recording.rig.sample_rate_hz)
    channel_errors, log_ratios = channel_errors_of(validation.record), []
    for simulation in simulated_machines(
        validation.recording, named_rig, channel_errors, prepared.simulate, CONFIRMING_SIMULATION_COUNT
    ):
        record = record_of(simulation, tolerances=validation.record.tolerances)
        nominal_refit, corrected_refit = (fit_nuisance(record, rig)[1] for rig in (record.rig, named_rig))
        log_ratios.append(mean_error_log_ratio(simulation, nominal_refit, corrected_refit, horizon_samples, predict))
    return with_simulation_veto(rollout, log_ratios)


def prediction_checked_decision(
    ranked_hypotheses: Sequence[ValidatedHypothesis],
    decide: Callable[[Sequence[ValidatedHypothesis], bool], Decision],
    predict: Callable[[ValidatedHypothesis], Attempt[Rollout]],
) -> PredictionCheckedDecision:
    """Decide among hypotheses; veto the named effects if they predict the motion worse.

    Where the prediction is vetoed or falls short of what is expected, the decision is repeated without that
    hypothesis, among those likelier than `RIVAL_PROBABILITY` whose strengths exclude their neutral values, until one
    predicts as expected. If none does, the first that is not vetoed stays, or the first with its veto. decide takes
    hypotheses, and whether their named effects are vetoed.
    """
    first_decision = latest_decision = _decision_with_rollout(ranked_hypotheses, decide, predict)
    accepted = None if first_decision.is_vetoed else first_decision
    rivals = [
        weighted.validated
        for weighted in first_decision.decision.weighted_hypotheses
        if weighted.probability > RIVAL_PROBABILITY and strengths_exclude_neutral(weighted.validated.hypothesis)
    ]
    ruled_out: list[ValidatedHypothesis] = []
    while latest_decision.is_prediction_poor:
        doubtful_hypothesis = latest_decision.decision.named_hypothesis
        ruled_out += [validated for validated in latest_decision.ranked_hypotheses if validated is doubtful_hypothesis]
        rivals = [rival for rival in rivals if rival is not doubtful_hypothesis]
        if not rivals:
            break
        latest_decision = _decision_with_rollout([nominal_hypothesis_of(ranked_hypotheses), *rivals], decide, predict)
        if latest_decision.decision.corrects_rig and not (latest_decision.is_prediction_poor and accepted):
            accepted = None if latest_decision.is_vetoed else replace(latest_decision, ruled_out=tuple(ruled_out))
    return accepted or first_decision


def _decision_with_rollout(
    ranked_hypotheses: Sequence[ValidatedHypothesis],
    decide: Callable[[Sequence[ValidatedHypothesis], bool], Decision],
    predict: Callable[[ValidatedHypothesis], Attempt[Rollout]],
) -> PredictionCheckedDecision:
    decision = decide(ranked_hypotheses, False)
    if not decision.corrects_rig or decision.named_hypothesis is None:
        return PredictionCheckedDecision(ranked_hypotheses, decision)
    predicted = PredictionCheckedDecision(ranked_hypotheses, decision, predict(decision.named_hypothesis))
    if predicted.is_vetoed:
        return PredictionCheckedDecision(ranked_hypotheses, decide(ranked_hypotheses, True), predicted.rollout_attempt)
    return predicted
