"""Candidates: every effect of the library, at every place of the rig where it could act."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from identify.gaps.residual.record import Record
from identify.linear.joined import joined_contacts
from rig.effects import effects
from rig.effects.base import Effect, Place, Scale
from rig.errors import RigError
from rig.model.description import Rig
from rig.model.parameters import ParameterSet

PLACES = 9
"""A parameter that says where, rather than how much, is tried at so many values of its range."""
WHOLE = 8
"""A ratio is tried at so many values over its whole range."""
SMALL = 0.05
"""Steps for derivatives, as a share of what the typical effect adds."""


@dataclass(frozen=True)
class Candidate:
    """One effect at one place: `typical` there, with the ranges of its parameters, the strength first.

    Where all parameters that have a neutral value are at it, the effect is nothing. The others say where or at which
    frequency; `starts` are the values of theirs that are tried.
    """

    kind: type[Effect]
    place: Place
    parameters: ParameterSet
    typical: Effect

    @property
    def name(self) -> str:
        return ":".join([self.kind.name, *(target or "all" for target in self.place.values())])

    @property
    def neutral(self) -> float:
        """Strength without the effect."""
        return next(p.neutral for p in self.parameters if p.neutral is not None)

    @property
    def default(self) -> Float[np.ndarray, " parameters"]:
        """The parameters of the typical effect."""
        return np.array([getattr(self.typical, name) for name in self.parameters.names])

    @property
    def steps(self) -> Float[np.ndarray, " parameters"]:
        """Small changes: of a strength a share of the typical effect's, of the others of their range.

        Of a sharp frequency, of the lowest one, which is that of two periods in the record.
        """
        adds = [
            typical - p.neutral
            if p.neutral is not None
            else p.low
            if p.name == self.kind.grid_screened
            else p.high - p.low
            for typical, p in zip(self.default, self.parameters, strict=True)
        ]
        adds = [a or self.default[0] - self.neutral for a in adds]
        return SMALL * np.array(adds)

    def starts(self, screened: Sequence[float] = ()) -> list[Float[np.ndarray, " parameters"]]:
        """The neutral strength at every place that is tried; `screened` are the values of the grid-screened one."""
        grids = []
        for parameter in self.parameters:
            ends = (parameter.low, parameter.high)
            if parameter.name == self.kind.grid_screened:
                grids.append(np.array([v for v in screened if ends[0] <= v <= ends[1]]))
                continue
            logarithmic = parameter.low > 0 and parameter.high > 20 * parameter.low
            if parameter.neutral is not None:
                grids.append(np.array([parameter.neutral]))
            else:
                grids.append(np.geomspace(*ends, PLACES + 2)[1:-1] if logarithmic else np.linspace(*ends, PLACES))
        return [np.array(values) for values in product(*grids)]

    def strengths(self, multiples: Sequence[float]) -> list[float]:
        """Strengths to try: multiples of what the typical effect adds, of both signs, and of ratios the whole range."""
        low, high = (float(ends[0]) for ends in self.parameters.bounds)
        adds = float(self.default[0]) - self.neutral
        tried = [self.neutral + sign * m * adds for sign in (1, -1) for m in multiples]
        if self.neutral == 1 and low > 0 and high > 4 * low:
            tried += list(np.geomspace(low, high, WHOLE))
        return [float(t) for t in tried if low <= t <= high]

    def effect(self, values: Float[np.ndarray, " parameters"]) -> Effect:
        """The typical effect with other numbers."""
        return msgspec.structs.replace(self.typical, **self.parameters.named(values))

    def applied(self, rig: Rig, values: Float[np.ndarray, " parameters"]) -> Rig:
        """The rig with the effect; the rig itself where the effect is nothing (some cannot be nothing exactly)."""
        nothing = all(p.neutral in (None, v) for v, p in zip(values, self.parameters, strict=True))
        return rig if nothing else self.effect(values).applied_to(rig)


def scale_of(record: Record, rig: Rig) -> Scale:
    """Scale of effects' ranges: the rig, and the record's force (root mean square) and duration.

    In a free decay the inertial force of a body stands for the force, in the mean of what its sensors show.
    """
    if record.forced:
        forces_n = record.in_time(record.forces)
    else:
        masses = np.array([rig.body(s.station.body).mass_kg for s in record.sensors])
        forces_n = record.in_time(masses[:, None] * record.delivered) / np.sqrt(masses.size)
    return Scale(rig, float(np.sqrt(np.mean(np.sum(forces_n**2, axis=0)))), record.samples / record.sample_rate_hz)


def candidates(scale: Scale, sensors: Sequence[str], zero_known: bool, forced: bool = True) -> list[Candidate]:
    """Every effect that the rig can have, at every place and sensor that a record sees.

    Effects that only the zero of a relative displacement shows are left out where it is not known, those of the force
    and of channels where no force is measured (the free motion has no scale, and may begin at any time), those of the
    force where several act, and those that change nothing, or part contacts between the same places.
    """
    found = []
    for kind in effects().values():
        if kind.needs_zero and not zero_known:
            continue
        for place in kind.placements(scale.rig, sensors):
            there = scale.at(place)
            candidate = Candidate(kind, place, kind.parameters(there), kind.typical(there))
            try:
                changed = candidate.applied(scale.rig, candidate.default)
            except RigError:
                continue  # it makes no sense here
            own = scale.rig
            if not forced or len(own.forces) > 1:
                changed = replace(changed, force_sensor=own.force_sensor)
            if not forced:
                changed = replace(changed, sensors=own.sensors, force_at=own.force_at)
            if changed != scale.rig and len(joined_contacts(changed)) == len(joined_contacts(scale.rig)):
                found.append(candidate)
    return found


def joins(candidate: Candidate, rig: Rig) -> bool:
    """True if an effect makes sense in a rig."""
    try:
        candidate.applied(rig, candidate.default)
    except RigError:
        return False
    return True
