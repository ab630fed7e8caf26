"""A machine of modes with stops, linear between changes of contact and solved there exactly (numpy, scipy, numba).

Modal coordinates q (mass-normalised), inputs u (forces, minus the ground's acceleration), stops j with relative
displacement eta_j = c_j q::

    q'' + 2 zeta w q' + w^2 q = B^T u - sum_j c_j f_j
    f_j = k (eta - d) + c eta'   for eta > d (upper stop);   k (eta + d) + c eta'   for eta < -d (lower stop);   else 0

Inputs are straight lines within a step. A step during which a stop opens or closes is halved until the moment of the
change is known to 2^-LEVELS of the step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

LEVELS = 12
OPEN_M = 1e3
"""A clearance that nothing crosses."""


@dataclass(frozen=True)
class TwoSidedStop:
    """Clearances to the lower and the upper stop (OPEN_M: none), m; stiffness, N/m; damping in contact, N s/m."""

    name: str
    row: Float[np.ndarray, " modes"]
    lower_m: float
    upper_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0


@dataclass(frozen=True)
class PiecewiseMachine:
    """inputs: what a unit of each input does to every modal coordinate."""

    omega_rad_per_s: Float[np.ndarray, " modes"]
    ratios: Float[np.ndarray, " modes"]
    inputs: Float[np.ndarray, "inputs modes"]
    stops: tuple[TwoSidedStop, ...]


@dataclass(frozen=True)
class Pickup:
    """What a channel follows: row q (order 0), row q' (1) or row q'' (2)."""

    row: Float[np.ndarray, " modes"]
    order: int


def motion(
    machine: PiecewiseMachine,
    pickups: Sequence[Pickup],
    inputs: Float[np.ndarray, "steps inputs"],
    step_s: float,
    displaced: Float[np.ndarray, " modes"] | None = None,
) -> tuple[Float[np.ndarray, "pickups steps"], Float[np.ndarray, " stops"]]:
    """What the pickups follow at every step, and the share of the time for which each stop is closed.

    From rest, or at standstill from displaced modal coordinates.
    """
    modes = machine.omega_rad_per_s.size
    stops = machine.stops
    states = list(product((-1, 0, 1), repeat=len(stops)))
    steps = [_propagators(machine, state, inputs.shape[1], step_s) for state in states]
    after, constant, by_value, by_slope = (np.ascontiguousarray([s[k] for s in steps]) for k in range(4))
    read, offset, through = _readings(machine, states, pickups)
    rows = np.array([s.row for s in stops]).reshape(-1, modes)
    limits = np.array([(s.lower_m, s.upper_m) for s in stops]).reshape(-1, 2)
    x = np.zeros(2 * modes)
    if displaced is not None:
        x[:modes] = displaced
    out = np.empty((len(inputs), len(pickups)))
    closed = np.zeros(len(stops))
    inputs = np.ascontiguousarray(inputs)
    _advance(after, constant, by_value, by_slope, read, offset, through, rows, limits, inputs, x, out, closed)
    return out.T, closed / len(inputs)


def static(machine: PiecewiseMachine, force: Float[np.ndarray, " inputs"]) -> Float[np.ndarray, " modes"]:
    """Modal coordinates at rest under steady inputs, every stop open; modes of frequency 0 stay where they are."""
    held = machine.omega_rad_per_s > 0
    return np.where(held, force @ machine.inputs / np.where(held, machine.omega_rad_per_s, 1.0) ** 2, 0.0)


def linear_rms_m(machine: PiecewiseMachine, stop: int, number: int, band_hz: tuple[float, float]) -> float:
    """Relative displacement of a stop (rms), were it open, under white noise of rms 1 in the band of one input."""
    frequency = np.geomspace(*band_hz, 4001)
    s = 2j * np.pi * frequency[:, None]
    w = machine.omega_rad_per_s
    response = (machine.stops[stop].row * machine.inputs[number] / (s**2 + 2 * machine.ratios * w * s + w**2)).sum(1)
    return float(np.sqrt(np.trapezoid(np.abs(response) ** 2, frequency) / (band_hz[1] - band_hz[0])))


def _closed_terms(
    machine: PiecewiseMachine, state: Sequence[int]
) -> tuple[Float[np.ndarray, "modes states"], Float[np.ndarray, " modes"]]:
    """q'' = system x + constant without inputs, in one combination of closed stops."""
    w = machine.omega_rad_per_s
    system = np.hstack([-np.diag(w**2), -np.diag(2 * machine.ratios * w)])
    constant = np.zeros(w.size)
    for side, stop in zip(state, machine.stops, strict=True):
        if side:
            pull = np.concatenate([stop.stiffness_n_per_m * stop.row, stop.damping_n_s_per_m * stop.row])
            system -= np.outer(stop.row, pull)
            constant += stop.row * stop.stiffness_n_per_m * (stop.upper_m if side > 0 else -stop.lower_m)
    return system, constant


def _propagators(
    machine: PiecewiseMachine, state: Sequence[int], inputs: int, step_s: float
) -> tuple[Float[np.ndarray, "levels states states"], ...]:
    """x after a step of step_s / 2^level: after x + constant + by_value u + by_slope (change of u over a step)."""
    system, constant = _closed_terms(machine, state)
    modes = constant.size
    size = 2 * modes + 1 + 2 * inputs  # x, 1, u, du/dt
    whole = np.zeros((size, size))
    whole[:modes, modes : 2 * modes] = np.eye(modes)
    whole[modes : 2 * modes, : 2 * modes] = system
    whole[modes : 2 * modes, 2 * modes] = constant
    whole[modes : 2 * modes, 2 * modes + 1 : 2 * modes + 1 + inputs] = machine.inputs.T
    whole[2 * modes + 1 : 2 * modes + 1 + inputs, 2 * modes + 1 + inputs :] = np.eye(inputs)
    powers = np.array([expm(whole * (step_s / 2**level))[: 2 * modes] for level in range(LEVELS + 1)])
    first = 2 * modes + 1
    return (
        powers[:, :, : 2 * modes],
        powers[:, :, 2 * modes],
        powers[:, :, first : first + inputs],
        powers[:, :, first + inputs :] / step_s,
    )


def _readings(
    machine: PiecewiseMachine, states: Sequence[Sequence[int]], pickups: Sequence[Pickup]
) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "pickups inputs"]]:
    """Pickups = read x + offset + through u, read and offset for each combination of closed stops."""
    modes = machine.omega_rad_per_s.size
    read = np.zeros((len(states), len(pickups), 2 * modes))
    offset = np.zeros((len(states), len(pickups)))
    through = np.zeros((len(pickups), len(machine.inputs)))
    for number, state in enumerate(states):
        system, constant = _closed_terms(machine, state)
        for k, pickup in enumerate(pickups):
            if pickup.order == 0:
                read[number, k, :modes] = pickup.row
            elif pickup.order == 1:
                read[number, k, modes:] = pickup.row
            else:
                read[number, k] = pickup.row @ system
                offset[number, k] = pickup.row @ constant
                through[k] = machine.inputs @ pickup.row
    return read, offset, through


@numba.njit(cache=True)
@no_type_check  # numba compiles the plain functions only
def _state_of(rows, limits, x):
    number = 0
    for j in range(len(rows)):
        eta = 0.0
        for i in range(rows.shape[1]):
            eta += rows[j, i] * x[i]
        side = 2 if eta > limits[j, 1] else 0 if eta < -limits[j, 0] else 1
        number = 3 * number + side
    return number


@numba.njit(cache=True)
@no_type_check
def _advance(after, constant, by_value, by_slope, read, offset, through, rows, limits, inputs, x, out, closed):
    levels = after.shape[1] - 1
    whole = 1 << levels
    known = inputs.shape[1]
    state = _state_of(rows, limits, x)
    for n in range(len(inputs)):
        out[n] = read[state] @ x + offset[state] + through @ inputs[n]
        code = state
        for j in range(len(rows) - 1, -1, -1):
            closed[j] += code % 3 != 1
            code //= 3
        if n + 1 == len(inputs):
            break
        change = inputs[n + 1] - inputs[n]
        place, level = 0, 0
        while place < whole:
            value = inputs[n] + change * (place / whole)
            end = after[state, level] @ x + constant[state, level]
            for u in range(known):
                end += by_value[state, level, :, u] * value[u] + by_slope[state, level, :, u] * change[u]
            reached = _state_of(rows, limits, end)
            if reached != state and level < levels:
                level += 1
                continue
            x[:] = end
            state = reached
            place += whole >> level
            while level > 0 and place % (whole >> (level - 1)) == 0:
                level -= 1
