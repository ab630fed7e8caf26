"""Prediction of a rig's motion from measured states over many windows of a record, by which a diagnosis judges it.

`modal` is the predictor that the package registers as an entry point.
"""

import numpy as np
from jaxtyping import Float, Int
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from rig.model.description import Rig, Station
from rig.simulation.plants.modal import Model, applied_inputs, body_modes_of, constants_of, model_of, shape_row
from rig.simulation.replay import finer, step_s_of

MODES, MIN_RATE_HZ = 24, 2.0**15
"""Modes of a beam and least step rate of the plant, as in `replay.modal`."""


def modal(
    rig: Rig,
    forces_n: Float[np.ndarray, "forces record"],
    first_samples: Int[np.ndarray, " windows"],
    samples: int,
    stations: tuple[Station, ...],
    states: Float[np.ndarray, "windows 2 stations"],
) -> Float[np.ndarray, "windows 2 stations times"]:
    """Displacement (m) and velocity (m/s) at stations over each window, from their states at its first sample.

    forces_n are the measured forces of the whole record at the sampling rate; a window has `samples` of them. Initially
    each body moves in as many of its lowest modes as it has stations, in the least-squares sense. Base motion is left
    out, as its history is unknown. A diverging motion is not finite.

    Raises RigError if a contact is too stiff for the plant's step.
    """
    from rig.simulation.plants.stepping import advance  # numba only where something is simulated

    step_s = step_s_of(rig, MIN_RATE_HZ)
    factor = round(1 / (rig.sample_rate_hz * step_s))
    step_count = (samples - 1) * factor
    still = replace(rig, base_motion=None)
    model, body_modes = model_of(still, False, MODES), body_modes_of(still, MODES)
    constants = constants_of(model, step_s)
    shapes = np.array([shape_row(body_modes, station) for station in stations])
    to_modes = modal_inverse(shapes, [(body.name, count) for body, _, count in body_modes], stations)
    forces = finer(forces_n, rig.sample_rate_hz, step_s, forces_n.shape[1] * factor)
    predicted = np.empty((first_samples.size, 2, len(stations), samples))
    trajectory, contact_n = (
        np.empty((step_count + 1, 2 * model.omega.size)),
        np.empty((2, len(model.across), step_count)),
    )
    with threadpool_limits(1):  # the matrices are small
        for window, sample, state in zip(predicted, first_samples.tolist(), states, strict=True):
            start = sample * factor
            applied, bends = applied_inputs(still, forces, (), step_s, slice(start + 1, start + 1 + step_count))
            trajectory[0] = (state @ to_modes.T).ravel()
            contact_state = contact_state_at(model, trajectory[0], start * step_s)
            advance(trajectory, contact_state, *contact_n, applied, bends, *constants, start + 1, step_s)
            sampled = trajectory[::factor].T.reshape(2, model.omega.size, samples)
            np.matmul(shapes, sampled, out=window)
    return predicted


def modal_inverse(
    shapes: Float[np.ndarray, "stations modes"], mode_counts: list[tuple[str, int]], stations: tuple[Station, ...]
) -> Float[np.ndarray, "modes stations"]:
    """Pseudo-inverse from station displacements to modal coordinates, in the order of the bodies' modes.

    For each body it uses as many of the lowest modes as the body has stations; all other rows are zero.
    """
    inverse_shapes, first_mode = np.zeros(shapes.T.shape), 0
    for name, count in mode_counts:
        rows = [i for i, station in enumerate(stations) if station.body == name]
        modes = range(first_mode, first_mode + min(len(rows), count))
        if rows:
            inverse_shapes[np.ix_(modes, rows)] = np.linalg.pinv(shapes[np.ix_(rows, modes)])
        first_mode += count
    return inverse_shapes


def contact_state_at(model: Model, state: Float[np.ndarray, " both"], time_s: float) -> Float[np.ndarray, "4 contacts"]:
    """Contact state of `stepping.advance` at a modal state: force, eta, eta', and zero bend."""
    eta, rate = (model.across @ half for half in state.reshape(2, -1))
    force = [float(law.force_n(e, r, time_s)) for law, e, r in zip(model.laws, eta, rate, strict=True)]
    return np.stack([np.array(force, dtype=float), eta, rate, np.zeros(len(force))])
