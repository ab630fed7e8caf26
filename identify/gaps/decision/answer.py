"""Diagnosis: recordings prepared, effects searched, hypotheses judged, and the answer of gap.json assembled."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import asdict

from identify.gaps.decision.attribution import attribution
from identify.gaps.decision.causes import bands_of, cause_of, confirming_tests, unexplained_shares, words_of
from identify.gaps.decision.differences import differences
from identify.gaps.decision.experiment import next_experiments
from identify.gaps.decision.judge import Judgement, UnmeasuredCauses, judge
from identify.gaps.decision.notes import Attempt, attempted
from identify.gaps.decision.prepare import PreparedRecordings, SearchResult, Simulator, prepare, search
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision.verdict import RIVAL_PROBABILITY, Decision
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
from identify.gaps.unmeasured_force import described
from identify.linear.joined import group_rig_of
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

    prepared = prepare(
        recordings,
        validation,
        simulator,
        null_reference_path,
        tolerances,
        lambda done_share: progress("null_reference", done_share),
    )
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
    decision, record = judgement.decision, prepared.validation_recording.record
    side_analyses = _side_analyses(prepared, search_result, judgement, matters, ask_next, progress)
    causes_by_weight = sorted(
        (
            weighted_hypothesis
            for weighted_hypothesis in decision.weighted_hypotheses
            if weighted_hypothesis.validated.hypothesis.candidates
        ),
        key=lambda weighted_hypothesis: weighted_hypothesis.validated is not decision.named_hypothesis,
    )
    causes = tuple(
        cause_of(weighted_hypothesis, decision.weighted_hypotheses, record, prepared.null_reference, matters)
        for weighted_hypothesis in causes_by_weight
    )
    evidence = decision.evidence
    diagnosis = Diagnosis(
        verdict=decision.verdict,
        criteria=Criteria(evidence.differs, evidence.bounded, evidence.named, evidence.enough),
        evidence=evidence,
        not_seen=evidence.not_seen,
        rollout=judgement.prediction.rollout_attempt.result,
        ruled_out=tuple(
            words_of(weighted_hypothesis.hypothesis, record.rig)
            for weighted_hypothesis in judgement.prediction.ruled_out
        ),
        free_decay=not any(observation.record.has_force for observation in prepared.observations),
        before=unexplained_shares(decision.nominal_hypothesis.misfit, record.rig, evidence.p_value),
        after=unexplained_shares(decision.named_misfit, record.rig, evidence.p_value_after),
        matters=matters,
        causes=causes,
        probability_nothing=decision.probability_nothing,
        probability_unknown=decision.probability_unmeasured,
        nothing_minus_two_log=decision.nominal_hypothesis.misfit.minus_two_log,
        unknown_gain=judgement.unmeasured.cost_decrease,
        unknown=side_analyses.unknown,
        bands=bands_of(decision.nominal_hypothesis.misfit, decision.named_misfit, prepared.null_reference),
        separate_by=confirming_tests(
            causes, [weighted_hypothesis.validated for weighted_hypothesis in causes_by_weight]
        ),
        next_experiments=side_analyses.next_experiments,
        next_between=side_analyses.next_between,
        attribution=side_analyses.attribution,
        between=side_analyses.between,
        channel_faults=prepared.channel_faults,
        notes=(*judgement.prediction.rollout_attempt.notes, *judgement.unmeasured.notes, *side_analyses.notes),
    )
    return Gap(**asdict(diagnosis), sentence=sentence(diagnosis))


@dataclass(frozen=True)
class SideAnalyses:
    """Analyses on which the verdict does not rest; failed ones are left out, with a note."""

    between: RecordDifferences | None
    unknown: UnmeasuredForce | None
    next_experiments: tuple[NextExperiment, ...]
    next_between: tuple[str, ...]
    attribution: Attribution
    notes: tuple[FailedAnalysis, ...]


def _side_analyses(
    prepared: PreparedRecordings,
    search_result: SearchResult,
    judgement: Judgement,
    matters: Matters,
    ask_next: bool,
    progress: Callable[[float], None],
) -> SideAnalyses:
    decision, record = judgement.decision, prepared.validation_recording.record
    differences_attempt = _record_differences(
        prepared, search_result, decision, lambda done_share: progress(0.5 * done_share)
    )
    force_attempt = _unmeasured_force(record.rig, judgement.unmeasured, decision.misfit_to_describe, matters)
    rival_pair = _rival_hypotheses(decision) if ask_next and record.has_force else None
    experiments_attempt = _next_experiments(prepared, rival_pair)
    attribution_attempt = attempted(
        "attribution",
        lambda: attribution(judgement.linearization, judgement.nominal_residual, decision.nominal_hypothesis.misfit),
    )
    progress(1.0)
    return SideAnalyses(
        between=differences_attempt.result,
        unknown=force_attempt.result,
        next_experiments=experiments_attempt.result or (),
        next_between=tuple(" + ".join(rival.effects) or "nothing" for rival in rival_pair or ()),
        attribution=attribution_attempt.result or Attribution(),
        notes=tuple(
            note
            for attempt in (force_attempt, differences_attempt, experiments_attempt, attribution_attempt)
            for note in attempt.notes
        ),
    )


def _record_differences(
    prepared: PreparedRecordings, search_result: SearchResult, decision: Decision, progress: Callable[[float], None]
) -> Attempt[RecordDifferences]:
    """Differences between the records, where more than one was fitted."""
    if not prepared.fits_several:
        return Attempt()
    records = [observation.record for observation in prepared.observations]
    variances_by_record = [observation.nominal_variances for observation in prepared.observations]
    named_cause = decision.named_hypothesis if decision.corrects_rig else None
    force_levels_n = [
        float(np.sqrt(np.mean(np.sum(observation.recording.forces_n**2, axis=0))))
        for observation in prepared.observations
    ]
    return attempted(
        "between_records",
        lambda: differences(
            records,
            variances_by_record,
            named_cause,
            search_result.candidates,
            prepared.record_titles,
            force_levels_n,
            progress,
        ),
    )


def _unmeasured_force(
    rig: Rig, unmeasured: UnmeasuredCauses, misfit: Misfit, matters: Matters
) -> Attempt[UnmeasuredForce]:
    """Description of the unmeasured force or of the modulated clearance, whichever explains more of the mismatch.

    Both are compared in units of what matters: a force by its share of the unexplained motion, a modulated clearance by
    its share of the unexplained force of its contact.
    """
    force_fit, clearance_swing = unmeasured.force_fit, unmeasured.clearance_swing
    force_attempt = attempted("force_description", lambda: described(force_fit)) if force_fit else Attempt()
    if clearance_swing is None:
        return force_attempt
    contact_by_name = {contact.name: contact for contact in group_rig_of(rig).contacts}
    unexplained_contact_share = dict(zip(contact_by_name, misfit.contact_shares, strict=True))[
        clearance_swing.contact_name
    ]
    force_size = force_attempt.result.explained * misfit.motion_share / matters.motion if force_attempt.result else 0.0
    if clearance_swing.variance_share * unexplained_contact_share / matters.contact > force_size:
        return Attempt(
            clearance_swing.as_unmeasured_force(contact_by_name[clearance_swing.contact_name]), force_attempt.notes
        )
    return force_attempt


def _next_experiments(
    prepared: PreparedRecordings, rival_pair: tuple[Hypothesis, Hypothesis] | None
) -> Attempt[tuple[NextExperiment, ...]]:
    if rival_pair is None:
        return Attempt()
    validation_recording = prepared.validation_recording
    return attempted(
        "next_experiment",
        lambda: next_experiments(
            validation_recording.record, validation_recording.recording.forces_n, rival_pair, prepared.simulate
        ),
    )


def _rival_hypotheses(decision: Decision) -> tuple[Hypothesis, Hypothesis] | None:
    """The two likeliest hypotheses, if both are likelier than `RIVAL_PROBABILITY`: two causes, or one and the nominal
    rig.

    The nominal rig also stands for something unmeasured, which cannot be simulated.
    """
    probabilities_and_hypotheses = [
        (
            weighted_hypothesis.probability
            + decision.probability_unmeasured * (weighted_hypothesis.validated is decision.nominal_hypothesis),
            weighted_hypothesis.validated.hypothesis,
        )
        for weighted_hypothesis in decision.weighted_hypotheses
    ]
    likely_hypotheses = sorted(
        (
            probability_and_hypothesis
            for probability_and_hypothesis in probabilities_and_hypotheses
            if probability_and_hypothesis[0] > RIVAL_PROBABILITY
        ),
        key=lambda probability_and_hypothesis: -probability_and_hypothesis[0],
    )
    return (likely_hypotheses[0][1], likely_hypotheses[1][1]) if len(likely_hypotheses) > 1 else None
