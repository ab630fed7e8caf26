"""The assumed-mode model of the paper (equations 13 to 20), advanced by an exact linear propagator."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError
from rig.model.contact_laws import ContactLaw
from rig.model.description import Body, Rig, Sensor, Station, contact_stations, stations_of
from rig.model.modes import Modes, modes_of, modes_wanted, participation
from rig.simulation.motion import Forces, ForceSignal, Motion, Progress, Projected, forces_of
from rig.simulation.plants.loading import (
    base_motion,
    check_softening,
    connections,
    equilibrium,
    softening_limits_m,
    true_force,
)

BLOCK = 1 << 13
BENT = 8
"""So many samples to either side decide how a force bends within a step, and more."""


@dataclass(frozen=True)
class Model:
    """Modes of all bodies, the shapes at every station, what acts on them, and where they rest.

    sensed are the sensors' measurement operators over the modal coordinates, gains the modal forces per unit of each
    known force: the exciting forces, static loads, the base, tones.
    """

    omega: Float[np.ndarray, " modes"]
    zeta: Float[np.ndarray, " modes"]
    rows: dict[Station, Float[np.ndarray, " modes"]]
    sensed: Float[np.ndarray, "sensors modes"]
    across: Float[np.ndarray, "contacts modes"]
    laws: tuple[ContactLaw, ...]
    gains: Float[np.ndarray, "inputs modes"]
    at_rest: Float[np.ndarray, " modes"]
    holding_n: Float[np.ndarray, " contacts"]

    def start(self) -> tuple[Float[np.ndarray, " states"], Float[np.ndarray, "4 contacts"]]:
        """The state of rest, and what `advance` holds of the contacts."""
        none = np.zeros(len(self.across))
        held = np.stack([self.holding_n, self.across @ self.at_rest, none, none])
        return np.append(self.at_rest, np.zeros(self.omega.size)), held


def simulate(rig: Rig, force_n: ForceSignal, step_s: float, progress: Progress, modes: int = 16) -> Iterator[Motion]:
    """The motion from rest, with `modes` modes a beam (a mass has one, a structure no more than its basis).

    The modes are those of the bodies with what is attached to them, in a frame that moves with the base. Every mode
    obeys q'' + 2 zeta omega q' + omega^2 q = p with the modal force p = phi(x_F) F + p_static - g a_base -
    sum_j b_j f_j(eta_j, eta_j', t), eta_j = b_j . q, over contacts, cubic springs and dampers; tones join F.

    Over a step each force is a straight line between its ends plus a parabola that vanishes there, and every mode is
    advanced exactly. The parabola gives the force its true mean: for F and a_base that of a smooth curve through the
    samples; for a contact that of its law along the cubic eta(t) that fits eta and eta' at both ends, so that a stop
    met within a step costs no accuracy. The contact forces are found by fixed-point iteration.

    Yields blocks of at most 2^13 samples. Raises RigError if a contact is too stiff for the step, a softening
    spring lets go, or the result is not finite.
    """
    from rig.simulation.plants.stepping import advance  # numba only where something is simulated

    limits_m, forces_n = softening_limits_m(rig), forces_of(rig, force_n)
    base = base_motion(rig, len(force_n), step_s)
    model, measured = model_of(rig, bool(base), modes), [s.measures for s in rig.sensors]
    constants = constants_of(model, step_s)
    shapes = np.array([model.rows[s] for s in stations_of(rig)]).reshape(-1, model.omega.size)
    last, held = model.start()
    history_n, history_bent_n = np.tile(model.holding_n[:, None], 4), np.zeros((len(model.across), 1))
    for first in range(0, len(force_n), BLOCK):
        now = slice(first, min(first + BLOCK, len(force_n)))
        applied, bends = applied_inputs(rig, forces_n, base, step_s, now)
        contact_n, bent_n = np.empty((2, len(model.across), now.stop - first))
        states = np.empty((now.stop - first + 1, last.size))  # a new array a block: Motion computes from it on demand
        states[0] = last
        advance(states, held, contact_n, bent_n, applied, bends, *constants, first, step_s)
        moved, last = states[1:], states[-1]
        if not np.all(np.isfinite(last)):  # what is not finite stays so
            raise RigError(
                f"the modal plant diverged near {first * step_s:.3f} s at step {step_s} s; use a smaller step"
            )
        check_softening(limits_m, model.across @ moved[:, : model.omega.size].T)
        progress(now.stop / len(force_n))
        history_n = np.concatenate([history_n[:, -4:], contact_n], axis=1)
        history_bent_n = np.concatenate([history_bent_n[:, -1:], bent_n], axis=1)
        heard_n = _without_alias(history_n, history_bent_n)
        sensed = observed(rig, model, moved, applied[:, 1:], heard_n)
        if base:
            sensed += np.array([base[m.order][now] * m.translates for m in measured]).reshape(sensed.shape)
        coordinates = moved[:, : model.omega.size]
        yield Motion(
            start_s=first * step_s,
            step_s=step_s,
            forces_n=forces_n[now],
            sensed=sensed,
            displacement_m=Projected(shapes, coordinates, base[0][now] if base else None),
            eta_m=Projected(model.across[: len(rig.contacts)], coordinates),
            contact_force_n=contact_n[: len(rig.contacts)],
        )


def observed(
    rig: Rig,
    model: Model,
    states: Float[np.ndarray, "samples states"],
    applied: Float[np.ndarray, "inputs samples"],
    contact_n: Float[np.ndarray, "all samples"],
) -> Float[np.ndarray, "sensors samples"]:
    """Signals that the sensors see of the modes, relative to the base."""
    size = model.omega.size
    sensed = np.empty((len(rig.sensors), len(states)))
    first = 0
    for order, alike in groupby(rig.sensors, lambda s: s.measures.order):
        rows = model.sensed[first : first + len(list(alike))]
        into = sensed[first : first + len(rows)]
        first += len(rows)
        if order < 2:
            np.matmul(rows, states[:, order * size : (order + 1) * size].T, out=into)
        else:
            own = np.concatenate([-(model.omega**2) * rows, -2 * model.zeta * model.omega * rows], axis=1)
            pushed = np.concatenate([rows @ model.gains.T, -rows @ model.across.T], axis=1)
            np.matmul(own, states.T, out=into)
            into += pushed @ np.concatenate([applied, contact_n])
    return sensed


def _without_alias(
    history_n: Float[np.ndarray, "contacts longer"], bent_n: Float[np.ndarray, "contacts long"]
) -> Float[np.ndarray, "contacts samples"]:
    """Contact forces whose samples give the true impulse when added up, as the samples of a force with corners do not.

    Accelerometers hear these: else each closure would leave an error in the velocity. What the bend of a step has more
    than a smooth force would (-f'' h^2 / 12, from the samples before) is moved to the samples after it, about the
    middle of the step. Begins with four more samples of the forces, and one more bend.
    """
    second = np.diff(history_n, n=2)
    corner = bent_n + (3 * second[:, 1:] - second[:, :-1]) / 24
    return history_n[:, 4:] + 1.5 * corner[:, 1:] - 0.5 * corner[:, :-1]


def bodies_of(rig: Rig, modes: int) -> list[tuple[Body, Modes, int]]:
    """The bodies with their modes in this rig, and how many of them are taken."""
    return [(b, modes_of(rig, b), modes_wanted(b, modes)) for b in rig.bodies]


def model_of(rig: Rig, moving_base: bool, modes: int) -> Model:
    """The rig with what acts on it."""
    bodies = bodies_of(rig, modes)
    omega = 2 * np.pi * np.concatenate([shapes.frequencies_hz(n) for _, shapes, n in bodies])
    zeta = np.concatenate([shapes.damping_ratios(n) for _, shapes, n in bodies])
    contacts, laws = connections(rig), tuple(c.law for c in connections(rig))
    wanted = {*stations_of(rig), *rig.forces, *(load.station for load in rig.loads)}
    wanted |= {tone.station for tone in rig.tones}
    wanted |= {station for c in contacts for station in contact_stations(c)}
    rows = {station: shape_row(bodies, station) for station in wanted}
    across = np.array([rows[c.at] - (rows[c.against] if c.against else 0) for c in contacts])
    across = across.reshape(len(contacts), omega.size)
    static = np.zeros(omega.size) + sum(load.force_n * rows[load.station] for load in rig.loads)
    at_rest = equilibrium(omega**2, across, laws, static)
    holding = [float(law.force_n(eta)) for law, eta in zip(laws, across @ at_rest, strict=True)]
    gains = [rows[station] for station in rig.forces]
    if rig.loads:
        gains.append(static)
    if moving_base:
        gains.append(-np.concatenate([participation(rig, body, shapes, n) for body, shapes, n in bodies]))
    gains += [rows[tone.station] for tone in rig.tones]
    return Model(
        omega=omega,
        zeta=zeta,
        rows=rows,
        sensed=np.array([_sensed_row(rig, bodies, s) for s in rig.sensors]).reshape(-1, omega.size),
        across=across,
        laws=laws,
        gains=np.array(gains),
        at_rest=at_rest,
        holding_n=np.array(holding, dtype=float),
    )


def applied_inputs(
    rig: Rig, forces_n: Forces, base: tuple[Float[np.ndarray, " samples"], ...], step_s: float, now: slice
) -> tuple[Float[np.ndarray, "inputs more"], Float[np.ndarray, "inputs more"]]:
    """The known forces at the samples `now` and at the one before, and how they bend in between.

    Before the first sample is the state of rest: no force, all static loads, no motion of the base.
    """
    around = slice(max(0, now.start - BENT), min(len(forces_n), now.stop + BENT))
    rest = int(around.start == 0)
    rows = [np.append(np.zeros(rest), true_force(rig, one, step_s, around)) for one in forces_n.signals]
    if rig.loads:
        rows.append(np.ones(rows[0].size))
    if base:
        rows.append(np.append(np.zeros(rest), base[2][around]))
    time_s = np.arange(around.start - rest, around.stop) * step_s
    rows += [tone.force_n(time_s) for tone in rig.tones]
    inputs = np.array(rows)
    begin = now.start - around.start - 1 + rest
    some = slice(begin, begin + now.stop - now.start + 1)
    return np.ascontiguousarray(inputs[:, some]), np.ascontiguousarray(_bends(inputs)[:, some])


def constants_of(model: Model, step_s: float) -> tuple[Any, ...]:
    """Constants that `stepping.advance` takes of a model; raises RigError if a contact is too stiff for the step."""
    from rig.simulation.plants.compiled_laws import table_of
    from rig.simulation.plants.stepping import within_a_step

    propagate, response = _propagator(model.omega, model.zeta, step_s)
    driven, pushed = (
        (response[:, None] * g[:, None]).reshape(3, len(g), 2 * model.omega.size) for g in (model.gains, -model.across)
    )
    reach, relief = _reach(model, pushed, step_s)
    return propagate, driven, model.across, pushed, reach, relief, table_of(model.laws), within_a_step(step_s)


def _reach(
    model: Model, pushed: Float[np.ndarray, "3 contacts states"], step_s: float
) -> tuple[Float[np.ndarray, "2 2 contacts contacts"], Float[np.ndarray, " contacts"]]:
    """Reach of each end force, and each bend, in every eta and eta'; and how much of a change that leaves to make.

    Raises RigError if a force would change itself by half or more.
    """
    parts = pushed[1:].reshape(2, len(model.across), 2, model.omega.size)
    reach = np.ascontiguousarray(np.einsum("ji,fkxi->fxjk", model.across, parts))
    stiffness, slope = np.array([law.steepest for law in model.laws]).reshape(-1, 2).T
    loop = np.abs(reach[0, 0]) @ stiffness + np.abs(reach[0, 1]) @ slope
    if np.any(loop > 0.5):
        raise RigError(
            f"a contact is too stiff for the step of {step_s} s (loop gain {loop.max():.2g}); use a smaller step"
        )
    own = -np.diag(reach[0, 0]) * stiffness - np.diag(reach[0, 1]) * slope
    return reach, 1 / (1 + own)


def _bends(inputs: Float[np.ndarray, "inputs samples"]) -> Float[np.ndarray, "inputs samples"]:
    """The mean over each step of a smooth curve through the samples, less that of the straight line: -F'' h^2 / 12.

    F'' is the mean of the second differences at both ends of the step; of one end where the other is a corner, at
    which the second difference stands out from both its neighbours.
    """
    bends = np.zeros(inputs.shape)
    with np.errstate(invalid="ignore"):  # a force that is not finite
        second = np.pad(np.diff(inputs, n=2), ((0, 0), (1, 1)))
        size = np.abs(second)
        corner = size[:, 1:-1] > 4 * np.maximum(size[:, :-2], size[:, 2:])
        left, right = second[:, 1:-2], second[:, 2:-1]
        bends[:, 1:-2] = -(np.where(corner[:, :-1], right, left) + np.where(corner[:, 1:], left, right)) / 24
    return bends


def shape_row(
    bodies: list[tuple[Body, Modes, int]], station: Station, order: int = 0
) -> Float[np.ndarray, " allmodes"]:
    """The shapes of all bodies' modes at a station, or a derivative along; zero for the modes of the other bodies."""
    place = np.array([station.position_m])
    return np.concatenate(
        [modes.shapes(place, n, order)[0] if body.name == station.body else np.zeros(n) for body, modes, n in bodies]
    )


def _sensed_row(rig: Rig, bodies: list[tuple[Body, Modes, int]], sensor: Sensor) -> Float[np.ndarray, " allmodes"]:
    along = np.array([shape_row(bodies, sensor.station, order) for order in range(3)])
    return sensor.measures.operator(along, rig.fibre_m(sensor))


def _propagator(
    omega: Float[np.ndarray, " modes"], zeta: Float[np.ndarray, " modes"], step_s: float
) -> tuple[Float[np.ndarray, "2 2 modes"], Float[np.ndarray, "3 2 modes"]]:
    """Exact step of x = (q, q') under p(s) = (1 - s) p0 + s p1 + 6 b s (1 - s): x1 = A x0 + r0 p0 + r1 p1 + r2 b.

    A and the three r come from one augmented matrix exponential, that of (q, q', p, dp/ds, d2p/ds2).
    """
    augmented = np.zeros((omega.size, 5, 5))
    augmented[:, 0, 1] = step_s
    augmented[:, 1, 0] = -(omega**2) * step_s
    augmented[:, 1, 1] = -2 * zeta * omega * step_s
    augmented[:, 1, 2] = step_s
    augmented[:, 2, 3] = augmented[:, 3, 4] = 1.0
    powers = scipy.linalg.expm(augmented)
    constant, linear, quadratic = powers[:, :2, 2:].transpose(2, 1, 0)
    propagate = np.ascontiguousarray(powers[:, :2, :2].transpose(1, 2, 0))
    return propagate, np.stack([constant - linear, linear, 6 * linear - 12 * quadratic])
