"""Rollouts of a believed linear model with dead zones, over many windows at once: compiled, for output error."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
import scipy
from jaxtyping import Float

from scenarios.peers.peer_data import LinearModel

SWEEP_COUNT = 4
"""Fixed-point sweeps for the contact forces at the end of a step; each divides their error by the loop gain, ~20."""


class Stepper(NamedTuple):
    """Exact steps of the kept modes under forces that are straight lines over a step; the others follow statically."""

    propagate: Float[np.ndarray, "2 2 modes"]
    respond: Float[np.ndarray, "2 2 modes"]
    """Response of (q, q') to the modal force at both ends of the step."""
    force_row: Float[np.ndarray, " modes"]
    contact_rows: Float[np.ndarray, "contacts modes"]
    loop: Float[np.ndarray, "2 contacts contacts"]
    """Response of (eta, eta') to the contact forces at the end of the step."""
    static_eta_by_contact: Float[np.ndarray, "contacts contacts"]
    """Static compliance of the modes that are not kept, between contacts, m/N."""
    static_eta_by_force: Float[np.ndarray, " contacts"]
    output_by_state: Float[np.ndarray, "outputs states"]
    output_by_contact: Float[np.ndarray, "outputs contacts"]
    output_by_force: Float[np.ndarray, " outputs"]


def stepper(model: LinearModel, is_moving: Float[np.ndarray, " modes"], step_s: float, accelerations: bool) -> Stepper:
    """Stepper that keeps some modes (a mask); its outputs are the stations' accelerations or displacements."""
    omega, zeta = model.omega[is_moving], model.zeta[is_moving]
    augmented = np.zeros((omega.size, 4, 4))  # (q, q', p, dp/dt * step): p rises over the step by its last
    augmented[:, 0, 1] = step_s
    augmented[:, 1, :3] = np.stack([-(omega**2), -2 * zeta * omega, np.ones(omega.size)], axis=1) * step_s
    augmented[:, 2, 3] = 1
    advance = scipy.linalg.expm(augmented)
    start_response, slope_response = advance[:, :2, 2].T, advance[:, :2, 3].T
    respond = np.array([start_response - slope_response, slope_response])
    is_static = ~is_moving & (model.omega > 0)
    compliance = np.where(is_static, 1 / np.where(is_static, model.omega, 1) ** 2, 0)
    moving_rows, moving_contact_rows = model.sensor_rows[:, is_moving], model.contact_rows[:, is_moving]
    static_rows, static_contact_rows = model.sensor_rows * compliance, model.contact_rows * compliance
    if accelerations:
        by_state = np.hstack([-moving_rows * omega**2, -moving_rows * 2 * zeta * omega])
        by_contact, by_force = -moving_rows @ moving_contact_rows.T, moving_rows @ model.force_row[is_moving]
    else:
        by_state = np.hstack([moving_rows, 0 * moving_rows])
        by_contact, by_force = -static_rows @ model.contact_rows.T, static_rows @ model.force_row
    return Stepper(
        propagate=np.ascontiguousarray(np.moveaxis(advance[:, :2, :2], 0, -1)),
        respond=respond,
        force_row=np.ascontiguousarray(model.force_row[is_moving]),
        contact_rows=np.ascontiguousarray(moving_contact_rows),
        loop=-np.einsum("jm,xm,km->xjk", moving_contact_rows, respond[1], moving_contact_rows),
        static_eta_by_contact=-static_contact_rows @ model.contact_rows.T,
        static_eta_by_force=static_contact_rows @ model.force_row,
        output_by_state=by_state,
        output_by_contact=by_contact,
        output_by_force=by_force,
    )


def roll_out(
    system: Stepper,
    laws: Float[np.ndarray, "contacts 3"],
    starts: Float[np.ndarray, "windows states"],
    force_n: Float[np.ndarray, "windows times"],
    steps_per_output: int,
) -> Float[np.ndarray, "windows samples outputs"]:
    """Outputs at every so manyth step, from the start on; laws are clearance, stiffness and damping of each contact."""
    outputs = np.empty((len(starts), (force_n.shape[1] - 1) // steps_per_output + 1, len(system.output_by_state)))
    _roll(
        np.array(starts), np.ascontiguousarray(force_n), np.ascontiguousarray(laws), system, steps_per_output, outputs
    )
    return outputs


@numba.njit(cache=True, fastmath=True)
@no_type_check
def _roll(states, force_n, laws, system, steps_per_output, outputs):
    contact_count, mode_count = system.contact_rows.shape
    for w in range(states.shape[0]):
        q, v = states[w, :mode_count], states[w, mode_count:]
        contact_n, eta, rate = np.zeros(contact_count), np.zeros(contact_count), np.zeros(contact_count)
        for n in range(force_n.shape[1]):
            if n:
                _advance(q, v, force_n[w, n - 1], force_n[w, n], contact_n, system)
            for j in range(contact_count):
                eta[j] = system.static_eta_by_force[j] * force_n[w, n] + _product(system.contact_rows[j], q)
                rate[j] = _product(system.contact_rows[j], v)
            for _ in range(SWEEP_COUNT):
                _sweep(contact_n, eta, rate, laws, system, 1.0 if n else 0.0)
            for j in range(contact_count if n else 0):
                for i in range(mode_count):
                    q[i] -= system.contact_rows[j, i] * system.respond[1, 0, i] * contact_n[j]
                    v[i] -= system.contact_rows[j, i] * system.respond[1, 1, i] * contact_n[j]
            for o in range(outputs.shape[2] if n % steps_per_output == 0 else 0):
                outputs[w, n // steps_per_output, o] = (
                    system.output_by_force[o] * force_n[w, n]
                    + _product(system.output_by_state[o], states[w])
                    + _product(system.output_by_contact[o], contact_n)
                )


@numba.njit(cache=True, fastmath=True, inline="always")
@no_type_check
def _product(row, column):
    total = 0.0
    for i in range(row.size):
        total += row[i] * column[i]
    return total


@numba.njit(cache=True, fastmath=True, inline="always")
@no_type_check
def _advance(q, v, start_n, end_n, contact_n, system):
    """Step of all modes, without what the contact forces at its end do."""
    propagate, respond = system.propagate, system.respond
    for i in range(q.size):
        at_start = system.force_row[i] * start_n
        for j in range(contact_n.size):
            at_start -= system.contact_rows[j, i] * contact_n[j]
        at_end, q0, v0 = system.force_row[i] * end_n, q[i], v[i]
        q[i] = propagate[0, 0, i] * q0 + propagate[0, 1, i] * v0
        q[i] += respond[0, 0, i] * at_start + respond[1, 0, i] * at_end
        v[i] = propagate[1, 0, i] * q0 + propagate[1, 1, i] * v0
        v[i] += respond[0, 1, i] * at_start + respond[1, 1, i] * at_end


@numba.njit(cache=True, fastmath=True, inline="always")
@no_type_check
def _sweep(contact_n, eta, rate, laws, system, step_share):
    """Contact forces by their laws, each given the others; step_share is 0 at a window's start, else 1."""
    for j in range(contact_n.size):
        e, r = eta[j], rate[j]
        for k in range(contact_n.size):
            e += (system.static_eta_by_contact[j, k] + step_share * system.loop[0, j, k]) * contact_n[k]
            r += step_share * system.loop[1, j, k] * contact_n[k]
        depth = max(e - laws[j, 0], 0.0) + min(e + laws[j, 0], 0.0)
        target, force_slope = 0.0, 1.0
        if depth != 0.0:
            target = laws[j, 1] * depth + laws[j, 2] * r
            force_slope -= laws[j, 1] * (system.static_eta_by_contact[j, j] + step_share * system.loop[0, j, j])
            force_slope -= laws[j, 2] * step_share * system.loop[1, j, j]
        contact_n[j] += (target - contact_n[j]) / force_slope
