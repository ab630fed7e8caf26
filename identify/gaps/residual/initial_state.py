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
    unexplained_signals: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMode, ...]:
    """Free modes that, beside the unknown inputs, explain most of what known forces leave; none with a force.

    signal_per_input, scaled_response and unexplained are in standard deviations of the sensors' errors.
    """
    if not record.fits_initial_state:
        return ()
    sampling = None if floats_in_contacts(record.rig) else record.sampling
    sensor_by_name = {sensor.name: sensor for sensor in rig.sensors}
    sensor_stations = [sensor_by_name[sensor.name].station for sensor in record.sensors]
    unfitted_modes = free_modes(responses, _free_mode_indices(record, responses), sensor_stations, sampling)
    fitted_modes, mass_modes = _fitted_and_mass_modes(record, rig, unfitted_modes, responses)
    if fitted_modes:
        mass_accelerations = sum((mode.sensed_acceleration for mode in mass_modes), np.zeros_like(unexplained_signals))
        unexplained_signals = unexplained_signals - scaled_response * mass_accelerations
        contact_projection = projection(signal_per_input, error_deviation, len(rig.contacts))
        residual = contact_projection.applied_to(unexplained_signals * error_deviation)[0][: len(sensor_stations)]
        fitted_modes = fitted_free_modes(fitted_modes, contact_projection, scaled_response, residual)
    return (*mass_modes, *fitted_modes)


def _free_mode_indices(record: Record, responses: tuple[Response, ...]) -> list[Int[np.ndarray, "_"]]:
    """Modes of each body with a free motion in a record without a force, by the nominal rig: all rigs have the same.

    Without contacts they reach beyond the band until the omitted ones no longer matter in it, but not beyond the
    sensors' passband.
    """
    highest_hz = record.highest_hz
    if not record.rig.contacts:
        highest_hz = min(FREE_MODE_REACH * highest_hz, PASSBAND * record.sample_rate_hz)
    bodies = [(record.rig.body(response.body.name), response.mode_count) for response in responses]
    return [np.flatnonzero(modes_of(record.rig, body).frequencies_hz(count) < highest_hz) for body, count in bodies]


def _fitted_and_mass_modes(
    record: Record, rig: Rig, modes: tuple[FreeMode, ...], responses: tuple[Response, ...]
) -> tuple[tuple[FreeMode, ...], tuple[FreeMode, ...]]:
    """Free modes whose initial state is to be fitted, and those of masses in contacts with the measured one."""
    if not rig.contacts:
        return modes, ()
    gain_by_sensor = {sensor.name: sensor.gain for sensor in rig.sensors}
    fitted_modes, mass_modes = [], []
    for mode in modes:
        body = responses[mode.body_index].body
        sensed = [k for k, sensor in enumerate(record.sensors) if sensor.station.body == body.name]
        if body.is_mass and sensed:
            gain = gain_by_sensor[record.sensors[sensed[0]].name]
            modal_per_signal = record.sample_rate_hz / (gain * mode.shape[sensed[0]])
            mass_modes.append(replace(mode, initial_state=record.initial_sensor_states[sensed[0]] * modal_per_signal))
        else:
            fitted_modes.append(mode)
    return tuple(fitted_modes), tuple(mass_modes)
