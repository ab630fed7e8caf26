"""What might cause a gap: every effect of the library, at every place of the rig where it could act."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from rig.beam import Beam
from rig.description import Rig
from rig.effect import Effect, Parameter, parameters_of
from rig.effects import effects
from rig.errors import RigError

PLACES = 6
"""A parameter that says where, rather than how much, is tried at so many values of its range."""
SMALL = 0.05
"""Steps for derivatives, as a share of what the effect's default adds."""


@dataclass(frozen=True)
class Candidate:
    """One effect at one place. neutral is what its first parameter, the strength, is without the effect.

    The further parameters say where or at which frequency; `starts` are the values of theirs that are tried.
    """

    kind: type[Effect]
    place: Mapping[str, str]
    parameters: Mapping[str, Parameter]
    neutral: float

    @property
    def name(self) -> str:
        return ":".join([self.kind.name, *self.place.values()])

    @property
    def default(self) -> Float[np.ndarray, " parameters"]:
        made = self.kind()
        return np.array([getattr(made, p) for p in self.parameters])

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " parameters"], Float[np.ndarray, " parameters"]]:
        low, high = np.array([[p.low, p.high] for p in self.parameters.values()]).T
        return low, high

    @property
    def steps(self) -> Float[np.ndarray, " parameters"]:
        """Small changes: of the strength a share of the default's, of the others of their range."""
        low, high = self.bounds
        steps = SMALL * (high - low)
        steps[0] = SMALL * (self.default[0] - self.neutral)
        return steps

    @property
    def starts(self) -> list[Float[np.ndarray, " parameters"]]:
        """The neutral strength at every place that is tried."""
        grids = [np.array([self.neutral])]
        for parameter in list(self.parameters.values())[1:]:
            ends = (parameter.low, parameter.high)
            logarithmic = parameter.low > 0 and parameter.high > 20 * parameter.low
            spaced = np.geomspace(*ends, PLACES + 2)[1:-1] if logarithmic else np.linspace(*ends, PLACES)
            grids.append(spaced)
        return [np.array(values) for values in product(*grids)]

    def effect(self, values: Float[np.ndarray, " parameters"]) -> Effect:
        numbers = {name: float(v) for name, v in zip(self.parameters, values, strict=True)}
        return self.kind(**numbers, **self.place)

    def applied(self, rig: Rig, values: Float[np.ndarray, " parameters"]) -> Rig:
        """The rig with the effect; the rig itself where the effect is nothing (some cannot be nothing exactly)."""
        return rig if values[0] == self.neutral else self.effect(values).applied_to(rig)


def candidates(rig: Rig, sensors: Sequence[str], zero_known: bool) -> list[Candidate]:
    """Every effect that the rig can have, at every place and sensor that a record sees.

    Effects that only the zero of a relative displacement shows are left out where it is not known.
    """
    targets = {
        "contact": [c.name for c in rig.contacts],
        "body": [b.name for b in rig.bodies],
        "beam": [b.name for b in rig.bodies if isinstance(b, Beam)],
        "sensor": list(sensors),
    }
    found = []
    for kind in effects().values():
        parameters = parameters_of(kind)
        if not parameters or (kind.needs_zero and not zero_known):
            continue
        where = [t for t in targets if t in kind.__struct_fields__]
        for chosen in product(*(targets[t] for t in where)):
            neutral = 1.0 if next(iter(parameters)) == "factor" else 0.0
            candidate = Candidate(kind, dict(zip(where, chosen, strict=True)), parameters, neutral)
            try:
                candidate.applied(rig, candidate.default)
            except RigError:
                continue  # it makes no sense here
            found.append(candidate)
    return found
