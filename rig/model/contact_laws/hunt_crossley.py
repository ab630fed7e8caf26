"""A stop whose damping grows with the penetration (Hunt and Crossley, J. Appl. Mech. 42, 1975)."""

from typing import Any

import numpy as np

from rig.errors import RigError
from rig.model.contact_laws.base import PlaneLaw, Signal, Values, depth_of
from rig.model.contact_laws.elementary import magnitude, power


class HuntCrossley(PlaneLaw, frozen=True, kw_only=True, tag="hunt_crossley"):
    """Two stops of a material that dissipates while it is compressed, without a jump of the force at first touch::

        f = (k depth + c rate |depth / d|) |depth / d|^(p - 1)

    with depth as of a dead zone. At the reference depth d stiffness and damping are k and c, whatever p; p = 1.5 is the
    contact of two spheres (Hertz).
    """

    exponent: float = 1.5
    reference_depth_m: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.exponent <= 3:
            raise RigError(f"contact law: exponent is {self.exponent}; give 1 to 3")
        if not self.reference_depth_m > 0:
            raise RigError(f"contact law: reference_depth_m is {self.reference_depth_m}; give a value above zero")

    @staticmethod
    def formula(law: Any, eta: Any, rate: Any, time_s: Any) -> Any:
        depth = depth_of(law, eta, time_s)
        depth_ratio = magnitude(depth) / law.reference_depth_m
        linear_force = law.stiffness_n_per_m * depth + law.damping_n_s_per_m * rate * depth_ratio
        return linear_force * power(depth_ratio, law.exponent - 1.0)

    def by_eta_n_per_m(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        return np.asarray(self.exponent * self._secant_stiffness(depth_of(self, eta_m, time_s)))

    def by_rate_n_s_per_m(self, eta_m: Signal, rate_m_per_s: Signal, time_s: Signal = 0.0) -> Values:
        depth_ratio = np.abs(depth_of(self, eta_m, time_s)) / self.reference_depth_m
        return np.asarray(self.damping_n_s_per_m * depth_ratio**self.exponent + 0.0 * rate_m_per_s)

    def energy_j(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        depth = depth_of(self, eta_m, time_s)
        return np.asarray(self._secant_stiffness(depth) * depth**2 / (self.exponent + 1))

    def _secant_stiffness(self, depth_m: Any) -> Any:
        depth_ratio = np.abs(depth_m) / self.reference_depth_m
        return self.stiffness_n_per_m * depth_ratio ** (self.exponent - 1) * (depth_m != 0)
