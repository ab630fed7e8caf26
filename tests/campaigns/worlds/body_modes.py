"""The modes of one body, whatever it is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class BodyModes:
    """The lowest modes, normalised to unit mass; `carried` is each mode's share in a translation of the whole body.

    weights(position_m): how much every coordinate moves a place.
    """

    omega_rad_per_s: Float[np.ndarray, " modes"]
    damping_ratio: Float[np.ndarray, " modes"]
    vectors: Float[np.ndarray, "coordinates modes"]
    carried: Float[np.ndarray, " modes"]
    weights: Callable[[float], Float[np.ndarray, " coordinates"]]

    def shapes(self, position_m: float) -> Float[np.ndarray, " modes"]:
        """Every mode's displacement at a place, 1/sqrt(kg)."""
        return self.weights(position_m) @ self.vectors
