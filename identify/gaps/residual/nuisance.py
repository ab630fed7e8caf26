"""Nuisance parameters: what a laboratory never knows exactly, as columns of the residual with a prior of one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from msgspec.structs import replace

from identify.gaps.residual.grounded import pushed_by_motion
from identify.gaps.residual.linear import Linear, ground_spring_correction
from identify.gaps.residual.record import Record
from identify.linear.free_motion import detuned, state_changes
from identify.linear.model import Response, times
from identify.linear.nuisance import (
    THE_FORCE,
    BodyMotion,
    Change,
    Nuisance,
    NuisanceKind,
    Observed,
    changes_of,
    crosstalk_of,
    elastic_modes,
)
from identify.linear.projection import Projection
from rig.model.description import Body, Rig, Sensor
from rig.model.modes import modes_of
from rig.model.tolerances import Tolerances

LIMIT = 6.0
"""No nuisance parameter goes further than so many standard deviations: beyond, something else is wrong."""
BEYOND = 1.3
"""Modes up to this multiple of the highest frequency have parameters of their own."""


@dataclass(frozen=True)
class Columns:
    """Derivatives of the linear residual, the contact forces and the relative displacements, each by one nuisance
    parameter in its standard deviations; in single precision, save where sharp modes ring, whose shifts are told from
    those by an effect in the seventh digit alone."""

    parameters: tuple[Nuisance, ...]
    residual: Float[np.ndarray, "nuisances rows times"]
    contact_n: Float[np.ndarray, "nuisances contacts times"]
    eta_m: Float[np.ndarray, "nuisances contacts times"]

    @property
    def flat(self) -> Float[np.ndarray, "nuisances all"]:
        """Columns of the residual, row after row."""
        return self.residual.reshape(len(self.parameters), -1)

    def along(self, nuisance: Float[np.ndarray, " nuisances"]) -> Float[np.ndarray, "rows times"]:
        """Decrease of the linear residual by nuisance parameters."""
        return (nuisance.astype(self.residual.dtype) @ self.flat).reshape(self.residual.shape[1:])

    def products(self, residuals: Float[np.ndarray, "*some all"]) -> Float[np.ndarray, "nuisances *some"]:
        """Products with residuals, each row after row."""
        return (self.flat @ residuals.T.astype(self.residual.dtype, copy=False)).astype(float)


def columns_of(record: Record, model: Linear) -> Columns:
    """The columns of all tolerances above zero."""
    bodies = [r.body.name for r in model.responses]
    states = state_changes(model.free, bodies, model.sensor_response, float(np.linalg.norm(record.delivered)))
    observed = _observed(record, model)
    stated = (*changes_of(observed), *crosstalk_of(observed))
    changes = [*(_of_free_motion(record, model, change) for change in stated), *states]
    count, contacts, samples = len(changes), len(model.rig.contacts), record.taken.stop - record.taken.start
    residual = np.empty((count, len(model.residual), samples), np.float64 if record.modes else np.float32)
    forces, eta = (np.zeros((count, contacts, samples), np.float32) for _ in range(2))
    projection = model.projection if record.modes else model.projection.single()
    for i, change in enumerate(changes):
        left, force = _projected(record, model, projection, change)
        residual[i] = counted(record, left)
        forces[i] = record.in_time(force)
        if change.displaced is not None:
            moved = at_contacts(record, model, change.displaced, change.sensors)
            eta[i] = record.in_time(moved.astype(np.complex64))
    return Columns(tuple(c.parameter for c in changes), residual, forces, eta)


def _of_free_motion(record: Record, model: Linear, change: Change) -> Change:
    """Change in a free decay that tells its modes: what other frequencies and damping make of the free motion as it is
    shown, to the faded end; any other change as it is.
    """
    parameter, tolerances = change.parameter, record.tolerances
    if not record.modes or parameter.kind not in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING):
        return change
    delivered = np.zeros_like(model.sensor_response)
    for motion in model.free:
        response = model.responses[motion.body]
        if response.body.name == parameter.of and parameter.mode in (None, motion.mode + 1):
            delivered += detuned(motion, response, record.sampling, parameter.kind)
    own = tolerances if parameter.mode is None else tolerances.of_mode(parameter.of, parameter.mode)
    tolerance = own.frequency if parameter.kind is NuisanceKind.FREQUENCY else own.damping
    return Change(parameter, list(range(len(delivered))), tolerance * model.sensor_response * delivered)


def _projected(
    record: Record, model: Linear, projection: Projection, change: Change
) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "contacts lines"]]:
    """Projected change, with that of springs whose displacement is not the measured one."""
    if change.displaced is None or not pushed_by_motion(model.rig):
        return projection.of(change.delivered, change.sensors)
    displaced, delivered = np.zeros_like(model.sensor_response), np.zeros_like(model.sensor_response)
    displaced[change.sensors], delivered[change.sensors] = change.displaced, change.delivered
    return projection.of(delivered + ground_spring_correction(record, model, displaced))


def _observed(record: Record, model: Linear) -> Observed:
    return Observed(
        sensors=record.sensors,
        displaced_by=record.sensors,
        tolerances=record.tolerances,
        omega=record.omega,
        sensor_response=model.sensor_response,
        explained=record.delivered - model.residual[: len(record.sensors)] * model.deviation,
        by_force=model.by_force,
        displaced=model.displaced,
        bodies=tuple(
            BodyMotion(response, motion, _elastic(record, response))
            for response, motion in zip(model.responses, _measured(record, model), strict=True)
        ),
    )


def _elastic(record: Record, response: Response) -> Int[np.ndarray, " some"]:
    """The modes with parameters of their own: by the believed rig, so that all rigs have the same parameters."""
    count = response.count
    natural_hz = modes_of(record.rig, record.rig.body(response.body.name)).frequencies_hz(count)
    bending = elastic_modes(response, count)  # no matter which springs hold the body
    return bending[natural_hz[bending] < BEYOND * record.omega[-1] / (2 * np.pi)]


def _measured(record: Record, model: Linear) -> list[Complex[np.ndarray, "modes lines"]]:
    """The modal accelerations of each body: as modelled, plus what the sensors show beyond that."""
    beyond = model.residual[: len(record.sensors)] * model.deviation / model.sensor_response
    found = []
    for response, motion in zip(model.responses, model.modal, strict=True):
        rows = [i for i, s in enumerate(record.sensors) if s.station.body == response.body.name]
        if rows:
            count = min(len(rows), response.count)
            shapes = response.shapes([record.sensors[i].station for i in rows])[:, :count]
            motion[:count] += np.linalg.pinv(shapes) @ beyond[rows]
        found.append(motion)
    return found


def apply_nuisance(
    rig: Rig,
    parameters: tuple[Nuisance, ...],
    values: Float[np.ndarray, " nuisances"],
    tolerances: Tolerances,
) -> tuple[Rig, Float[np.ndarray, " nuisances"]]:
    """The rig with the values of its single masses and their sensors put into it, and those values, the others zero.

    Those alone bend the residual: a single mass may have been believed from a record of another level, and a resonance
    that lies off by a part of its width is no linear matter. Without contacts the modes of every body are moved
    together too; `tuned_modes` moves them one by one.
    """
    single = {b.name for b in rig.bodies if b.is_mass}
    ringing = {b.name for b in rig.bodies if b.is_mass or not rig.contacts}
    bends = {Nuisance(kind, name) for name in ringing for kind in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)}
    bends |= {Nuisance(NuisanceKind.GAIN, s.name) for s in rig.sensors if s.station.body in single}
    put = np.where([p in bends for p in parameters], values, 0.0)
    return with_nuisance(rig, parameters, put, tolerances), put


def with_nuisance(
    rig: Rig,
    parameters: tuple[Nuisance, ...],
    values: Float[np.ndarray, " nuisances"],
    tolerances: Tolerances,
) -> Rig:
    """The rig with mass, frequencies and damping of its bodies, gains and delays of its channels as they were fitted.

    Stations stay, as a contact knows its sensors by them; so does what belongs to one mode, to a high-pass or to one of
    several forces.
    """
    fitted = dict(zip(parameters, values.tolist(), strict=True))

    def factor(kind: NuisanceKind, of: str, tolerance: float) -> float:
        return float(max(0.1, 1 + tolerance * fitted.get(Nuisance(kind, of), 0.0)))

    def body(one: Body) -> Body:
        heavier = one.scale_mass(factor(NuisanceKind.MASS, one.name, tolerances.mass))
        tuned = heavier.scale_frequencies(factor(NuisanceKind.FREQUENCY, one.name, tolerances.frequency))
        return tuned.scale_damping(factor(NuisanceKind.DAMPING, one.name, tolerances.damping))

    def sensor(one: Sensor) -> Sensor:
        own = tolerances.of_sensor(one.name)
        later_s = own.delay_s * fitted.get(Nuisance(NuisanceKind.DELAY, one.name), 0.0)
        return replace(
            one, gain=one.gain * factor(NuisanceKind.GAIN, one.name, own.gain), delay_s=one.delay_s + later_s
        )

    force_gain = rig.force_sensor.gain * factor(NuisanceKind.FORCE_GAIN, THE_FORCE, tolerances.force_gain)
    return replace(
        rig,
        bodies=tuple(body(b) for b in rig.bodies),
        sensors=tuple(sensor(s) for s in rig.sensors),
        force_sensor=replace(rig.force_sensor, gain=force_gain),
    )


def counted(record: Record, residual: Complex[np.ndarray, "rows lines"]) -> Float[np.ndarray, "rows times"]:
    """Over time, with a variance of one where that of the lines is one.

    A quiet start counts for nothing: what was switched on before the record rings out there.
    """
    found = residual_scale(record) * record.in_time(residual)
    found[:, record.time_s < record.excited_s] = 0.0
    return found


def residual_scale(record: Record) -> float:
    """Makes the residual over time, of lines with a variance of one, have a variance of one."""
    return float(np.sqrt(record.length * record.samples / (2 * record.omega.size)))


def at_contacts(
    record: Record,
    model: Linear,
    displaced: Complex[np.ndarray, "some lines"],
    sensors: list[int] | slice = slice(None),
) -> Complex[np.ndarray, "contacts lines"]:
    """Relative displacements from the sensors at the contacts, of which some are displaced."""
    stations = [s.station for s in record.sensors]
    signs = np.array([[(s == c.at) * 1.0 - (s == c.against) * 1.0 for s in stations] for c in model.rig.contacts])
    return times(signs.reshape(-1, len(stations))[:, sensors], displaced)
