"""Viscous dampers between a body and the ground as feedback between the body's modes.

A damper c_d reacts to the acceleration a_d at its place with the force -c_d a_d / (i omega). With the accelerance G of
the body without dampers, a force F and the places d of its dampers (Woodbury's identity),

    a = G_F F - G_d M G_dF F,   M = (diag(i omega / c_d) + G_dd)^-1

Forces that follow the measured motion instead hold the sensors' noise, and make dampers too small where the motion is
near the noise (errors in the variables).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

OutputShapes = Float[np.ndarray, "outputs modes"]
InputShapes = Float[np.ndarray, "inputs modes"]
Transfer = Callable[[OutputShapes, InputShapes], Complex[np.ndarray, "inputs outputs lines"]]
"""Accelerations along some shapes (first argument) per force along others."""


@dataclass(frozen=True, eq=False)
class DamperFeedback:
    """Mode shapes at the dampers of a body, and the forces against each per acceleration at each, N per m/s^2."""

    shapes: Float[np.ndarray, "dampers modes"]
    force_per_acceleration: Complex[np.ndarray, "dampers dampers lines"]

    def transfer(
        self, undamped: Transfer, output_shapes: OutputShapes, input_shapes: InputShapes
    ) -> Complex[np.ndarray, "inputs outputs lines"]:
        """Accelerations along some shapes per force along others, from those without dampers."""
        damper_forces = np.einsum("del,iel->idl", self.force_per_acceleration, undamped(self.shapes, input_shapes))
        acceleration_by_dampers = np.einsum("idl,dol->iol", damper_forces, undamped(output_shapes, self.shapes))
        return np.asarray(undamped(output_shapes, input_shapes) - acceleration_by_dampers)

    def modal_reactions(self, accelerations: Complex[np.ndarray, "modes lines"]) -> Complex[np.ndarray, "modes lines"]:
        """Modal forces of the dampers against the accelerations that the modes would have without them."""
        damper_forces = np.einsum("del,el->dl", self.force_per_acceleration, self.shapes @ accelerations)
        return np.asarray(self.shapes.T @ damper_forces)


def damper_feedback(
    shapes: Float[np.ndarray, "dampers modes"],
    damping_n_s_per_m: Sequence[float],
    undamped: Transfer,
    omega: Float[np.ndarray, " lines"],
) -> DamperFeedback:
    """Feedback of dampers above zero; at frequency zero there is none."""
    summed_accelerance = undamped(shapes, shapes).transpose(2, 0, 1).copy()
    is_above_zero_hz, diagonal = omega > 0, np.arange(len(shapes))
    summed_accelerance[:, diagonal, diagonal] += 1j * omega[:, None] / np.asarray(damping_n_s_per_m)
    force_per_acceleration = np.zeros_like(summed_accelerance)
    force_per_acceleration[is_above_zero_hz] = np.linalg.inv(summed_accelerance[is_above_zero_hz])
    return DamperFeedback(shapes, force_per_acceleration.transpose(1, 2, 0))
