"""The dead zone (figures 2 and 11 of the paper)."""

from typing import Any, ClassVar

import numpy as np

from rig.errors import RigError
from rig.model.contact_laws.base import PlaneLaw, Signal, Values, depth_of
from rig.model.contact_laws.elementary import contributes, magnitude, power, select, smaller, tanh

DAMPING_DEPTH_M = 1e-5
FRICTION_SPEED_M_PER_S = 0.02


class DeadZone(PlaneLaw, frozen=True, kw_only=True, tag="dead_zone"):
    """A gap with a stop on either side; inside the gap nothing but friction passes.

    With the relative displacement eta and its rate::

        f = k depth |depth / d|^(p - 1) + k3 depth^3 + c rate min(1, |depth| / h) + c0 rate + F tanh(rate / v0)
        depth = eta - upper   for eta > upper
        depth = eta + lower   for eta < -lower
        depth = 0             between

    The lower stop's k is `lower_stiffness_ratio` times the upper one's. The exponent p is 1 to 3; at the reference
    depth d the force is that of the linear stop, whatever p. A stop that cannot pull (`pulls` false: nothing glues the
    parts together) gives no force, of the terms in depth, that draws back what leaves it.

    The friction F and the open damping c0 act in and out of the gap. The damping sets in over the first h = 10 um of
    penetration, and the friction turns round over v0 = 0.02 m/s: a force that jumped would leave an implicit solver
    without a solution at some steps.
    """

    signed_fields: ClassVar[tuple[str, ...]] = ("cubic_n_per_m3",)
    piecewise_linear: ClassVar[bool] = True

    cubic_n_per_m3: float = 0.0
    friction_n: float = 0.0
    lower_stiffness_ratio: float = 1.0
    exponent: float = 1.0
    reference_depth_m: float = 1e-4
    open_damping_n_s_per_m: float = 0.0
    pulls: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.exponent <= 3:
            raise RigError(f"contact law: exponent is {self.exponent}; give 1 to 3")
        if self.exponent > 1 and not self.reference_depth_m > 0:
            raise RigError(f"contact law: reference_depth_m is {self.reference_depth_m}; give a value above zero")

    @staticmethod
    def formula(law: Any, eta: Any, rate: Any, time_s: Any) -> Any:
        depth_m = depth_of(law, eta, time_s)
        force_n = _secant_stiffness_n_per_m(law, depth_m) * depth_m
        if contributes(law.cubic_n_per_m3):
            force_n = force_n + law.cubic_n_per_m3 * depth_m * depth_m * depth_m
        if contributes(law.damping_n_s_per_m):
            damping = law.damping_n_s_per_m
            force_n = force_n + smaller(magnitude(depth_m) * (damping / DAMPING_DEPTH_M), damping) * rate
            if not law.pulls:
                force_n = select(force_n * depth_m > 0.0, force_n, 0.0)
        if contributes(law.open_damping_n_s_per_m):
            force_n = force_n + law.open_damping_n_s_per_m * rate
        if law.friction_n != 0.0:
            force_n = force_n + law.friction_n * tanh(rate / FRICTION_SPEED_M_PER_S)
        return force_n

    @property
    def acts_in_the_gap(self) -> bool:
        return bool(self.friction_n or self.open_damping_n_s_per_m)

    @property
    def largest_slopes(self) -> tuple[float, float]:
        damping_slope = self.damping_n_s_per_m + self.open_damping_n_s_per_m + self.friction_n / FRICTION_SPEED_M_PER_S
        return self.stiffness_n_per_m * max(1.0, self.lower_stiffness_ratio), damping_slope

    def by_eta_n_per_m(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        depth_m = depth_of(self, eta_m, time_s)
        tangent_n_per_m = self.exponent * _secant_stiffness_n_per_m(self, depth_m)
        return np.asarray((tangent_n_per_m + 3 * self.cubic_n_per_m3 * depth_m * depth_m) * (depth_m != 0))

    def by_rate_n_s_per_m(self, eta_m: Signal, rate_m_per_s: Signal, time_s: Signal = 0.0) -> Values:
        depth_m = depth_of(self, eta_m, time_s)
        damping_share = smaller(magnitude(depth_m) / DAMPING_DEPTH_M, 1.0)
        if not self.pulls:
            elastic_n = (_secant_stiffness_n_per_m(self, depth_m) + self.cubic_n_per_m3 * depth_m * depth_m) * depth_m
            damping_share = damping_share * (
                (elastic_n + self.damping_n_s_per_m * damping_share * rate_m_per_s) * depth_m > 0.0
            )
        friction_slope = (1 - np.tanh(rate_m_per_s / FRICTION_SPEED_M_PER_S) ** 2) / FRICTION_SPEED_M_PER_S
        return np.asarray(
            self.damping_n_s_per_m * damping_share + self.open_damping_n_s_per_m + self.friction_n * friction_slope
        )

    def energy_j(self, eta_m: Signal, time_s: Signal = 0.0) -> Values:
        depth = depth_of(self, eta_m, time_s)
        return np.asarray(
            _secant_stiffness_n_per_m(self, depth) * depth**2 / (self.exponent + 1) + self.cubic_n_per_m3 * depth**4 / 4
        )


def _secant_stiffness_n_per_m(law: Any, depth_m: Any) -> Any:
    """k |depth / d|^(p - 1) of the stop that is touched, N/m."""
    secant_n_per_m = law.stiffness_n_per_m
    if contributes(law.lower_stiffness_ratio - 1.0):
        secant_n_per_m = secant_n_per_m * select(depth_m < 0.0, law.lower_stiffness_ratio, 1.0)
    if law.exponent != 1.0:
        secant_n_per_m = secant_n_per_m * power(magnitude(depth_m) / law.reference_depth_m, law.exponent - 1.0)
    return secant_n_per_m


def symmetric_dead_zone(clearance_m: float, stiffness_n_per_m: float, damping_n_s_per_m: float = 0.0) -> DeadZone:
    """The paper's contact: the same clearance to both sides; RigError if it is below zero."""
    if not clearance_m >= 0:
        raise RigError(f"contact law: clearance_m is {clearance_m}; give a value in metres, zero or above")
    return DeadZone(
        lower_clearance_m=clearance_m,
        upper_clearance_m=clearance_m,
        stiffness_n_per_m=stiffness_n_per_m,
        damping_n_s_per_m=damping_n_s_per_m,
    )
