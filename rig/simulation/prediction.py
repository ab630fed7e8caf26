"""Prediction of a rig's motion from measured states over many windows of a record, by which a diagnosis judges it.

`modal` is the predictor that the package registers as an entry point.
"""

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from rig.model.description import Rig, Station
from rig.simulation.plants.loading import base_motion_from_rig_or_force, connection_forces_n
from rig.simulation.plants.modal import (
    ModalModel,
    body_modes_of,
    inputs_and_bends,
    model_of,
    shape_row,
    stepping_constants,
)
from rig.simulation.replay import forces_at_steps, step_s_of

MODE_COUNT, MIN_STEP_RATE_HZ = 24, 2.0**15
"""Modes of a beam and least step rate of the plant, as in `replay.modal`."""


def modal(
    rig: Rig,
    forces_n: Float[np.ndarray, "forces record"],
    first_samples: Int[np.ndarray, " windows"],
    sample_count: int,
    stations: tuple[Station, ...],
    initial_states: Float[np.ndarray, "windows 2 stations"],
) -> Float[np.ndarray, "windows 2 stations times"]:
    """Displacement (m) and velocity (m/s) at stations over each window, from their states at its first sample.

    forces_n are the measured forces of the whole record at the sampling rate; a window has `sample_count` of them.
    Initially each body moves in as many of its lowest modes as it has stations, in the least-squares sense. Where a
    sensor measures the base, states and motion are those against it, and the force on the ground is its inertial force,
    N/kg; else base motion is left out, as its history is unknown. A diverging motion is not finite.

    Raises RigError if a contact is too stiff for the plant's step.
    """
    from rig.simulation.plants.stepping import advance  # numba only where something is simulated

    step_s = step_s_of(rig, MIN_STEP_RATE_HZ)
    steps_per_sample = round(1 / (rig.sample_rate_hz * step_s))
    step_count = (sample_count - 1) * steps_per_sample
    rig = replace(rig, base_motion=None)
    step_forces = forces_at_steps(forces_n, rig.sample_rate_hz, step_s, forces_n.shape[1] * steps_per_sample)
    base_signals = base_motion_from_rig_or_force(rig, step_forces, step_s)
    model = model_of(rig, bool(base_signals), MODE_COUNT)
    constants, body_modes = stepping_constants(model, step_s), body_modes_of(rig, MODE_COUNT)
    shapes = np.array([shape_row(body_modes, station) for station in stations])
    inverse_shapes = modal_inverse(shapes, [(basis.body.name, basis.mode_count) for basis in body_modes], stations)
    predicted = np.empty((first_samples.size, 2, len(stations), sample_count))
    step_states = np.empty((step_count + 1, 2 * model.omega.size))
    forces_and_bends = np.empty((2, len(model.eta_rows), step_count))  # and their bends
    with threadpool_limits(1):  # the matrices are small
        for window_motion, first_sample, state in zip(predicted, first_samples.tolist(), initial_states, strict=True):
            start_step = first_sample * steps_per_sample
            step_span = slice(start_step + 1, start_step + 1 + step_count)
            inputs = inputs_and_bends(rig, step_forces, base_signals, step_s, step_span)
            step_states[0] = (state @ inverse_shapes.T).ravel()
            contact_state = contact_state_at(model, step_states[0], start_step * step_s)
            advance(step_states, contact_state, *forces_and_bends, *inputs, *constants, step_span.start, step_s)
            coordinates_and_rates = step_states[::steps_per_sample].T.reshape(2, model.omega.size, sample_count)
            np.matmul(shapes, coordinates_and_rates, out=window_motion)
    return predicted


def modal_inverse(
    shapes: Float[np.ndarray, "stations modes"], body_mode_counts: list[tuple[str, int]], stations: tuple[Station, ...]
) -> Float[np.ndarray, "modes stations"]:
    """Pseudo-inverse from station displacements to modal coordinates, in the order of the bodies' modes.

    For each body it uses as many of the lowest modes as the body has stations; all other rows are zero.
    """
    inverse_shapes, first_mode = np.zeros(shapes.T.shape), 0
    for body_name, mode_count in body_mode_counts:
        station_rows = [station_row for station_row, station in enumerate(stations) if station.body == body_name]
        mode_rows = range(first_mode, first_mode + min(len(station_rows), mode_count))
        if station_rows:
            inverse_shapes[np.ix_(mode_rows, station_rows)] = np.linalg.pinv(shapes[np.ix_(station_rows, mode_rows)])
        first_mode += mode_count
    return inverse_shapes


def contact_state_at(
    model: ModalModel, modal_state: Float[np.ndarray, " both"], time_s: float
) -> Float[np.ndarray, "4 contacts"]:
    """Contact state of `stepping.advance` at a modal state: force, eta, eta', and zero bend."""
    eta_m, rate_m_per_s = (model.eta_rows @ values_per_mode for values_per_mode in modal_state.reshape(2, -1))
    force_n = connection_forces_n(model.laws, eta_m, rate_m_per_s, time_s)
    return np.stack([force_n, eta_m, rate_m_per_s, np.zeros(force_n.size)])
