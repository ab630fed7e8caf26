"""Whether the rig with the named effects moves as the machine does: it may veto an explanation, and never gives one."""

from identify.gaps.decision.comparison import Judged
from identify.gaps.decision.prepare import Prepared
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
