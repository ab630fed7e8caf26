"""Modes of masses in a row, with springs between them and to the ground."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh

from rig.errors import RigError
from tests.campaigns.worlds.body_modes import BodyModes
from tests.campaigns.worlds.machine import Lumped

FLOATING = 1e-9
"""A mode whose square of frequency is less than this share of the largest one's is a rigid motion."""


def lumped_modes(body: Lumped) -> BodyModes:
    """The modes of the masses with what is fixed to them; raises RigError if springs push more than they hold.

    Over the masses' displacements w: M w'' + K w = 0, K of the springs to the ground and between neighbours.
    """
    count = len(body.masses_kg)
    mass, stiffness = np.diag(body.masses_kg), np.diag(body.grounded_n_per_m)
    for k, spring_n_per_m in enumerate(body.between_n_per_m):
        stiffness[k : k + 2, k : k + 2] += spring_n_per_m * np.array([[1.0, -1.0], [-1.0, 1.0]])

    def weights(position_m: float) -> Float[np.ndarray, " coordinates"]:
        return np.array([np.interp(position_m, body.positions_m, unit) for unit in np.eye(count)])

    for position_m, mass_kg in body.masses:
        mass += mass_kg * np.outer(weights(position_m), weights(position_m))
    for position_m, spring_n_per_m in body.springs:
        stiffness += spring_n_per_m * np.outer(weights(position_m), weights(position_m))
    squares, vectors = eigh(stiffness, mass)
    rigid = np.abs(squares) <= FLOATING * np.abs(squares).max()
    if (squares[~rigid] < 0).any():
        raise RigError(f"the springs of {body.name!r} do not hold it; draw a weaker effect")
    omega = np.sqrt(np.where(rigid, 0.0, np.abs(squares))) * np.array(body.frequency_factors)
    damping = np.where(rigid, 0.0, body.damping_ratio * np.array(body.damping_factors))
    return BodyModes(omega, damping, vectors, vectors.T @ mass @ np.ones(count), weights)
