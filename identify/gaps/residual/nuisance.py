"""Columns of nuisance parameters: changes of the residual by gains, delays, positions, modes and masses that a
laboratory never knows exactly, per standard deviation of their priors; and rigs with fitted values applied."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from msgspec.structs import replace

from identify.gaps.residual.linear import Linear, ground_spring_correction
from identify.gaps.residual.record import Record
from identify.gaps.residual.windowed import has_ground_forces
from identify.linear.free_motion import state_changes, tuning_derivative
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
"""Bound of every nuisance parameter in standard deviations: beyond it, something else is wrong. Derived: a normal
variable exceeds it once in 5e8."""
MODE_REACH = 1.3
"""Multiple of the highest frequency up to which modes have parameters of their own. Set by hand: higher modes act
nearly as static compliance."""


@dataclass(frozen=True)
class Columns:
    """Decrease of the linear residual, the contact forces and the relative displacements per nuisance parameter.

    Each parameter is in its standard deviations, relative displacements are spectra. Arrays are in single precision,
    except for records of sharp modes, where a nuisance parameter's shift and an effect's differ in the seventh digit.
    """

    parameters: tuple[Nuisance, ...]
    residual: Float[np.ndarray, "nuisances rows times"]
    contact_n: Float[np.ndarray, "nuisances contacts times"]
    eta_m: Complex[np.ndarray, "nuisances contacts lines"]

    @property
    def flat(self) -> Float[np.ndarray, "nuisances all"]:
        """Columns of the residual, nuisances x (rows times)."""
        return self.residual.reshape(len(self.parameters), -1)

    def residual_decrease(self, nuisance: Float[np.ndarray, " nuisances"]) -> Float[np.ndarray, "rows times"]:
        """Decrease of the linear residual by nuisance parameters."""
        return (nuisance.astype(self.residual.dtype) @ self.flat).reshape(self.residual.shape[1:])

    def products(self, residuals: Float[np.ndarray, "*some all"]) -> Float[np.ndarray, "nuisances *some"]:
        """Inner products of the columns with flattened residuals."""
        return (self.flat @ residuals.T.astype(self.residual.dtype, copy=False)).astype(float)


def columns_of(record: Record, model: Linear) -> Columns:
    """Columns of all parameters whose tolerance is above zero."""
    bodies = [r.body.name for r in model.responses]
    states = state_changes(model.free, bodies, model.sensor_response, float(np.linalg.norm(record.delivered)))
    observed = _observed(record, model)
    tolerance_changes = (*changes_of(observed), *crosstalk_of(observed))
    changes = [*(_free_motion_change(record, model, change) for change in tolerance_changes), *states]
    count, contact_count, samples = (
        len(changes),
        len(model.rig.contacts),
        record.counted_samples.stop - record.counted_samples.start,
    )
    residual = np.empty((count, len(model.residual), samples), np.float64 if record.modes else np.float32)
    contact_n = np.zeros((count, contact_count, samples), np.float32)
    eta_m = np.zeros((count, contact_count, record.omega.size), np.complex64)
    projection = model.projection if record.modes else model.projection.single()
    for i, change in enumerate(changes):
        linear, contact_force = _projected(record, model, projection, change)
        residual[i] = residual_in_time(record, linear)
        contact_n[i] = record.in_time(contact_force)
        if change.displaced is not None:
            eta_m[i] = relative_displacements(record, model, change.displaced, change.sensors)
    return Columns(tuple(c.parameter for c in changes), residual, contact_n, eta_m)


def _free_motion_change(record: Record, model: Linear, change: Change) -> Change:
    """Change of a mode's frequency or damping in a record with measured modes, by its sampled free motion up to the
    faded end; any other change as it is."""
    parameter, tolerances = change.parameter, record.tolerances
    if not record.modes or parameter.kind not in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING):
        return change
    delivered = np.zeros_like(model.sensor_response)
    for motion in model.free:
        response = model.responses[motion.body_index]
        if response.body.name == parameter.of and parameter.mode_number in (None, motion.mode_index + 1):
            delivered += tuning_derivative(motion, response, record.sampling, parameter.kind)
    applicable = (
        tolerances if parameter.mode_number is None else tolerances.of_mode(parameter.of, parameter.mode_number)
    )
    tolerance = applicable.frequency if parameter.kind is NuisanceKind.FREQUENCY else applicable.damping
    return Change(parameter, list(range(len(delivered))), tolerance * model.sensor_response * delivered)


def _projected(
    record: Record, model: Linear, projection: Projection, change: Change
) -> tuple[Complex[np.ndarray, "rows lines"], Complex[np.ndarray, "contacts lines"]]:
    """Projected change, with that of the ground springs whose displacement differs from the measured one."""
    if change.displaced is None or not has_ground_forces(model.rig):
        return projection.of(change.delivered, change.sensors)
    displaced, delivered = np.zeros_like(model.sensor_response), np.zeros_like(model.sensor_response)
    displaced[change.sensors], delivered[change.sensors] = change.displaced, change.delivered
    return projection.of(delivered + ground_spring_correction(record, model, displaced))


def _observed(record: Record, model: Linear) -> Observed:
    """Observed motion of a record under a linear model, from which changes by nuisance parameters follow."""
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
            BodyMotion(response, motion, _parameter_modes(record, response))
            for response, motion in zip(model.responses, _modal_accelerations(record, model), strict=True)
        ),
    )


def _parameter_modes(record: Record, response: Response) -> Int[np.ndarray, " some"]:
    """Modes with parameters of their own, by the nominal rig, so that all rigs have the same parameters."""
    count = response.count
    natural_hz = modes_of(record.rig, record.rig.body(response.body.name)).frequencies_hz(count)
    bending = elastic_modes(response, count)  # whichever springs hold the body
    return bending[natural_hz[bending] < MODE_REACH * record.omega[-1] / (2 * np.pi)]


def _modal_accelerations(record: Record, model: Linear) -> list[Complex[np.ndarray, "modes lines"]]:
    """Modal accelerations of each body: the modelled ones, corrected by the unexplained part of its sensors."""
    unexplained = model.residual[: len(record.sensors)] * model.deviation / model.sensor_response
    accelerations = []
    for response, motion in zip(model.responses, model.modal, strict=True):
        rows = [i for i, s in enumerate(record.sensors) if s.station.body == response.body.name]
        if rows:
            count = min(len(rows), response.count)
            shapes = response.shapes([record.sensors[i].station for i in rows])[:, :count]
            motion[:count] += np.linalg.pinv(shapes) @ unexplained[rows]
        accelerations.append(motion)
    return accelerations


def apply_nuisance(
    rig: Rig,
    parameters: tuple[Nuisance, ...],
    values: Float[np.ndarray, " nuisances"],
    tolerances: Tolerances,
) -> tuple[Rig, Float[np.ndarray, " nuisances"]]:
    """Rig with the nuisance parameters applied in which the residual is nonlinear, and their values, others zero.

    These are the frequencies and damping of single masses and the gains of their sensors: a resonance that is off by a
    fraction of its width is nonlinear. Without contacts the modes of every body are also scaled together; `tuned_modes`
    scales them one by one.
    """
    mass_names = {b.name for b in rig.bodies if b.is_mass}
    tuned_names = {b.name for b in rig.bodies if b.is_mass or not rig.contacts}
    applied_kinds = {
        Nuisance(kind, name) for name in tuned_names for kind in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
    }
    applied_kinds |= {Nuisance(NuisanceKind.GAIN, s.name) for s in rig.sensors if s.station.body in mass_names}
    applied = np.where([p in applied_kinds for p in parameters], values, 0.0)
    return with_nuisance(rig, parameters, applied, tolerances), applied


def with_nuisance(
    rig: Rig,
    parameters: tuple[Nuisance, ...],
    values: Float[np.ndarray, " nuisances"],
    tolerances: Tolerances,
) -> Rig:
    """Rig with fitted mass, frequencies and damping of its bodies, gains and delays of its channels.

    Stations are kept, as they link a contact to its sensors; so are single modes, high-passes and single gains of
    several forces.
    """
    fitted = dict(zip(parameters, values.tolist(), strict=True))

    def factor(kind: NuisanceKind, of: str, tolerance: float) -> float:
        return float(max(0.1, 1 + tolerance * fitted.get(Nuisance(kind, of), 0.0)))

    def body(nominal: Body) -> Body:
        heavier = nominal.scale_mass(factor(NuisanceKind.MASS, nominal.name, tolerances.mass))
        tuned = heavier.scale_frequencies(factor(NuisanceKind.FREQUENCY, nominal.name, tolerances.frequency))
        return tuned.scale_damping(factor(NuisanceKind.DAMPING, nominal.name, tolerances.damping))

    def sensor(nominal: Sensor) -> Sensor:
        sensor_tolerances = tolerances.of_sensor(nominal.name)
        delay_change_s = sensor_tolerances.delay_s * fitted.get(Nuisance(NuisanceKind.DELAY, nominal.name), 0.0)
        return replace(
            nominal,
            gain=nominal.gain * factor(NuisanceKind.GAIN, nominal.name, sensor_tolerances.gain),
            delay_s=nominal.delay_s + delay_change_s,
        )

    force_gain = rig.force_sensor.gain * factor(NuisanceKind.FORCE_GAIN, THE_FORCE, tolerances.force_gain)
    return replace(
        rig,
        bodies=tuple(body(b) for b in rig.bodies),
        sensors=tuple(sensor(s) for s in rig.sensors),
        force_sensor=replace(rig.force_sensor, gain=force_gain),
    )


def residual_in_time(record: Record, residual: Complex[np.ndarray, "rows lines"]) -> Float[np.ndarray, "rows times"]:
    """Residual over time, with unit variance where its lines have unit variance.

    Zero in a quiet start, where motion from before the record decays.
    """
    rows = residual_scale(record) * record.in_time(residual)
    rows[:, record.time_s < record.excited_s] = 0.0
    return rows


def residual_scale(record: Record) -> float:
    """Factor from lines of unit variance to a residual over time of unit variance."""
    return float(np.sqrt(record.length * record.samples / (2 * record.omega.size)))


def relative_displacements(
    record: Record,
    model: Linear,
    displaced: Complex[np.ndarray, "some lines"],
    sensors: list[int] | slice = slice(None),
) -> Complex[np.ndarray, "contacts lines"]:
    """Relative displacements at the contacts from displacements of some of the sensors there."""
    stations = [s.station for s in record.sensors]
    signs = np.array([[(s == c.at) * 1.0 - (s == c.against) * 1.0 for s in stations] for c in model.rig.contacts])
    return times(signs.reshape(-1, len(stations))[:, sensors], displaced)
