"""Diagnosis: recordings prepared, effects searched, hypotheses judged, and the answer of gap.json assembled."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from msgspec.structs import asdict

from identify.gaps.decision.attribution import attribution
from identify.gaps.decision.causes import (
    cause_of,
    confirming_tests,
    effect_phrases,
    unexplained_bands,
    unexplained_shares,
)
from identify.gaps.decision.differences import differences
from identify.gaps.decision.experiment import next_experiments
from identify.gaps.decision.judge import Judgement, UnmeasuredCauses, judge
from identify.gaps.decision.notes import Attempt, attempted
from identify.gaps.decision.prepare import PreparedRecordings, SearchResult, Simulator, prepare_recordings, search
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision.verdict import RIVAL_PROBABILITY, Decision, WeightedHypothesis
from identify.gaps.residual.gauges import reason_against_gauges
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import (
    Attribution,
    Criteria,
    Diagnosis,
    FailedAnalysis,
    Gap,
    Matters,
    NextExperiment,
    RecordDifferences,
)
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force import described_force
from identify.linear.joined import rig_with_joined_contacts
from rig.model.description import Rig
from rig.model.tolerances import Tolerances
from rig.model.unmeasured_force import UnmeasuredForce
from rig.recording import Recording

__all__ = ["Simulator", "diagnose"]

DEFAULT_MATTERS = Matters()
"""Thresholds of what matters where none are given: 0.5 % of the acceleration, 3 % of a contact force. Set by hand."""

Progress = Callable[[str, float], None]


def diagnose(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    null_reference_path: Path | None = None,
    progress: Progress = lambda *_: None,
    tolerances: Tolerances | None = None,
    matters: Matters = DEFAULT_MATTERS,
    ask_next: bool = False,
) -> tuple[Gap, Rig]:
    """Diagnosis of recordings, and the corrected rig (the nominal one, if no effect explains at least a part).

    `validation` may be one of the recordings, or another; by default it is the last of several, or the last part of a
    single one. Of several fitted recordings, the one of the strongest force is searched; all then share the parameters
    of the hypotheses, and differences between the records are reported. The null reference is read from
    `null_reference_path` or made by the simulator (see `null_reference`). Tolerances default to those of the rig, then
    to a laboratory's. With ask_next, the next experiment is computed where two causes stay alike.

    Raises RigError if the records do not fit together or allow no diagnosis.
    """

    def causes_progress(start_share: float, stop_share: float) -> Callable[[float], None]:
        return lambda done_share: progress("causes", start_share + (stop_share - start_share) * done_share)

    def null_progress(done_share: float) -> None:
        progress("null_reference", done_share)

    prepared = prepare_recordings(recordings, validation, simulator, null_reference_path, tolerances, null_progress)
    search_result = search(prepared, causes_progress(0.0, 0.7))
    judgement = judge(prepared, search_result, matters, causes_progress(0.7, 0.9))
    gap = describe(prepared, search_result, judgement, matters, ask_next, causes_progress(0.9, 1.0))
    return gap, judgement.decision.corrected_rig or prepared.validation_recording.record.rig


def describe(
    prepared: PreparedRecordings,
    search_result: SearchResult,
    judgement: Judgement,
    matters: Matters,
    ask_next: bool = False,
    progress: Callable[[float], None] = lambda _: None,
) -> Gap:
    """Assemble the answer from the judgement; with ask_next, with the next experiment where two causes stay alike."""
    decision, prediction, unmeasured = judgement.decision, judgement.prediction, judgement.unmeasured
    record, null_reference = prepared.validation_recording.record, prepared.null_reference
    evidence, rig = decision.evidence, record.rig
    nominal_misfit, named_misfit = decision.nominal_hypothesis.misfit, decision.named_misfit
    differences_attempt = _record_differences(prepared, search_result, decision, lambda share: progress(0.5 * share))
    force_attempt = _largest_unmeasured_cause(rig, unmeasured, decision.misfit_to_describe, matters)
    rival_pair = _rival_hypotheses(decision) if ask_next and record.has_force else None
    experiments = _next_experiments(prepared, rival_pair)
    attributed = attempted(
        "attribution", lambda: attribution(judgement.linearization, judgement.nominal_residual, nominal_misfit)
    )
    side_analyses = prediction.rollout_attempt, unmeasured, force_attempt, differences_attempt, experiments, attributed
    progress(1.0)
    with_effects = [weighted for weighted in decision.weighted_hypotheses if weighted.validated.hypothesis.candidates]
    with_effects.sort(key=lambda weighted: weighted.validated is not decision.named_hypothesis)
    causes = tuple(
        cause_of(weighted, decision.weighted_hypotheses, record, null_reference, matters) for weighted in with_effects
    )
    diagnosis = Diagnosis(
        verdict=decision.verdict,
        criteria=Criteria(evidence.differs, evidence.bounded, evidence.named, evidence.enough),
        evidence=evidence,
        not_seen=evidence.not_seen,
        rollout=prediction.rollout_attempt.result,
        ruled_out=tuple(effect_phrases(validated.hypothesis, rig) for validated in prediction.ruled_out),
        free_decay=not any(observation.record.has_force for observation in prepared.observations),
        before=unexplained_shares(nominal_misfit, rig, null_reference),
        after=unexplained_shares(named_misfit, rig, null_reference),
        matters=matters,
        causes=causes,
        probability_nothing=decision.probability_nothing,
        probability_unknown=decision.probability_unmeasured,
        nothing_minus_two_log=nominal_misfit.minus_two_log,
        unknown_gain=unmeasured.cost_decrease,
        unknown=force_attempt.result,
        bands=unexplained_bands(nominal_misfit, named_misfit, null_reference),
        separate_by=confirming_tests(causes, [weighted.validated for weighted in with_effects]),
        next_experiments=experiments.result or (),
        next_between=tuple(" + ".join(rival.effects) or "nothing" for rival in rival_pair or ()),
        attribution=attributed.result or Attribution(),
        between=differences_attempt.result,
        channel_faults=prepared.channel_faults,
        notes=(*(note for analysis in side_analyses for note in analysis.notes), *_gauge_notes(prepared)),
    )
    return Gap(**asdict(diagnosis), sentence=sentence(diagnosis))


def _gauge_notes(prepared: PreparedRecordings) -> list[FailedAnalysis]:
    """Note that strain gauges are not read, where they are there."""
    reasons = dict.fromkeys(reason_against_gauges(observation.recording) for observation in prepared.observations)
    return [FailedAnalysis("strain_gauges", reason) for reason in reasons if reason]


def _record_differences(
    prepared: PreparedRecordings, search_result: SearchResult, decision: Decision, progress: Callable[[float], None]
) -> Attempt[RecordDifferences]:
    """Differences between the records, where more than one was fitted."""
    if not prepared.fits_several_records:
        return Attempt()
    observations = prepared.observations
    records = [observation.record for observation in observations]
    variances = [observation.nominal_variances for observation in observations]
    cause = decision.named_hypothesis if decision.corrects_rig else None
    forces_n = (observation.recording.forces_n for observation in observations)
    force_levels_n = [float(np.sqrt(np.mean(np.sum(record_forces_n**2, axis=0)))) for record_forces_n in forces_n]
    candidates, titles = search_result.candidates, prepared.record_titles
    return attempted(
        "between_records", lambda: differences(records, variances, cause, candidates, titles, force_levels_n, progress)
    )


def _largest_unmeasured_cause(
    rig: Rig, unmeasured: UnmeasuredCauses, misfit: Misfit, matters: Matters
) -> Attempt[UnmeasuredForce]:
    """Description of the unmeasured force or of the modulated clearance, whichever explains more of the mismatch.

    Both are compared in units of what matters: a force by its share of the unexplained motion, a modulated clearance by
    its share of the unexplained force of its contact.
    """
    force_fit, clearance_swing = unmeasured.force_fit, unmeasured.clearance_swing
    force_attempt = attempted("force_description", lambda: described_force(force_fit)) if force_fit else Attempt()
    if clearance_swing is None:
        return force_attempt
    contacts = {contact.name: contact for contact in rig_with_joined_contacts(rig).contacts}
    contact_share = dict(zip(contacts, misfit.unexplained_contact_shares, strict=True))[clearance_swing.contact_name]
    force_size = (
        force_attempt.result.explained * misfit.unexplained_share / matters.motion if force_attempt.result else 0.0
    )
    if clearance_swing.variance_share * contact_share / matters.contact > force_size:
        return Attempt(clearance_swing.as_unmeasured_force(contacts[clearance_swing.contact_name]), force_attempt.notes)
    return force_attempt


def _next_experiments(
    prepared: PreparedRecordings, rival_pair: tuple[Hypothesis, Hypothesis] | None
) -> Attempt[tuple[NextExperiment, ...]]:
    if rival_pair is None:
        return Attempt()
    record, forces_n = prepared.validation_recording.record, prepared.validation_recording.recording.forces_n
    return attempted("next_experiment", lambda: next_experiments(record, forces_n, rival_pair, prepared.simulate))


def _rival_hypotheses(decision: Decision) -> tuple[Hypothesis, Hypothesis] | None:
    """The two likeliest hypotheses, if both are likelier than `RIVAL_PROBABILITY`: two causes, or one and the nominal
    rig.

    The nominal rig also stands for something unmeasured, which cannot be simulated.
    """

    def probability_of(weighted: WeightedHypothesis) -> float:
        is_nominal = weighted.validated is decision.nominal_hypothesis
        return weighted.probability + decision.probability_unmeasured * is_nominal

    likely = [weighted for weighted in decision.weighted_hypotheses if probability_of(weighted) > RIVAL_PROBABILITY]
    likely.sort(key=lambda weighted: -probability_of(weighted))
    return (likely[0].validated.hypothesis, likely[1].validated.hypothesis) if len(likely) > 1 else None
