"""What is said of every hypothesis in gap.json: its parameters, what it closes and leaves, what stands in its place."""

import numpy as np

from identify.gaps.decision.comparison import Judged, closed, closed_interval
from identify.gaps.decision.null_reference import NullReference
from identify.gaps.decision.untold import untold
from identify.gaps.residual.likelihood import Misfit
from identify.gaps.residual.scales import BAND_HZ
from identify.gaps.residual.spectra import Record
from identify.gaps.results import Band, Cause, Left, Matters
from identify.linear.joined import joined
from rig.model.description import Rig
from rig.model.unmeasured_force import Value

ALIKE = 0.05
"""Causes that are likelier than this beside the best one cannot be told apart from it."""
AT_LIMIT = 1e-3
"""A parameter within this share of its range from an end stands there."""


def left_of(left: Misfit, rig: Rig, p_value: float) -> Left:
    names = [c.name for c in joined(rig).contacts]
    return Left(
        share=left.share,
        contact_shares=dict(zip(names, left.contact_shares.tolist(), strict=True)),
        p_value=p_value,
    )


def cause_of(one: Judged, record: Record, probability: float, null_reference: NullReference, matters: Matters) -> Cause:
    """Standard errors hold what the effect leaves: residuals were weighed by the scales estimated from it."""
    parameters: dict[str, Value] = {}
    places: dict[str, str] = {}
    deviations = np.sqrt(np.maximum(np.diag(one.hypothesis.covariance), 0.0))
    numbers = zip(one.hypothesis.values.tolist(), deviations.tolist(), strict=True)
    first = 0
    for part in one.hypothesis.parts:
        own = slice(first, first + len(part.parameters))
        first = own.stop
        instead = untold(
            record.rig, part, one.hypothesis.values[own], one.hypothesis.covariance[own, own], record.highest_hz
        )
        for p, (value, error) in zip(part.parameters, numbers, strict=False):
            margin = AT_LIMIT * (p.high - p.low)
            limited = (value < p.low + margin and p.low != p.neutral) or value > p.high - margin
            strength = p.neutral is not None
            parameters[f"{part.kind.name}.{p.name}"] = Value(value, error, p.unit, limited, instead if strength else "")
        places |= {f"{part.kind.name}.{field}": place or "all" for field, place in part.place.items()}
    return Cause(
        effects=one.hypothesis.effects,
        probability=probability,
        parameters=parameters,
        places=places,
        explained=closed(one.without, one.misfit, matters),
        interval_95=closed_interval(one.without, one.misfit, matters),
        left=left_of(one.misfit, one.rig, null_reference.p_value(one.misfit)),
        log_prior=one.log_prior,
        minus_two_log=one.misfit.minus_two_log,
    )


def bands_of(without: Misfit, after: Misfit, null_reference: NullReference) -> tuple[Band, ...]:
    return tuple(
        Band(low_hz=BAND_HZ * i, high_hz=BAND_HZ * (i + 1), before=float(b), after=float(a), usual=float(u))
        for i, (b, a, u) in enumerate(zip(without.shares, after.shares, null_reference.usual_shares(), strict=False))
    )


def equivalent(causes: tuple[Cause, ...]) -> tuple[tuple[str, ...], ...]:
    """Each effect of the likeliest cause with those that stand in its place in causes that are likely too."""
    if not causes:
        return ()
    best, *likely = dict.fromkeys(frozenset(c.effects) for i, c in enumerate(causes) if not i or c.probability > ALIKE)
    classes = []
    for effect in causes[0].effects:
        instead = [one - best for one in likely if len(one) == len(best) and best - one == {effect}]
        classes.append((effect, *(other for others in instead for other in others)))
    return tuple(names for names in classes if len(names) > 1)


def confirmed_by(causes: tuple[Cause, ...], ranked: list[Judged]) -> tuple[str, ...]:
    """What would confirm or refute each effect of the causes that are likely, or close part of the gap."""
    kinds = {part.kind.name: part.kind for j in ranked for part in j.hypothesis.parts}
    likely = [c for i, c in enumerate(causes) if c.probability > ALIKE or (i == 0 and c.interval_95[0] > 0)]
    names = dict.fromkeys(effect for cause in likely for effect in cause.effects)
    return tuple(f"{name}: {kinds[name].separated_by}" for name in names)
