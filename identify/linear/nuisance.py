"""Nuisance parameters: what a laboratory never knows exactly, and what each would change in what sensors deliver.

With D = omega_m^2 - omega^2 + 2 i zeta_m omega_m omega of a mode, an error dD of it changes its acceleration by
-dD / D of the true one exactly: so the measured modal accelerations stand in these changes.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float, Int

from identify.linear.model import Response, times
from identify.signals.kinematics import CORNER_HZ, integrated
from rig.model.description import Sensor, force_names
from rig.model.tolerances import Tolerances

THE_FORCE = "the force"
THE_RECORD = "the record"

ChainKind = Literal["gain", "delay", "high-pass"]
Kind = Literal["gain", "position", "delay", "high-pass", "force gain", "mass", "frequency", "damping", "initial state"]


@dataclass(frozen=True)
class Nuisance:
    """One nuisance parameter: of a sensor, a body or (mode counts from 1) a mode of a body, of force or record."""

    kind: Kind
    of: str
    mode: int | None = None

    @property
    def name(self) -> str:
        return f"{self.kind} of {self.of}" + ("" if self.mode is None else f" {self.mode}")


@dataclass(frozen=True)
class BodyMotion:
    """A body's modes and their accelerations, of the first ones alone where the others are taken to rest.

    `elastic` are the modes with parameters of their own, from 0.
    """

    response: Response
    acceleration: Complex[np.ndarray, "modes lines"]
    elastic: Int[np.ndarray, " some"]

    @property
    def moving(self) -> slice:
        """The modes that do not rest."""
        return slice(len(self.acceleration))


@dataclass(frozen=True)
class Observed:
    """What sensors deliver of the true motion (explained), the accelerations by each measured force (by_force), and the
    displacements at the sensors' stations, which the sensors `displaced_by` gave.

    sensor_response is what a sensor delivers per acceleration.
    """

    sensors: tuple[Sensor, ...]
    displaced_by: tuple[Sensor, ...]
    tolerances: Tolerances
    omega: Float[np.ndarray, " lines"]
    sensor_response: Complex[np.ndarray, "sensors lines"]
    explained: Complex[np.ndarray, "sensors lines"]
    by_force: Complex[np.ndarray, "forces sensors lines"]
    displaced: Complex[np.ndarray, "sensors lines"]
    bodies: tuple[BodyMotion, ...]


@dataclass(frozen=True)
class Change:
    """What one standard deviation of a parameter adds to what some sensors deliver, and to the displacements there."""

    parameter: Nuisance
    sensors: list[int]
    delivered: Complex[np.ndarray, "some lines"]
    displaced: Complex[np.ndarray, "some lines"] | None = None

    @property
    def in_single_precision(self) -> "Change":
        displaced = None if self.displaced is None else self.displaced.astype(np.complex64)
        return replace(self, delivered=self.delivered.astype(np.complex64), displaced=displaced)


def changes_of(observed: Observed) -> Iterator[Change]:
    """Of every tolerance above zero."""
    yield from _of_sensors(observed)
    yield from _of_force(observed)
    for body in observed.bodies:
        rows = [i for i, s in enumerate(observed.sensors) if s.station.body == body.response.body.name]
        yield from _of_positions(observed, body, rows)
        yield from _of_modes(observed, body, rows)


def _of_sensors(observed: Observed) -> Iterator[Change]:
    """Of each sensor's chain."""
    for i, (sensor, other) in enumerate(zip(observed.sensors, observed.displaced_by, strict=True)):
        for one in dict.fromkeys((sensor, other)):
            for kind, factor in chain_sensitivities(one, observed.tolerances, observed.omega).items():
                if np.any(factor):
                    delivered = factor * observed.explained[[i]] * (one == sensor)
                    displaced = factor * observed.displaced[[i]] if one == other else None
                    yield Change(Nuisance(kind, one.name), [i], delivered, displaced)


def _of_force(observed: Observed) -> Iterator[Change]:
    """A measured force is gain times the true one."""
    names = force_names(len(observed.by_force)) if len(observed.by_force) > 1 else (THE_FORCE,)
    if gain := observed.tolerances.force_gain:
        for name, by_force in zip(names, observed.by_force, strict=True):
            change = -gain * observed.sensor_response * by_force
            yield Change(Nuisance("force gain", name), list(range(len(change))), change)


def _of_positions(observed: Observed, body: BodyMotion, rows: list[int]) -> Iterator[Change]:
    if not (body.response.body.length_m and rows):
        return
    slopes = body.response.slopes([observed.sensors[i].station for i in rows])[:, body.moving]
    twice = integrated(observed.omega, -2, CORNER_HZ)
    for i, slope in zip(rows, slopes @ body.acceleration, strict=True):
        sensor, other = observed.sensors[i], observed.displaced_by[i]
        for one in dict.fromkeys((sensor, other)):
            if tolerance := observed.tolerances.of_sensor(one.name).position_m:
                change = tolerance * slope[None]
                delivered = observed.sensor_response[i] * change * (one == sensor)
                yield Change(Nuisance("position", one.name), [i], delivered, twice * change if one == other else None)


def _of_modes(observed: Observed, motion: BodyMotion, rows: list[int]) -> Iterator[Change]:
    """The mass of a body; its frequencies and its damping together, and of each mode by itself."""
    response, believed = motion.response, observed.tolerances
    body, sensor_response = response.body, observed.sensor_response[rows]
    shapes = response.shapes([observed.sensors[i].station for i in rows])[:, motion.moving]
    if believed.mass:
        change = -believed.mass * sensor_response * times(shapes, motion.acceleration)
        yield Change(Nuisance("mass", body.name), rows, change)
    kinds: tuple[Literal["frequency", "damping"], ...] = ("frequency", "damping")
    for kind in kinds:
        change = response.sensitivity(kind, motion.moving)
        change *= motion.acceleration
        if common := float(getattr(believed, kind)):
            yield Change(Nuisance(kind, body.name), rows, common * sensor_response * times(shapes, change))
        for m in motion.elastic if not body.is_mass else []:
            if own := float(getattr(believed.of_mode(body.name, int(m) + 1), kind)):
                moved = own * sensor_response * (shapes[:, m, None] * change[m])
                yield Change(Nuisance(kind, body.name, int(m) + 1), rows, moved)


def chain_sensitivities(
    sensor: Sensor, tolerances: Tolerances, omega: Float[np.ndarray, " lines"]
) -> dict[ChainKind, Complex[np.ndarray, " lines"]]:
    """The relative change of what a sensor delivers by one tolerance each of its gain g, its delay tau, and the corner
    w of a first-order high-pass i omega / (i omega + w) that an AC-coupled one has: g, -i omega tau, -w / (i omega + w)
    """
    own, turning = tolerances.of_sensor(sensor.name), 1j * omega
    corner = 2 * np.pi * own.high_pass_hz if sensor.measures.ac_coupled else 0.0
    return {
        "gain": np.full(omega.size, own.gain, dtype=complex),
        "delay": -own.delay_s * turning,
        "high-pass": -corner / (turning + corner) if corner else np.zeros_like(turning),
    }
