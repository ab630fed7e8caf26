"""The force between two places of a machine, or between one and the ground, as a function of motion and time."""

from typing import no_type_check

import msgspec
import numba
import numpy as np
from jaxtyping import Float

ONSET_M = 1e-5
"""Penetration over which the damping of a stop sets in where nothing else is drawn, as rig.json has it."""
NONE_M = 1e6
"""A clearance that nothing crosses: JSON knows no infinity."""
TURN_M_PER_S = 0.02
"""Speed over which dry friction turns round."""
compiled = numba.njit(cache=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")


class StopLaw(msgspec.Struct, frozen=True, kw_only=True):
    """A force against the relative displacement x = eta - offset and its rate v::

        f = k |depth / d|^(n - 1) depth + k3 depth^3 + c v min(1, |depth| / onset)    (stop)
          + F tanh(v / 0.02 m/s) + k_s x + k_s3 x^3 + c_d v + c_q |v| v + F_y tanh(x / x_y)
        depth = x - upper - g    for x > upper + g,    k = stiffness_above
        depth = x + lower + g    for x < -lower - g,   k = stiffness_below
        g(t) = wear t + breath sin(2 pi breath_hz t)

    No stop where a clearance is that of NONE_M. A stop that cannot pull (pulls = 0) gives no force against its own
    direction, however fast it is left.
    """

    lower_m: float = NONE_M
    upper_m: float = NONE_M
    stiffness_below_n_per_m: float = 0.0
    stiffness_above_n_per_m: float = 0.0
    exponent: float = 1.0
    reference_depth_m: float = 1e-3
    cubic_stop_n_per_m3: float = 0.0
    damping_n_s_per_m: float = 0.0
    friction_n: float = 0.0
    wear_m_per_s: float = 0.0
    breath_m: float = 0.0
    breath_hz: float = 0.0
    offset_m: float = 0.0
    spring_n_per_m: float = 0.0
    cubic_spring_n_per_m3: float = 0.0
    dashpot_n_s_per_m: float = 0.0
    drag_n_s2_per_m2: float = 0.0
    yield_n: float = 0.0
    yield_m: float = 1.0
    pulls: float = 1.0
    onset_m: float = ONSET_M

    def row(self) -> Float[np.ndarray, " fields"]:
        """Every number in the order of the fields, as the compiled loop wants it."""
        return np.array([getattr(self, field) for field in self.__struct_fields__])


@compiled
@no_type_check  # numba compiles the plain functions only
def depth_m(law, eta_m, time_s):
    """Signed penetration of the stops."""
    time_s = max(time_s, 0.0)
    grown = law[9] * time_s
    if law[10] != 0.0:
        grown += law[10] * np.sin(2 * np.pi * law[11] * time_s)
    x = eta_m - law[12]
    return max(x - law[1] - grown, 0.0) + min(x + law[0] + grown, 0.0)


@compiled
@no_type_check
def force_of(law, eta_m, rate_m_per_s, time_s):
    """The force of a `StopLaw` (its row) and its slopes over eta and over the rate."""
    x, v = eta_m - law[12], rate_m_per_s
    force = law[13] * x + law[15] * v
    slope, viscous = law[13], law[15]
    depth = depth_m(law, eta_m, time_s)
    if depth != 0.0:
        stiffness = law[3] if depth > 0.0 else law[2]
        if law[4] != 1.0:
            stiffness *= (abs(depth) / law[5]) ** (law[4] - 1.0)
        share = min(1.0, abs(depth) / law[20])
        stop = (stiffness + law[6] * depth * depth) * depth + law[7] * v * share
        if law[19] != 0.0 or stop * depth > 0.0:
            force += stop
            slope += law[4] * stiffness + 3.0 * law[6] * depth * depth
            viscous += law[7] * share
    if law[8] != 0.0:
        turned = np.tanh(v / TURN_M_PER_S)
        force += law[8] * turned
        viscous += law[8] * (1.0 - turned * turned) / TURN_M_PER_S
    if law[14] != 0.0:
        force += law[14] * x * x * x
        slope += 3.0 * law[14] * x * x
    if law[16] != 0.0:
        force += law[16] * abs(v) * v
        viscous += 2.0 * law[16] * abs(v)
    if law[17] != 0.0:
        turned = np.tanh(x / law[18])
        force += law[17] * turned
        slope += law[17] * (1.0 - turned * turned) / law[18]
    return force, slope, viscous


def energy_j(law: StopLaw, eta_m: float) -> float:
    """What the elastic parts of the law store at time 0."""
    x = eta_m - law.offset_m
    depth = float(depth_m(law.row(), eta_m, 0.0))
    stiffness = law.stiffness_above_n_per_m if depth > 0 else law.stiffness_below_n_per_m
    n, d = law.exponent, law.reference_depth_m
    stop = stiffness * d**2 / (n + 1) * (abs(depth) / d) ** (n + 1) + law.cubic_stop_n_per_m3 * depth**4 / 4
    spring = law.spring_n_per_m * x**2 / 2 + law.cubic_spring_n_per_m3 * x**4 / 4
    return float(stop + spring + law.yield_n * law.yield_m * np.logaddexp(x / law.yield_m, -x / law.yield_m))
