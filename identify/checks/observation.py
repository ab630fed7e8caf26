"""Motion of a record as the linear model of rig.json has it: the input of the columns of its nuisance parameters."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Complex

from identify.checks.prediction import LinearCheck
from identify.linear.model import Response, ResponseCache, input_shapes, real_product, response_of
from identify.linear.nuisance import (
    CONVERGED_SHARE,
    Change,
    Nuisance,
    NuisanceKind,
    ObservedSignals,
    elastic_modes,
    mode_count_near_band,
)
from identify.linear.observed_motion import BodyMotion
from rig.model.description import Rig, Sensor
from rig.model.tolerances import Tolerances

MODE_BAND_RATIO = 2.0
"""Modes up to this multiple of the band's end may be off: the frequency of one there changes the motion at the band's
end by 0.9 times its own relative error, which is less than `MIN_MODEL_ERROR_SHARE` for the default tolerance."""

InputSpectra = Complex[np.ndarray, "inputs lines"]


def observed_motion(
    rig: Rig, check: LinearCheck, channel_indices: list[int], tolerances: Tolerances
) -> ObservedSignals:
    """Motion as these channels show it, with the contact forces that explain it best.

    Modes near the band may be off, whether or not as many sensors stand on their body.
    """
    sensors, omega = tuple(check.spectra.sensors[i] for i in channel_indices), check.spectra.omega
    prediction, response_cache = check.prediction(channel_indices), ResponseCache(omega, 0)
    accelerations = prediction.accelerations[channel_indices]
    input_spectra = np.concatenate([prediction.force_spectra, prediction.contact_force_spectra])
    body_responses = [response_of(rig, body, response_cache) for body in rig.bodies]
    return ObservedSignals(
        sensors=sensors,
        displaced_by=sensors,
        tolerances=tolerances,
        omega=omega,
        sensor_response=np.ones_like(accelerations),
        signals=accelerations,
        force_accelerations=check.acceleration_by_force[:, channel_indices],
        displacements=np.zeros_like(accelerations),
        bodies=tuple(_body_motion(rig, response, input_spectra) for response in body_responses),
        further_changes=tuple(
            c for response in body_responses for c in _truncation_changes(rig, response, sensors, input_spectra)
        ),
    )


def _body_motion(rig: Rig, response: Response, input_spectra: InputSpectra) -> BodyMotion:
    """Modal accelerations of a body by the forces and the contact forces."""
    modal_force = real_product(input_shapes(rig, response, rig.forces).T, input_spectra)
    elastic_indices = elastic_modes(response, mode_count_near_band(response, MODE_BAND_RATIO))
    return BodyMotion(response, response.accelerance * modal_force, elastic_indices)


def _truncation_changes(
    rig: Rig, response: Response, sensors: Sequence[Sensor], input_spectra: InputSpectra
) -> Iterator[Change]:
    """Changes by the modes that a description leaves out, of each force on a body and each station there: the share
    of its highest modes, beyond the band, in the motion is the standard deviation of what modes beyond them would add.
    """
    high_mode_start = max(mode_count_near_band(response, MODE_BAND_RATIO), int(CONVERGED_SHARE * response.mode_count))
    if response.body.is_mass or high_mode_start >= response.mode_count:
        return
    stations = list(dict.fromkeys(sensor.station for sensor in sensors if sensor.station.body == response.body.name))
    high_shapes = response.shapes(stations)[:, high_mode_start:]
    names = (*rig.force_names, *(contact.name for contact in rig.contacts))
    for input_name, shape, spectrum in zip(names, input_shapes(rig, response, rig.forces), input_spectra, strict=True):
        if stations and np.any(shape):
            by_station = real_product(high_shapes * shape[high_mode_start:], response.accelerance[high_mode_start:])
            for station, acceleration in zip(stations, by_station * spectrum, strict=True):
                sensor_indices = [i for i, sensor in enumerate(sensors) if sensor.station == station]
                parameter = Nuisance(NuisanceKind.TRUNCATION, f"{sensors[sensor_indices[0]].name} by {input_name}")
                yield Change(parameter, sensor_indices, np.tile(acceleration, (len(sensor_indices), 1)))
