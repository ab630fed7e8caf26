"""The assumed-mode model of the paper (equations 13 to 20), advanced by an exact linear propagator."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from rig.errors import RigError
from rig.model.contact_laws import ContactLaw
from rig.model.description import Body, Direction, Rig, Sensor, Station, contact_rows, contact_stations, rig_stations
from rig.model.modes import Modes, mode_count, modes_of, participation
from rig.model.space import plane_rigs
from rig.simulation.motion import Forces, ForceSignal, Motion, Progress, ProjectedSignals, forces_of
from rig.simulation.plants.loading import (
    base_motion_from_rig_or_force,
    check_softening_limits,
    connection_forces_n,
    connections,
    equilibrium,
    has_static_load,
    softening_limits_m,
    true_force,
)

STEPS_PER_BLOCK = 1 << 13
BEND_SUPPORT = 8
"""Samples on either side that are used for the bend of a force within a step."""


@dataclass(frozen=True)
class ModalModel:
    """Modal model of a rig: modes of all bodies, shapes at every station, contacts, inputs and equilibrium.

    Rows are over the modal coordinates q: station_rows give the displacement of a station, sensor_rows what a sensor
    measures, eta_rows the relative displacements. modal_force_by_input is per unit of each known input: exciting
    forces, static loads with the weight, base, tones. At rest the coordinates are rest_coordinates and the
    contact forces rest_contact_n. In space the modes are those of y, then of z, and an annular contact has a row and
    its law in each.
    """

    omega: Float[np.ndarray, " modes"]
    zeta: Float[np.ndarray, " modes"]
    station_rows: dict[Station, Float[np.ndarray, " modes"]]
    sensor_rows: Float[np.ndarray, "sensors modes"]
    eta_rows: Float[np.ndarray, "contacts modes"]
    laws: tuple[ContactLaw, ...]
    modal_force_by_input: Float[np.ndarray, "inputs modes"]
    rest_coordinates: Float[np.ndarray, " modes"]
    rest_contact_n: Float[np.ndarray, " contacts"]

    def start(self) -> tuple[Float[np.ndarray, " states"], Float[np.ndarray, "4 contacts"]]:
        """State of rest (q, q'), and the contact state (4, contacts) of `stepping.advance`."""
        zeros = np.zeros(len(self.eta_rows))
        rest_contact_state = np.stack([self.rest_contact_n, self.eta_rows @ self.rest_coordinates, zeros, zeros])
        return np.append(self.rest_coordinates, np.zeros(self.omega.size)), rest_contact_state


def simulate(
    rig: Rig, force_n: ForceSignal, step_s: float, progress: Progress, modes_per_beam: int = 16
) -> Iterator[Motion]:
    """Motion from rest, with `modes_per_beam` modes (a mass has one, a structure at most those of its basis).

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
    base_signals = base_motion_from_rig_or_force(rig, forces_n, step_s)
    model, quantities = model_of(rig, bool(base_signals), modes_per_beam), [sensor.measures for sensor in rig.sensors]
    step_constants = stepping_constants(model, step_s)
    shapes = np.array([model.station_rows[station] for station in rig_stations(rig)]).reshape(-1, model.omega.size)
    last_state, contact_state = model.start()
    contact_history_n, bend_history_n = np.tile(model.rest_contact_n[:, None], 4), np.zeros((len(model.eta_rows), 1))
    for first_step in range(0, len(force_n), STEPS_PER_BLOCK):
        span = slice(first_step, min(first_step + STEPS_PER_BLOCK, len(force_n)))
        inputs, input_bends = inputs_and_bends(rig, forces_n, base_signals, step_s, span)
        contact_n, contact_bends_n = np.empty((2, len(model.eta_rows), span.stop - first_step))
        # a new array a block: Motion computes from it on demand
        states = np.empty((span.stop - first_step + 1, last_state.size))
        states[0] = last_state
        advance(
            states, contact_state, contact_n, contact_bends_n, inputs, input_bends, *step_constants, first_step, step_s
        )
        block_states, last_state = states[1:], states[-1]
        if not np.all(np.isfinite(last_state)):  # what is not finite stays so
            raise RigError(
                f"the modal plant diverged near {first_step * step_s:.3f} s at step {step_s} s; use a smaller step"
            )
        check_softening_limits(limits_m, model.eta_rows @ block_states[:, : model.omega.size].T)
        progress(span.stop / len(force_n))
        contact_history_n = np.concatenate([contact_history_n[:, -4:], contact_n], axis=1)
        bend_history_n = np.concatenate([bend_history_n[:, -1:], contact_bends_n], axis=1)
        corrected_contact_n = _alias_free_forces_n(contact_history_n, bend_history_n)
        sensed = sensed_quantities(rig, model, block_states, inputs[:, 1:], corrected_contact_n)
        if base_signals:
            sensed += np.array(
                [base_signals[quantity.order][span] * quantity.translates for quantity in quantities]
            ).reshape(sensed.shape)
        modal_coordinates = block_states[:, : model.omega.size]
        yield Motion(
            start_s=first_step * step_s,
            step_s=step_s,
            forces_n=forces_n[span],
            sensed=sensed,
            displacement_m=ProjectedSignals(shapes, modal_coordinates, base_signals[0][span] if base_signals else None),
            eta_m=ProjectedSignals(model.eta_rows[: len(contact_rows(rig))], modal_coordinates),
            contact_force_n=contact_n[: len(contact_rows(rig))],
        )


def sensed_quantities(
    rig: Rig,
    model: ModalModel,
    states: Float[np.ndarray, "samples states"],
    inputs: Float[np.ndarray, "inputs samples"],
    contact_forces_n: Float[np.ndarray, "all samples"],
) -> Float[np.ndarray, "sensors samples"]:
    """True quantities at the sensors from the modal states, relative to the base."""
    mode_count = model.omega.size
    sensed_values = np.empty((len(rig.sensors), len(states)))
    first_sensor = 0
    for order, sensors in groupby(rig.sensors, lambda s: s.measures.order):
        sensor_shapes = model.sensor_rows[first_sensor : first_sensor + len(list(sensors))]
        sensor_values = sensed_values[first_sensor : first_sensor + len(sensor_shapes)]
        first_sensor += len(sensor_shapes)
        if order < 2:
            np.matmul(sensor_shapes, states[:, order * mode_count : (order + 1) * mode_count].T, out=sensor_values)
        else:
            acceleration_by_state = np.concatenate(
                [-(model.omega**2) * sensor_shapes, -2 * model.zeta * model.omega * sensor_shapes], axis=1
            )
            acceleration_by_force = np.concatenate(
                [sensor_shapes @ model.modal_force_by_input.T, -sensor_shapes @ model.eta_rows.T], axis=1
            )
            np.matmul(acceleration_by_state, states.T, out=sensor_values)
            sensor_values += acceleration_by_force @ np.concatenate([inputs, contact_forces_n])
    return sensed_values


def _alias_free_forces_n(
    contact_history_n: Float[np.ndarray, "contacts longer"], bend_history_n: Float[np.ndarray, "contacts long"]
) -> Float[np.ndarray, "contacts samples"]:
    """Contact forces for accelerometers: their samples add up to the true impulse although the force has corners.

    Otherwise each closure would leave an error in the velocity. The excess of a step's bend over that of a smooth force
    (-f'' h^2 / 12, from the samples before) is moved to the samples after it, about the middle of the step. The input
    has four earlier samples of the forces, and one earlier bend.
    """
    second_differences_n = np.diff(contact_history_n, n=2)
    excess_bends_n = bend_history_n + (3 * second_differences_n[:, 1:] - second_differences_n[:, :-1]) / 24
    return contact_history_n[:, 4:] + 1.5 * excess_bends_n[:, 1:] - 0.5 * excess_bends_n[:, :-1]


class BodyModes(NamedTuple):
    """A body with its modes in a rig, the number of modes taken, and their direction."""

    body: Body
    modes: Modes
    mode_count: int
    direction: Direction


def body_modes_of(rig: Rig, modes_per_beam: int) -> list[BodyModes]:
    """Modes of every body of a rig, first in y, then in z if the rig moves in it."""
    return [
        BodyModes(body, modes_of(plane_rig, body), mode_count(body, modes_per_beam), direction)
        for direction, plane_rig in plane_rigs(rig).items()
        for body in plane_rig.bodies
    ]


def model_of(rig: Rig, base_moves: bool, modes_per_beam: int) -> ModalModel:
    """Modal model of a rig, with an input for the base if it moves."""
    body_modes = body_modes_of(rig, modes_per_beam)
    omega = 2 * np.pi * np.concatenate([basis.modes.frequencies_hz(basis.mode_count) for basis in body_modes])
    zeta = np.concatenate([basis.modes.damping_ratios(basis.mode_count) for basis in body_modes])
    contacts, laws = connections(rig), tuple(contact.law for contact in connections(rig))
    stations = {*rig_stations(rig), *rig.forces, *(load.station for load in rig.loads)}
    stations |= {tone.station for tone in rig.tones}
    stations |= {station for contact in contacts for station in contact_stations(contact)}
    station_rows = {station: shape_row(body_modes, station) for station in stations}
    eta_rows = np.array([station_rows[c.at] - (station_rows[c.against] if c.against else 0) for c in contacts])
    eta_rows = eta_rows.reshape(len(contacts), omega.size)
    static_modal_load = np.zeros(omega.size) + sum(load.force_n * station_rows[load.station] for load in rig.loads)
    base_modal_load = _base_modal_forces(rig, body_modes) if base_moves or rig.gravity_m_per_s2 else np.zeros(0)
    if rig.gravity_m_per_s2:
        static_modal_load = static_modal_load + rig.gravity_m_per_s2 * base_modal_load
    rest_coordinates = equilibrium(omega**2, eta_rows, laws, static_modal_load)
    modal_force_by_input = [station_rows[station] for station in rig.forces]
    if has_static_load(rig):
        modal_force_by_input.append(static_modal_load)
    if base_moves:
        modal_force_by_input.append(base_modal_load)
    modal_force_by_input += [station_rows[tone.station] for tone in rig.tones]
    return ModalModel(
        omega=omega,
        zeta=zeta,
        station_rows=station_rows,
        sensor_rows=np.array([_sensed_row(rig, body_modes, sensor) for sensor in rig.sensors]).reshape(-1, omega.size),
        eta_rows=eta_rows,
        laws=laws,
        modal_force_by_input=np.array(modal_force_by_input),
        rest_coordinates=rest_coordinates,
        rest_contact_n=connection_forces_n(laws, eta_rows @ rest_coordinates, np.zeros(len(eta_rows))),
    )


def _base_modal_forces(rig: Rig, body_modes: list[BodyModes]) -> Float[np.ndarray, " modes"]:
    """Modal forces of an acceleration of the base in y, which are also those of gravity."""
    return -np.concatenate([participation(rig, *basis[:3]) * (basis.direction == "y") for basis in body_modes])


def inputs_and_bends(
    rig: Rig, forces_n: Forces, base_signals: tuple[Float[np.ndarray, " samples"], ...], step_s: float, span: slice
) -> tuple[Float[np.ndarray, "inputs more"], Float[np.ndarray, "inputs more"]]:
    """Known inputs at the samples of `span` and at the one before, and their bends over the steps.

    Before the first sample the rig rests: no force, all static loads, no motion of the base.
    """
    padded_span = slice(max(0, span.start - BEND_SUPPORT), min(len(forces_n), span.stop + BEND_SUPPORT))
    rest_sample = np.zeros(int(padded_span.start == 0))
    input_rows = [np.append(rest_sample, true_force(rig, signal, step_s, padded_span)) for signal in forces_n.signals]
    if has_static_load(rig):
        input_rows.append(np.ones(input_rows[0].size))
    if base_signals:
        input_rows.append(np.append(rest_sample, base_signals[2][padded_span]))
    time_s = np.arange(padded_span.start - rest_sample.size, padded_span.stop) * step_s
    input_rows += [tone.force_n(time_s) for tone in rig.tones]
    inputs = np.array(input_rows)
    first_column = span.start - padded_span.start - 1 + rest_sample.size
    column_span = slice(first_column, first_column + span.stop - span.start + 1)
    return np.ascontiguousarray(inputs[:, column_span]), np.ascontiguousarray(_chord_excess(inputs)[:, column_span])


def stepping_constants(model: ModalModel, step_s: float) -> tuple[Any, ...]:
    """Arrays of a model for `stepping.advance`; raises RigError if a contact is too stiff for the step."""
    from rig.simulation.plants.compiled_laws import law_records
    from rig.simulation.plants.stepping import gauss_points

    propagator, force_response = _propagator_and_force_response(model.omega, model.zeta, step_s)
    state_by_input, state_by_contact_force = (
        (force_response[:, None] * modal_force_rows[:, None]).reshape(3, len(modal_force_rows), 2 * model.omega.size)
        for modal_force_rows in (model.modal_force_by_input, -model.eta_rows)
    )
    gain, increment_factors = _gain_and_increment_factors(model, state_by_contact_force, step_s)
    return (
        propagator,
        state_by_input,
        model.eta_rows,
        state_by_contact_force,
        gain,
        increment_factors,
        law_records(model.laws),
        gauss_points(step_s),
        True if any(law.spatial for law in model.laws) else None,
    )


def _gain_and_increment_factors(
    model: ModalModel, state_by_contact_force: Float[np.ndarray, "3 contacts states"], step_s: float
) -> tuple[Float[np.ndarray, "2 2 contacts contacts"], Float[np.ndarray, " contacts"]]:
    """Response of every eta and eta' to each end force and each bend within a step, and 1 / (1 + self gain).

    Raises RigError if the loop gain of a contact force exceeds one half.
    """
    force_responses = state_by_contact_force[1:].reshape(2, len(model.eta_rows), 2, model.omega.size)
    gain = np.ascontiguousarray(np.einsum("ji,fkxi->fxjk", model.eta_rows, force_responses))
    largest_stiffness, largest_damping = np.array([law.largest_slopes for law in model.laws]).reshape(-1, 2).T
    loop_gain = np.abs(gain[0, 0]) @ largest_stiffness + np.abs(gain[0, 1]) @ largest_damping
    if np.any(loop_gain > 0.5):
        raise RigError(
            f"a contact is too stiff for the step of {step_s} s (loop gain {loop_gain.max():.2g}); use a smaller step"
        )
    self_gain = -np.diag(gain[0, 0]) * largest_stiffness - np.diag(gain[0, 1]) * largest_damping
    return gain, 1 / (1 + self_gain)


def _chord_excess(inputs: Float[np.ndarray, "inputs samples"]) -> Float[np.ndarray, "inputs samples"]:
    """Bends of the inputs: mean over each step of a smooth curve less that of the straight line, -F'' h^2 / 12.

    F'' is the mean of the second differences at both ends of the step, or that of one end if the other is a corner,
    where the second difference exceeds both its neighbours fourfold.
    """
    bends = np.zeros(inputs.shape)
    with np.errstate(invalid="ignore"):  # a force that is not finite
        curvature = np.pad(np.diff(inputs, n=2), ((0, 0), (1, 1)))
        curvature_sizes = np.abs(curvature)
        is_corner = curvature_sizes[:, 1:-1] > 4 * np.maximum(curvature_sizes[:, :-2], curvature_sizes[:, 2:])
        at_start, at_end = curvature[:, 1:-2], curvature[:, 2:-1]
        curvature_sum = np.where(is_corner[:, :-1], at_end, at_start) + np.where(is_corner[:, 1:], at_start, at_end)
        bends[:, 1:-2] = -curvature_sum / 24
    return bends


def shape_row(body_modes: list[BodyModes], station: Station, order: int = 0) -> Float[np.ndarray, " allmodes"]:
    """Shapes of all bodies' modes at a station, or a derivative along the body; zero for all other modes."""
    positions_m = np.array([station.position_m])
    return np.concatenate(
        [
            basis.modes.shapes(positions_m, basis.mode_count, order)[0]
            if (basis.body.name, basis.direction) == (station.body, station.direction)
            else np.zeros(basis.mode_count)
            for basis in body_modes
        ]
    )


def _sensed_row(rig: Rig, body_modes: list[BodyModes], sensor: Sensor) -> Float[np.ndarray, " allmodes"]:
    derivative_rows = np.array([shape_row(body_modes, sensor.station, order) for order in range(3)])
    return sensor.measures.operator(derivative_rows, rig.fibre_m(sensor))


def _propagator_and_force_response(
    omega: Float[np.ndarray, " modes"], zeta: Float[np.ndarray, " modes"], step_s: float
) -> tuple[Float[np.ndarray, "2 2 modes"], Float[np.ndarray, "3 2 modes"]]:
    """Exact step of x = (q, q') under p(s) = (1 - s) p0 + s p1 + 6 b s (1 - s): x1 = A x0 + r0 p0 + r1 p1 + r2 b.

    A and the three r come from one augmented matrix exponential, that of (q, q', p, dp/ds, d2p/ds2).
    """
    augmented_matrices = np.zeros((omega.size, 5, 5))
    augmented_matrices[:, 0, 1] = step_s
    augmented_matrices[:, 1, 0] = -(omega**2) * step_s
    augmented_matrices[:, 1, 1] = -2 * zeta * omega * step_s
    augmented_matrices[:, 1, 2] = step_s
    augmented_matrices[:, 2, 3] = augmented_matrices[:, 3, 4] = 1.0
    matrix_exponential = scipy.linalg.expm(augmented_matrices)
    constant, linear, quadratic = matrix_exponential[:, :2, 2:].transpose(2, 1, 0)
    propagator = np.ascontiguousarray(matrix_exponential[:, :2, :2].transpose(1, 2, 0))
    return propagator, np.stack([constant - linear, linear, 6 * linear - 12 * quadratic])
