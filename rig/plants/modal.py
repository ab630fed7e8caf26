"""The assumed-mode model of the paper (equations 13 to 20), advanced by an exact linear propagator."""

from collections.abc import Iterator
from functools import cache
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

from rig.beam import Beam
from rig.contact import DAMPING_DEPTH_M, FRICTION_SPEED_M_PER_S
from rig.description import Body, Rig, Station, contact_stations, stations_of
from rig.errors import RigError
from rig.modes import Modes, modes_of, participation
from rig.motion import Motion, Progress
from rig.plants.loading import base_motion, connections, equilibrium, true_force

BLOCK = 1 << 14
TOLERANCE_N = 1e-9
QUANTITIES = ("displacement", "velocity", "acceleration")
_LAW = (  # the columns of the compiled loop's table
    "lower_clearance_m",
    "upper_clearance_m",
    "stiffness_n_per_m",
    "damping_n_s_per_m",
    "cubic_n_per_m3",
    "friction_n",
    "wear_m_per_s",
)


def simulate(
    rig: Rig, force_n: Float[np.ndarray, " samples"], step_s: float, progress: Progress, modes: int = 16
) -> Iterator[Motion]:
    """The motion from rest, with `modes` modes a beam (a mass has one).

    The modes are those of the bodies with what is attached to them, in a frame that moves with the base. Every mode
    obeys q'' + 2 zeta omega q' + omega^2 q = p with the modal force p = phi(x_F) F + p_static - g a_base -
    sum_j b_j f_j(eta_j, eta_j', t), eta_j = b_j . q, over contacts and cubic springs. Over a step p is taken as linear
    in time and the mode is advanced exactly; the contact forces at the end of the step are found by fixed-point
    iteration, so the only error, second order in the step, is that p bends within a step.

    Yields blocks of at most 2^14 samples. Raises RigError if a contact is too stiff for the step or the result is not
    finite.
    """
    model = _model(rig, step_s, modes)
    base = base_motion(rig, len(force_n), step_s)
    applied_n = true_force(rig, force_n, step_s)
    drive, static, inertia = model["drive"], model["static"], model["inertia"]
    state = np.stack([model["at_rest"], np.zeros(len(static))])
    contact_n = model["holding_n"].copy()
    previous = static
    for first in range(0, len(force_n), BLOCK):
        now = slice(first, first + BLOCK)
        modal_force = np.outer(applied_n[now], drive) + static
        if base:
            modal_force -= np.outer(base["acceleration"][now], inertia)
        coordinates, contact_force = _compiled()(state, contact_n, previous, modal_force, first, *model["kernel"])
        previous = modal_force[-1]
        if not np.all(np.isfinite(coordinates)):
            raise RigError(
                f"the modal plant diverged near {first * step_s:.3f} s at step {step_s} s; use a smaller step"
            )
        samples = coordinates.shape[2]
        progress(min(1.0, (first + samples) / len(force_n)))
        sensed = np.array([row @ coordinates[QUANTITIES.index(q)] for row, q in model["sensors"]]).reshape(-1, samples)
        displacement = model["stations"] @ coordinates[0]
        if base:
            sensed += np.array([base[q][now] for _, q in model["sensors"]]).reshape(-1, samples)
            displacement += base["displacement"][now]
        contacts = len(rig.contacts)
        yield Motion(
            start_s=first * step_s,
            step_s=step_s,
            force_n=force_n[now],
            sensed=sensed,
            displacement_m=displacement,
            eta_m=model["connections"][:contacts] @ coordinates[0],
            contact_force_n=contact_force[:contacts],
        )


def _model(rig: Rig, step_s: float, modes: int) -> dict[str, Any]:
    bodies = [(b, modes_of(rig, b), modes if isinstance(b, Beam) else 1) for b in rig.bodies]
    omega = 2 * np.pi * np.concatenate([shapes.frequencies_hz(n) for _, shapes, n in bodies])
    zeta = np.concatenate([shapes.damping_ratios(n) for _, shapes, n in bodies])
    propagate, from_start, from_end = _propagator(omega, zeta, step_s)
    wanted = {*stations_of(rig), rig.force_at, *(load.station for load in rig.loads)}
    wanted |= {station for c in connections(rig) for station in contact_stations(c)}
    rows = {station: _shape_row(bodies, station) for station in wanted}
    contacts, laws = connections(rig), tuple(c.law for c in connections(rig))
    across = np.array([rows[c.at] - (rows[c.against] if c.against else 0) for c in contacts])
    across = across.reshape(len(contacts), omega.size)
    table = np.array([[getattr(law, field) for field in _LAW] for law in laws]).reshape(len(laws), len(_LAW))
    reach = np.stack([(across * from_end[k]) @ across.T for k in range(2)])  # end force -> -eta, -eta'
    slope = table[:, 3] + table[:, 5] / FRICTION_SPEED_M_PER_S
    loop = np.abs(reach[0]) @ table[:, 2] + np.abs(reach[1]) @ slope
    if np.any(loop > 0.5):
        raise RigError(
            f"a contact is too stiff for the step of {step_s} s (loop gain {loop.max():.2g}); use a smaller step"
        )
    static = np.zeros(omega.size) + sum(load.force_n * rows[load.station] for load in rig.loads)
    at_rest = equilibrium(omega**2, across, laws, static)
    holding = [law.force_n(np.array([eta]), np.zeros(1))[0] for law, eta in zip(laws, across @ at_rest, strict=True)]
    kernel = (propagate, from_start, from_end, across, table, reach, omega, zeta)
    return {
        "kernel": (*(np.ascontiguousarray(a) for a in kernel), step_s),
        "drive": rows[rig.force_at],
        "static": static,
        "inertia": np.concatenate([participation(rig, body, shapes, n) for body, shapes, n in bodies]),
        "at_rest": at_rest,
        "holding_n": np.array(holding, dtype=float),
        "connections": across,
        "stations": np.array([rows[s] for s in stations_of(rig)]),
        "sensors": [(rows[s.station], s.quantity) for s in rig.sensors],
    }


def _shape_row(bodies: list[tuple[Body, Modes, int]], station: Station) -> Float[np.ndarray, " allmodes"]:
    """The shapes of all bodies' modes at a station; zero for the modes of the other bodies."""
    return np.concatenate(
        [
            shapes.shapes(np.array([station.position_m]), n)[0] if body.name == station.body else np.zeros(n)
            for body, shapes, n in bodies
        ]
    )


def _propagator(
    omega: Float[np.ndarray, " modes"], zeta: Float[np.ndarray, " modes"], step_s: float
) -> tuple[Float[np.ndarray, "2 2 modes"], Float[np.ndarray, "2 modes"], Float[np.ndarray, "2 modes"]]:
    """Exact step of q, q' under a force linear in time: x1 = A x0 + B0 p0 + B1 p1 (augmented matrix exponential)."""
    augmented = np.zeros((omega.size, 4, 4))
    augmented[:, 0, 1] = step_s
    augmented[:, 1, 0] = -(omega**2) * step_s
    augmented[:, 1, 1] = -2 * zeta * omega * step_s
    augmented[:, 1, 2] = step_s
    augmented[:, 2, 3] = 1.0
    powers = expm(augmented)
    from_end = powers[:, :2, 3].T
    return powers[:, :2, :2].transpose(1, 2, 0), powers[:, :2, 2].T - from_end, from_end


@cache
def _compiled() -> Any:
    import numba

    @numba.njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
    @no_type_check  # numba compiles the plain function only
    def advance(
        state,
        contact_n,
        previous,
        modal_force,
        first,
        propagate,
        from_start,
        from_end,
        contacts,
        laws,
        reach,
        omega,
        zeta,
        step_s,
    ):
        samples, modes, count = modal_force.shape[0], omega.size, laws.shape[0]
        coordinates = np.empty((3, modes, samples))
        contact_force = np.empty((count, samples))
        q, v = state[0], state[1]
        eta, rate, end_force = np.empty(count), np.empty(count), contact_n.copy()
        before = previous
        for n in range(samples):
            eta[:] = 0.0
            rate[:] = 0.0
            for i in range(modes):
                p0 = before[i]
                for j in range(count):
                    p0 -= contacts[j, i] * contact_n[j]
                p1 = modal_force[n, i]
                q1 = propagate[0, 0, i] * q[i] + propagate[0, 1, i] * v[i] + from_start[0, i] * p0 + from_end[0, i] * p1
                v1 = propagate[1, 0, i] * q[i] + propagate[1, 1, i] * v[i] + from_start[1, i] * p0 + from_end[1, i] * p1
                q[i] = q1
                v[i] = v1
                for j in range(count):
                    eta[j] += contacts[j, i] * q1
                    rate[j] += contacts[j, i] * v1
            for _ in range(60):
                change = 0.0
                for j in range(count):
                    e, r = eta[j], rate[j]
                    for k in range(count):
                        e -= reach[0, j, k] * end_force[k]
                        r -= reach[1, j, k] * end_force[k]
                    worn = laws[j, 6] * (first + n) * step_s
                    depth = max(e - laws[j, 1] - worn, 0.0) + min(e + laws[j, 0] + worn, 0.0)
                    f = (laws[j, 2] + laws[j, 4] * depth**2) * depth
                    f += laws[j, 3] * r * min(1.0, abs(depth) / DAMPING_DEPTH_M)
                    if laws[j, 5] != 0.0:
                        f += laws[j, 5] * np.tanh(r / FRICTION_SPEED_M_PER_S)
                    change = max(change, abs(f - end_force[j]))
                    end_force[j] = f
                if change <= TOLERANCE_N:
                    break
            for j in range(count):
                contact_n[j] = end_force[j]
                contact_force[j, n] = end_force[j]
            before = modal_force[n]
            for i in range(modes):
                p = 0.0
                for j in range(count):
                    p -= contacts[j, i] * end_force[j]
                q[i] += from_end[0, i] * p
                v[i] += from_end[1, i] * p
                p += before[i]
                coordinates[0, i, n] = q[i]
                coordinates[1, i, n] = v[i]
                coordinates[2, i, n] = p - omega[i] * (2.0 * zeta[i] * v[i] + omega[i] * q[i])
        return coordinates, contact_force

    return advance
