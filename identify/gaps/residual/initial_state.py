"""Free motion of a record that begins in motion and has no force: the modes that move, and their initial states.

Initial states are fitted to the linear residual, which the contact forces are projected out of. A mass has as a
rule one sensor, so that its separated contact force takes up any initial state; it has the measured one.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.gaps.residual.extent import floats_in_contacts
from identify.gaps.residual.record import Record
from identify.linear.free_motion import FreeMode, fitted_modes, free_modes
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
    by_input: Complex[np.ndarray, "inputs sensors lines"],
    deviation: Float[np.ndarray, "sensors lines"],
    scaled_response: Complex[np.ndarray, "sensors lines"],
    unexplained: Complex[np.ndarray, "sensors lines"],
) -> tuple[FreeMode, ...]:
    """Free modes that, beside the unknown inputs, explain most of what known forces leave; none with a force.

    by_input, scaled_response and unexplained are in standard deviations of the sensors' errors (deviation).
    """
    if not record.counts_from_blow:
        return ()
    sampling = None if floats_in_contacts(record.rig) else record.sampling
    sensors = {s.name: s for s in rig.sensors}
    stations = [sensors[s.name].station for s in record.sensors]
    free = free_modes(responses, _free_modes(record, responses), stations, sampling)
    free_modes_to_fit, mass_modes = _split_by_state(record, rig, free, responses)
    if free_modes_to_fit:
        unexplained = unexplained - scaled_response * sum((m.sensed for m in mass_modes), np.zeros_like(unexplained))
        projected = projection(by_input, deviation, len(rig.contacts))
        residual = projected.of(unexplained * deviation)[0][: len(stations)]
        free_modes_to_fit = fitted_modes(free_modes_to_fit, projected, scaled_response, residual)
    return (*mass_modes, *free_modes_to_fit)


def _free_modes(record: Record, responses: tuple[Response, ...]) -> list[Int[np.ndarray, "_"]]:
    """Modes of each body with a free motion in a record without a force, by the nominal rig: all rigs have the same.

    Without contacts they reach beyond the band until the omitted ones no longer matter in it, but not beyond the
    sensors' passband.
    """
    reach_hz = record.highest_hz
    if not record.rig.contacts:
        reach_hz = min(FREE_MODE_REACH * reach_hz, PASSBAND * record.sample_rate_hz)
    nominal = [modes_of(record.rig, record.rig.body(r.body.name)).frequencies_hz(r.count) for r in responses]
    return [np.flatnonzero(hz < reach_hz) for hz in nominal]


def _split_by_state(
    record: Record, rig: Rig, free: tuple[FreeMode, ...], responses: tuple[Response, ...]
) -> tuple[tuple[FreeMode, ...], tuple[FreeMode, ...]]:
    """Free modes whose initial state is to be fitted, and those of masses in contacts with the measured one."""
    if not rig.contacts:
        return free, ()
    free_modes_to_fit, mass_modes = [], []
    for mode in free:
        body = responses[mode.body_index].body
        on_body = [k for k, s in enumerate(record.sensors) if s.station.body == body.name] if body.is_mass else []
        if on_body:
            first, gains = on_body[0], {s.name: s.gain for s in rig.sensors}
            scale = record.sample_rate_hz / (gains[record.sensors[first].name] * mode.shape[first])
            state = record.first_states[first] * scale
            mass_modes.append(replace(mode, initial_state=state))
        else:
            free_modes_to_fit.append(mode)
    return tuple(free_modes_to_fit), tuple(mass_modes)
