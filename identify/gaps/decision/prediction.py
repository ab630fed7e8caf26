"""Whether the rig with the named effects moves as the machine does: it may veto an explanation, and never gives one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from identify.gaps.decision.comparison import Judged
from identify.gaps.decision.notes import Attempt
from identify.gaps.decision.prepare import Prepared
from identify.gaps.decision.verdict import ALIKE, Decision, all_told, nominal_of
from identify.gaps.residual.residual import Residual
from identify.gaps.residual.spectra import record_of
from identify.gaps.rollout.judge import confirmed, judged, log_ratio_of
from identify.gaps.rollout.results import Rollout
from identify.gaps.search.nominal import fit_nuisance

CONFIRMING = 3
"""Simulations of a machine with the named effects, where a prediction falls short of what it would be."""


def predicted(prepared: Prepared, believed: Residual, named: Judged) -> Rollout:
    """The prediction of the validation record by the believed rig (`believed` is its residual there) and by that with
    the named effects."""
    if prepared.predict is None:
        return Rollout(code="not_simulated")
    validation, predict = prepared.validation, prepared.predict
    corrected = fit_nuisance(validation.record, named.rig, rounds=1)[1]
    nulls = prepared.null_reference.predictions
    told = judged(validation.recording, believed, corrected, nulls, predict)
    if not told.falls_short:
        return told
    samples = round(told.horizon_s * validation.recording.rig.sample_rate_hz)
    ratios = []
    for seed in range(CONFIRMING):
        made = prepared.simulate(validation.recording.rig, named.corrected, validation.recording.forces_n, seed)
        record = record_of(made, tolerances=validation.record.tolerances)
        nominal, with_effects = (fit_nuisance(record, rig, rounds=1)[1] for rig in (record.rig, named.rig))
        ratios.append(log_ratio_of(made, nominal, with_effects, samples, predict))
    return confirmed(told, ratios)


@dataclass(frozen=True)
class PredictedDecision:
    """A decision among hypotheses, and what prediction says of its named effects; ruled_out are likelier hypotheses
    with which the motion is predicted no better."""

    ranked: Sequence[Judged]
    decision: Decision
    rollout: Attempt[Rollout] = field(default_factory=Attempt)
    ruled_out: tuple[Judged, ...] = ()

    @property
    def vetoed(self) -> bool:
        return self.rollout.value is not None and self.rollout.value.vetoed


def predicted_decision(
    ranked: Sequence[Judged],
    decide: Callable[[Sequence[Judged], bool], Decision],
    predict: Callable[[Judged], Attempt[Rollout]],
) -> PredictedDecision:
    """The decision, vetoed if its named effects predict the motion worse.

    Then other hypotheses that were likely too, and whose strengths are all told, take its place, as long as prediction
    rules out the likeliest of them; if it rules out all, the first stays, with its veto. decide takes hypotheses and
    whether they are vetoed.
    """
    first = outcome = _predicted(ranked, decide, predict)
    rest = [w.judged for w in first.decision.weighed if w.probability > ALIKE and all_told(w.judged.hypothesis)]
    ruled_out: list[Judged] = []
    while outcome.vetoed:
        vetoed = outcome.decision.named
        ruled_out += [one for one in outcome.ranked if one is vetoed]
        rest = [one for one in rest if one is not vetoed]
        if not rest:
            return first
        outcome = _predicted([nominal_of(ranked), *rest], decide, predict)
    if not outcome.decision.helps:
        return first
    return PredictedDecision(outcome.ranked, outcome.decision, outcome.rollout, tuple(ruled_out))


def _predicted(
    ranked: Sequence[Judged],
    decide: Callable[[Sequence[Judged], bool], Decision],
    predict: Callable[[Judged], Attempt[Rollout]],
) -> PredictedDecision:
    decision = decide(ranked, False)
    if not decision.helps or decision.named is None:
        return PredictedDecision(ranked, decision)
    outcome = PredictedDecision(ranked, decision, predict(decision.named))
    return PredictedDecision(ranked, decide(ranked, True), outcome.rollout) if outcome.vetoed else outcome
