"""The third stage of a diagnosis: hypotheses, and something unmeasured, judged on the recording that was not fitted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identify.gaps.decision.bounds import Difference, contact_distances, share_bounds
from identify.gaps.decision.comparison import TEMPERATURE, Judged, closed, judged, log_priors
from identify.gaps.decision.contact_evidence import with_contact_evidence
from identify.gaps.decision.hypotheses import Searched
from identify.gaps.decision.notes import attempted
from identify.gaps.decision.null_reference import combined, p_values
from identify.gaps.decision.prediction import PredictedDecision, predicted, predicted_decision
from identify.gaps.decision.prepare import Prepared, PreparedRecording
from identify.gaps.decision.verdict import Decision, Rivals, acts_where_they_do, decided, nominal_of
from identify.gaps.decision_table import DIFFERS, HALF, Verdict, all_hold
from identify.gaps.residual.likelihood import Misfit, misfit
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.results import Matters, Note
from identify.gaps.search.contact_laws import with_contact_fit
from identify.gaps.search.hypothesis import WORTH
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force import UnmeasuredForceFit, likeliest_force
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation, clearance_modulation
from identify.linear.joined import joined
from rig.model.description import Rig


@dataclass(frozen=True)
class Unmeasured:
    """Unmeasured force, or modulated clearance, beside the nominal rig, or beside named effects that explain a part.

    gain is by how much -2 ln p of the believed rig falls with the force that explains it best; None where none was
    looked for.
    """

    force: UnmeasuredForceFit | None = None
    modulation: ClearanceModulation | None = None
    gain: float | None = None
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class Judgement:
    """The decision on the validation record, and what prediction said before an unmeasured force was looked for;
    linearization and residual there are those of the believed rig."""

    decision: Decision
    prediction: PredictedDecision
    unmeasured: Unmeasured
    linearization: Linearization
    residual: Residual


def judge(
    prepared: Prepared, searched: Searched, matters: Matters, progress: Callable[[float], None] = lambda _: None
) -> Judgement:
    """The difference, every hypothesis on the validation record, whether the named effects predict the motion, and
    something unmeasured where they do not suffice."""
    validation = prepared.validation
    record = validation.record
    linearization, residual = fit_nuisance(record, record.rig, rounds=1)
    priors = log_priors(searched.hypotheses, searched.candidates)
    ranked = judged(record, validation.reference, residual, searched.hypotheses, priors, progress)
    ranked = _with_contact_fit(prepared, ranked, residual)
    difference = difference_of(prepared, residual, matters, split_p_value(ranked))
    ranked = with_contact_evidence(prepared, searched.candidates, ranked, difference, residual)
    basis = _Basis(prepared, difference, residual, matters)
    outcome = predicted_decision(
        ranked, basis.decided, lambda named: attempted("rollout", lambda: predicted(prepared, residual, named))
    )
    decision, unmeasured = outcome.decision, Unmeasured()
    if decision.verdict in INCOMPLETE:
        decision, unmeasured = _with_a_force(basis, outcome.ranked, decision)
    return Judgement(decision, outcome, unmeasured, linearization, residual)


@dataclass(frozen=True)
class _Basis:
    """Evidence that all decisions on the hypotheses share."""

    prepared: Prepared
    difference: Difference
    residual: Residual
    matters: Matters

    def decided(self, ranked: Sequence[Judged], vetoed: bool = False, rivals: Rivals | None = None) -> Decision:
        return decided(ranked, self.difference, self.prepared.null_reference, self.matters, rivals, vetoed)


def split_p_value(ranked: Sequence[Judged]) -> float:
    """p-value of the nominal rig against the hypotheses that were fitted on another record.

    With S of the nominal rig and of the n-th hypothesis on the record that was not fitted, the split likelihood ratio
    gives p <= n exp((S_hypothesis - S_nominal) / (2 TEMPERATURE)) (Wasserman, Ramdas and Balakrishnan, Proc.
    Natl. Acad. Sci. 117, 2020).
    """
    nominal = nominal_of(ranked).misfit.minus_two_log
    gains = [nominal - j.misfit.minus_two_log for j in ranked if j.hypothesis.parts]
    return float(min(1.0, len(gains) * np.exp(-max(gains, default=0.0) / (2 * TEMPERATURE)))) if gains else 1.0


CERTAIN = DIFFERS / 10
"""A p-value that no further part of the combination raises above `DIFFERS`."""
INCOMPLETE = (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)
"""Verdicts with which something is left to be described."""


def difference_of(prepared: Prepared, residual: Residual, matters: Matters, p_split: float) -> Difference:
    """Difference of the nominal rig and all records; `residual` is that of the record that validates.

    Contact parameters are looked at unless the rest is certain of a difference that is not bounded.
    """
    validation = prepared.validation
    residuals = [
        residual if one is validation else fit_nuisance(one.record, one.record.rig, rounds=1)[1]
        for one in prepared.observations
    ]
    left = [misfit(one.record, one.reference, at) for one, at in zip(prepared.observations, residuals, strict=True)]
    parts = np.append(p_values(list(zip(prepared.null_references, left, strict=True))), p_split)
    rig = validation.record.rig
    names = [f"force of {contact.name}" for contact in joined(rig).contacts]
    motion, *contacts = share_bounds(left[prepared.validating], names, matters)
    if combined(parts) < CERTAIN and not all_hold((motion, *contacts)):
        return Difference(combined(parts), motion, tuple(contacts))
    recordings = [one.recording for one in prepared.observations]
    distances = contact_distances(recordings, rig, validation.record.tolerances)
    p = combined(np.append(parts, distances.p_values))
    return Difference(p, motion, tuple(contacts), distances.bounds, distances.estimates)


def _with_contact_fit(prepared: Prepared, ranked: list[Judged], residual: Residual) -> list[Judged]:
    """The likeliest effects with contact laws as `identify contact` fits them, unless the validation record then shows
    more than it showed before, by `WORTH` in -2 ln p.

    Nothing is fitted where the believed rig is the likeliest.
    """
    best, *others = ranked
    recordings, record = [one.recording for one in prepared.fitted], prepared.validation.record
    hypothesis = with_contact_fit(best.hypothesis, recordings, record.tolerances)
    if hypothesis is best.hypothesis:
        return ranked
    priors = {hypothesis.key: best.log_prior}
    fitted = judged(record, prepared.validation.reference, residual, [hypothesis], priors)
    better = [one for one in fitted if one.misfit.minus_two_log < best.misfit.minus_two_log + WORTH]
    return sorted([*(better or [best]), *others], key=lambda one: -one.log_posterior)


def _with_a_force(basis: _Basis, ranked: Sequence[Judged], decision: Decision) -> tuple[Decision, Unmeasured]:
    """The decision with an unmeasured force as a rival of the effects; where they explain half, as their companion."""
    prepared, residual, validation = basis.prepared, basis.residual, basis.prepared.validation
    record, vetoed = validation.record, decision.evidence.vetoed
    alone = attempted("unmeasured_force", lambda: likeliest_force(prepared.searched.record, record.rig, record))
    nothing = nominal_of(ranked)
    cost = cost_with(validation, record.rig, alone.value, nothing.misfit) if alone.value else None
    gain = None if cost is None else nothing.misfit.minus_two_log - cost
    decision = basis.decided(ranked, vetoed, Rivals(cost))
    force, named = alone, decision.named
    if named and closed(named.without, named.misfit, basis.matters) >= HALF:
        rig = named.rig
        beside = attempted("unmeasured_force", lambda: likeliest_force(prepared.searched.record, rig, record))
        companion = beside.value
        if companion and acts_where_they_do(companion.on_fit.candidate, record.rig, rig):
            companion = None
        cost_beside = cost_with(validation, rig, companion, named.misfit) if companion else None
        decision = basis.decided(ranked, vetoed, Rivals(cost, named, cost_beside))
        if decision.verdict == Verdict.PARTLY_EXPLAINED:
            force, residual = beside, fit_nuisance(record, rig, rounds=1)[1]
    modulation = attempted("clearance_modulation", lambda: clearance_modulation(record, residual))
    return decision, Unmeasured(force.value, modulation.value, gain, (*force.notes, *modulation.notes))


def cost_with(validation: PreparedRecording, rig: Rig, force: UnmeasuredForceFit, alone: Misfit) -> float:
    """-2 ln p of a validation record with an unmeasured force beside a rig, which alone leaves `alone`.

    The force is taken off what the sensors delivered, and the rig fitted to the rest like any other. Its time history
    is free to follow one direction of the residual's many: there nothing is gained. Nor is it where the records do not
    show the same.
    """
    if not force.same_place:
        return alone.minus_two_log
    record = validation.record
    cleared = replace(record, delivered=record.delivered - force.delivered())
    left = misfit(cleared, validation.reference, fit_nuisance(cleared, rig, rounds=1)[1])
    followed = force.directions / force.held.observed.rows
    return left.minus_two_log + followed * (alone.linear + alone.sharp - left.linear - left.sharp)
