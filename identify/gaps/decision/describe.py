"""The last stage of a diagnosis: its answer in words and numbers, the content of gap.json."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from msgspec.structs import asdict

from identify.gaps.decision.attribution import attribution
from identify.gaps.decision.causes import bands_of, cause_of, confirmed_by, left_of
from identify.gaps.decision.differences import differences
from identify.gaps.decision.experiment import next_experiments
from identify.gaps.decision.hypotheses import Searched
from identify.gaps.decision.judge import Judgement, Unmeasured
from identify.gaps.decision.notes import Attempt, attempted
from identify.gaps.decision.phrases import words_of
from identify.gaps.decision.prepare import Prepared
from identify.gaps.decision.response_comparison import compared
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision.verdict import ALIKE, Decision
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.results import (
    Attribution,
    Between,
    Criteria,
    Curve,
    Diagnosis,
    Figure,
    Gap,
    Matters,
    NextExperiment,
    Note,
)
from identify.gaps.search.hypothesis import Hypothesis
from identify.gaps.unmeasured_force import described
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.model.unmeasured_force import UnmeasuredForce


def describe(
    prepared: Prepared,
    searched: Searched,
    judgement: Judgement,
    matters: Matters,
    ask_next: bool = False,
    progress: Callable[[float], None] = lambda _: None,
) -> Gap:
    """The answer. With ask_next the next experiment is computed where two causes stay alike."""
    decision, record = judgement.decision, prepared.validation.record
    sides = _side_analyses(prepared, searched, judgement, matters, ask_next, progress)
    weighed = sorted(
        (w for w in decision.weighed if w.judged.hypothesis.parts), key=lambda w: w.judged is not decision.named
    )
    causes = tuple(cause_of(w, decision.weighed, record, prepared.null_reference, matters) for w in weighed)
    evidence = decision.evidence
    diagnosis = Diagnosis(
        verdict=decision.verdict,
        criteria=Criteria(evidence.differs, evidence.bounded, evidence.named, evidence.enough),
        evidence=evidence,
        not_seen=evidence.not_seen,
        rollout=judgement.prediction.rollout.value,
        ruled_out=tuple(words_of(one.hypothesis, record.rig) for one in judgement.prediction.ruled_out),
        free_decay=not any(one.record.forced for one in prepared.observations),
        before=left_of(decision.nothing.misfit, record.rig, evidence.p_value),
        after=left_of(decision.after, record.rig, evidence.p_value_after),
        matters=matters,
        causes=causes,
        probability_nothing=decision.probability_nothing,
        probability_unknown=decision.unknown,
        nothing_minus_two_log=decision.nothing.misfit.minus_two_log,
        unknown_gain=judgement.unmeasured.gain,
        unknown=sides.unknown,
        bands=bands_of(decision.nothing.misfit, decision.after, prepared.null_reference),
        separate_by=confirmed_by(causes, [w.judged for w in weighed]),
        next_experiments=sides.next_experiments,
        next_between=sides.next_between,
        attribution=sides.attribution,
        figures=sides.figures,
        curves=sides.curves,
        between=sides.between,
        channel_faults=prepared.channel_faults,
        notes=(*judgement.prediction.rollout.notes, *judgement.unmeasured.notes, *sides.notes),
    )
    return Gap(**asdict(diagnosis), sentence=sentence(diagnosis))


@dataclass(frozen=True)
class SideAnalyses:
    """Analyses that the verdict does not rest on; what could not be computed is left out, and noted."""

    between: Between | None
    unknown: UnmeasuredForce | None
    figures: tuple[Figure, ...]
    curves: tuple[Curve, ...]
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
    between = _between(prepared, searched, decision, lambda x: progress(0.5 * x))
    force = _unmeasured(record.rig, judgement.unmeasured, decision.left_to_describe, matters)
    comparison = _compared(prepared, decision.likeliest_rig or record.rig)
    rivals = _rivals(decision) if ask_next and record.forced else None
    further = _next_experiments(prepared, rivals)
    where = attempted(
        "attribution", lambda: attribution(judgement.linearization, judgement.residual, decision.nothing.misfit)
    )
    progress(1.0)
    figures, curves = comparison.value or ((), ())
    return SideAnalyses(
        between=between.value,
        unknown=force.value,
        figures=figures,
        curves=curves,
        next_experiments=further.value or (),
        next_between=tuple(" + ".join(one.effects) or "nothing" for one in rivals or ()),
        attribution=where.value or Attribution(),
        notes=tuple(note for one in (force, between, comparison, further, where) for note in one.notes),
    )


def _between(
    prepared: Prepared, searched: Searched, decision: Decision, progress: Callable[[float], None]
) -> Attempt[Between]:
    """Differences between the records, where more than one was fitted."""
    if not prepared.several:
        return Attempt()
    records = [one.record for one in prepared.observations]
    references = [one.reference for one in prepared.observations]
    cause = decision.named if decision.helps else None
    levels_n = [float(np.sqrt(np.mean(np.sum(one.recording.forces_n**2, axis=0)))) for one in prepared.observations]
    return attempted(
        "between_records",
        lambda: differences(records, references, cause, searched.candidates, prepared.titles, levels_n, progress),
    )


def _unmeasured(rig: Rig, found: Unmeasured, left: Misfit, matters: Matters) -> Attempt[UnmeasuredForce]:
    """The force, or the clearance that swings: what explains more of the gap, in units of what matters.

    A force explains a share of what is left of the motion, a swinging clearance of what is left of its contact's force.
    """
    fit, modulation = found.force, found.modulation
    force = attempted("force_description", lambda: described(fit)) if fit else Attempt()
    if modulation is None:
        return force
    contacts = {c.name: c for c in joined(rig).contacts}
    share = dict(zip(contacts, left.contact_shares, strict=True))[modulation.contact]
    by_force = force.value.explained * left.share / matters.motion if force.value else 0.0
    if modulation.share * share / matters.contact > by_force:
        return Attempt(modulation.described(contacts[modulation.contact]), force.notes)
    return force


def _compared(prepared: Prepared, likeliest: Rig) -> Attempt[tuple[tuple[Figure, ...], tuple[Curve, ...]]]:
    measured = prepared.validation.recording
    return attempted(
        "response_comparison",
        lambda: compared(measured, measured.rig, likeliest, prepared.simulate, prepared.null_reference),
    )


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


def _rivals(decision: Decision) -> tuple[Hypothesis, Hypothesis] | None:
    """The two likeliest, if both are likelier than `ALIKE`: causes, or a cause and the believed rig.

    That stands for something unknown too, which nobody can simulate.
    """
    shares = [
        (weighed.probability + decision.unknown * (weighed.judged is decision.nothing), weighed.judged.hypothesis)
        for weighed in decision.weighed
    ]
    likely = sorted((one for one in shares if one[0] > ALIKE), key=lambda one: -one[0])
    return (likely[0][1], likely[1][1]) if len(likely) > 1 else None
