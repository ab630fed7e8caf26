"""Veto by prediction: the rig with the named effects has to move as the machine does."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from identify.gaps.decision.comparison import Judged
from identify.gaps.decision.notes import Attempt
from identify.gaps.decision.prepare import Prepared
from identify.gaps.decision.verdict import ALIKE, Decision, nominal_of, strengths_exclude_neutral
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
    """Decide among hypotheses; veto the named effects if they predict the motion worse.

    After a veto, the hypotheses that were likelier than `ALIKE`, and whose strengths exclude their neutral values, are
    decided among without the vetoed one, until one is not vetoed; if all are, the first decision stays, with its veto.
    decide takes hypotheses and whether their named effects are vetoed.
    """
    first = outcome = _predicted(ranked, decide, predict)
    rivals = [w.judged for w in first.decision.weighed if w.probability > ALIKE]
    rivals = [rival for rival in rivals if strengths_exclude_neutral(rival.hypothesis)]
    ruled_out: list[Judged] = []
    while outcome.vetoed:
        vetoed = outcome.decision.named
        ruled_out += [hypothesis for hypothesis in outcome.ranked if hypothesis is vetoed]
        rivals = [rival for rival in rivals if rival is not vetoed]
        if not rivals:
            return first
        outcome = _predicted([nominal_of(ranked), *rivals], decide, predict)
    return replace(outcome, ruled_out=tuple(ruled_out)) if outcome.decision.helps else first


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
