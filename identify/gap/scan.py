"""Where to begin: effects too large for a linear look are tried at a few strengths and places each."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from identify.gap.candidates import Candidate
from identify.gap.grounded import needs_every_line
from identify.gap.linear import linear_model
from identify.gap.residual import MODEL_ERROR, Base, same_but_laws
from identify.gap.spectra import Record
from rig.description import Rig
from rig.errors import RigError

STRENGTHS = (0.3, 0.6, 1.2, 2.4)
"""Multiples of what a typical effect adds."""
THINNED = 8
"""Every so-many-th line tells enough of where a minimum lies."""


@dataclass(frozen=True)
class Start:
    """A candidate's most promising values, and by how much they lower the part of the cost that was looked at."""

    candidate: Candidate
    values: Float[np.ndarray, " parameters"]
    gain: float


def linear_starts(base: Base, candidates: Sequence[Candidate]) -> list[Start]:
    """By the linear residual alone, of effects that change the linear model."""
    thin = _thinned(base.record)
    before = _linear_cost(thin, base.rig)
    found = []
    for candidate in candidates:
        changed = candidate.applied(base.rig, candidate.default)
        if (
            same_but_laws(base.rig, changed)
            or changed.base_motion is not None
            or needs_every_line(changed)
            or changed.loads != base.rig.loads
        ):
            continue
        costs = []
        for values in _tried(candidate):
            try:
                costs.append((_linear_cost(thin, candidate.applied(base.rig, values)), values))
            except RigError:
                continue
        least, values = min(costs, key=lambda c: c[0])
        found.append(Start(candidate, values, before - least))
    return sorted(found, key=lambda s: -s.gain)


def _tried(candidate: Candidate) -> Iterable[Float[np.ndarray, " parameters"]]:
    for place in candidate.starts:
        yield from _strengths(candidate, place)


def _strengths(candidate: Candidate, place: Float[np.ndarray, " parameters"]) -> list[Float[np.ndarray, " parameters"]]:
    found = []
    for strength in candidate.strengths(STRENGTHS):
        values = place.copy()
        values[0] = strength
        found.append(values)
    return found


def _thinned(record: Record) -> Record:
    some = slice(1, None, THINNED)
    return replace(
        record,
        omega=record.omega[some],
        **{name: getattr(record, name)[..., some] for name in ("force", "delivered", "displaced", "noise", "power")},
    )


def _linear_cost(thin: Record, rig: Rig) -> float:
    model = linear_model(thin, rig, MODEL_ERROR)
    return THINNED * float(np.sum(np.abs(model.residual) ** 2))
