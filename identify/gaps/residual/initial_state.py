"""Free motion of a record that begins in motion and has no force: the modes that move, and their initial states.

Initial states are fitted to the linear residual, which the contact forces are projected out of. A mass has as a
rule one sensor, so that its separated contact force takes up any initial state; it has the measured one.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.gaps.residual.extent import floats_in_contacts
from identify.gaps.residual.record import Record
from identify.linear.free_motion import FreeMode, fitted_free_modes, free_modes
from identify.linear.model import Response
from identify.linear.projection import projection
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.model.sensing import PASSBAND

FREE_MODE_REACH = 4.0
"""Modes up to this multiple of the highest frequency have a free motion of their own. Set by hand: what is left out is
below noise."""


def free_motion_of(
    record: Record,
    rig: Rig,
    responses: tuple[Response, ...],
    signal_per_input: Complex[np.ndarray, "inputs sensors lines"],
    error_deviation: Float[np.ndarray, "sensors lines"],
    scaled_response: Complex[np.ndarray, "sensors lines"],
    unexplained: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMode, ...]:
    """Free modes that, beside the unknown inputs, explain most of what known forces leave; none with a force.

    signal_per_input, scaled_response and unexplained are in standard deviations of the sensors' errors.
    """
    if not record.counts_from_blow:
        return ()
    sampling = None if floats_in_contacts(record.rig) else record.sampling
    sensors_by_name = {sensor.name: sensor for sensor in rig.sensors}
    sensor_stations = [sensors_by_name[sensor.name].station for sensor in record.sensors]
    all_free_modes = free_modes(responses, _free_mode_indices(record, responses), sensor_stations, sampling)
    free_modes_to_fit, mass_modes = _split_by_state(record, rig, all_free_modes, responses)
    if free_modes_to_fit:
        unexplained = unexplained - scaled_response * sum(
            (mass_mode.sensed_acceleration for mass_mode in mass_modes), np.zeros_like(unexplained)
        )
        contact_projection = projection(signal_per_input, error_deviation, len(rig.contacts))
        projected_residual = contact_projection.applied_to(unexplained * error_deviation)[0][: len(sensor_stations)]
        free_modes_to_fit = fitted_free_modes(
            free_modes_to_fit, contact_projection, scaled_response, projected_residual
        )
    return (*mass_modes, *free_modes_to_fit)


def _free_mode_indices(record: Record, responses: tuple[Response, ...]) -> list[Int[np.ndarray, "_"]]:
    """Modes of each body with a free motion in a record without a force, by the nominal rig: all rigs have the same.

    Without contacts they reach beyond the band until the omitted ones no longer matter in it, but not beyond the
    sensors' passband.
    """
    highest_mode_hz = record.highest_hz
    if not record.rig.contacts:
        highest_mode_hz = min(FREE_MODE_REACH * highest_mode_hz, PASSBAND * record.sample_rate_hz)
    nominal_hz = [
        modes_of(record.rig, record.rig.body(response.body.name)).frequencies_hz(response.mode_count)
        for response in responses
    ]
    return [np.flatnonzero(natural_hz < highest_mode_hz) for natural_hz in nominal_hz]


def _split_by_state(
    record: Record, rig: Rig, all_free_modes: tuple[FreeMode, ...], responses: tuple[Response, ...]
) -> tuple[tuple[FreeMode, ...], tuple[FreeMode, ...]]:
    """Free modes whose initial state is to be fitted, and those of masses in contacts with the measured one."""
    if not rig.contacts:
        return all_free_modes, ()
    free_modes_to_fit, mass_modes = [], []
    for free_mode in all_free_modes:
        body = responses[free_mode.body_index].body
        body_sensor_indices = (
            [sensor_index for sensor_index, sensor in enumerate(record.sensors) if sensor.station.body == body.name]
            if body.is_mass
            else []
        )
        if body_sensor_indices:
            first_sensor, gain_by_sensor = body_sensor_indices[0], {sensor.name: sensor.gain for sensor in rig.sensors}
            modal_per_signal = record.sample_rate_hz / (
                gain_by_sensor[record.sensors[first_sensor].name] * free_mode.shape[first_sensor]
            )
            initial_state = record.first_states[first_sensor] * modal_per_signal
            mass_modes.append(replace(free_mode, initial_state=initial_state))
        else:
            free_modes_to_fit.append(free_mode)
    return tuple(free_modes_to_fit), tuple(mass_modes)
