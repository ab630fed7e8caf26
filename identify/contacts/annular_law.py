"""Law of an annular contact, with its derivatives by motion and by every parameter.

With eta = (eta_y, eta_z) less the centre, r = |eta|, e = eta / r, t = (-e_z, e_y), the rates v_r and v_t along both,

    f = f_n (e + mu tanh(v_t / v_0) t),    f_n = max(0, k (r - d) + c v_r s)    for r > d,  else 0
    s = (1 - o) min(1, (r - d) / 10 um) + o

where the onset o of the damping is 0 in rig.json and 1 of a damper that acts at once. The fitted force is f less the
force at rest (f_y0, f_z0), which accelerometers do not show.

At samples a time step_s apart, s is its mean over that time about each, as in `law_form`.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from identify.contacts.law_form import DampingShare, damping_share

RING = (
    "clearance_m",
    "stiffness_n_per_m",
    "damping_n_s_per_m",
    "friction_coefficient",
    "log_sliding_speed",
    "damping_onset",
    "center_y_m",
    "center_z_m",
    "rest_y_n",
    "rest_z_n",
)
"""Parameters of an annular contact; log_sliding_speed is the natural logarithm of v_0 in m/s."""
CLEARANCE, STIFFNESS, DAMPING, FRICTION, LOG_SPEED, ONSET = range(6)
CENTER, REST = slice(6, 8), slice(8, 10)

RingValues = Float[np.ndarray, "10"]
Signal = Float[np.ndarray, "*samples"]


@dataclass(frozen=True)
class RingMotion:
    """Polar quantities of a motion within a ring: unit vectors, rates along both, depth, and the forces there.

    pushes: True where the normal force is above zero. damping_share holds the part s of the damping that acts,
    sliding_tanh is tanh(v_t / v_0), unit_force is e + mu tanh(v_t / v_0) t.
    """

    radial: Float[np.ndarray, "2 *samples"]
    tangent: Float[np.ndarray, "2 *samples"]
    radius_m: Signal
    depth_m: Signal
    tangential_rate_m_per_s: Signal
    radial_rate_m_per_s: Signal
    pushes: Bool[np.ndarray, "*samples"]
    damping_share: DampingShare
    normal_n: Signal
    sliding_tanh: Signal
    unit_force: Float[np.ndarray, "2 *samples"]


def ring_motion(
    values: RingValues,
    eta_m: Float[np.ndarray, "2 *samples"],
    rate_m_per_s: Float[np.ndarray, "2 *samples"],
    step_s: float = 0.0,
) -> RingMotion:
    """Polar quantities at some relative displacements and velocities, step_s apart."""
    (eta_y, eta_z), (rate_y, rate_z) = eta_m, rate_m_per_s
    eta_y, eta_z = eta_y - values[CENTER][0], eta_z - values[CENTER][1]
    radius_m = np.maximum(np.sqrt(eta_y * eta_y + eta_z * eta_z), 1e-12)
    radial_y, radial_z = eta_y / radius_m, eta_z / radius_m
    radial_rate, tangential_rate = radial_y * rate_y + radial_z * rate_z, radial_y * rate_z - radial_z * rate_y
    depth_m = radius_m - values[CLEARANCE]
    share = damping_share(depth_m, radial_rate, values[ONSET], step_s)
    normal_n = values[STIFFNESS] * np.maximum(depth_m, 0.0) + values[DAMPING] * share.acting * radial_rate
    pushes = normal_n > 0
    normal_n = normal_n * pushes
    sliding = np.tanh(tangential_rate * np.exp(-values[LOG_SPEED]))
    radial, tangent = np.stack([radial_y, radial_z]), np.stack([-radial_z, radial_y])
    unit_force = radial + values[FRICTION] * sliding * tangent
    return RingMotion(
        radial,
        tangent,
        radius_m,
        depth_m,
        tangential_rate,
        radial_rate,
        pushes,
        share,
        normal_n,
        sliding,
        unit_force,
    )


def ring_force_n(
    values: RingValues,
    eta_y_m: Signal,
    eta_z_m: Signal,
    rate_y_m_per_s: Signal,
    rate_z_m_per_s: Signal,
    step_s: float = 0.0,
) -> Float[np.ndarray, "2 *samples"]:
    """Components of the contact force, N."""
    motion = ring_motion(values, np.stack([eta_y_m, eta_z_m]), np.stack([rate_y_m_per_s, rate_z_m_per_s]), step_s)
    return np.asarray(motion.normal_n * motion.unit_force)


@dataclass(frozen=True)
class RingDerivatives:
    """Derivatives of both force components: by the relative displacement (N/m), by its rate (N s/m), and by every
    parameter but the forces at rest."""

    by_eta: Float[np.ndarray, "2 2 *samples"]
    by_rate: Float[np.ndarray, "2 2 *samples"]
    by_law: Float[np.ndarray, "8 2 *samples"]


def ring_derivatives(
    values: RingValues,
    eta_m: Float[np.ndarray, "2 *samples"],
    rate_m_per_s: Float[np.ndarray, "2 *samples"],
    step_s: float = 0.0,
) -> RingDerivatives:
    """Derivatives at some motion; how the travel between samples changes with the rate is left out."""
    motion = ring_motion(values, eta_m, rate_m_per_s, step_s)
    share = motion.damping_share
    damper_n = values[DAMPING] * motion.radial_rate_m_per_s
    normal_by_depth = values[STIFFNESS] * (motion.depth_m > 0) + damper_n * share.by_depth_per_m
    normal_by_depth = normal_by_depth * motion.pushes
    radial, tangent, unit_force, normal_n = motion.radial, motion.tangent, motion.unit_force, motion.normal_n
    _, _, damping, friction, log_speed, *_ = values.tolist()
    damping_slope = damping * share.acting * motion.pushes
    # of the tangential force by v_t
    friction_slope = friction * normal_n * (1 - motion.sliding_tanh**2) * np.exp(-log_speed)
    turning_slope = damping_slope * motion.tangential_rate_m_per_s / motion.radius_m
    normal_by_eta = normal_by_depth * radial + turning_slope * tangent
    tangential_n = normal_n - friction_slope * motion.radial_rate_m_per_s
    turning_n = tangential_n * tangent - friction * normal_n * motion.sliding_tanh * radial
    by_eta = unit_force[:, None] * normal_by_eta[None] + turning_n[:, None] / motion.radius_m * tangent[None]
    by_rate = unit_force[:, None] * (damping_slope * radial)[None] + (friction_slope * tangent)[:, None] * tangent[None]
    by_law = np.stack(
        [
            -normal_by_depth * unit_force,
            np.maximum(motion.depth_m, 0.0) * motion.pushes * unit_force,
            share.acting * motion.radial_rate_m_per_s * motion.pushes * unit_force,
            normal_n * motion.sliding_tanh * tangent,
            -friction_slope * motion.tangential_rate_m_per_s * tangent,
            damping * share.withheld * motion.radial_rate_m_per_s * motion.pushes * unit_force,
            -by_eta[:, 0],
            -by_eta[:, 1],
        ]
    )
    return RingDerivatives(by_eta, by_rate, by_law)
