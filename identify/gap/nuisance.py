"""Nuisance parameters: what a laboratory never knows exactly, as columns of the residual with a prior of one."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float
from msgspec.structs import replace

from identify.gap.linear import Linear, bent
from identify.gap.response import Response
from identify.gap.spectra import Record
from identify.kinematics import CORNER_HZ, integrated
from identify.modal import receptance
from rig.description import Body, Contact, Rig
from rig.model.tolerances import Tolerances
from rig.oscillator import Oscillator

LIMIT = 6.0
"""No nuisance parameter goes further than so many standard deviations: beyond, something else is wrong."""
BEYOND = 1.3
"""Modes up to this multiple of the highest frequency have parameters of their own."""

TOGETHER = 24
"""So many columns are projected at a time: more would not be faster, and take memory."""

Kind = Literal["gain", "position", "delay", "high-pass", "force gain", "mass", "frequency", "damping"]


@dataclass(frozen=True)
class Nuisance:
    """One nuisance parameter: of a sensor, a body or (mode counts from 1) a mode of a body, or of the force."""

    kind: Kind
    of: str
    mode: int | None = None

    @property
    def name(self) -> str:
        return f"{self.kind} of {self.of}" + ("" if self.mode is None else f" {self.mode}")


@dataclass(frozen=True)
class Columns:
    """Derivatives of the linear residual, the contact forces and the relative displacements, each by one nuisance
    parameter in its standard deviations."""

    parameters: tuple[Nuisance, ...]
    residual: Float[np.ndarray, "nuisances rows times"]
    contact_n: Float[np.ndarray, "nuisances contacts times"]
    eta_m: Float[np.ndarray, "nuisances contacts times"]


@dataclass(frozen=True)
class _Change:
    """What one standard deviation of a parameter adds to what the sensors deliver, and to the displacements there."""

    parameter: Nuisance
    delivered: Complex[np.ndarray, "sensors lines"]
    displaced: Complex[np.ndarray, "sensors lines"] | None = None


def columns_of(record: Record, model: Linear) -> Columns:
    """The columns of all tolerances above zero.

    With D = omega_m^2 - omega^2 + 2 i zeta omega_m omega of a mode, an error dD of it changes its acceleration by
    -H dD q exactly, if q is the true motion: so the measured modal accelerations stand in these columns.
    """
    changes = [*_of_sensors(record, model), *_of_force(record, model)]
    for response, motion in zip(model.responses, _measured(record, model), strict=True):
        changes += [*_of_positions(record, model, response, motion), *_of_modes(record, model, response, motion)]
    rows, times = model.residual.shape[0], record.taken.stop - record.taken.start
    contacts = len(model.rig.contacts)
    residual = np.empty((len(changes), rows, times))
    forces, eta = np.empty((len(changes), contacts, times)), np.zeros((len(changes), contacts, times))
    for first in range(0, len(changes), TOGETHER):
        some = slice(first, min(first + TOGETHER, len(changes)))
        left, force = model.projected_many(np.stack([_delivered(record, model, c) for c in changes[some]]))
        residual[some] = residual_scale(record) * record.in_time(left)
        forces[some] = record.in_time(force)
    for i, change in enumerate(changes):
        if change.displaced is not None:
            eta[i] = record.in_time(at_contacts(record, model, change.displaced))
    return Columns(tuple(c.parameter for c in changes), residual, forces, eta)


def _delivered(record: Record, model: Linear, change: _Change) -> Complex[np.ndarray, "sensors lines"]:
    """With what the springs do whose displacement is not the measured one."""
    if change.displaced is None or not (model.rig.springs or model.rig.dampers):
        return change.delivered
    return change.delivered + bent(record, model, change.displaced)


def _of_sensors(record: Record, model: Linear) -> Iterator[_Change]:
    """Gain g, delay tau and the corner w of a first-order high-pass i omega / (i omega + w) of each sensor."""
    explained = record.delivered - model.residual[: len(record.sensors)] * model.spread
    displaced = record.displaced / model.chain
    turning = 1j * record.omega
    for i, sensor in enumerate(record.sensors):
        own = record.tolerances.of_sensor(sensor.name)
        corner = 2 * np.pi * own.high_pass_hz if sensor.quantity == "acceleration" else 0.0
        factors: dict[Kind, Complex[np.ndarray, " lines"]] = {
            "gain": np.full(turning.size, own.gain, dtype=complex),
            "delay": -own.delay_s * turning,
            "high-pass": -corner / (turning + corner) if corner else np.zeros_like(turning),
        }
        for kind, factor in factors.items():
            if np.any(factor):
                one = np.zeros_like(explained), np.zeros_like(displaced)
                one[0][i], one[1][i] = factor * explained[i], factor * displaced[i]
                yield _Change(Nuisance(kind, sensor.name), *one)


def _of_force(record: Record, model: Linear) -> Iterator[_Change]:
    """The measured force is gain times the true one."""
    if record.tolerances.force_gain:
        yield _Change(Nuisance("force gain", "the force"), -record.tolerances.force_gain * model.chain * model.by_force)


def _measured(record: Record, model: Linear) -> list[Complex[np.ndarray, "modes lines"]]:
    """The modal accelerations of each body: as modelled, plus what the sensors show beyond that."""
    beyond = model.residual[: len(record.sensors)] * model.spread / model.chain
    found = []
    for response, motion in zip(model.responses, model.modal, strict=True):
        rows = [i for i, s in enumerate(record.sensors) if s.station.body == response.body.name]
        motion = motion.copy()
        if rows:
            count = min(len(rows), response.count)
            shapes = response.shapes([record.sensors[i].station for i in rows])[:, :count]
            motion[:count] += np.linalg.pinv(shapes) @ beyond[rows]
        found.append(motion)
    return found


def _of_positions(
    record: Record, model: Linear, response: Response, motion: Complex[np.ndarray, "modes lines"]
) -> Iterator[_Change]:
    body = response.body
    rows = [i for i, s in enumerate(record.sensors) if s.station.body == body.name]
    if not (body.length_m and rows):
        return
    twice = integrated(record.omega, -2, CORNER_HZ)
    places = np.array([record.sensors[i].station.position_m for i in rows])
    step = 1e-4 * body.length_m
    right, left = np.minimum(places + step, body.length_m), np.maximum(places - step, 0.0)
    beside = [response.modes.shapes(at, response.count) for at in (right, left)]
    slopes = (beside[0] - beside[1]) / (right - left)[:, None]
    for i, slope in zip(rows, slopes @ motion, strict=True):
        tolerance = record.tolerances.of_sensor(record.sensors[i].name).position_m
        if tolerance:
            change = np.zeros((len(record.sensors), slope.size), dtype=complex)
            change[i] = tolerance * slope
            yield _Change(Nuisance("position", record.sensors[i].name), model.chain * change, twice * change)


def _of_modes(
    record: Record, model: Linear, response: Response, motion: Complex[np.ndarray, "modes lines"]
) -> Iterator[_Change]:
    """The mass of a body; its frequencies and its damping together, and of each mode by itself."""
    body, omega, believed = response.body, record.omega, record.tolerances
    shapes = response.shapes([s.station for s in record.sensors])
    if believed.mass:
        yield _Change(Nuisance("mass", body.name), -believed.mass * model.chain * (shapes @ motion))
    natural_hz, zeta = response.modes.frequencies_hz(response.count), response.modes.damping_ratios(response.count)
    flexible = receptance(natural_hz, zeta, omega / (2 * np.pi)) * motion
    natural = 2 * np.pi * natural_hz[:, None]
    loss = 1j * zeta[:, None] * natural * omega
    per_unit: dict[Kind, Complex[np.ndarray, "modes lines"]] = {
        "frequency": -2 * (natural**2 + loss) * flexible,
        "damping": -2 * loss * flexible,
    }
    flexing = np.arange(response.count) >= body.rigid_modes  # no matter which springs hold the body
    elastic = np.flatnonzero(flexing & (natural_hz < BEYOND * omega[-1] / (2 * np.pi)))
    for kind, change in per_unit.items():
        if common := float(getattr(believed, kind)):
            yield _Change(Nuisance(kind, body.name), common * model.chain * (shapes @ change))
        for m in elastic if not isinstance(body, Oscillator) else []:
            if own := float(getattr(believed.of_mode(body.name, int(m) + 1), kind)):
                yield _Change(
                    Nuisance(kind, body.name, int(m) + 1), own * model.chain * np.outer(shapes[:, m], change[m])
                )


def apply_nuisance(
    rig: Rig,
    parameters: tuple[Nuisance, ...],
    values: Float[np.ndarray, " nuisances"],
    tolerances: Tolerances,
) -> tuple[Rig, Float[np.ndarray, " nuisances"]]:
    """The rig with the values of its single masses and their sensors put into it, and those values, the others zero.

    Those alone bend the residual: a single mass may have been believed from a record of another level, and a resonance
    that lies off by a part of its width is no linear matter. The modes of other bodies are not moved one by one.
    """
    put = np.zeros(len(parameters))
    index = {p: i for i, p in enumerate(parameters)}

    def factor(parameter: Nuisance, tolerance: float) -> float:
        at = index.get(parameter)
        if at is None:
            return 1.0
        put[at] = values[at]
        return max(0.1, 1 + tolerance * float(values[at]))

    bodies: list[Body] = []
    for body in rig.bodies:
        if isinstance(body, Oscillator):
            natural_hz = body.frequency_hz * factor(Nuisance("frequency", body.name), tolerances.frequency)
            ratio = body.damping_ratio * factor(Nuisance("damping", body.name), tolerances.damping)
            bodies.append(replace(body, frequency_hz=natural_hz, damping_ratio=ratio))
        else:
            bodies.append(body)
    single = {b.name for b in rig.bodies if isinstance(b, Oscillator)}
    sensors = tuple(
        replace(s, gain=s.gain * factor(Nuisance("gain", s.name), tolerances.of_sensor(s.name).gain))
        if s.station.body in single
        else s
        for s in rig.sensors
    )
    return replace(rig, bodies=tuple(bodies), sensors=sensors), put


def residual_scale(record: Record) -> float:
    """Makes the residual over time, of lines with a variance of one, have a variance of one."""
    return float(np.sqrt(record.length * record.samples / (2 * record.omega.size)))


def at_contacts(
    record: Record, model: Linear, displaced: Complex[np.ndarray, "sensors lines"]
) -> Complex[np.ndarray, "contacts lines"]:
    """Relative displacements from the sensors at the contacts."""

    def of(contact: Contact) -> Complex[np.ndarray, " lines"]:
        found = np.zeros(displaced.shape[1], dtype=complex)
        for i, sensor in enumerate(record.sensors):
            found += displaced[i] * ((sensor.station == contact.at) * 1.0 - (sensor.station == contact.against) * 1.0)
        return found

    return np.array([of(c) for c in model.rig.contacts], dtype=complex).reshape(-1, displaced.shape[1])
