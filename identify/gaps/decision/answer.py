"""From recordings to a diagnosis in words and numbers: the content of gap.json."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identify.gaps.decision.attribution import attribution
from identify.gaps.decision.causes import ALIKE, bands_of, cause_of, confirmed_by, equivalent, left_of
from identify.gaps.decision.comparison import Judged, closed, judged, log_priors
from identify.gaps.decision.differences import differences
from identify.gaps.decision.experiment import next_experiments
from identify.gaps.decision.null_reference import NullReference, Simulate, null_reference_of
from identify.gaps.decision.recordings import parts_of, sound
from identify.gaps.decision.release import released
from identify.gaps.decision.response_comparison import compared
from identify.gaps.decision.sentence import sentence
from identify.gaps.decision.unmeasured import cost_with, unmeasured
from identify.gaps.decision.verdict import HALF, Decision, acts_where_they_do, decided, doubted
from identify.gaps.residual.likelihood import Reference, reference_of
from identify.gaps.residual.residual import Residual, linearized
from identify.gaps.residual.spectra import Record, record_of
from identify.gaps.results import USUAL, Gap, Matters, NextExperiment
from identify.gaps.search.candidates import Candidate, candidates, scale_of
from identify.gaps.search.hypothesis import Hypothesis, Search
from identify.gaps.search.joint import search
from identify.gaps.search.nominal import fit_nuisance
from identify.gaps.search.pooled import fitted_together
from identify.gaps.unmeasured_force import UnmeasuredForceFit, described, likeliest_force
from identify.gaps.unmeasured_force.clearance_modulation import ClearanceModulation, clearance_modulation
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.tolerances import LABORATORY, Tolerances
from rig.recording import Recording

MATTERS = Matters()

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Simulator:
    """What simulates a rig under a measured force, and its name."""

    name: str
    simulate: Simulate


def _level_n(recording: Recording) -> float:
    """Of all forces together, N rms."""
    return float(np.sqrt(np.sum(np.var(recording.forces_n, axis=1))))


def diagnose(
    recordings: Recording | Sequence[Recording],
    validation: Recording | None,
    simulator: Simulator,
    kept: Path | None = None,
    progress: Progress = lambda *_: None,
    tolerances: Tolerances | None = None,
    matters: Matters = MATTERS,
    ask_next: bool = False,
) -> tuple[Gap, Rig]:
    """The diagnosis, and the rig corrected by it (the believed one, if no effect explains the gap at least in part).

    `validation` may be one of the recordings, or another; None: the last of several, or the last part of a single one.
    Of several that are fitted, the one of the strongest force is searched; then all share the parameters of what was
    found there, and what differs between the records is told. The null reference is made by the simulator, or read from
    `kept` (see `null_reference`); tolerances say how exactly the rig is believed (else the rig itself does, else they
    are a laboratory's). Raises RigError if the records do not fit together or allow no diagnosis. With ask_next the
    next experiment is computed where two causes stay alike.
    """
    parts, last = parts_of(recordings, validation)
    believed = tolerances or parts[0].rig.tolerances or LABORATORY
    parts, faults = sound(*parts)
    every = [record_of(part, tolerances=believed) for part in parts]
    other, record = parts[last], every[last]
    fitted = [k for k in range(len(parts)) if k != last]
    searched_on = max(fitted, key=lambda k: _level_n(parts[k]))
    fit_record = every[searched_on]
    simulate = simulator.simulate if record.forced else released(other, simulator.simulate)
    null_reference = null_reference_of(
        other, believed, simulate, simulator.name, lambda x: progress("null_reference", x), kept
    )
    several = len(fitted) > 1
    hypotheses, known = searched(fit_record, lambda x: progress("causes", (0.4 if several else 0.7) * x))
    reference = _reference(record)
    if several:
        seen = [_reference(one) for one in every]
        shared = [every[k] for k in fitted], [seen[k] for k in fitted]
        hypotheses = [fitted_together(*shared, one) for one in hypotheses]
    priors = log_priors(hypotheses, known)
    linearization, at = fit_nuisance(record, record.rig, rounds=1)
    ranked = judged(record, reference, at, hypotheses, priors, lambda x: progress("causes", 0.7 + 0.2 * x))
    found = _decided(fit_record, record, reference, at, ranked, null_reference, matters)
    decision, unknown, swinging = found.decision, found.unknown, found.swinging
    between = None
    if several:
        cause = decision.best if decision.verdict in ("explained", "partly_explained") else None
        names = [f"{k + 1}, {_level_n(p):.3g} N{', validates' * (k == last)}" for k, p in enumerate(parts)]
        between = differences(every, seen, cause, known, names, lambda x: progress("causes", 0.9 + 0.05 * x))
    progress("causes", 0.95)
    likeliest = decision.best.corrected if decision.best else other.rig
    figures, curves = compared(other, other.rig, likeliest, simulate, null_reference)
    progress("causes", 1.0)
    causes = tuple(
        cause_of(j, record, p, null_reference, matters)
        for j, p in zip(ranked, decision.probabilities, strict=True)
        if j.hypothesis.parts
    )
    nothing = decision.nothing
    further: tuple[NextExperiment, ...] = ()
    rivals = _rivals(ranked, decision) if ask_next and record.forced else None
    if rivals:
        further = next_experiments(record, other.forces_n, rivals, simulator.simulate)
    doubt = doubted(ranked, decision.verdict)
    after = decision.best.misfit if decision.best else nothing.misfit
    without = decision.best.without if decision.best else nothing.misfit
    rest = after if decision.verdict == "partly_explained" else nothing.misfit
    gap = Gap(
        verdict=decision.verdict,
        sentence="",
        before=left_of(without, other.rig, decision.p_before),
        after=left_of(after, other.rig, decision.p_after),
        matters=matters,
        causes=causes,
        probability_nothing=decision.probabilities[ranked.index(nothing)],
        probability_unknown=decision.unknown,
        nothing_minus_two_log=nothing.misfit.minus_two_log,
        unknown_gain=found.unknown_gain,
        unknown=unmeasured(other.rig, described(unknown) if unknown else None, swinging, rest, matters),
        doubted=None if doubt is None else causes[[j for j in ranked if j.hypothesis.parts].index(doubt)],
        bands=bands_of(without, after, null_reference),
        equivalent=equivalent(causes) if causes else (),
        separate_by=confirmed_by(causes, ranked),
        next_experiments=further,
        next_between=tuple(" + ".join(one.effects) or "nothing" for one in rivals or ()),
        attribution=attribution(linearization, at, nothing.misfit),
        figures=figures,
        curves=curves,
        between=between,
        channel_faults=faults,
    )
    helps = decision.verdict in ("explained", "partly_explained")
    return sentence(gap, decision.criterion, any(one.forced for one in every)), likeliest if helps else other.rig


def searched(
    record: Record, progress: Callable[[float], None] = lambda _: None
) -> tuple[list[Hypothesis], list[Candidate]]:
    """Hypotheses on a record, and the candidates among which they were found."""
    reference = _reference(record)
    linearization, at = fit_nuisance(record, record.rig)
    known = candidates(scale_of(record, record.rig), [s.name for s in record.sensors], record.zero_known, record.forced)
    return search(Search(reference, linearization, at, tuple(known)), progress), known


def _reference(record: Record) -> Reference:
    return reference_of(linearized(record, record.rig))


@dataclass(frozen=True)
class _Decided:
    """The decision, what acts unmeasured or swings where the verdict asks for it, and by how much -2 ln p of the
    believed rig falls with it."""

    decision: Decision
    unknown: UnmeasuredForceFit | None = None
    swinging: ClearanceModulation | None = None
    unknown_gain: float | None = None


def _decided(
    fit_record: Record,
    record: Record,
    reference: Reference,
    at: Residual,
    ranked: list[Judged],
    null_reference: NullReference,
    matters: Matters,
) -> _Decided:
    """The verdict; and of a gap that no effect explains, what acts unmeasured: beside the likeliest effects, if those
    explain it in part.

    Effects that leave more than tolerances and noise must be likelier than something unmeasured, however little it is.
    """
    decision = decided(ranked, None, null_reference, matters)
    if decision.verdict == "no_gap" or (decision.verdict == "explained" and decision.p_after >= USUAL):
        return _Decided(decision)
    unknown, nothing, best = _unknown(fit_record, record, record.rig), decision.nothing, decision.best
    cost = cost_with(record, reference, record.rig, unknown, nothing.misfit) if unknown else None
    gain = None if cost is None else nothing.misfit.minus_two_log - cost
    decision = decided(ranked, cost, null_reference, matters)
    if decision.verdict in ("no_gap", "explained"):
        return _Decided(decision, unknown_gain=gain)
    if best and closed(best.without, best.misfit, matters) >= HALF:
        rest = _unknown(fit_record, record, best.rig)
        beside = None
        if rest and not acts_where_they_do(rest.on_fit.candidate, record.rig, best.rig):
            beside = cost_with(record, reference, best.rig, rest, best.misfit)
        decision = decided(ranked, cost, null_reference, matters, beside)
        if decision.verdict == "partly_explained":
            unknown, at = rest, fit_nuisance(record, best.rig, rounds=1)[1]
    if decision.verdict in ("no_gap", "explained"):
        return _Decided(decision, unknown_gain=gain)
    return _Decided(decision, unknown, clearance_modulation(record, at), gain)


def _unknown(fit_record: Record, record: Record, rig: Rig) -> UnmeasuredForceFit | None:
    """What acts unmeasured beside a rig."""
    try:
        return likeliest_force(fit_record, rig, record)
    except RigError:
        return None  # too few sensors to show a force beside the contacts'


def _rivals(ranked: list[Judged], decision: Decision) -> tuple[Hypothesis, Hypothesis] | None:
    """The two likeliest, if both are likelier than `ALIKE`: causes, or a cause and the believed rig.

    That stands for something unknown too, which nobody can simulate.
    """
    shares = dict(zip((id(j) for j in ranked), decision.probabilities, strict=True))
    shares[id(decision.nothing)] += decision.unknown
    likely = sorted((j for j in ranked if shares[id(j)] > ALIKE), key=lambda j: -shares[id(j)])
    return (likely[0].hypothesis, likely[1].hypothesis) if len(likely) > 1 else None
