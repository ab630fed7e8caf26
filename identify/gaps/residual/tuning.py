"""Nuisance parameters of single modes, applied to the linear model of a rig without contacts or of a held beam's decay.

The residual is nonlinear in a resonance that is off by a fraction of its width, so that fitted values enter the model
about which the next fit is linearised. For a free decay they start from the measured modes, within their limits.
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

TUNED_KINDS = (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
"""Kinds of parameters in which the residual is nonlinear around a resonance."""
LEAST_FACTOR = 0.05
"""Least factor on a frequency or on a damping ratio."""


@dataclass(frozen=True)
class TunedModes:
    """Nuisance parameters of single modes that the linear model contains, and the factors that result."""

    pulls: dict[Nuisance, float] = field(default_factory=dict)
    factors: Tuned = field(default_factory=dict)


@dataclass(frozen=True)
class MatchedMode:
    """Mode of a body (from 1) and its measured counterpart, with the logarithms of measured frequency and damping ratio
    over those of the rig."""

    body: str
    mode_number: int
    measured: MeasuredMode
    logarithms: Float[np.ndarray, "2"]


def matched_modes(measured: tuple[MeasuredMode, ...], rig: Rig) -> list[MatchedMode]:
    """Assignment of measured modes to those of the rig with the least sum of |ln frequency ratio|."""
    names, numbers, nominal_modes = [], [], []
    for body in rig.bodies:
        modes, count = modes_of(rig, body), body.max_modes
        for m, hz, ratio in zip(range(count), modes.frequencies_hz(count), modes.damping_ratios(count), strict=True):
            if hz > 0:
                names.append(body.name)
                numbers.append(m + 1)
                nominal_modes.append((hz, max(ratio, 1e-12)))
    if not (measured and nominal_modes):
        return []
    logarithms = np.log([(mode.frequency_hz, mode.damping_ratio) for mode in measured])[:, None] - np.log(nominal_modes)
    rows, columns = linear_sum_assignment(np.abs(logarithms[..., 0]))
    return [
        MatchedMode(names[k], numbers[k], measured[i], logarithms[i, k]) for i, k in zip(rows, columns, strict=True)
    ]


def tuned_modes(
    record: Record,
    rig: Rig,
    parameters: tuple[Nuisance, ...] | None = None,
    nuisance: Float[np.ndarray, " nuisances"] | None = None,
) -> TunedModes:
    """Tuned modes from fitted nuisance parameters, else from a record's measured modes; none with contacts if it has no
    measured modes."""
    if rig.contacts and not record.modes:
        return TunedModes()
    if parameters is not None and nuisance is not None:
        pulls = {
            p: float(v) for p, v in zip(parameters, nuisance, strict=True) if p.kind in TUNED_KINDS and p.mode_number
        }
    else:
        pulls = {}
        for matched in matched_modes(record.modes, rig):
            for kind, increase in zip(TUNED_KINDS, np.expm1(matched.logarithms), strict=True):
                tolerance = _tolerance(record, matched.body, matched.mode_number, kind)
                if tolerance and not rig.body(matched.body).is_mass:
                    pulls[Nuisance(kind, matched.body, matched.mode_number)] = float(
                        np.clip(increase / tolerance, -LIMIT, LIMIT)
                    )
    factors = {}
    for body in {p.of for p in pulls}:
        numbers = range(1, rig.body(body).max_modes + 1)
        frequencies, damping = (
            np.array([_factor(record, body, number, kind, pulls) for number in numbers]) for kind in TUNED_KINDS
        )
        factors[body] = frequencies, damping
    return TunedModes(pulls, factors)


def _factor(record: Record, body: str, mode_number: int, kind: NuisanceKind, pulls: dict[Nuisance, float]) -> float:
    """Factor 1 + tolerance * pull on the frequency or on the damping ratio of a mode."""
    return max(
        LEAST_FACTOR,
        1 + _tolerance(record, body, mode_number, kind) * pulls.get(Nuisance(kind, body, mode_number), 0.0),
    )


def _tolerance(record: Record, body: str, mode_number: int, kind: NuisanceKind) -> float:
    """Relative tolerance of the frequency or of the damping ratio of a mode."""
    mode_tolerances = record.tolerances.of_mode(body, mode_number)
    return mode_tolerances.frequency if kind is NuisanceKind.FREQUENCY else mode_tolerances.damping
