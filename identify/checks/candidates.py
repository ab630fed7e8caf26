"""Candidates of what may be off: every nuisance parameter, and common errors that several parameters share."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.linear.model import times
from identify.linear.nuisance import BodyMotion, Nuisance
from rig.model.description import Sensor, force_names
from rig.model.tolerances import Tolerances


@dataclass(frozen=True)
class Suspect:
    """A nuisance parameter, or a common error of several. One unit of its column is so much, relative or in SI."""

    kind: str
    of: str
    unit: float


def candidates_of(
    parameters: list[Nuisance],
    bodies: tuple[BodyMotion, ...],
    sensors: tuple[Sensor, ...],
    by_force: Complex[np.ndarray, "forces sensors lines"],
    omega: Float[np.ndarray, " lines"],
    tolerances: Tolerances,
) -> tuple[list[Suspect], Complex[np.ndarray, "added sensors lines"]]:
    """All nuisance parameters; then, with columns of their own, densities, a clock that is off and forces that come
    late."""
    found = [_of(p, tolerances) for p in parameters]
    added = []
    clock = np.zeros_like(by_force[0])
    for body in bodies:
        r = body.response
        rows = [i for i, s in enumerate(sensors) if s.station.body == r.body.name]
        shapes = r.shapes([sensors[i].station for i in rows])
        tuned = times(shapes, r.sensitivity("frequency") * body.acceleration)
        clock[rows] += tuned
        if r.body.length_m and tolerances.mass:
            heavier = np.zeros_like(clock)
            heavier[rows] = -tolerances.mass * (times(shapes, body.acceleration) + 0.5 * tuned)
            added.append((Suspect("density", r.body.name, tolerances.mass), heavier))
    added.append((Suspect("clock", "", 1.0), clock))
    if tolerances.delay_s:
        for name, row in zip(force_names(len(by_force)), by_force, strict=True):
            added.append((Suspect("force delay", name, tolerances.delay_s), 1j * omega * tolerances.delay_s * row))
    return [*found, *(a for a, _ in added)], np.stack([column for _, column in added])


def _of(parameter: Nuisance, tolerances: Tolerances) -> Suspect:
    own = tolerances.of_sensor(parameter.of)
    unit = {
        "gain": own.gain,
        "position": own.position_m,
        "delay": own.delay_s,
        "high-pass": own.high_pass_hz,
        "force gain": tolerances.force_gain,
        "mass": tolerances.mass,
        "frequency": tolerances.frequency,
        "damping": tolerances.damping,
    }[parameter.kind]
    of = parameter.of + ("" if parameter.mode is None else f" {parameter.mode}")
    return Suspect(parameter.kind, of, unit)
