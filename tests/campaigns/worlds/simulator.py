"""Simulates a machine: modes of all bodies, links between them, known forces; block by block at 65536 Hz."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from rig.errors import RigError
from tests.campaigns.worlds.beams import modes_of
from tests.campaigns.worlds.laws import StopLaw, energy_j, force_of
from tests.campaigns.worlds.lumped import lumped_modes
from tests.campaigns.worlds.machine import Link, Machine, Place
from tests.campaigns.worlds.stepping import advance

STEP_S = 2.0**-16
BLOCK = 4096
TERMS = 40
FARTHEST_M = 0.25
"""A sensor that moves more than this is no longer on a rig of small deflections."""


@dataclass(frozen=True)
class Model:
    """Coordinates q with q'' + 2 zeta omega q' + omega^2 q = sum of gains times inputs - sum of rows times link forces.

    inputs: the exciting force, every tone, the static loads (together, at level 1), the acceleration of the ground. The
    frame moves with the ground. omega^2 falls by fall_per_s times the time.
    """

    omega: Float[np.ndarray, " coordinates"]
    zeta: Float[np.ndarray, " coordinates"]
    fall_per_s: Float[np.ndarray, " coordinates"]
    gains: Float[np.ndarray, "inputs coordinates"]
    rows: Float[np.ndarray, "links coordinates"]
    links: tuple[Link, ...]
    sensed: Float[np.ndarray, "sensors coordinates"]
    loaded: Float[np.ndarray, " coordinates"]

    def at(self, time_s: float) -> Float[np.ndarray, " coordinates"]:
        """omega at a time."""
        return self.omega * np.sqrt(1 - self.fall_per_s * max(time_s, 0.0))


@dataclass(frozen=True)
class SimulatedBlock:
    """Samples from start_s on: states (q, q'), forces of the links, accelerations at the sensors (absolute)."""

    start_s: float
    states: Float[np.ndarray, "samples 2 coordinates"]
    link_n: Float[np.ndarray, "samples links"]
    acceleration_m_per_s2: Float[np.ndarray, "sensors samples"]
    closed: Float[np.ndarray, " links"]


def model_of(machine: Machine) -> Model:
    """The machine's modes and what acts on them."""
    modes = {b.name: modes_of(b) for b in machine.beams} | {b.name: lumped_modes(b) for b in machine.lumped}
    names = [*modes, *(m.name for m in machine.masses)]
    sizes = [len(m.omega_rad_per_s) for m in modes.values()] + [1] * len(machine.masses)
    ends = np.cumsum(sizes)
    where = {name: slice(end - size, end) for name, end, size in zip(names, ends, sizes, strict=True)}
    roots = {m.name: np.sqrt(m.mass_kg) for m in machine.masses}

    def row(place: Place) -> Float[np.ndarray, " coordinates"]:
        values = np.zeros(ends[-1])
        own = modes[place.body].shapes(place.position_m) if place.body in modes else 1 / roots[place.body]
        values[where[place.body]] = own
        return values

    links = (*machine.contacts, *machine.links)
    rows = [row(link.at) - (row(link.against) if link.against else 0.0) for link in links]
    loaded = np.zeros(ends[-1]) + sum(force_n * row(place) for place, force_n in machine.loads)
    carried = np.concatenate([*(m.carried for m in modes.values()), list(roots.values())])
    gains = [row(machine.force_at), *(row(tone.at) for tone in machine.tones), loaded, -carried]
    falls = [np.full(len(modes[b.name].omega_rad_per_s), b.fall / b.fall_s) for b in machine.beams]
    none = np.zeros(len(machine.masses))
    steady = np.zeros(sum(len(b.masses_kg) for b in machine.lumped) + len(machine.masses))
    return Model(
        omega=np.concatenate([*(m.omega_rad_per_s for m in modes.values()), none]),
        zeta=np.concatenate([*(m.damping_ratio for m in modes.values()), none]),
        fall_per_s=np.concatenate([*falls, steady]),
        gains=np.array(gains),
        rows=np.array(rows).reshape(len(rows), ends[-1]),
        links=links,
        sensed=np.array([row(s.at) for s in machine.sensors]).reshape(len(machine.sensors), ends[-1]),
        loaded=loaded,
    )


def at_rest(model: Model, held_n: float = 0.0) -> Float[np.ndarray, " coordinates"]:
    """Where the machine rests under its static loads and the exciting force: the least of its energy.

    Raises RigError if there is none.
    """
    loaded = model.loaded + held_n * model.gains[0]
    if not loaded.any():
        return np.zeros(len(model.omega))
    table = np.array([link.law.row() for link in model.links])
    scale = 1 / np.sqrt(model.omega**2 + 100.0**2)

    def energy(y: Float[np.ndarray, " n"]) -> float:
        q = scale * y
        stored = sum(energy_j(link.law, float(x)) for link, x in zip(model.links, model.rows @ q, strict=True))
        return float((model.omega * q) @ (model.omega * q) / 2 - loaded @ q + stored)

    def parts(y: Float[np.ndarray, " n"]) -> Float[np.ndarray, "two links"]:
        etas = model.rows @ (scale * y)
        return np.array([force_of(law, x, 0.0, 0.0)[:2] for law, x in zip(table, etas, strict=True)]).reshape(-1, 2).T

    def gradient(y: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return scale * (model.omega**2 * scale * y - loaded + parts(y)[0] @ model.rows)

    def hessian(y: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        within = (model.rows.T * parts(y)[1]) @ model.rows
        return np.diag((model.omega * scale) ** 2) + scale[:, None] * within * scale

    guess = np.zeros(len(scale))
    options = {"gtol": 1e-9, "maxiter": 500, "initial_trust_radius": 0.3, "max_trust_radius": 3.0}
    found = minimize(energy, guess, jac=gradient, hess=hessian, method="trust-exact", options=options)
    if np.abs(gradient(found.x)).max() > 1e-5 * np.abs(scale * loaded).max():
        raise RigError(f"the machine does not come to rest under its loads ({found.message}); draw others")
    return np.asarray(scale * found.x)


def propagator(
    omega: Float[np.ndarray, " n"], zeta: Float[np.ndarray, " n"], step_s: float
) -> tuple[Float[np.ndarray, "4 n"], Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]]:
    """The exact step of q'' + 2 zeta omega q' + omega^2 q = p0 + (p1 - p0) t / h: from (q, q'), from p0 and from p1.

    By the power series of the solution over s = t / h, with x = omega h, which 40 terms hold to rounding for x < 5::

        q = sum a_n s^n,  (n + 1) (n + 2) a_(n+2) = h^2 p_n - 2 zeta x (n + 1) a_(n+1) - x^2 a_n

    Raises RigError for a step that is too long.
    """
    x = omega * step_s
    if x.max() > 5:  # beyond, such a mode's motion would alias into the recording's band
        raise RigError(f"a mode turns by {x.max():.1f} rad in a step of {step_s} s; give a shorter step, below 5 rad")

    def after(q: float, v: float, constant: float, ramp: float) -> Float[np.ndarray, "2 n"]:
        a = [np.full(x.size, q), np.full(x.size, v * step_s)]
        for n in range(TERMS):
            p = step_s**2 * (constant, ramp)[n] if n < 2 else 0.0
            a.append((p - 2 * zeta * x * (n + 1) * a[n + 1] - x**2 * a[n]) / ((n + 1) * (n + 2)))
        return np.array([np.sum(a, axis=0), np.arange(len(a)) @ np.array(a) / step_s])

    own = np.stack([after(1.0, 0.0, 0.0, 0.0), after(0.0, 1.0, 0.0, 0.0)], axis=1).reshape(4, x.size)
    return own, after(0.0, 0.0, 1.0, -1.0), after(0.0, 0.0, 0.0, 1.0)


def simulate(
    model: Model,
    inputs: Float[np.ndarray, "samples inputs"],
    start_s: float,
    step_s: float = STEP_S,
    initial: Float[np.ndarray, "2 coordinates"] | None = None,
) -> Iterator[SimulatedBlock]:
    """The motion from rest under the loads, or from an initial state, for every sample but the last.

    inputs are those of the `Model` in its order, one row a sample. Raises RigError if the forces of the links cannot be
    found or a sensor moves by more than 0.25 m.
    """
    laws = np.array([link.law.row() for link in model.links]).reshape(-1, len(StopLaw.__struct_fields__))
    state = np.array([at_rest(model), np.zeros(len(model.omega))]) if initial is None else initial.copy()
    begun = zip(laws, *(model.rows @ x for x in state), strict=True)
    held = np.array([force_of(law, eta, rate, start_s)[0] for law, eta, rate in begun], dtype=float)
    driven = np.concatenate([model.gains, model.rows])
    own, begin, end = propagator(model.omega, model.zeta, step_s)
    for first in range(0, len(inputs) - 1, BLOCK):
        now_s = start_s + first * step_s
        steps = min(BLOCK, len(inputs) - 1 - first)
        omega = model.at(now_s + steps / 2 * step_s)
        if model.fall_per_s.any():
            own, begin, end = propagator(omega, model.zeta, step_s)
        states, link_n = np.empty((steps, 2, len(omega))), np.empty((steps, len(laws)))
        closed = np.zeros(len(laws))
        known = np.ascontiguousarray(inputs[first : first + steps + 1])
        pushes = [driven[:, None] * x for x in (begin, end)]
        found = advance(own, *pushes, model.rows, laws, now_s, step_s, known, state, held, states, link_n, closed)
        if not (found and np.abs(model.sensed @ state[0]).max(initial=0.0) < FARTHEST_M):  # also of what is no number
            raise RigError(f"the machine's motion is lost at {now_s:.2f} s; draw a weaker effect")
        of_state = np.concatenate([-model.sensed * omega**2, -2 * model.sensed * model.zeta * omega], axis=1)
        pushed = model.sensed @ model.gains.T
        pushed[:, -1] += 1.0  # the ground carries the frame
        acceleration = (
            of_state @ states.reshape(steps, -1).T + pushed @ known[:-1].T - (model.sensed @ model.rows.T) @ link_n.T
        )
        yield SimulatedBlock(now_s, states, link_n, acceleration, closed)
