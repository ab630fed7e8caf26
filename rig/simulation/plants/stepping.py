"""The compiled loop of the modal plant: modes advanced exactly, contact forces solved for at every step."""

from collections.abc import Callable
from typing import Any, no_type_check

import numba
import numpy as np
from jaxtyping import Float

from rig.simulation.plants.compiled_laws import FAST, force_n

TOLERANCE_N = 1e-9
REFRESH = 1e-4
"""How much the end forces must change, of the largest, for their bends within the step to be looked at again."""
FORCE, ETA, RATE, BEND = range(4)
"""The rows of `held` and of what becomes of it: force, eta and eta' of every contact, and the bend of the force."""


def _compiled(function: Callable[..., None]) -> Any:
    """Machine code, kept on disk where there is a place for it."""
    try:
        return numba.njit(cache=True, inline="always", **FAST)(function)
    except RuntimeError:  # neither this folder nor the user's can be written: compiled anew in every run
        return numba.njit(inline="always", **FAST)(function)


def within_a_step(step_s: float) -> Float[np.ndarray, "10 16"]:
    """Sixteen Gauss points: place and weight, then the weights of eta and eta' at both ends in eta, and in eta'."""
    points, weights = np.polynomial.legendre.leggauss(16)
    z, h = (points + 1) / 2, step_s
    value = [(1 - z) ** 2 * (1 + 2 * z), h * z * (1 - z) ** 2, z**2 * (3 - 2 * z), -h * z**2 * (1 - z)]
    slope = [-6 * z * (1 - z) / h, (1 - z) * (1 - 3 * z), 6 * z * (1 - z) / h, z * (3 * z - 2)]
    return np.array([z, weights / 2, *value, *slope])


@_compiled
@no_type_check  # numba compiles the plain functions only
def _touches(law, held, j, eta1, rate1, time_s, step_s):
    """True if there may be a force between two moments: the cubic between them stays within this of its ends."""
    apart = 0.15 * step_s * (abs(held[RATE, j]) + abs(rate1))
    worn = law.wear_m_per_s * (time_s - step_s)
    above = max(held[ETA, j], eta1) + apart > law.upper_clearance_m + worn
    below = min(held[ETA, j], eta1) - apart < -law.lower_clearance_m - worn
    return above or below or law.acts_in_the_gap != 0


@_compiled
@no_type_check
def _bend(law, j, old, new, time_s, step_s, within):
    """The mean of the force over the step that ends at a time, less that of the straight line between its ends."""
    eta0, rate0, eta1, rate1 = old[ETA, j], old[RATE, j], new[ETA, j], new[RATE, j]
    begin_s = time_s - step_s
    mean = 0.0
    for m in range(within.shape[1]):
        eta = within[2, m] * eta0 + within[3, m] * rate0 + within[4, m] * eta1 + within[5, m] * rate1
        rate = within[6, m] * eta0 + within[7, m] * rate0 + within[8, m] * eta1 + within[9, m] * rate1
        mean += within[1, m] * force_n(law, eta, rate, begin_s + within[0, m] * step_s)
    return mean - (old[FORCE, j] + new[FORCE, j]) / 2


@_compiled
@no_type_check
def _modes_alone(states, n, inputs, bends, propagate, driven, pushed, held):
    """Row n + 1 of the states under the known forces, and under the contact forces at the start of the step."""
    modes = propagate.shape[2]
    for i in range(modes):
        q, v = states[n, i], states[n, modes + i]
        states[n + 1, i] = propagate[0, 0, i] * q + propagate[0, 1, i] * v
        states[n + 1, modes + i] = propagate[1, 0, i] * q + propagate[1, 1, i] * v
    for k in range(inputs.shape[0]):
        start, end, bend = inputs[k, n], inputs[k, n + 1], bends[k, n]
        for i in range(2 * modes):
            states[n + 1, i] += driven[0, k, i] * start + driven[1, k, i] * end + driven[2, k, i] * bend
    for j in range(held.shape[1]):
        if held[FORCE, j] != 0.0:
            for i in range(2 * modes):
                states[n + 1, i] += pushed[0, j, i] * held[FORCE, j]


@_compiled
@no_type_check
def _sweep(new, eta, rate, reach, relief, laws, time_s):
    """Every end force from the others, its own part in eta solved for; returns the largest change and force."""
    change, largest = 0.0, 0.0
    for j in range(eta.size):
        e, r = eta[j], rate[j]
        for k in range(eta.size):
            e += reach[0, 0, j, k] * new[FORCE, k] + reach[1, 0, j, k] * new[BEND, k]
            r += reach[0, 1, j, k] * new[FORCE, k] + reach[1, 1, j, k] * new[BEND, k]
        force = force_n(laws[j], e, r, time_s)
        more = force - new[FORCE, j]
        if force != 0.0:
            more *= relief[j]
        new[FORCE, j] += more
        new[ETA, j], new[RATE, j] = e + reach[0, 0, j, j] * more, r + reach[0, 1, j, j] * more
        change, largest = max(change, abs(more)), max(largest, abs(force))
    return change, largest


@_compiled
@no_type_check
def _solve(held, new, eta, rate, touches, reach, relief, laws, time_s, step_s, within):
    """The forces at the end of a step and their bends, from eta and eta' as they would be without."""
    for iteration in range(60):
        change, largest = _sweep(new, eta, rate, reach, relief, laws, time_s)
        if iteration > 0 and change <= TOLERANCE_N:
            break
        if iteration == 0 or change > REFRESH * largest:
            for j in range(eta.size):
                if touches[j]:
                    new[BEND, j] = _bend(laws[j], j, held, new, time_s, step_s, within)


@_compiled
@no_type_check
def advance(
    states,
    held,
    forces,
    bent,
    inputs,
    bends,
    propagate,
    driven,
    across,
    pushed,
    reach,
    relief,
    laws,
    within,
    first,
    step_s,
):
    """Fills states (samples + 1, q and q' of every mode) from its first row on; forces and bent (contacts, samples).

    held (4, contacts) goes with the first row and is left as goes with the last. inputs and bends (inputs, samples + 1)
    are the known forces. propagate (2, 2, modes) advances a mode; driven, pushed (3, inputs or contacts, 2 modes) are
    what a force at the start and at the end of a step, and its bend, add to a state; reach (2, 2, contacts, contacts)
    what an end force and a bend add to every eta and eta'. relief is the share of a change that its own reach leaves;
    laws is the table of `compiled_laws`.
    """
    modes, contacts = across.shape[1], across.shape[0]
    new, eta, rate = np.empty(held.shape), np.empty(contacts), np.empty(contacts)
    touches = np.empty(contacts, dtype=np.bool_)
    for n in range(forces.shape[1]):
        time_s = (first + n) * step_s
        _modes_alone(states, n, inputs, bends, propagate, driven, pushed, held)
        touching = False
        for j in range(contacts):
            e, r = 0.0, 0.0
            for i in range(modes):
                e += across[j, i] * states[n + 1, i]
                r += across[j, i] * states[n + 1, modes + i]
            touches[j] = _touches(laws[j], held, j, e, r, time_s, step_s)
            touching |= touches[j]
            eta[j], rate[j] = e, r
            new[FORCE, j], new[ETA, j], new[RATE, j], new[BEND, j] = held[FORCE, j], e, r, 0.0
        if touching:
            _solve(held, new, eta, rate, touches, reach, relief, laws, time_s, step_s, within)
            for j in range(contacts):
                for i in range(2 * modes):
                    states[n + 1, i] += pushed[1, j, i] * new[FORCE, j] + pushed[2, j, i] * new[BEND, j]
        for j in range(contacts):
            forces[j, n], bent[j, n] = new[FORCE, j], new[BEND, j]
            for row in range(4):
                held[row, j] = new[row, j]
