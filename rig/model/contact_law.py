"""The contact law: a dead zone (figures 2 and 11 of the paper)."""

import msgspec
import numpy as np
from jaxtyping import Float

from rig.errors import RigError

DAMPING_DEPTH_M = 1e-5
FRICTION_SPEED_M_PER_S = 0.02


class DeadZone(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A gap with a stop on either side; inside the gap nothing but friction passes.

    With the relative displacement eta and its rate::

        f = k depth |depth / d|^(p - 1) + k3 depth^3 + c rate min(1, |depth| / h) + c0 rate + F tanh(rate / v0)
        depth = eta - upper   for eta > upper
        depth = eta + lower   for eta < -lower
        depth = 0             between

    The lower stop's k is `lower_stiffness_ratio` times the upper one's. The exponent p is 1 to 3; at the reference
    depth d the force is that of the linear stop, whatever p.

    Both clearances grow by `wear_m_per_s` from what they are at time 0. The friction F and the open damping c0 act in
    and out of the gap. The
    damping sets in over the first h = 10 um of penetration, and the friction turns round over v0 = 0.02 m/s: a force
    that jumped would leave an implicit solver without a solution at some steps.

    The force f acts against eta: -f on the body that eta is counted for, +f on the other.
    """

    lower_clearance_m: float
    upper_clearance_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0
    cubic_n_per_m3: float = 0.0
    friction_n: float = 0.0
    wear_m_per_s: float = 0.0
    lower_stiffness_ratio: float = 1.0
    exponent: float = 1.0
    reference_depth_m: float = 1e-4
    open_damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        for field in self.__struct_fields__:
            value = getattr(self, field)
            if not (np.isfinite(value) and (value >= 0 or field == "cubic_n_per_m3")):
                raise RigError(f"contact law: {field} is {value}; give a finite value, zero or above")
        if not 1 <= self.exponent <= 3:
            raise RigError(f"contact law: exponent is {self.exponent}; give 1 to 3")
        if self.exponent > 1 and not self.reference_depth_m > 0:
            raise RigError(f"contact law: reference_depth_m is {self.reference_depth_m}; give a value above zero")

    @property
    def clearance_m(self) -> float:
        """Half the total play at time 0: the paper's d where both sides are equal."""
        return (self.lower_clearance_m + self.upper_clearance_m) / 2

    @property
    def lower_stiffness_n_per_m(self) -> float:
        return self.lower_stiffness_ratio * self.stiffness_n_per_m

    def penetration_m(
        self, eta_m: Float[np.ndarray, "*shape"], time_s: float | Float[np.ndarray, "*shape"] = 0.0
    ) -> Float[np.ndarray, "*shape"]:
        """Signed depth beyond the stops: the paper's dead-zone function of the relative displacement."""
        worn_m = self.wear_m_per_s * time_s
        return eta_m - np.clip(eta_m, -self.lower_clearance_m - worn_m, self.upper_clearance_m + worn_m)

    def force_n(
        self,
        eta_m: Float[np.ndarray, "*shape"],
        rate_m_per_s: Float[np.ndarray, "*shape"],
        time_s: float | Float[np.ndarray, "*shape"] = 0.0,
    ) -> Float[np.ndarray, "*shape"]:
        depth = self.penetration_m(eta_m, time_s)
        force = self.elastic_n(depth)
        if self.damping_n_s_per_m:
            force = force + self.damping_n_s_per_m * rate_m_per_s * damping_share(depth)
        if self.open_damping_n_s_per_m:
            force = force + self.open_damping_n_s_per_m * rate_m_per_s
        if self.friction_n:
            force = force + self.friction_n * np.tanh(rate_m_per_s / FRICTION_SPEED_M_PER_S)
        return force

    def elastic_n(self, depth_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The force at rest at a depth."""
        spring = self.spring_n(depth_m)
        return spring + self.cubic_n_per_m3 * depth_m * depth_m * depth_m if self.cubic_n_per_m3 else spring

    def spring_n(self, depth_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The part of the force that is proportional to the stiffness: k depth |depth / d|^(p - 1)."""
        return self._secant_n_per_m(depth_m) * depth_m

    def tangent_n_per_m(self, depth_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The derivative of the elastic force by the depth; zero in the gap."""
        spring = self.exponent * self._secant_n_per_m(depth_m)
        return (spring + 3 * self.cubic_n_per_m3 * depth_m * depth_m) * (depth_m != 0)

    def energy_j(self, depth_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """What the elastic force stores."""
        return self.spring_n(depth_m) * depth_m / (self.exponent + 1) + self.cubic_n_per_m3 * depth_m**4 / 4

    def _secant_n_per_m(self, depth_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        stiffness = np.where(depth_m < 0, self.lower_stiffness_n_per_m, self.stiffness_n_per_m)
        if self.exponent != 1:
            stiffness = stiffness * (np.abs(depth_m) / self.reference_depth_m) ** (self.exponent - 1)
        return np.asarray(stiffness)


def damping_share(depth_m: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """How far the damping has set in at a penetration: min(1, |depth| / 10 um)."""
    return np.minimum(1.0, np.abs(depth_m) / DAMPING_DEPTH_M)


def dead_zone(eta_m: Float[np.ndarray, "*shape"], lower_m: float, upper_m: float) -> Float[np.ndarray, "*shape"]:
    """eta - upper above the upper stop, eta + lower below the lower one, zero between; metres."""
    return eta_m - np.clip(eta_m, -lower_m, upper_m)
