"""The smallest unmeasured force that explains a gap: found on one record, demanded of another."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex

from identify.gaps.residual.record import Record
from identify.gaps.unmeasured_force.evidence import explained
from identify.gaps.unmeasured_force.location import Located, located, response_of
from identify.gaps.unmeasured_force.nuisance import drift_accelerations, observed
from identify.gaps.unmeasured_force.observed import WhitenedRecord
from identify.gaps.unmeasured_force.time_history import force_of
from rig.model.description import Rig

SAME_M = 0.05
"""Two records show the same place if theirs differ by no more, or by five standard errors."""


@dataclass(frozen=True)
class UnmeasuredForceFit:
    """The unmeasured force that explains the fit record best, what the validation record alone shows, and that record
    with the place and the shape of the spectrum held.
    """

    on_fit: Located
    on_validation: Located
    held: Located

    @property
    def same_place(self) -> bool:
        return same_place(self.on_fit, self.on_validation)

    @property
    def directions(self) -> int:
        """Count of directions of the residual, of `held.observed.rows`, that are free to follow the force."""
        return 0 if self.on_fit.candidate.kind == "distributed" else 1

    def delivered(self) -> Complex[np.ndarray, "sensors alllines"]:
        """Signals that the sensors of the validation record deliver of the force, at its likeliest time history."""
        own, candidate = self.held.observed, self.held.candidate
        accelerations = np.zeros(own.model.sensor_response.shape, dtype=complex)
        if candidate.kind == "distributed":
            for body, growth in zip(candidate.bodies, self.held.growth, strict=True):
                accelerations += growth * drift_accelerations(own, body)
        elif candidate.kind == "sensor":
            accelerations[[s.name for s in own.record.sensors].index(candidate.sensor)] = force_of(self.held)
        else:
            for station, sign in zip(candidate.stations, (1.0, -1.0), strict=False):
                accelerations += sign * own.accelerance(station) * force_of(self.held)
        return own.model.sensor_response * accelerations


def likeliest_force(fit: Record, rig: Rig, validation: Record) -> UnmeasuredForceFit:
    """The unmeasured force that explains the fit record best beside a rig, and how far both records agree.

    Whether it deserves to be believed, `same_place` and the gains say. Raises RigError if there are too few sensors to
    show an unmeasured force.
    """
    on_fit = located(observed(fit, rig))
    whitened = observed(validation, rig)
    on_validation = located(whitened)
    return UnmeasuredForceFit(on_fit, on_validation, _held(on_fit, whitened, on_validation))


def _held(on_fit: Located, own: WhitenedRecord, on_validation: Located) -> Located:
    """Another record with the place, and the shape of the spectrum, of the fit record; of a drift its bodies."""
    candidate = on_fit.candidate
    if candidate.kind == "distributed":
        return on_validation if on_validation.candidate == candidate else located(own, near=candidate)
    shape = np.zeros(own.starts.size)
    common = min(shape.size, on_fit.after.spectrum.size)
    shape[:common] = on_fit.after.spectrum[:common]
    before, response = on_validation.before, response_of(own, candidate)
    after = explained(own, response, before, shape=shape)
    return Located(candidate, before.criterion - after.criterion, 0.0, before, after, own, response)


def same_place(one: Located, other: Located) -> bool:
    """True if two records show the same place."""
    a, b = one.candidate, other.candidate
    if (a.kind, a.sensor, a.bodies) != (b.kind, b.sensor, b.bodies):
        return False
    near = max(SAME_M, 5 * float(np.hypot(one.error_m, other.error_m)))
    return all(
        p.body == q.body and abs(p.position_m - q.position_m) <= near
        for p, q in zip(a.stations, b.stations, strict=True)
    )
