"""Nuisance parameters of single modes, applied to the linear model of a rig without contacts or of a held beam's decay.

The residual is nonlinear in a resonance that is off by a fraction of its width, so that fitted values enter the model
about which the next fit is linearised. For a free decay they start from the measured modes, within their limits, unless
dampers, friction or cubic springs to the ground change the ringing: the modes of the linear model are without them.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from identify.gaps.residual.linear import ModeFactors
from identify.gaps.residual.nuisance import PULL_LIMIT
from identify.gaps.residual.record import Record
from identify.gaps.residual.ringing import MeasuredMode
from identify.gaps.residual.windowed import has_ground_forces
from identify.linear.nuisance import Nuisance, NuisanceKind
from rig.model.description import Rig
from rig.model.modes import modes_of

TUNED_KINDS = (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
"""Kinds of parameters in which the residual is nonlinear around a resonance."""
LEAST_TUNING_FACTOR = 0.05
"""Least factor on a frequency or on a damping ratio."""


@dataclass(frozen=True)
class TunedModes:
    """Nuisance parameters of single modes that the linear model contains, and the factors that result."""

    pulls: dict[Nuisance, float] = field(default_factory=dict)
    factors: ModeFactors = field(default_factory=dict)


@dataclass(frozen=True)
class MatchedMode:
    """Mode of a body (from 1) and its measured counterpart, with the logarithms of measured frequency and damping ratio
    over those of the rig."""

    body_name: str
    mode_number: int
    measured_mode: MeasuredMode
    log_ratios: Float[np.ndarray, "2"]


def matched_modes(modes_of_record: tuple[MeasuredMode, ...], rig: Rig) -> list[MatchedMode]:
    """Assignment of measured modes to those of the rig with the least sum of |ln frequency ratio|."""
    body_names, mode_numbers, nominal_modes = [], [], []
    for body in rig.bodies:
        modes, mode_count = modes_of(rig, body), body.max_modes
        for number, natural_hz, damping_ratio in zip(
            range(1, mode_count + 1), modes.frequencies_hz(mode_count), modes.damping_ratios(mode_count), strict=True
        ):
            if natural_hz > 0:
                body_names.append(body.name)
                mode_numbers.append(number)
                nominal_modes.append((natural_hz, max(damping_ratio, 1e-12)))
    if not (modes_of_record and nominal_modes):
        return []
    measured_logs = np.log([(mode.frequency_hz, mode.damping_ratio) for mode in modes_of_record])
    log_ratios = measured_logs[:, None] - np.log(nominal_modes)
    index_pairs = zip(*linear_sum_assignment(np.abs(log_ratios[..., 0])), strict=True)
    return [MatchedMode(body_names[j], mode_numbers[j], modes_of_record[i], log_ratios[i, j]) for i, j in index_pairs]


def tuned_modes(
    record: Record,
    rig: Rig,
    parameters: tuple[Nuisance, ...] | None = None,
    nuisance_pulls: Float[np.ndarray, " nuisances"] | None = None,
) -> TunedModes:
    """Tuned modes from fitted nuisance parameters, else from a record's measured modes; none with contacts if it has no
    measured modes."""
    if rig.contacts and not record.measured_modes:
        return TunedModes()
    pulls: dict[Nuisance, float] = {}
    if parameters is not None and nuisance_pulls is not None:
        for parameter, pull in zip(parameters, nuisance_pulls, strict=True):
            if parameter.kind in TUNED_KINDS and parameter.mode_number:
                pulls[parameter] = float(pull)
    else:
        for mode in matched_modes(() if has_ground_forces(rig) else record.measured_modes, rig):
            name, number = mode.body_name, mode.mode_number
            for kind, relative_increase in zip(TUNED_KINDS, np.expm1(mode.log_ratios), strict=True):
                tolerance = _mode_tolerance(record, name, number, kind)
                if tolerance and not rig.body(name).is_mass:
                    pull = float(np.clip(relative_increase / tolerance, -PULL_LIMIT, PULL_LIMIT))
                    pulls[Nuisance(kind, name, number)] = pull
    factors = {}
    for name in {parameter.owner for parameter in pulls}:
        numbers = range(1, rig.body(name).max_modes + 1)
        frequency_factors, damping_factors = (
            np.array([_mode_factor(record, name, number, kind, pulls) for number in numbers]) for kind in TUNED_KINDS
        )
        factors[name] = frequency_factors, damping_factors
    return TunedModes(pulls, factors)


def _mode_factor(
    record: Record, body_name: str, mode_number: int, kind: NuisanceKind, pulls: dict[Nuisance, float]
) -> float:
    """Factor 1 + tolerance * pull on the frequency or on the damping ratio of a mode."""
    pull = pulls.get(Nuisance(kind, body_name, mode_number), 0.0)
    return max(LEAST_TUNING_FACTOR, 1 + _mode_tolerance(record, body_name, mode_number, kind) * pull)


def _mode_tolerance(record: Record, body_name: str, mode_number: int, kind: NuisanceKind) -> float:
    """Relative tolerance of the frequency or of the damping ratio of a mode."""
    mode_tolerances = record.tolerances.of_mode(body_name, mode_number)
    return mode_tolerances.frequency if kind is NuisanceKind.FREQUENCY else mode_tolerances.damping
