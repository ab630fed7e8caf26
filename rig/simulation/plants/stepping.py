"""Compiled loop of the modal plant: modes advanced exactly, contact forces solved for at every step."""

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, no_type_check

import numba
import numpy as np
from jaxtyping import Float

from rig.files import is_writable_folder, user_cache_folder
from rig.simulation.plants.compiled_laws import ANNULAR_Y, ANNULAR_Z, NUMBA_OPTIONS, force_n, vector_force_n

FORCE_TOLERANCE_N = 1e-9
MAX_SWEEPS = 60
BEND_REFRESH_CHANGE = 1e-4
"""Relative change of the end forces beyond which their bends within the step are recomputed."""
FORCE, ETA, RATE, BEND = range(4)
"""Rows of a contact state: force, eta, eta' and bend of the force, for every contact."""


@cache
def _compiled_code_folder() -> Path | None:
    """NUMBA_CACHE_DIR or a folder of the user's cache; None where it cannot be written: numba would take this one."""
    if not numba.config.CACHE_DIR:
        return user_cache_folder()
    folder = Path(numba.config.CACHE_DIR)
    return folder if is_writable_folder(folder) else None


def _compiled(function: Callable[..., None]) -> Any:
    """Compile a function with numba; the compiled code is kept in the user's cache, or not at all."""
    not_kept = numba.njit(inline="always", **NUMBA_OPTIONS)(function)
    folder = _compiled_code_folder()
    if folder is None:
        return not_kept
    folder_of_all = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder)  # numba adds a name made of this file's path: installations share nothing
    try:
        kept = numba.njit(cache=True, inline="always", **NUMBA_OPTIONS)(function)
    finally:
        numba.config.CACHE_DIR = folder_of_all
    return kept if Path(kept.stats.cache_path).is_relative_to(folder) else not_kept


def gauss_points(step_s: float) -> Float[np.ndarray, "10 16"]:
    """Sixteen Gauss points of a step as columns.

    Rows: position and weight, then the weights of eta and eta' at both ends of the step in eta, and those in eta'.
    """
    legendre_points, legendre_weights = np.polynomial.legendre.leggauss(16)
    z, h = (legendre_points + 1) / 2, step_s
    eta_weights = [(1 - z) ** 2 * (1 + 2 * z), h * z * (1 - z) ** 2, z**2 * (3 - 2 * z), -h * z**2 * (1 - z)]
    rate_weights = [-6 * z * (1 - z) / h, (1 - z) * (1 - 3 * z), 6 * z * (1 - z) / h, z * (3 * z - 2)]
    return np.array([z, legendre_weights / 2, *eta_weights, *rate_weights])


@_compiled
@no_type_check  # numba compiles the plain functions only
def _may_touch(law, previous, j, eta1, rate1, time_s, step_s):
    """True if a contact may have a force within the step: the cubic eta(t) stays within a margin of its ends."""
    margin_m = 0.15 * step_s * (abs(previous[RATE, j]) + abs(rate1))
    wear_m = law.wear_m_per_s * (time_s - step_s)
    may_touch_upper = max(previous[ETA, j], eta1) + margin_m > law.upper_clearance_m + wear_m
    may_touch_lower = min(previous[ETA, j], eta1) - margin_m < -law.lower_clearance_m - wear_m
    return may_touch_upper or may_touch_lower or law.acts_in_the_gap != 0


@_compiled
@no_type_check
def _may_touch_ring(law, previous, j, eta, rate, time_s, step_s):
    """True if an annular contact of rows j and j + 1 may have a force within the step, as `_may_touch`."""
    y0, z0 = previous[ETA, j] - law.center_y_m, previous[ETA, j + 1] - law.center_z_m
    y1, z1 = eta[0] - law.center_y_m, eta[1] - law.center_z_m
    speed = math.hypot(previous[RATE, j], previous[RATE, j + 1]) + math.hypot(rate[0], rate[1])
    reach_m = math.sqrt(max(y0 * y0 + z0 * z0, y1 * y1 + z1 * z1)) + 0.15 * step_s * speed
    return reach_m > law.clearance_m + law.wear_m_per_s * (time_s - step_s)


@_compiled
@no_type_check
def _relax_ring_bends(law, j, previous, current, time_s, step_s, gauss, relaxation):
    """Move the bends of rows j and j + 1, the components of an annular contact's force, by a share to those due."""
    start_s, i = time_s - step_s, j + 1
    mean_force_y, mean_force_z = 0.0, 0.0
    for m in range(gauss.shape[1]):
        a, b, c, d = gauss[2, m], gauss[3, m], gauss[4, m], gauss[5, m]
        y = a * previous[ETA, j] + b * previous[RATE, j] + c * current[ETA, j] + d * current[RATE, j]
        z = a * previous[ETA, i] + b * previous[RATE, i] + c * current[ETA, i] + d * current[RATE, i]
        a, b, c, d = gauss[6, m], gauss[7, m], gauss[8, m], gauss[9, m]
        y_rate = a * previous[ETA, j] + b * previous[RATE, j] + c * current[ETA, j] + d * current[RATE, j]
        z_rate = a * previous[ETA, i] + b * previous[RATE, i] + c * current[ETA, i] + d * current[RATE, i]
        force_y, force_z = vector_force_n(law, (y, z), (y_rate, z_rate), start_s + gauss[0, m] * step_s)
        mean_force_y += gauss[1, m] * force_y
        mean_force_z += gauss[1, m] * force_z
    current[BEND, j] += relaxation * (mean_force_y - (previous[FORCE, j] + current[FORCE, j]) / 2 - current[BEND, j])
    current[BEND, i] += relaxation * (mean_force_z - (previous[FORCE, i] + current[FORCE, i]) / 2 - current[BEND, i])


@_compiled
@no_type_check
def _ring_force_increments(law, j, gain, eta, rate, excess):
    """Changes of an annular contact's force that leave no excess (force of the law less that of before).

    The self-response is solved for, with the slopes k and c of the law along its normal n, to which friction adds
    mu tanh along t, and of the friction the mean of tangent and secant through zero, so that it does not overshoot.
    """
    i, y, z = j + 1, eta[0] - law.center_y_m, eta[1] - law.center_z_m
    radius_m = math.sqrt(y * y + z * z) + 1e-150
    y, z = y / radius_m, z / radius_m
    sliding = (rate[1] * y - rate[0] * z) / law.sliding_speed_m_per_s
    friction = law.friction_coefficient * math.tanh(sliding)
    friction_slope = law.friction_coefficient
    if abs(friction) > 1e-6 * friction_slope:
        friction_slope = (friction / sliding + friction_slope - friction * friction / friction_slope) / 2
    friction_slope *= law.stiffness_n_per_m * max(radius_m - law.clearance_m, 0.0) / law.sliding_speed_m_per_s
    k, c = law.stiffness_n_per_m, law.damping_n_s_per_m
    push_y = (gain[0, 0, j, j] * k + gain[0, 1, j, j] * c) * (y - friction * z)
    push_z = (gain[0, 0, i, i] * k + gain[0, 1, i, i] * c) * (z + friction * y)
    rub_y, rub_z = gain[0, 1, j, j] * friction_slope * z, gain[0, 1, i, i] * friction_slope * y
    yy, yz = 1.0 - push_y * y - rub_y * z, -push_y * z + rub_y * y
    zy, zz = -push_z * y + rub_z * z, 1.0 - push_z * z - rub_z * y
    determinant = yy * zz - yz * zy
    return (zz * excess[0] - yz * excess[1]) / determinant, (yy * excess[1] - zy * excess[0]) / determinant


@_compiled
@no_type_check
def _force_mean_excess_over_chord(law, j, previous, current, time_s, step_s, gauss):
    """Bend of a contact force: its mean over the step that ends at time_s less that of the line between its ends."""
    eta0, rate0, eta1, rate1 = (previous[ETA, j], previous[RATE, j], current[ETA, j], current[RATE, j])
    start_s = time_s - step_s
    mean_force = 0.0
    for m in range(gauss.shape[1]):
        eta = gauss[2, m] * eta0 + gauss[3, m] * rate0 + gauss[4, m] * eta1 + gauss[5, m] * rate1
        rate = gauss[6, m] * eta0 + gauss[7, m] * rate0 + gauss[8, m] * eta1 + gauss[9, m] * rate1
        mean_force += gauss[1, m] * force_n(law, eta, rate, start_s + gauss[0, m] * step_s)
    return mean_force - (previous[FORCE, j] + current[FORCE, j]) / 2


@_compiled
@no_type_check
def _advance_modes(states, step, inputs, bends, propagator, state_by_input, state_by_contact_force, contact_state):
    """Compute row step + 1 of the states from the known inputs and the contact forces at the start of the step."""
    mode_count = propagator.shape[2]
    for i in range(mode_count):
        displacement, velocity = states[step, i], states[step, mode_count + i]
        states[step + 1, i] = propagator[0, 0, i] * displacement + propagator[0, 1, i] * velocity
        states[step + 1, mode_count + i] = propagator[1, 0, i] * displacement + propagator[1, 1, i] * velocity
    for k in range(inputs.shape[0]):
        at_start, at_end, bend = inputs[k, step], inputs[k, step + 1], bends[k, step]
        for i in range(2 * mode_count):
            states[step + 1, i] += (
                state_by_input[0, k, i] * at_start + state_by_input[1, k, i] * at_end + state_by_input[2, k, i] * bend
            )
    for j in range(contact_state.shape[1]):
        if contact_state[FORCE, j] != 0.0:
            for i in range(2 * mode_count):
                states[step + 1, i] += state_by_contact_force[0, j, i] * contact_state[FORCE, j]


@_compiled
@no_type_check
def _sweep_forces(current, eta, rate, gain, increment_factors, laws, time_s, has_annular):
    """Update every end force given the others, with its self-response solved for; return largest change and force."""
    max_change, max_force = 0.0, 0.0
    for j in range(eta.size):
        if has_annular is not None and laws[j].kind == ANNULAR_Z:
            continue
        eta_j, rate_j = eta[j], rate[j]
        for k in range(eta.size):
            eta_j += gain[0, 0, j, k] * current[FORCE, k] + gain[1, 0, j, k] * current[BEND, k]
            rate_j += gain[0, 1, j, k] * current[FORCE, k] + gain[1, 1, j, k] * current[BEND, k]
        if has_annular is not None and laws[j].kind == ANNULAR_Y:
            z_row = j + 1
            second_eta, second_rate = eta[z_row], rate[z_row]
            for k in range(eta.size):
                second_eta += gain[0, 0, z_row, k] * current[FORCE, k] + gain[1, 0, z_row, k] * current[BEND, k]
                second_rate += gain[0, 1, z_row, k] * current[FORCE, k] + gain[1, 1, z_row, k] * current[BEND, k]
            law_force, second_force = vector_force_n(laws[j], (eta_j, second_eta), (rate_j, second_rate), time_s)
            force_increment, second_increment = law_force - current[FORCE, j], second_force - current[FORCE, z_row]
            if law_force != 0.0 or second_force != 0.0:
                force_increment, second_increment = _ring_force_increments(
                    laws[j], j, gain, (eta_j, second_eta), (rate_j, second_rate), (force_increment, second_increment)
                )
            current[FORCE, j] += force_increment
            current[FORCE, z_row] += second_increment
            current[ETA, j], current[RATE, j] = (
                eta_j + gain[0, 0, j, j] * force_increment,
                rate_j + gain[0, 1, j, j] * force_increment,
            )
            current[ETA, z_row], current[RATE, z_row] = (
                second_eta + gain[0, 0, z_row, z_row] * second_increment,
                second_rate + gain[0, 1, z_row, z_row] * second_increment,
            )
            max_change = max(max_change, abs(force_increment), abs(second_increment))
            max_force = max(max_force, abs(law_force), abs(second_force))
            continue
        law_force = force_n(laws[j], eta_j, rate_j, time_s)
        force_increment = law_force - current[FORCE, j]
        if law_force != 0.0:
            force_increment *= increment_factors[j]
        current[FORCE, j] += force_increment
        current[ETA, j], current[RATE, j] = (
            eta_j + gain[0, 0, j, j] * force_increment,
            rate_j + gain[0, 1, j, j] * force_increment,
        )
        max_change, max_force = max(max_change, abs(force_increment)), max(max_force, abs(law_force))
    return max_change, max_force


@_compiled
@no_type_check
def _solve_contact_forces(
    previous, current, eta, rate, may_touch, gain, increment_factors, laws, time_s, step_s, gauss, has_annular
):
    """Solve for the contact forces at the end of a step and their bends, from eta and eta' without them."""
    for iteration in range(MAX_SWEEPS):
        max_change, max_force = _sweep_forces(current, eta, rate, gain, increment_factors, laws, time_s, has_annular)
        if iteration > 0 and max_change <= FORCE_TOLERANCE_N:
            break
        if has_annular is not None and iteration == MAX_SWEEPS - 1 and max_change > 1e-6 * max_force:
            current[FORCE, 0] = np.nan  # not solved: the run ends
        if iteration == 0 or max_change > BEND_REFRESH_CHANGE * max_force:
            for j in range(eta.size):
                if has_annular is not None and laws[j].kind < 0:
                    if may_touch[j] and laws[j].kind == ANNULAR_Y:
                        relaxation = 1.0 if iteration < 6 else 0.5  # a bend that swings about its end would go on
                        _relax_ring_bends(laws[j], j, previous, current, time_s, step_s, gauss, relaxation)
                elif may_touch[j]:
                    current[BEND, j] = _force_mean_excess_over_chord(
                        laws[j], j, previous, current, time_s, step_s, gauss
                    )


@_compiled
@no_type_check
def advance(
    states,
    contact_state,
    contact_forces,
    contact_bends,
    inputs,
    input_bends,
    propagator,
    state_by_input,
    eta_rows,
    state_by_contact_force,
    gain,
    increment_factors,
    laws,
    gauss,
    has_annular,
    first_step,
    step_s,
):
    """Fill states (samples + 1, q and q' of all modes) from row 0, contact_forces, contact_bends (contacts, samples).

    contact_state (4, contacts) belongs to the first row and is updated to the last. inputs and input_bends
    (inputs, samples + 1) are the known forces. propagator (2, 2, modes) advances a mode; state_by_input and
    state_by_contact_force (3, inputs or contacts, 2 modes) are the contributions to a state of a force at the start and
    at the end of a step, and of its bend; gain (2, 2, contacts, contacts) those of an end force and a bend to every
    eta and eta'. increment_factors are the shares of a change that its own gain leaves; laws is the table of
    `compiled_laws`. has_annular is None for rigs without annular contacts, for which the loop is compiled by itself.
    """
    mode_count, contact_count = eta_rows.shape[1], eta_rows.shape[0]
    current, eta, rate = np.empty(contact_state.shape), np.empty(contact_count), np.empty(contact_count)
    may_touch = np.empty(contact_count, dtype=np.bool_)
    for step in range(contact_forces.shape[1]):
        time_s = (first_step + step) * step_s
        _advance_modes(
            states, step, inputs, input_bends, propagator, state_by_input, state_by_contact_force, contact_state
        )
        any_may_touch = False
        for j in range(contact_count):
            eta_j, rate_j = 0.0, 0.0
            for i in range(mode_count):
                eta_j += eta_rows[j, i] * states[step + 1, i]
                rate_j += eta_rows[j, i] * states[step + 1, mode_count + i]
            eta[j], rate[j] = eta_j, rate_j
            if has_annular is not None and laws[j].kind < 0:
                may_touch[j] = laws[j].kind == ANNULAR_Z and _may_touch_ring(
                    laws[j], contact_state, j - 1, (eta[j - 1], eta_j), (rate[j - 1], rate_j), time_s, step_s
                )
                may_touch[j - 1] |= may_touch[j]
            else:
                may_touch[j] = _may_touch(laws[j], contact_state, j, eta_j, rate_j, time_s, step_s)
            any_may_touch |= may_touch[j]
            current[FORCE, j], current[ETA, j], current[RATE, j], current[BEND, j] = (
                contact_state[FORCE, j],
                eta_j,
                rate_j,
                0.0,
            )
        if any_may_touch:
            _solve_contact_forces(
                contact_state,
                current,
                eta,
                rate,
                may_touch,
                gain,
                increment_factors,
                laws,
                time_s,
                step_s,
                gauss,
                has_annular,
            )
            for j in range(contact_count):
                for i in range(2 * mode_count):
                    states[step + 1, i] += (
                        state_by_contact_force[1, j, i] * current[FORCE, j]
                        + state_by_contact_force[2, j, i] * current[BEND, j]
                    )
        for j in range(contact_count):
            contact_forces[j, step], contact_bends[j, step] = current[FORCE, j], current[BEND, j]
            for row in range(4):
                contact_state[row, j] = current[row, j]
