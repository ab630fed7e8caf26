"""A tube in a ring: a clearance all around, with friction."""

from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.contact_laws.base import ContactLaw, Signal, Values
from rig.model.contact_laws.dead_zone import DAMPING_DEPTH_M, DeadZone
from rig.model.contact_laws.elementary import beyond, contributes, root, select, smaller, tanh

Components = Float[np.ndarray, "2 *shape"]
Tensor = Float[np.ndarray, "2 2 *shape"]
"""Components of a derivative: of the force, then of eta or its rate."""
MIN_RADIUS_M = 1e-150
"""Distance from the centre below which the force has no direction, and is zero."""


class Annular(ContactLaw, frozen=True, kw_only=True, tag="annular"):
    """A ring with the same clearance d all around its centre, that presses outwards and rubs along its wall::

        f = f_n n + f_t t
        f_n = max(0, k depth + c v_n min(1, depth / h)),   depth = max(0, r - d)
        f_t = mu f_n tanh(v_t / v_0)

    with r the distance of eta = (eta_y, eta_z) from the centre, n the direction of it and t that a right angle from n
    towards z, v_n and v_t the components of the rate along them, and h = 10 um as in a dead zone that cannot pull. The
    clearance grows by `wear_m_per_s`. The bodies do not turn about their axes, so that v_t is the sliding velocity.
    """

    signed_fields: ClassVar[tuple[str, ...]] = ("center_y_m", "center_z_m")
    spatial: ClassVar[bool] = True

    clearance_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0
    wear_m_per_s: float = 0.0
    friction_coefficient: float = 0.0
    sliding_speed_m_per_s: float = 0.01
    center_y_m: float = 0.0
    center_z_m: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.clearance_m) and self.sliding_speed_m_per_s > 0):
            raise RigError(
                f"contact law: clearance_m is {self.clearance_m} and sliding_speed_m_per_s "
                f"{self.sliding_speed_m_per_s}; give a finite clearance and a speed above zero"
            )

    @property
    def lower_clearance_m(self) -> float:
        return self.clearance_m

    @property
    def upper_clearance_m(self) -> float:
        return self.clearance_m

    @property
    def in_plane(self) -> DeadZone:
        """Dead zone that the ring is for motion along a line through its centre."""
        return DeadZone(
            lower_clearance_m=self.clearance_m,
            upper_clearance_m=self.clearance_m,
            stiffness_n_per_m=self.stiffness_n_per_m,
            damping_n_s_per_m=self.damping_n_s_per_m,
            wear_m_per_s=self.wear_m_per_s,
            pulls=False,
        )

    def with_clearances(self, lower_clearance_m: float, upper_clearance_m: float) -> "Annular":
        """Ring of half the play below and above, about the middle between them in y."""
        return replace(
            self,
            clearance_m=(lower_clearance_m + upper_clearance_m) / 2,
            center_y_m=self.center_y_m + (upper_clearance_m - lower_clearance_m) / 2,
        )

    @staticmethod
    def formula(law: Any, eta: Any, rate: Any, time_s: Any) -> Any:
        radial_y, radial_z = eta[0] - law.center_y_m, eta[1] - law.center_z_m
        radius_m = root(radial_y * radial_y + radial_z * radial_z) + MIN_RADIUS_M
        depth_m = beyond(radius_m, 0.0, law.clearance_m + law.wear_m_per_s * time_s)
        normal_n = law.stiffness_n_per_m * depth_m
        if contributes(law.damping_n_s_per_m):
            damping_n_s_per_m = smaller(depth_m * (law.damping_n_s_per_m / DAMPING_DEPTH_M), law.damping_n_s_per_m)
            normal_n = normal_n + damping_n_s_per_m * ((rate[0] * radial_y + rate[1] * radial_z) / radius_m)
            normal_n = select(normal_n > 0.0, normal_n, 0.0)
        relative_speed = (rate[1] * radial_y - rate[0] * radial_z) / (radius_m * law.sliding_speed_m_per_s)
        friction_n = law.friction_coefficient * normal_n * tanh(relative_speed)
        return (normal_n * radial_y - friction_n * radial_z) / radius_m, (
            normal_n * radial_z + friction_n * radial_y
        ) / radius_m

    def force_n(
        self, eta_m: float | Components, rate_m_per_s: float | Components = 0.0, time_s: Signal = 0.0
    ) -> Components:
        return super().force_n(np.asarray(eta_m), np.broadcast_to(rate_m_per_s, np.shape(eta_m)), time_s)

    def penetration_m(self, eta_m: float | Components, time_s: Signal = 0.0) -> Values:
        """Depth beyond the ring, without direction, m."""
        eta_m = np.asarray(eta_m)
        radius_m = np.hypot(eta_m[0] - self.center_y_m, eta_m[1] - self.center_z_m)
        return np.asarray(np.maximum(radius_m - self.clearance_m - self.wear_m_per_s * np.asarray(time_s), 0.0))

    def by_eta_n_per_m(self, eta_m: float | Components, time_s: Signal = 0.0) -> Tensor:
        return self.tangent(eta_m, 0.0, time_s)[0]

    def by_rate_n_s_per_m(
        self, eta_m: float | Components, rate_m_per_s: float | Components, time_s: Signal = 0.0
    ) -> Tensor:
        return self.tangent(eta_m, rate_m_per_s, time_s)[1]

    def tangent(
        self, eta_m: float | Components, rate_m_per_s: float | Components, time_s: Signal = 0.0
    ) -> tuple[Tensor, Tensor]:
        """Derivatives df/d eta (N/m) and df/d eta' (N s/m), by components of the force, then of eta.

        With dn = t dt'eta / r and dt = -n dt'eta / r, the turn of the axes, and dv_n = v_t t / r, dv_t = -v_n t / r.
        """
        eta_m = np.asarray(eta_m)
        rates = np.broadcast_to(rate_m_per_s, eta_m.shape)
        y, z = eta_m[0] - self.center_y_m, eta_m[1] - self.center_z_m
        radius_m = np.hypot(y, z) + MIN_RADIUS_M
        n, t = np.stack([y, z]) / radius_m, np.stack([-z, y]) / radius_m
        v_n, v_t = np.sum(rates * n, axis=0), np.sum(rates * t, axis=0)
        depth_m, c, mu = self.penetration_m(eta_m, time_s), self.damping_n_s_per_m, self.friction_coefficient
        damping_share = np.minimum(depth_m / DAMPING_DEPTH_M, 1.0)
        damping_share_slope = (depth_m < DAMPING_DEPTH_M) / DAMPING_DEPTH_M
        normal_n = self.stiffness_n_per_m * depth_m + c * damping_share * v_n
        is_closed = (depth_m > 0) & (normal_n > 0)
        normal_n = normal_n * is_closed
        friction_saturation = np.tanh(v_t / self.sliding_speed_m_per_s)
        friction_rate_slope = mu * normal_n * (1 - friction_saturation**2) / self.sliding_speed_m_per_s
        normal_by_eta = is_closed * (
            (self.stiffness_n_per_m + c * damping_share_slope * v_n) * n + c * damping_share * v_t / radius_m * t
        )
        normal_by_rate = is_closed * c * damping_share * n
        friction_by_eta = mu * friction_saturation * normal_by_eta - friction_rate_slope * v_n / radius_m * t
        friction_by_rate = mu * friction_saturation * normal_by_rate + friction_rate_slope * t
        axis_turn = (normal_n * t - mu * normal_n * friction_saturation * n) / radius_m
        by_eta = n[:, None] * normal_by_eta + t[:, None] * friction_by_eta + axis_turn[:, None] * t
        return by_eta, n[:, None] * normal_by_rate + t[:, None] * friction_by_rate

    def energy_j(self, eta_m: float | Components, time_s: Signal = 0.0) -> Values:
        return np.asarray(self.stiffness_n_per_m * self.penetration_m(eta_m, time_s) ** 2 / 2)
