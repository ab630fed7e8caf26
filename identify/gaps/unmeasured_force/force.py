"""Fit of one unmeasured force: located on the fit record, then validated on a second record."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex

from identify.gaps.residual.record import Record
from identify.gaps.unmeasured_force.evidence import evidence_with_force
from identify.gaps.unmeasured_force.location import LocatedForce, locate_force, response_of
from identify.gaps.unmeasured_force.nuisance import modulus_drift_accelerations, whitened_record
from identify.gaps.unmeasured_force.time_history import force_spectrum
from identify.gaps.unmeasured_force.whitened_record import WhitenedRecord, without_nuisance_columns
from rig.model.description import Rig

SAME_PLACE_M = 0.05
"""Two records show the same place if their positions differ by no more than this, or five standard errors."""


@dataclass(frozen=True)
class UnmeasuredForceFit:
    """One unmeasured force on two records.

    on_fit_record is the best candidate of the fit record, on_validation_record that of the validation record alone, and
    at_fit_place the validation record with the place and the spectrum's shape of the fit record.
    """

    on_fit_record: LocatedForce
    on_validation_record: LocatedForce
    at_fit_place: LocatedForce

    @property
    def same_place(self) -> bool:
        return same_place(self.on_fit_record, self.on_validation_record)

    @property
    def free_direction_count(self) -> int:
        """Count of the residual's directions, of all rows at the fit place, that are free to follow the force."""
        return 0 if self.on_fit_record.force_place.kind == "distributed" else 1

    def sensor_signals(self) -> Complex[np.ndarray, "sensors alllines"]:
        """Spectra of the validation sensors' signals caused by the force with its likeliest time history."""
        whitened, place = self.at_fit_place.whitened_record, self.at_fit_place.force_place
        accelerations = np.zeros(whitened.model.sensor_response.shape, dtype=complex)
        if place.kind == "distributed":
            for body_name, growth in zip(place.body_names, self.at_fit_place.modulus_growth, strict=True):
                accelerations += growth * modulus_drift_accelerations(whitened, body_name)
        elif place.kind == "sensor":
            sensor_names = [sensor.name for sensor in whitened.record.sensors]
            accelerations[sensor_names.index(place.sensor_name)] = force_spectrum(self.at_fit_place)
        else:
            for station, sign in zip(place.stations, (1.0, -1.0), strict=False):
                accelerations += sign * whitened.accelerance(station) * force_spectrum(self.at_fit_place)
        return whitened.model.sensor_response * accelerations


def likeliest_force(fit_record: Record, rig: Rig, validation: Record) -> UnmeasuredForceFit:
    """Unmeasured force beside a rig that explains the fit record best, with its fit to the validation record.

    `same_place` and the gains of the result say whether the records agree. Raises RigError if there are too few sensors
    to show an unmeasured force.
    """
    on_fit_record = locate_force(whitened_record(fit_record, rig))
    whitened_validation = whitened_record(validation, rig)
    on_validation_record = locate_force(whitened_validation)
    at_fit_place = _validation_fit_at_place(on_fit_record, whitened_validation, on_validation_record)
    on_validation_record, at_fit_place = (
        replace(located, whitened_record=without_nuisance_columns(located.whitened_record))
        for located in (on_validation_record, at_fit_place)
    )
    return UnmeasuredForceFit(on_fit_record, on_validation_record, at_fit_place)


def _validation_fit_at_place(
    on_fit_record: LocatedForce, whitened: WhitenedRecord, on_validation: LocatedForce
) -> LocatedForce:
    """Fit of the validation record with the place and the spectrum's shape of the fit record, or a drift's bodies."""
    place, without_force = on_fit_record.force_place, on_validation.without_force
    if place.kind == "distributed":
        is_same_drift = on_validation.force_place == place
        return on_validation if is_same_drift else locate_force(whitened, expected_place=place)
    spectrum_shape = np.zeros(whitened.band_first_lines.size)
    band_count = min(spectrum_shape.size, on_fit_record.with_force.force_spectrum.size)
    spectrum_shape[:band_count] = on_fit_record.with_force.force_spectrum[:band_count]
    residual_response = response_of(whitened, place)
    with_force = evidence_with_force(whitened, residual_response, without_force, spectrum_shape=spectrum_shape)
    return LocatedForce(place, without_force, with_force, whitened, residual_response)


def same_place(on_fit_record: LocatedForce, on_validation_record: LocatedForce) -> bool:
    """True if two records show the same kind at the same place, within the larger of `SAME_PLACE_M` and five errors."""
    error_m = float(np.hypot(on_fit_record.position_error_m, on_validation_record.position_error_m))
    return on_fit_record.force_place.is_near(on_validation_record.force_place, max(SAME_PLACE_M, 5 * error_m))
