"""A spring and a damper between two places, without stops."""

from typing import Any, ClassVar

import numpy as np

from rig.errors import RigError
from rig.model.contact_laws.base import PlaneLaw, Signal, Values, depth_of


class Spring(PlaneLaw, frozen=True, kw_only=True, tag="spring"):
    """A linear spring and damper, a strut or a bushing between two bodies or to the ground::

        f = k eta + c rate

    Its clearances are zero and are not given; it does not wear.
    """

    piecewise_linear: ClassVar[bool] = True
    has_stops: ClassVar[bool] = False

    lower_clearance_m: float = 0.0
    upper_clearance_m: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in ("lower_clearance_m", "upper_clearance_m", "wear_m_per_s"):
            if getattr(self, field):
                raise RigError(
                    f"contact law: {field} of a spring is {getattr(self, field)}; leave it out, or give the type "
                    "dead_zone"
                )

    @staticmethod
    def formula(law: Any, eta: Any, rate: Any, time_s: Any) -> Any:
        return law.stiffness_n_per_m * depth_of(law, eta, time_s) + law.damping_n_s_per_m * rate

    @property
    def acts_in_the_gap(self) -> bool:
        return True

    def by_eta_n_per_m(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        return np.asarray(self.stiffness_n_per_m + 0.0 * depth_of(self, eta_m, time_s))

    def by_rate_n_s_per_m(self, eta_m: Signal, rate_m_per_s: Signal, time_s: Signal = 0.0) -> Values:
        return np.asarray(self.damping_n_s_per_m + 0.0 * (depth_of(self, eta_m, time_s) + rate_m_per_s))

    def energy_j(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        return np.asarray(self.stiffness_n_per_m * depth_of(self, eta_m, time_s) ** 2 / 2)
