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
from identify.gaps.decision.judge import Judgement, Unmeasured, judge
from identify.gaps.decision.notes import Attempt, attempted
from identify.gaps.decision.prepare import Prepared, Searched, Simulator, prepare, search
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision.verdict import RIVAL_PROBABILITY, Decision
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import (
    Attribution,
    Criteria,
    Diagnosis,
    Gap,
    Matters,
    NextExperiment,
    Note,
    RecordDifferences,
)
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force import described
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.model.tolerances import Tolerances
from rig.model.unmeasured_force import UnmeasuredForce
from rig.recording import Recording

__all__ = ["Simulator", "diagnose"]

MATTERS = Matters()
"""Thresholds of what matters where none are given: 0.5 % of the acceleration, 3 % of a contact force. Set by hand."""

Progress = Callable[[str, float], None]


def diagnose(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    null_reference_path: Path | None = None,
    progress: Progress = lambda *_: None,
    tolerances: Tolerances | None = None,
    matters: Matters = MATTERS,
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
        return lambda share: progress("causes", start_share + (stop_share - start_share) * share)

    prepared = prepare(
        recordings,
        validation,
        simulator,
        null_reference_path,
        tolerances,
        lambda share: progress("null_reference", share),
    )
    searched = search(prepared, causes_progress(0.0, 0.7))
    judgement = judge(prepared, searched, matters, causes_progress(0.7, 0.9))
    gap = describe(prepared, searched, judgement, matters, ask_next, causes_progress(0.9, 1.0))
    return gap, judgement.decision.corrected_rig or prepared.validation.record.rig


def describe(
    prepared: Prepared,
    searched: Searched,
    judgement: Judgement,
    matters: Matters,
    ask_next: bool = False,
    progress: Callable[[float], None] = lambda _: None,
) -> Gap:
    """Assemble the answer from the judgement; with ask_next, with the next experiment where two causes stay alike."""
    decision, record = judgement.decision, prepared.validation.record
    side_analyses = _side_analyses(prepared, searched, judgement, matters, ask_next, progress)
    weighted = sorted(
        (item for item in decision.weighted if item.validated.hypothesis.candidates),
        key=lambda item: item.validated is not decision.named,
    )
    causes = tuple(cause_of(item, decision.weighted, record, prepared.null_reference, matters) for item in weighted)
    evidence = decision.evidence
    diagnosis = Diagnosis(
        verdict=decision.verdict,
        criteria=Criteria(evidence.differs, evidence.bounded, evidence.named, evidence.enough),
        evidence=evidence,
        not_seen=evidence.not_seen,
        rollout=judgement.prediction.rollout.value,
        ruled_out=tuple(words_of(item.hypothesis, record.rig) for item in judgement.prediction.ruled_out),
        free_decay=not any(observation.record.forced for observation in prepared.observations),
        before=unexplained_shares(decision.nominal.misfit, record.rig, evidence.p_value),
        after=unexplained_shares(decision.named_misfit, record.rig, evidence.p_value_after),
        matters=matters,
        causes=causes,
        probability_nothing=decision.probability_nothing,
        probability_unknown=decision.probability_unmeasured,
        nothing_minus_two_log=decision.nominal.misfit.minus_two_log,
        unknown_gain=judgement.unmeasured.minus_two_log_decrease,
        unknown=side_analyses.unknown,
        bands=bands_of(decision.nominal.misfit, decision.named_misfit, prepared.null_reference),
        separate_by=confirming_tests(causes, [item.validated for item in weighted]),
        next_experiments=side_analyses.next_experiments,
        next_between=side_analyses.next_between,
        attribution=side_analyses.attribution,
        between=side_analyses.between,
        channel_faults=prepared.channel_faults,
        notes=(*judgement.prediction.rollout.notes, *judgement.unmeasured.notes, *side_analyses.notes),
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
    notes: tuple[Note, ...]


def _side_analyses(
    prepared: Prepared,
    searched: Searched,
    judgement: Judgement,
    matters: Matters,
    ask_next: bool,
    progress: Callable[[float], None],
) -> SideAnalyses:
    decision, record = judgement.decision, prepared.validation.record
    between = _record_differences(prepared, searched, decision, lambda x: progress(0.5 * x))
    force = _unmeasured_force(record.rig, judgement.unmeasured, decision.misfit_to_describe, matters)
    rivals = _rival_hypotheses(decision) if ask_next and record.forced else None
    experiments = _next_experiments(prepared, rivals)
    attributed = attempted(
        "attribution", lambda: attribution(judgement.linearization, judgement.residual, decision.nominal.misfit)
    )
    progress(1.0)
    return SideAnalyses(
        between=between.value,
        unknown=force.value,
        next_experiments=experiments.value or (),
        next_between=tuple(" + ".join(rival.effects) or "nothing" for rival in rivals or ()),
        attribution=attributed.value or Attribution(),
        notes=tuple(note for attempt in (force, between, experiments, attributed) for note in attempt.notes),
    )


def _record_differences(
    prepared: Prepared, searched: Searched, decision: Decision, progress: Callable[[float], None]
) -> Attempt[RecordDifferences]:
    """Differences between the records, where more than one was fitted."""
    if not prepared.fits_several:
        return Attempt()
    records = [observation.record for observation in prepared.observations]
    variances_by_record = [observation.nominal_variances for observation in prepared.observations]
    cause = decision.named if decision.corrects_rig else None
    levels_n = [
        float(np.sqrt(np.mean(np.sum(observation.recording.forces_n**2, axis=0))))
        for observation in prepared.observations
    ]
    return attempted(
        "between_records",
        lambda: differences(
            records, variances_by_record, cause, searched.candidates, prepared.titles, levels_n, progress
        ),
    )


def _unmeasured_force(rig: Rig, unmeasured: Unmeasured, misfit: Misfit, matters: Matters) -> Attempt[UnmeasuredForce]:
    """Description of the unmeasured force or of the modulated clearance, whichever explains more of the mismatch.

    Both are compared in units of what matters: a force by its share of the unexplained motion, a modulated clearance by
    its share of the unexplained force of its contact.
    """
    fit, modulation = unmeasured.force, unmeasured.modulation
    force = attempted("force_description", lambda: described(fit)) if fit else Attempt()
    if modulation is None:
        return force
    contacts = {c.name: c for c in joined(rig).contacts}
    contact_share = dict(zip(contacts, misfit.contact_shares, strict=True))[modulation.contact]
    force_size = force.value.explained * misfit.share / matters.motion if force.value else 0.0
    if modulation.share * contact_share / matters.contact > force_size:
        return Attempt(modulation.described(contacts[modulation.contact]), force.notes)
    return force


def _next_experiments(
    prepared: Prepared, rivals: tuple[Hypothesis, Hypothesis] | None
) -> Attempt[tuple[NextExperiment, ...]]:
    if rivals is None:
        return Attempt()
    validation = prepared.validation
    return attempted(
        "next_experiment",
        lambda: next_experiments(validation.record, validation.recording.forces_n, rivals, prepared.simulate),
    )


def _rival_hypotheses(decision: Decision) -> tuple[Hypothesis, Hypothesis] | None:
    """The two likeliest hypotheses, if both are likelier than `RIVAL_PROBABILITY`: two causes, or one and the nominal
    rig.

    The nominal rig also stands for something unmeasured, which cannot be simulated.
    """
    pairs = [
        (
            item.probability + decision.probability_unmeasured * (item.validated is decision.nominal),
            item.validated.hypothesis,
        )
        for item in decision.weighted
    ]
    likely = sorted((pair for pair in pairs if pair[0] > RIVAL_PROBABILITY), key=lambda pair: -pair[0])
    return (likely[0][1], likely[1][1]) if len(likely) > 1 else None
