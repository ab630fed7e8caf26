"""Causes in gap.json: parameters of every hypothesis, what it removes and leaves, what stands in its place."""

from collections.abc import Sequence

import numpy as np

from identify.gaps.decision.comparison import Judged, closed, closed_interval
from identify.gaps.decision.identifiability import identifiable_change
from identify.gaps.decision.null_reference import NullReference, p_value
from identify.gaps.decision.phrases import phrase
from identify.gaps.decision.verdict import ALIKE, Weighed, strengths_of
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.residual.record import Record
from identify.gaps.residual.scales import BAND_HZ
from identify.gaps.results import Band, Cause, Left, Matters, labels_of
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.model.unmeasured_force import Value

AT_LIMIT = 1e-3
"""A parameter within this share of its range from an end stands there."""


def left_of(left: Misfit, rig: Rig, p_value: float) -> Left:
    names = [c.name for c in joined(rig).contacts]
    return Left(
        share=left.share,
        contact_shares=dict(zip(names, left.contact_shares.tolist(), strict=True)),
        p_value=p_value,
        largest_pull=float(np.max(np.abs(left.pulls), initial=0.0)),
    )


def cause_of(
    one: Weighed, weighed: Sequence[Weighed], record: Record, null_reference: NullReference, matters: Matters
) -> Cause:
    """Standard errors hold what the effect leaves: residuals were weighed by the scales estimated from it."""
    judged, hypothesis = one.judged, one.judged.hypothesis
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}
    deviations = np.sqrt(np.maximum(np.diag(hypothesis.covariance), 0.0))
    words, first = [], 0
    for label, part in zip(labels_of(hypothesis.effects), hypothesis.parts, strict=True):
        own = slice(first, first + len(part.parameters))
        first = own.stop
        values, errors = hypothesis.values[own], deviations[own]
        instead = identifiable_change(record.rig, part, values, hypothesis.covariance[own, own], record.highest_hz)
        words.append(phrase(part, values, record.rig, told=not instead))
        for p, value, error in zip(part.parameters, values.tolist(), errors.tolist(), strict=True):
            margin = AT_LIMIT * (p.high - p.low)
            limited = (value < p.low + margin and p.low != p.neutral) or value > p.high - margin
            strength = p.neutral is not None
            parameters[f"{label}.{p.name}"] = Value(value, error, p.unit, limited, instead if strength else "")
        places |= {f"{label}.{field}": place or "all" for field, place in part.place.items()}
    return Cause(
        effects=hypothesis.effects,
        words=tuple(words),
        strengths=strengths_of(hypothesis, weighed),
        probability=one.probability,
        parameters=parameters,
        places=places,
        explained=closed(judged.without, judged.misfit, matters),
        interval_95=closed_interval(judged.without, judged.misfit, matters),
        left=left_of(judged.misfit, judged.rig, p_value(null_reference, judged.misfit)),
        log_prior=judged.log_prior,
        minus_two_log=judged.misfit.minus_two_log,
    )


def bands_of(without: Misfit, after: Misfit, null_reference: NullReference) -> tuple[Band, ...]:
    return tuple(
        Band(low_hz=BAND_HZ * i, high_hz=BAND_HZ * (i + 1), before=float(b), after=float(a), usual=float(u))
        for i, (b, a, u) in enumerate(zip(without.shares, after.shares, null_reference.usual_shares(), strict=False))
    )


def confirmed_by(causes: tuple[Cause, ...], ranked: list[Judged]) -> tuple[str, ...]:
    """Tests that confirm or refute each effect of the causes that are likely, or remove a part of the mismatch."""
    kinds = {part.kind.name: part.kind for j in ranked for part in j.hypothesis.parts}
    likely = [c for i, c in enumerate(causes) if c.probability > ALIKE or (i == 0 and c.interval_95[0] > 0)]
    names = dict.fromkeys(effect for cause in likely for effect in cause.effects)
    return tuple(f"{name}: {kinds[name].separated_by}" for name in names)
