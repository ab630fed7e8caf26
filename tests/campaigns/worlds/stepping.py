"""The compiled loop: every mode advanced exactly under forces that are straight lines within a step."""

from typing import no_type_check

import numpy as np

from tests.campaigns.worlds.laws import compiled, depth_m, force_of

ITERATIONS = 80
TOLERANCE_N = 1e-10


@compiled
@no_type_check  # numba compiles the plain functions only
def _push(state, unit, force):
    """Adds to q and v what a force does that adds `unit` (2, coordinates) at 1 N."""
    for i in range(state.shape[1]):
        state[0, i] += unit[0, i] * force
        state[1, i] += unit[1, i] * force


@compiled
@no_type_check
def _free(own, state):
    """A step without forces."""
    for i in range(state.shape[1]):
        q, v = state[0, i], state[1, i]
        state[0, i] = own[0, i] * q + own[1, i] * v
        state[1, i] = own[2, i] * q + own[3, i] * v


@compiled
@no_type_check
def _reach(rows, end):
    """eta and eta' of every link (first index) by a unit force of every link at the step's end."""
    links = len(rows)
    reach = np.zeros((2, links, links))
    for j in range(links):
        for k in range(links):
            for i in range(rows.shape[1]):
                reach[0, j, k] += rows[j, i] * end[k, 0, i]
                reach[1, j, k] += rows[j, i] * end[k, 1, i]
    return reach


@compiled
@no_type_check
def _solve(laws, eta, rate, reach, time_s, force):
    """Finds the links' forces at the step's end in place, from eta and rate without them; whether they were found.

    Newton's method over each link's own flexibility: a force changes by the law's error over 1 + slope times reach.
    """
    for _ in range(ITERATIONS):
        worst = 0.0
        for j in range(len(force)):
            a, b = eta[j], rate[j]
            for k in range(len(force)):
                a -= reach[0, j, k] * force[k]
                b -= reach[1, j, k] * force[k]
            law_n, slope, viscous = force_of(laws[j], a, b, time_s)
            change = (law_n - force[j]) / (1.0 + slope * reach[0, j, j] + viscous * reach[1, j, j])
            force[j] += change
            worst = max(worst, abs(change))
        if worst < TOLERANCE_N:
            return True
    return False


@compiled
@no_type_check
def advance(own, begin, end, rows, laws, time_s, step_s, inputs, state, held, states, forces, closed):
    """Advances `state` and `held` in place by the rows of `states`; whether all steps' forces were found.

    own (4, coordinates): q and v after a step from q and v before; begin, end (inputs + links, 2, coordinates): what a
    unit force at the step's begin and end adds to q and v; rows (links, coordinates); inputs (steps + 1, inputs);
    state (2, coordinates); held (links), the laws' forces now. states (steps, 2, coordinates) and forces (steps, links)
    take what is true at the begin of every step, closed (links) how many of them lie beyond a stop.
    """
    links, known = len(rows), inputs.shape[1]
    reach = _reach(rows, end[known:])
    eta, rate = np.empty(links), np.empty(links)
    found = True
    for n in range(len(states)):
        states[n] = state
        forces[n] = held
        _free(own, state)
        for u in range(known):
            _push(state, begin[u], inputs[n, u])
            _push(state, end[u], inputs[n + 1, u])
        for j in range(links):
            if held[j] != 0.0:
                _push(state, begin[known + j], -held[j])
        now_s = time_s + (n + 1) * step_s
        for j in range(links):
            eta[j], rate[j] = 0.0, 0.0
            for i in range(rows.shape[1]):
                eta[j] += rows[j, i] * state[0, i]
                rate[j] += rows[j, i] * state[1, i]
        found = _solve(laws, eta, rate, reach, now_s, held) and found
        for j in range(links):
            if held[j] != 0.0:
                _push(state, end[known + j], -held[j])
            for k in range(links):
                eta[j] -= reach[0, j, k] * held[k]
            closed[j] += depth_m(laws[j], eta[j], now_s) != 0.0
    return found
