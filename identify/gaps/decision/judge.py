"""The third stage of a diagnosis: hypotheses, and something unmeasured, judged on the recording that was not fitted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from identify.gaps.decision.comparison import Judged, closed, judged, log_priors
from identify.gaps.decision.hypotheses import Searched
from identify.gaps.decision.notes import attempted
from identify.gaps.decision.prepare import Prepared, PreparedRecording
from identify.gaps.decision.verdict import HALF, Decision, acts_where_they_do, decided, nothing_of
from identify.gaps.residual.likelihood import Misfit, misfit
from identify.gaps.residual.residual import Linearization, Residual
from identify.gaps.results import USUAL, Matters, Note
from identify.gaps.search.contact_laws import with_contact_fit
from identify.gaps.search.hypothesis import WORTH
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.unmeasured_force import UnmeasuredForceFit, likeliest_force
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation, clearance_modulation
from rig.model.description import Rig


@dataclass(frozen=True)
class Unmeasured:
    """What acts unmeasured, or swings, beside the believed rig, or the likeliest effects if they explain a part.

    gain is by how much -2 ln p of the believed rig falls with the force that explains it best; None where none was
    looked for.
    """

    force: UnmeasuredForceFit | None = None
    modulation: ClearanceModulation | None = None
    gain: float | None = None
    notes: tuple[Note, ...] = ()


@dataclass(frozen=True)
class Judgement:
    """The decision on the validation record; linearization and residual there are those of the believed rig."""

    decision: Decision
    unmeasured: Unmeasured
    linearization: Linearization
    residual: Residual


def judge(
    prepared: Prepared, searched: Searched, matters: Matters, progress: Callable[[float], None] = lambda _: None
) -> Judgement:
    """Every hypothesis on the validation record, with something unmeasured where tolerances and noise leave less.

    Effects that leave more than tolerances and noise must be likelier than something unmeasured, however little it is.
    """
    validation = prepared.validation
    record = validation.record
    linearization, residual = fit_nuisance(record, record.rig, rounds=1)
    priors = log_priors(searched.hypotheses, searched.candidates)
    ranked = judged(record, validation.reference, residual, searched.hypotheses, priors, progress)
    ranked = _with_contact_fit(prepared, ranked, residual)
    decision = decided(ranked, None, prepared.null_reference, matters)
    unmeasured = Unmeasured()
    if decision.verdict != "no_gap" and (decision.verdict != "explained" or decision.p_after < USUAL):
        decision, unmeasured = _with_a_force(prepared, ranked, residual, matters)
    return Judgement(decision, unmeasured, linearization, residual)


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


def _with_a_force(
    prepared: Prepared, ranked: Sequence[Judged], residual: Residual, matters: Matters
) -> tuple[Decision, Unmeasured]:
    """The decision with an unmeasured force as a rival of the effects; where they explain half, as their companion."""
    validation, null_reference = prepared.validation, prepared.null_reference
    record = validation.record
    alone = attempted("unmeasured_force", lambda: likeliest_force(prepared.searched.record, record.rig, record))
    nothing = nothing_of(ranked)
    cost = cost_with(validation, record.rig, alone.value, nothing.misfit) if alone.value else None
    gain = None if cost is None else nothing.misfit.minus_two_log - cost
    decision = decided(ranked, cost, null_reference, matters)
    force, best = alone, decision.best
    if _names_or_nothing(decision):
        return decision, Unmeasured(gain=gain, notes=alone.notes)
    if best and closed(best.without, best.misfit, matters) >= HALF:
        rig = best.rig
        beside = attempted("unmeasured_force", lambda: likeliest_force(prepared.searched.record, rig, record))
        companion = beside.value
        if companion and acts_where_they_do(companion.on_fit.candidate, record.rig, rig):
            companion = None
        cost_beside = cost_with(validation, rig, companion, best.misfit) if companion else None
        decision = decided(ranked, cost, null_reference, matters, cost_beside)
        if decision.verdict == "partly_explained":
            force, residual = beside, fit_nuisance(record, rig, rounds=1)[1]
        if _names_or_nothing(decision):
            return decision, Unmeasured(gain=gain, notes=force.notes)
    modulation = attempted("clearance_modulation", lambda: clearance_modulation(record, residual))
    return decision, Unmeasured(force.value, modulation.value, gain, (*force.notes, *modulation.notes))


def _names_or_nothing(decision: Decision) -> bool:
    """Whether nothing is left to be described."""
    return decision.verdict in ("no_gap", "explained")


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
