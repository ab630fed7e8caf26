"""The linear part of a rig against a record: what no contact force explains, and the contact forces that explain most.

At every line the accelerations of all sensors are, by the rig's description,

    A = G_F F + G_T T - G_K (k3 w^3 + c v + F_c tanh(v / v0)) - G_C f + G_B a_base + error

with the accelerances G at the sensors of the forces F, of tones T, of cubic springs and dampers to the ground (by the
measured motion w, v at their places), of contact forces f, and of a base that shakes unmeasured. Static loads
accelerate nothing: the contacts hold them. The f are found by least squares, without a contact
law; so is a_base, held by its spectrum. What they leave, in standard deviations of the error, is the linear residual:
sensors less contacts tell it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.gaps.residual.grounded import ground_force_changes, ground_forces, pushed_by_motion
from identify.gaps.residual.record import Record
from identify.gaps.residual.windowed import modal_response, response_to_force
from identify.linear.free_motion import FreeMode, fitted_modes, free_modes
from identify.linear.joined import joined
from identify.linear.model import (
    Response,
    ResponseCache,
    accelerances,
    across,
    input_shapes,
    responses_of,
    slow_stiffness,
    times,
    weights_of,
)
from identify.linear.projection import Projection, estimated_inputs, projection, unexplained
from rig.model.description import Rig, Station, contact_stations
from rig.model.modes import modes_of, participation
from rig.model.sensing import PASSBAND

RINGING = 4.0
"""Modes up to this multiple of the highest frequency ring freely."""
Tuned = Mapping[str, tuple[Float[np.ndarray, " modes"], Float[np.ndarray, " modes"]]]
"""By body: factors on the frequency and on the damping ratio of each of its modes."""


@dataclass(frozen=True, eq=False)
class Linear:
    """A rig's linear model laid against a record.

    sensor_response is what each sensor makes of an acceleration. by_input are the accelerations, in standard
    deviations, that each unknown input makes: the contact forces, then a base that shakes, then the noise of each
    measured force. residual is in standard deviations; where the base shakes, a last row holds its acceleration in
    those of its own spectrum, and log_determinant is what that freedom costs. by_force are the accelerations that each
    measured force alone makes at the sensors, pushes all known forces with their places.
    """

    record: Record
    rig: Rig
    responses: tuple[Response, ...]
    sensor_response: Complex[np.ndarray, "sensors lines"]
    deviation: Float[np.ndarray, "sensors lines"]
    by_input: Complex[np.ndarray, "inputs sensors lines"]
    residual: Complex[np.ndarray, "rows lines"]
    contact_n: Complex[np.ndarray, "contacts lines"]
    by_force: Complex[np.ndarray, "forces sensors lines"]
    pushes: tuple[tuple[Station, Complex[np.ndarray, " lines"]], ...]
    free: tuple[FreeMode, ...]
    log_determinant: float

    @cached_property
    def projection(self) -> Projection:
        """Projection of what the sensors deliver."""
        return projection(self.by_input, self.deviation, len(self.rig.contacts))

    @property
    def modal(self) -> tuple[Complex[np.ndarray, "modes lines"], ...]:
        """The accelerations of each body's modes."""
        forces = np.stack([*(force_n for _, force_n in self.pushes), *self.contact_n])
        pushed = [station for station, _ in self.pushes]
        found = tuple(
            modal_response(self.record, self.rig, r, times(input_shapes(self.rig, r, pushed).T, forces))
            for r in self.responses
        )
        for motion in self.free:
            found[motion.body][motion.mode] += motion.acceleration
        return found

    @cached_property
    def accelerations(self) -> Complex[np.ndarray, "sensors lines"]:
        """Accelerations that the sensors show, and of a free motion those that they do not."""
        shown = self.record.delivered / self.sensor_response
        return np.asarray(shown + sum((m.not_shown for m in self.free), np.zeros_like(shown)))

    @cached_property
    def displaced(self) -> Complex[np.ndarray, "sensors lines"]:
        """The displacements at the sensors, likewise."""
        shown = self.record.displaced / self.sensor_response
        missing = sum((m.not_shown for m in self.free), np.zeros_like(shown))
        return np.asarray(shown + missing * self.record.twice_integrated)

    @cached_property
    def eta_m(self) -> Complex[np.ndarray, "contacts lines"]:
        """The relative displacements, without the slow part that integration loses."""
        places, displacements = places_of(self.record, self.rig), self.displaced
        eta = self.unseen_m(self.pushes, self.contact_n)
        for response in self.responses:
            eta += times(_across_weights(self.rig, response, places), displacements)
        for motion in self.free:
            missed = self._missed(self.responses[motion.body], places)[:, motion.mode]
            eta += np.outer(missed, motion.acceleration * self.record.twice_integrated)
        return eta

    def unseen_m(
        self,
        pushes: Sequence[tuple[Station, Complex[np.ndarray, " lines"]]],
        contact_n: Complex[np.ndarray, "contacts lines"],
    ) -> Complex[np.ndarray, "contacts lines"]:
        """The relative displacements that forces make in the modes which the sensors do not tell."""
        places, forces = places_of(self.record, self.rig), np.stack([*(force_n for _, force_n in pushes), *contact_n])
        moved = np.zeros((len(self.rig.contacts), forces.shape[1]), dtype=complex)
        for response in self.responses:
            into = input_shapes(self.rig, response, [station for station, _ in pushes])
            missed = self._missed(response, places)
            moved += np.einsum("icl,il->cl", response.transfer(missed, into), forces)
        return moved * self.record.twice_integrated

    def _missed(self, response: Response, places: list[Station | None]) -> Float[np.ndarray, "contacts modes"]:
        """Mode shapes in the relative displacements beyond what the sensors tell of them."""
        return across(self.rig, response) - _across_weights(self.rig, response, places) @ response.shapes(places)

    @cached_property
    def holding_n(self) -> Float[np.ndarray, " contacts"]:
        """The constant contact forces under static loads."""
        return _holding(self.rig, self.responses)

    @cached_property
    def slow_n_per_m(self) -> Float[np.ndarray, "contacts contacts"]:
        return slow_stiffness(self.rig, self.responses)

    def open_n(self, record: Record) -> Float[np.ndarray, " contacts"]:
        """Standard deviation over time of each contact force, by the errors of the accelerations."""
        variance = np.sum(np.abs(self.projection.to_inputs[: len(self.rig.contacts)]) ** 2, axis=(1, 2))
        return np.asarray(np.sqrt(2 * variance / (record.length * record.samples)))


def linear_model(
    record: Record,
    rig: Rig,
    model_error: float | Float[np.ndarray, "sensors lines"],
    cache: ResponseCache | None = None,
    tuned: Tuned | None = None,
) -> Linear:
    """The linear residual of a rig that has the record's sensors and contacts, whatever else it has.

    model_error is the share of each acceleration that no model of this kind explains. The noise of the measured force
    is a further unknown input, with a prior of its own size. Contacts between the same places are one. `cache` is that
    of whoever lays many rigs against the record; `tuned` are factors on frequencies and damping of the modes.
    """
    rig = joined(rig)
    sensor_response = sensor_response_of(record, rig)
    responses = responses_of(rig, cache or ResponseCache(record.omega), record.zero_known)
    if tuned:
        responses = tuple(r.tuned(*tuned[r.body.name]) if r.body.name in tuned else r for r in responses)
    places = places_of(record, rig)
    pushes = _pushes(record, rig, responses, places, sensor_response)
    contacts = len(rig.contacts)
    made = accelerances(rig, responses, [station for station, _ in pushes], places)
    by_contacts, per_newton = made[len(pushes) :], made[: len(rig.forces)]
    by_push = [
        response_to_force(record, rig, per_push, force_n) for per_push, (_, force_n) in zip(made, pushes, strict=False)
    ]
    by_force, known = np.stack(by_push[: len(rig.forces)]), sum(by_push[1:], by_push[0])
    deviation = np.sqrt(record.noise + model_error**2 * record.power)
    deviation = np.maximum(deviation, 1e-9 * deviation.max())
    sensed = sensor_response / deviation
    unknown = [by_contacts]
    if rig.base_motion is not None:
        unknown.append(_base(record, rig, responses, places)[None])
    noisy = record.force_noise > 0
    unknown.append(np.sqrt(record.force_noise[noisy, None, None]) / rig.force_sensor.gain * per_newton[noisy])
    by_input = np.concatenate(unknown) * sensed
    weighted = record.delivered / deviation - known * sensed
    free: tuple[FreeMode, ...] = ()
    if record.from_the_blow:
        free = free_modes(responses, _free_modes(record, responses), places, None if rig.contacts else record.sampling)
    if free:
        projected = projection(by_input, deviation, contacts)
        free = fitted_modes(free, projected, sensed, projected.of(weighted * deviation)[0][: len(places)])
        weighted = weighted - sensed * sum(mode.shown for mode in free)
    inputs, log_determinant = estimated_inputs(by_input, weighted, contacts)
    residual = unexplained(by_input, inputs, weighted)
    return Linear(
        record=record,
        rig=rig,
        responses=responses,
        sensor_response=sensor_response,
        deviation=deviation,
        by_input=by_input,
        residual=np.concatenate([residual, inputs[contacts:]]),
        contact_n=inputs[:contacts],
        by_force=by_force,
        pushes=pushes,
        free=free,
        log_determinant=log_determinant,
    )


def sensor_response_of(record: Record, rig: Rig) -> Complex[np.ndarray, "sensors lines"]:
    """Response of each sensor to an acceleration: gain, delay and high-pass."""
    named, omega = {s.name: s for s in rig.sensors}, record.omega
    found = np.empty((len(record.sensors), omega.size), dtype=complex)
    for row, sensor in zip(found, record.sensors, strict=True):
        row[:] = named[sensor.name].response(omega)
    return found


def places_of(record: Record, rig: Rig) -> list[Station | None]:
    """Places of the record's sensors in the rig."""
    named = {s.name: s for s in rig.sensors}
    return [named[s.name].station for s in record.sensors]


def _across_weights(
    rig: Rig, response: Response, places: list[Station | None]
) -> Float[np.ndarray, "contacts sensors"]:
    """Relative displacements from the body's sensors."""
    ends = weights_of(response, places, [*(c.at for c in rig.contacts), *(c.against for c in rig.contacts)])
    return ends[: len(rig.contacts)] - ends[len(rig.contacts) :]


def _pushes(
    record: Record,
    rig: Rig,
    responses: tuple[Response, ...],
    places: list[Station | None],
    sensor_response: Complex[np.ndarray, "sensors lines"],
) -> tuple[tuple[Station, Complex[np.ndarray, " lines"]], ...]:
    """The known forces: the measured ones, tones, and springs and dampers to the ground by the measured motion."""
    lagged = record.forces * np.exp(-1j * record.omega * rig.force_sensor.lag_s) / rig.force_sensor.gain
    tones = [(tone.station, record.spectrum(tone.force_n(record.sample_times_s))) for tone in rig.tones]
    held = []
    if pushed_by_motion(rig):
        held = ground_forces(record, rig, responses, places, record.displaced / sensor_response)
    return (*zip(rig.forces, lagged, strict=True), *tones, *_loads(record, rig), *held)


def _loads(record: Record, rig: Rig) -> list[tuple[Station, Complex[np.ndarray, " lines"]]]:
    """Constant forces on bodies that no contact holds, where the zero of displacements is seen."""
    held = {s.body for c in rig.contacts for s in contact_stations(c)}
    acting = [load for load in rig.loads if record.zero_known and load.station.body not in held]
    constant = record.spectrum(np.ones(record.samples)) if acting else np.zeros(record.omega.size, dtype=complex)
    return [(load.station, load.force_n * constant) for load in acting]


def _free_modes(record: Record, responses: tuple[Response, ...]) -> list[Int[np.ndarray, "_"]]:
    """The modes that ring freely at the beginning of a record without a force, by the nominal rig, so that all
    rigs have the same unknowns.

    Without contacts so far beyond the band that what is left out changes nothing in it; none that no sensor shows.
    """
    reach_hz = record.highest_hz
    if not record.rig.contacts:
        reach_hz = min(RINGING * reach_hz, PASSBAND * record.sample_rate_hz)
    nominal = [modes_of(record.rig, record.rig.body(r.body.name)).frequencies_hz(r.count) for r in responses]
    return [np.flatnonzero(hz < reach_hz) for hz in nominal]


def _holding(rig: Rig, responses: tuple[Response, ...]) -> Float[np.ndarray, " contacts"]:
    """The constant contact forces that hold static loads: of what floats by its balance, of a single mass the load."""
    held = np.zeros(len(rig.contacts))
    for response in responses if rig.loads else ():
        free = response.modes.frequencies_hz(response.count) == 0
        if response.body.is_mass:
            free[:] = True
        push = np.array([x.force_n for x in rig.loads]) @ response.shapes([x.station for x in rig.loads])
        if np.any(push[free]):
            held += np.linalg.lstsq(across(rig, response)[:, free].T, push[free], rcond=None)[0]
    return held


def ground_spring_correction(
    record: Record, model: Linear, displaced: Complex[np.ndarray, "sensors lines"]
) -> Complex[np.ndarray, "sensors lines"]:
    """Correction of the signals, as springs and dampers to the ground are displaced less than the sensors say."""
    places: list[Station | None] = [s.station for s in record.sensors]
    less = ground_force_changes(
        record, model.rig, model.responses, places, record.displaced / model.sensor_response, displaced
    )
    return -delivered_by(model, places, less)


def delivered_by(
    model: Linear, places: list[Station | None], forces: Sequence[tuple[Station, Complex[np.ndarray, " lines"]]]
) -> Complex[np.ndarray, "sensors lines"]:
    """Signals that sensors at some places deliver of forces at others."""
    found = np.zeros(model.sensor_response.shape, dtype=complex)
    for station, force_n in forces:
        for r in model.responses:
            found += model.sensor_response * (r.transfer(r.shapes(places), r.shapes([station]))[0] * force_n)
    return found


def _base(
    record: Record, rig: Rig, responses: tuple[Response, ...], places: list[Station | None]
) -> Complex[np.ndarray, "sensors lines"]:
    """Accelerations by a base motion of one standard deviation a line: a mode feels the base as an inertial load."""
    base = rig.base_motion
    assert base is not None
    follows = np.ones((len(places), record.omega.size), dtype=complex)
    for response in responses:
        load = participation(rig, response.body, response.modes, response.count)
        follows -= response.transfer(response.shapes(places), load[None])[0]
    hz = record.omega / (2 * np.pi)
    density = base.acceleration_rms_m_per_s2**2 / (base.high_hz - base.low_hz)
    size = np.sqrt(density * record.samples * record.sample_rate_hz / 2)
    return np.asarray(follows * size * ((hz >= base.low_hz) & (hz <= base.high_hz)))
