"""Tolerances of single modes in the linear model of a rig without contacts.

A resonance that lies off by a part of its width is no linear matter, so what was fitted stands in the model that the
next fit is linearised about. Of a free decay it begins at what the measured modes ask for, within the limits.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from identify.gaps.residual.linear import Tuned
from identify.gaps.residual.nuisance import LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.ringing import MeasuredMode
from identify.linear.nuisance import Nuisance, NuisanceKind
from rig.model.description import Rig
from rig.model.modes import modes_of

KINDS = (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
"""What bends the residual around a resonance."""
FLOOR = 0.05
"""No factor on a frequency or on a damping ratio is smaller."""


@dataclass(frozen=True)
class TunedModes:
    """Nuisance parameters of single modes that are in the linear model, and the factors that they make."""

    pulls: dict[Nuisance, float] = field(default_factory=dict)
    factors: Tuned = field(default_factory=dict)


@dataclass(frozen=True)
class MatchedMode:
    """A mode of a body, from 1, the measured one, and the logarithms of its frequency and of its damping ratio over the
    rig's."""

    body: str
    mode: int
    measured: MeasuredMode
    logarithms: Float[np.ndarray, "2"]


def matched_modes(measured: tuple[MeasuredMode, ...], rig: Rig) -> list[MatchedMode]:
    """Each measured mode with one of the rig's, as near in the logarithm of the frequency as they can be together."""
    names, numbers, own = [], [], []
    for body in rig.bodies:
        modes, count = modes_of(rig, body), body.max_modes
        for m, hz, ratio in zip(range(count), modes.frequencies_hz(count), modes.damping_ratios(count), strict=True):
            if hz > 0:
                names.append(body.name)
                numbers.append(m + 1)
                own.append((hz, max(ratio, 1e-12)))
    if not (measured and own):
        return []
    apart = np.log([(one.frequency_hz, one.damping_ratio) for one in measured])[:, None] - np.log(own)
    rows, columns = linear_sum_assignment(np.abs(apart[..., 0]))
    return [MatchedMode(names[k], numbers[k], measured[i], apart[i, k]) for i, k in zip(rows, columns, strict=True)]


def tuned_modes(
    record: Record,
    rig: Rig,
    parameters: tuple[Nuisance, ...] | None = None,
    nuisance: Float[np.ndarray, " nuisances"] | None = None,
) -> TunedModes:
    """Tuned modes as they were fitted, or as a record's measured modes ask of the rig; none with contacts."""
    if rig.contacts:
        return TunedModes()
    if parameters is not None and nuisance is not None:
        pulls = {p: float(v) for p, v in zip(parameters, nuisance, strict=True) if p.kind in KINDS and p.mode}
    else:
        pulls = {}
        for one in matched_modes(record.modes, rig):
            for kind, more in zip(KINDS, np.expm1(one.logarithms), strict=True):
                tolerance = _tolerance(record, one.body, one.mode, kind)
                if tolerance and not rig.body(one.body).is_mass:
                    pulls[Nuisance(kind, one.body, one.mode)] = float(np.clip(more / tolerance, -LIMIT, LIMIT))
    factors = {}
    for body in {p.of for p in pulls}:
        numbers = range(1, rig.body(body).max_modes + 1)
        frequencies, damping = (
            np.array([_factor(record, body, number, kind, pulls) for number in numbers]) for kind in KINDS
        )
        factors[body] = frequencies, damping
    return TunedModes(pulls, factors)


def _factor(record: Record, body: str, mode: int, kind: NuisanceKind, pulls: dict[Nuisance, float]) -> float:
    return max(FLOOR, 1 + _tolerance(record, body, mode, kind) * pulls.get(Nuisance(kind, body, mode), 0.0))


def _tolerance(record: Record, body: str, mode: int, kind: NuisanceKind) -> float:
    own = record.tolerances.of_mode(body, mode)
    return own.frequency if kind is NuisanceKind.FREQUENCY else own.damping
