"""Stiffness and damping of the bodies against slow relative displacements of the contacts, and constant contact forces.

Accelerations do not show slow motion; where they are all that is measured, the springs of some modes act on the
high-passed displacement alone, and the slow rest meets these matrices.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from identify.linear.model import RANK_TOLERANCE, Response, eta_shapes_and_omega, relative_shapes
from rig.model.description import Rig


def slow_damping(
    rig: Rig, responses: Sequence[Response], slow_stiffness_n_per_m: Float[np.ndarray, "contacts contacts"]
) -> Float[np.ndarray, "contacts contacts"]:
    """Contact forces (N s) per slow relative velocity (m/s): K M K, with M the sum of phi phi' 2 zeta / omega^3."""
    eta_shapes, omega = eta_shapes_and_omega(rig, responses)
    zeta, is_held = np.concatenate([response.dynamics.damping_ratios for response in responses]), omega > 0
    held_shapes, damping_weights = eta_shapes[:, is_held], 2 * zeta[is_held] / omega[is_held] ** 3
    return np.asarray(slow_stiffness_n_per_m @ (held_shapes * damping_weights) @ held_shapes.T @ slow_stiffness_n_per_m)


def slow_stiffness(rig: Rig, responses: Sequence[Response]) -> Float[np.ndarray, "contacts contacts"]:
    """Contact forces (N) per slow relative displacement (m), where springs act on the high-passed displacements.

    K = N (N' C N)^-1 N', with C the sum of phi phi' / omega^2 over the held modes, and N the combinations of contacts
    that no free mode moves. Zero if no mode's spring acts on the high-passed displacement.
    """
    eta_shapes, omega = eta_shapes_and_omega(rig, responses)
    combinations, singular_values, _ = np.linalg.svd(eta_shapes[:, omega == 0])
    rank_tolerance = RANK_TOLERANCE * np.max(np.abs(eta_shapes), initial=0.0)
    held_combinations = combinations[:, np.count_nonzero(singular_values > rank_tolerance) :]
    if not (held_combinations.size and has_high_passed_springs(responses)):
        return np.zeros((len(eta_shapes), len(eta_shapes)))
    held_shapes = eta_shapes[:, omega > 0]
    compliance = held_combinations.T @ (held_shapes / omega[omega > 0] ** 2) @ held_shapes.T @ held_combinations
    return np.asarray(held_combinations @ np.linalg.pinv(compliance, rcond=1e-12, hermitian=True) @ held_combinations.T)


def has_high_passed_springs(responses: Sequence[Response]) -> bool:
    """True if the spring of some mode acts on the high-passed displacement alone."""
    return any(np.any(r.dynamics.natural_hz[list(r.dynamics.slowly_free_modes)]) for r in responses)


def static_contact_forces(rig: Rig, responses: tuple[Response, ...]) -> Float[np.ndarray, " contacts"]:
    """Constant contact forces that balance static loads on floating bodies and on single masses, N."""
    forces_n = np.zeros(len(rig.contacts))
    loads_n, load_stations = np.array([load.force_n for load in rig.loads]), [load.station for load in rig.loads]
    for response in responses if rig.loads else ():
        is_rigid = (response.modes.frequencies_hz(response.mode_count) == 0) | response.body.is_mass
        modal_load_n = (loads_n @ response.shapes(load_stations))[is_rigid]
        if np.any(modal_load_n):
            rigid_shapes = relative_shapes(rig, response)[:, is_rigid]
            forces_n += np.linalg.lstsq(rigid_shapes.T, modal_load_n, rcond=None)[0]
    return forces_n
