"""The compiled loop: every mode advanced exactly under forces that are straight lines within a step."""

from typing import no_type_check

import numpy as np

from scenarios.worlds.laws import compiled, depth_m, force_of

ITERATIONS = 80
TOLERANCE_N = 1e-10


@compiled
@no_type_check  # numba compiles the plain functions only
def advance(own, begin, end, rows, laws, time_s, step_s, inputs, state, held, states, forces, closed):
    """Advances `state` and `held` in place by the rows of `states`; whether all steps' forces were found.

    own (4, coordinates): q and v after a step from q and v before; begin, end (2, inputs + links, coordinates): what a
    unit force at the step's begin and end adds to q and to v; rows (links, coordinates); inputs (steps + 1, inputs);
    state (2, coordinates); held (links), the laws' forces now. states (steps, 2 coordinates) and forces (steps, links)
    take what is true at the begin of every step, closed (links) how many of them lie beyond a stop.

    The laws' forces at the step's end by Newton's method over the links' own flexibility: each new force is the old one
    plus the law's error over 1 + slope times flexibility.
    """
    steps, count, links, known = len(states), own.shape[1], len(rows), inputs.shape[1]
    eta, rate, force = np.empty(links), np.empty(links), np.empty(links)
    reach_eta, reach_rate = np.zeros((links, links)), np.zeros((links, links))
    for j in range(links):
        for k in range(links):
            for i in range(count):
                reach_eta[j, k] += rows[j, i] * end[0, known + k, i]
                reach_rate[j, k] += rows[j, i] * end[1, known + k, i]
    q, v = state[0], state[1]
    found = True
    for n in range(steps):
        for i in range(count):
            states[n, i] = q[i]
            states[n, count + i] = v[i]
        for i in range(count):
            old = q[i]
            q[i] = own[0, i] * old + own[1, i] * v[i]
            v[i] = own[2, i] * old + own[3, i] * v[i]
        for u in range(known):
            first, last = inputs[n, u], inputs[n + 1, u]
            for i in range(count):
                q[i] += begin[0, u, i] * first + end[0, u, i] * last
                v[i] += begin[1, u, i] * first + end[1, u, i] * last
        for j in range(links):
            forces[n, j] = held[j]
            first = held[j]
            if first != 0.0:
                for i in range(count):
                    q[i] -= begin[0, known + j, i] * first
                    v[i] -= begin[1, known + j, i] * first
        now_s = time_s + (n + 1) * step_s
        for j in range(links):
            a, b = 0.0, 0.0
            for i in range(count):
                a += rows[j, i] * q[i]
                b += rows[j, i] * v[i]
            eta[j], rate[j], force[j] = a, b, held[j]
        done = False
        for _ in range(ITERATIONS):
            worst = 0.0
            for j in range(links):
                a, b = eta[j], rate[j]
                for k in range(links):
                    a -= reach_eta[j, k] * force[k]
                    b -= reach_rate[j, k] * force[k]
                law_n, slope, viscous = force_of(laws[j], a, b, now_s)
                change = (law_n - force[j]) / (1.0 + slope * reach_eta[j, j] + viscous * reach_rate[j, j])
                force[j] += change
                worst = max(worst, abs(change))
            if worst < TOLERANCE_N:
                done = True
                break
        found = found and done
        for j in range(links):
            last = force[j]
            held[j] = last
            if last != 0.0:
                for i in range(count):
                    q[i] -= end[0, known + j, i] * last
                    v[i] -= end[1, known + j, i] * last
                a = eta[j]
                for k in range(links):
                    a -= reach_eta[j, k] * force[k]
                closed[j] += depth_m(laws[j], a, now_s) != 0.0
    return found
