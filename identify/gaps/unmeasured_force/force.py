"""Fit of one unmeasured force: located on the fit record, then validated on a second record."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex

from identify.gaps.residual.record import Record
from identify.gaps.unmeasured_force.evidence import evidence_with_force
from identify.gaps.unmeasured_force.location import LocatedForce, locate_force, response_of
from identify.gaps.unmeasured_force.nuisance import drift_accelerations, whitened_record
from identify.gaps.unmeasured_force.time_history import force_spectrum
from identify.gaps.unmeasured_force.whitened_record import WhitenedRecord
from rig.model.description import Rig

SAME_M = 0.05
"""Two records show the same place if their positions differ by no more than this, or five standard errors."""


@dataclass(frozen=True)
class UnmeasuredForceFit:
    """One unmeasured force on two records.

    on_fit is the best candidate of the fit record, on_validation that of the validation record alone, and held the
    validation record with the place and the spectrum's shape of the fit record.
    """

    on_fit: LocatedForce
    on_validation: LocatedForce
    held: LocatedForce

    @property
    def same_place(self) -> bool:
        return same_place(self.on_fit, self.on_validation)

    @property
    def directions(self) -> int:
        """Count of the residual's directions, of `held.whitened.rows`, that are free to follow the force."""
        return 0 if self.on_fit.candidate.kind == "distributed" else 1

    def delivered(self) -> Complex[np.ndarray, "sensors alllines"]:
        """Spectra of the validation sensors' signals caused by the force with its likeliest time history."""
        whitened, candidate = self.held.whitened, self.held.candidate
        accelerations = np.zeros(whitened.model.sensor_response.shape, dtype=complex)
        if candidate.kind == "distributed":
            for body, growth in zip(candidate.bodies, self.held.growth, strict=True):
                accelerations += growth * drift_accelerations(whitened, body)
        elif candidate.kind == "sensor":
            accelerations[[s.name for s in whitened.record.sensors].index(candidate.sensor)] = force_spectrum(self.held)
        else:
            for station, sign in zip(candidate.stations, (1.0, -1.0), strict=False):
                accelerations += sign * whitened.accelerance(station) * force_spectrum(self.held)
        return whitened.model.sensor_response * accelerations


def likeliest_force(fit: Record, rig: Rig, validation: Record) -> UnmeasuredForceFit:
    """Unmeasured force beside a rig that explains the fit record best, with its fit to the validation record.

    `same_place` and the gains of the result say whether the records agree. Raises RigError if there are too few sensors
    to show an unmeasured force.
    """
    on_fit = locate_force(whitened_record(fit, rig))
    validation_record = whitened_record(validation, rig)
    on_validation = locate_force(validation_record)
    return UnmeasuredForceFit(on_fit, on_validation, _fit_at_place(on_fit, validation_record, on_validation))


def _fit_at_place(on_fit: LocatedForce, whitened: WhitenedRecord, on_validation: LocatedForce) -> LocatedForce:
    """Fit of the validation record with the place and the spectrum's shape of the fit record, or a drift's bodies."""
    candidate = on_fit.candidate
    if candidate.kind == "distributed":
        return on_validation if on_validation.candidate == candidate else locate_force(whitened, expected=candidate)
    shape = np.zeros(whitened.band_starts.size)
    band_count = min(shape.size, on_fit.with_force.spectrum.size)
    shape[:band_count] = on_fit.with_force.spectrum[:band_count]
    without_force, response = on_validation.without_force, response_of(whitened, candidate)
    with_force = evidence_with_force(whitened, response, without_force, shape=shape)
    criterion_decrease = without_force.criterion - with_force.criterion
    return LocatedForce(candidate, criterion_decrease, 0.0, without_force, with_force, whitened, response)


def same_place(first: LocatedForce, second: LocatedForce) -> bool:
    """True if two records show the same kind at the same place, within the larger of `SAME_M` and five errors."""
    place, other_place = first.candidate, second.candidate
    if (place.kind, place.sensor, place.bodies) != (other_place.kind, other_place.sensor, other_place.bodies):
        return False
    tolerance_m = max(SAME_M, 5 * float(np.hypot(first.error_m, second.error_m)))
    return all(
        station.body == other_station.body and abs(station.position_m - other_station.position_m) <= tolerance_m
        for station, other_station in zip(place.stations, other_place.stations, strict=True)
    )
