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

SAME_PLACE_M = 0.05
"""Two records show the same place if their positions differ by no more than this, or five standard errors."""


@dataclass(frozen=True)
class UnmeasuredForceFit:
    """One unmeasured force on two records.

    on_fit is the best candidate of the fit record, on_validation that of the validation record alone, and
    at_fit_place the validation record with the place and the spectrum's shape of the fit record.
    """

    on_fit: LocatedForce
    on_validation: LocatedForce
    at_fit_place: LocatedForce

    @property
    def same_place(self) -> bool:
        return same_place(self.on_fit, self.on_validation)

    @property
    def free_directions(self) -> int:
        """Count of the residual's directions, of all rows at the fit place, that are free to follow the force."""
        return 0 if self.on_fit.force_place.kind == "distributed" else 1

    def sensor_signals(self) -> Complex[np.ndarray, "sensors alllines"]:
        """Spectra of the validation sensors' signals caused by the force with its likeliest time history."""
        whitened, candidate = self.at_fit_place.whitened_record, self.at_fit_place.force_place
        accelerations = np.zeros(whitened.model.sensor_response.shape, dtype=complex)
        if candidate.kind == "distributed":
            for body_name, body_growth in zip(candidate.body_names, self.at_fit_place.modulus_growth, strict=True):
                accelerations += body_growth * drift_accelerations(whitened, body_name)
        elif candidate.kind == "sensor":
            accelerations[[sensor.name for sensor in whitened.record.sensors].index(candidate.sensor_name)] = (
                force_spectrum(self.at_fit_place)
            )
        else:
            for station, sign in zip(candidate.stations, (1.0, -1.0), strict=False):
                accelerations += sign * whitened.accelerance(station) * force_spectrum(self.at_fit_place)
        return whitened.model.sensor_response * accelerations


def likeliest_force(fit_record: Record, rig: Rig, validation: Record) -> UnmeasuredForceFit:
    """Unmeasured force beside a rig that explains the fit record best, with its fit to the validation record.

    `same_place` and the gains of the result say whether the records agree. Raises RigError if there are too few sensors
    to show an unmeasured force.
    """
    on_fit = locate_force(whitened_record(fit_record, rig))
    validation_record = whitened_record(validation, rig)
    on_validation = locate_force(validation_record)
    return UnmeasuredForceFit(on_fit, on_validation, _fit_at_place(on_fit, validation_record, on_validation))


def _fit_at_place(
    on_fit: LocatedForce, whitened_validation: WhitenedRecord, on_validation: LocatedForce
) -> LocatedForce:
    """Fit of the validation record with the place and the spectrum's shape of the fit record, or a drift's bodies."""
    candidate = on_fit.force_place
    if candidate.kind == "distributed":
        return (
            on_validation
            if on_validation.force_place == candidate
            else locate_force(whitened_validation, expected_place=candidate)
        )
    spectrum_shape = np.zeros(whitened_validation.band_starts.size)
    band_count = min(spectrum_shape.size, on_fit.fit_with_force.force_spectrum.size)
    spectrum_shape[:band_count] = on_fit.fit_with_force.force_spectrum[:band_count]
    fit_without_force, response = on_validation.fit_without_force, response_of(whitened_validation, candidate)
    fit_with_force = evidence_with_force(
        whitened_validation, response, fit_without_force, spectrum_shape=spectrum_shape
    )
    criterion_decrease = fit_without_force.criterion - fit_with_force.criterion
    return LocatedForce(
        candidate, criterion_decrease, 0.0, fit_without_force, fit_with_force, whitened_validation, response
    )


def same_place(first_force: LocatedForce, second_force: LocatedForce) -> bool:
    """True if two records show the same kind at the same place, within the larger of `SAME_PLACE_M` and five errors."""
    first_place, second_place = first_force.force_place, second_force.force_place
    if (first_place.kind, first_place.sensor_name, first_place.body_names) != (
        second_place.kind,
        second_place.sensor_name,
        second_place.body_names,
    ):
        return False
    tolerance_m = max(SAME_PLACE_M, 5 * float(np.hypot(first_force.position_error_m, second_force.position_error_m)))
    return all(
        station.body == other_station.body and abs(station.position_m - other_station.position_m) <= tolerance_m
        for station, other_station in zip(first_place.stations, second_place.stations, strict=True)
    )
