"""Modal accelerations of the bodies: of modes that the stations tell, and of the others by the separated forces."""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex

from identify.linear.modal import transformation
from identify.linear.model import Response, input_shapes, times
from identify.linear.nuisance import BodyMotion, elastic_modes
from identify.signals.kinematics import Kinematics
from rig.model.description import Rig

NEAR = 1.25
"""Modes up to this multiple of the band's end are believed to its tolerances only, those beyond altogether."""


def told_motion(
    rig: Rig, response: Response, motion: Kinematics, accelerated: Complex[np.ndarray, "stations lines"]
) -> BodyMotion:
    """The modal accelerations that the stations tell; those of higher modes are left out."""
    transform = transformation(rig, response.body, motion)
    found = times(transform.inverse, accelerated[list(transform.rows)])
    return BodyMotion(response, found, elastic_modes(response, len(found)))


def has_hidden_modes(response: Response, motion: Kinematics) -> bool:
    """True if a body has more modes near the band than stations."""
    return _near(response) > sum(s.body == response.body.name for s in motion.stations)


def whole_motion(
    rig: Rig,
    response: Response,
    motion: Kinematics,
    accelerated: Complex[np.ndarray, "stations lines"],
    forces: Complex[np.ndarray, "forces lines"],
    contact_forces: Complex[np.ndarray, "contacts lines"],
) -> BodyMotion:
    """Motion with the other modes, whose accelerations are the model's under the exciting forces and the contact
    forces:

        A_m (sum_k phi_m(x_k) F_k - sum_j phi_mj f_j)

    and the stations' less these.
    """
    told = len(transformation(rig, response.body, motion).inverse)
    modal_force = times(input_shapes(rig, response, rig.forces).T, np.concatenate([forces, contact_forces]))
    hidden = response.accelerance[told:] * modal_force[told:]
    rest = accelerated - times(response.shapes(motion.stations)[:, told:], hidden)
    found = told_motion(rig, response, motion, rest)
    return replace(
        found,
        acceleration=np.concatenate([found.acceleration, hidden]),
        elastic=elastic_modes(response, max(told, _near(response))),
    )


def _near(response: Response) -> int:
    omega = response.dynamics.omega
    return int(np.count_nonzero(response.dynamics.natural_hz < NEAR * omega[-1] / (2 * np.pi)))
