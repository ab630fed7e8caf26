"""A rig predicted from states that were measured, over many windows of one record: what a diagnosis judges it by.

`modal` is the predictor that this package offers to a diagnosis, by the entry points of its installation.
"""

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from rig.model.description import Rig, Station
from rig.simulation.plants.modal import Model, applied_inputs, bodies_of, constants_of, model_of, shape_row
from rig.simulation.replay import finer, step_s_of

MODES, LEAST_HZ = 24, 2.0**15
"""Of a beam, and the plant's least rate: those of a replay by the plant `modal`."""


def modal(
    rig: Rig,
    forces_n: Float[np.ndarray, "forces record"],
    first: Int[np.ndarray, " windows"],
    samples: int,
    stations: tuple[Station, ...],
    states: Float[np.ndarray, "windows 2 stations"],
) -> Float[np.ndarray, "windows 2 stations times"]:
    """Displacement (m) and velocity (m/s) at some stations from their states at the first sample of each window on.

    forces_n are the measured forces of the whole record, at the sampling rate; every window has so many samples of
    them. A body moves at the start in as many of its lowest modes as it has stations, as fits those best; no other mode
    moves. What a base motion does is left out, as its course is not known. A motion that is lost is not finite.

    Raises RigError if a contact is too stiff for the plant's step.
    """
    from rig.simulation.plants.stepping import advance  # numba only where something is simulated

    step_s = step_s_of(rig, LEAST_HZ)
    factor = round(1 / (rig.sample_rate_hz * step_s))
    steps = (samples - 1) * factor
    still = replace(rig, base_motion=None)
    model, bodies = model_of(still, False, MODES), bodies_of(still, MODES)
    constants = constants_of(model, step_s)
    shapes = np.array([shape_row(bodies, station) for station in stations])
    to_modes = modal_inverse(shapes, [(body.name, count) for body, _, count in bodies], stations)
    forces = finer(forces_n, rig.sample_rate_hz, step_s, forces_n.shape[1] * factor)
    moved = np.empty((first.size, 2, len(stations), samples))
    moving, contact_n = np.empty((steps + 1, 2 * model.omega.size)), np.empty((2, len(model.across), steps))
    with threadpool_limits(1):  # the matrices are small
        for window, sample, state in zip(moved, first.tolist(), states, strict=True):
            begin = sample * factor
            applied, bends = applied_inputs(still, forces, (), step_s, slice(begin + 1, begin + 1 + steps))
            moving[0] = (state @ to_modes.T).ravel()
            held = held_at(model, moving[0], begin * step_s)
            advance(moving, held, *contact_n, applied, bends, *constants, begin + 1, step_s)
            at = moving[::factor].T.reshape(2, model.omega.size, samples)
            np.matmul(shapes, at, out=window)
    return moved


def modal_inverse(
    shapes: Float[np.ndarray, "stations modes"], bodies: list[tuple[str, int]], stations: tuple[Station, ...]
) -> Float[np.ndarray, "modes stations"]:
    """Modal coordinates from displacements: those of each body's lowest modes, as many as it has stations, that fit its
    stations best, in the order of the bodies' modes."""
    found, begin = np.zeros(shapes.T.shape), 0
    for name, count in bodies:
        rows = [i for i, station in enumerate(stations) if station.body == name]
        used = range(begin, begin + min(len(rows), count))
        if rows:
            found[np.ix_(used, rows)] = np.linalg.pinv(shapes[np.ix_(rows, used)])
        begin += count
    return found


def held_at(model: Model, state: Float[np.ndarray, " both"], time_s: float) -> Float[np.ndarray, "4 contacts"]:
    """Contact values that `advance` holds at a state that moves: force, eta, eta', and no bend."""
    eta, rate = (model.across @ part for part in state.reshape(2, -1))
    force = [float(law.force_n(e, r, time_s)) for law, e, r in zip(model.laws, eta, rate, strict=True)]
    return np.stack([np.array(force, dtype=float), eta, rate, np.zeros(len(force))])
