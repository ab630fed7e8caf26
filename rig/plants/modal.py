"""The assumed-mode model of the paper (equations 13 to 20), advanced by an exact linear propagator."""

from collections.abc import Iterator
from functools import cache
from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

from rig.beam import Beam
from rig.contact import DAMPING_DEPTH_M
from rig.description import Rig, Station, stations_of
from rig.errors import RigError
from rig.motion import Motion, Progress

BLOCK = 1 << 14
TOLERANCE_N = 1e-9


def simulate(
    rig: Rig, force_n: Float[np.ndarray, " samples"], step_s: float, progress: Progress, modes: int = 16
) -> Iterator[Motion]:
    """The motion from rest, with `modes` modes a beam (a mass has one).

    Every mode obeys q'' + 2 zeta omega q' + omega^2 q = p with the modal force
    p = phi(x_F) F - sum_j b_j f_j(eta_j, eta_j'), eta_j = b_j . q. Over a step p is taken as linear in time and the
    mode is advanced exactly; the contact forces at the end of the step are found by fixed-point iteration, so the only
    error, second order in the step, is that p bends within a step.

    Yields blocks of at most 2^14 samples. Raises RigError if a contact is too stiff for the step or the result is not
    finite.
    """
    model = _model(rig, step_s, modes)
    state = np.zeros((2, model["omega"].size))
    contact_n = np.zeros(len(rig.contacts))
    for first in range(0, len(force_n), BLOCK):
        force = force_n[first : first + BLOCK]
        previous = force_n[first - 1] if first else 0.0
        coordinates, contact_force = _compiled()(state, contact_n, previous, force, *model["kernel"])
        if not np.all(np.isfinite(coordinates)):
            raise RigError(
                f"the modal plant diverged near {first * step_s:.3f} s at step {step_s} s; use a smaller step"
            )
        progress(min(1.0, (first + len(force)) / len(force_n)))
        yield Motion(
            start_s=first * step_s,
            step_s=step_s,
            force_n=force,
            sensed=np.array([row @ coordinates[order] for row, order in model["sensors"]]).reshape(-1, len(force)),
            displacement_m=model["stations"] @ coordinates[0],
            eta_m=model["contacts"] @ coordinates[0],
            contact_force_n=contact_force,
        )


def mode_count(rig: Rig, modes: int) -> list[int]:
    return [modes if isinstance(body, Beam) else 1 for body in rig.bodies]


def shape_row(rig: Rig, station: Station, modes: int) -> Float[np.ndarray, " allmodes"]:
    """The shapes of all bodies' modes at a station; zero for the modes of the other bodies."""
    return np.concatenate(
        [
            body.shapes(np.array([station.position_m]), n)[0] if body.name == station.body else np.zeros(n)
            for body, n in zip(rig.bodies, mode_count(rig, modes), strict=True)
        ]
    )


def _model(rig: Rig, step_s: float, modes: int) -> dict[str, Any]:
    counts = mode_count(rig, modes)
    omega = 2 * np.pi * np.concatenate([b.frequencies_hz(n) for b, n in zip(rig.bodies, counts, strict=True)])
    zeta = np.concatenate([b.damping_ratios(n) for b, n in zip(rig.bodies, counts, strict=True)])
    propagate, from_start, from_end = _propagator(omega, zeta, step_s)
    contacts = np.array(
        [shape_row(rig, c.at, modes) - (shape_row(rig, c.against, modes) if c.against else 0) for c in rig.contacts]
    ).reshape(len(rig.contacts), omega.size)
    laws = np.array(
        [
            (c.law.lower_clearance_m, c.law.upper_clearance_m, c.law.stiffness_n_per_m, c.law.damping_n_s_per_m)
            for c in rig.contacts
        ]
    ).reshape(len(rig.contacts), 4)
    reach = np.stack([(contacts * from_end[k]) @ contacts.T for k in range(2)])  # end force -> -eta, -eta'
    loop = np.abs(reach[0]) @ laws[:, 2] + np.abs(reach[1]) @ laws[:, 3]
    if np.any(loop > 0.5):
        raise RigError(
            f"a contact is too stiff for the step of {step_s} s (loop gain {loop.max():.2g}); use a smaller step"
        )
    kernel = (propagate, from_start, from_end, shape_row(rig, rig.force_at, modes), contacts, laws, reach, omega, zeta)
    return {
        "omega": omega,
        "contacts": contacts,
        "kernel": tuple(np.ascontiguousarray(a) for a in kernel),
        "stations": np.array([shape_row(rig, s, modes) for s in stations_of(rig)]),
        "sensors": [
            (shape_row(rig, s.station, modes), ("displacement", "velocity", "acceleration").index(s.quantity))
            for s in rig.sensors
        ],
    }


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
        state, contact_n, previous_n, force, propagate, from_start, from_end, drive, contacts, laws, reach, omega, zeta
    ):
        samples, modes, count = force.size, omega.size, laws.shape[0]
        coordinates = np.empty((3, modes, samples))
        contact_force = np.empty((count, samples))
        q, v = state[0], state[1]
        eta, rate, end_force = np.empty(count), np.empty(count), contact_n.copy()
        before = previous_n
        for n in range(samples):
            eta[:] = 0.0
            rate[:] = 0.0
            for i in range(modes):
                p0 = drive[i] * before
                for j in range(count):
                    p0 -= contacts[j, i] * contact_n[j]
                p1 = drive[i] * force[n]
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
                    f = 0.0
                    depth = max(e - laws[j, 1], 0.0) + min(e + laws[j, 0], 0.0)
                    if depth != 0.0:
                        f = laws[j, 2] * depth + laws[j, 3] * r * min(1.0, abs(depth) / DAMPING_DEPTH_M)
                    change = max(change, abs(f - end_force[j]))
                    end_force[j] = f
                if change <= TOLERANCE_N:
                    break
            for j in range(count):
                contact_n[j] = end_force[j]
                contact_force[j, n] = end_force[j]
            before = force[n]
            for i in range(modes):
                p = 0.0
                for j in range(count):
                    p -= contacts[j, i] * end_force[j]
                q[i] += from_end[0, i] * p
                v[i] += from_end[1, i] * p
                p += drive[i] * before
                coordinates[0, i, n] = q[i]
                coordinates[1, i, n] = v[i]
                coordinates[2, i, n] = p - omega[i] * (2.0 * zeta[i] * v[i] + omega[i] * q[i])
        return coordinates, contact_force

    return advance
