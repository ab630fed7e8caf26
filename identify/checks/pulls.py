"""Which tolerance of rig.json is broken: nuisance parameters fitted to the linear residual, and the one that pulls most.

With the residual r of the linear model (contact forces projected out), columns X of one standard deviation of each
nuisance parameter and a prior of one,

    M = I - X (X' X + I)^-1 X',   z = d' M r / sqrt(d' M d)

is how strongly the record asks for more of a column d than the tolerances allow: a standard normal number, if they
hold. The largest is freed, and the rest are asked again.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from identify.checks.findings import Finding
from identify.checks.prediction import ROUGH, LinearCheck, Predicted
from identify.structure.nuisance import BodyMotion, Change, Nuisance, Observed, changes_of
from identify.structure.response import Response, across, response_of, times
from rig.model.description import Rig
from rig.model.tolerances import Tolerances

COUNTED_HZ = 20.0
"""So many samples a second count as independent against the tolerances, as errors of a model last."""
BROKEN, CLOCK, FAR = 5.0, 2.7, 4.0
"""A parameter is off if the record asks for it by so many standard deviations, and for so many tolerances."""
MOST, NEXT = 4, 0.25
"""No more are named, and none that is asked for by less than this share of the first."""
FLOOR = 0.003
"""No model is believed to fit better than to this share of what a body does at a line."""
Columns = Complex[np.ndarray, "some sensors lines"]


@dataclass(frozen=True)
class Broken:
    """What a candidate is, by how many tolerances (or in its own unit) it is off, and how strongly it is asked for."""

    what: "Candidate"
    size: float
    pull: float


@dataclass(frozen=True)
class Candidate:
    """A nuisance parameter, or a common error of several: kind, what it is of, one of its units in relative or SI."""

    kind: str
    of: str
    unit: float


def broken(
    rig: Rig, check: LinearCheck, kept: list[int], tolerances: Tolerances
) -> tuple[list[Broken], Float[np.ndarray, " nuisances"]]:
    """Up to four parameters that break their tolerances, the strongest first; and the pulls of all others with those
    free."""
    if len(kept) <= check.contacts:
        return [], np.zeros(0)
    sensors = tuple(check.spectra.sensors[i] for i in kept)
    omega, measured = check.spectra.omega, check.spectra.acceleration[kept]
    responses = [response_of(rig, body, omega) for body in rig.bodies]
    by_force = check.accelerance[0][kept] * check.spectra.force
    modelled = check.predicted(kept)
    bodies = tuple(_body(rig, r, check, kept, modelled) for r in responses)
    changes = list(
        changes_of(
            Observed(
                sensors=sensors,
                displaced_by=sensors,
                tolerances=tolerances,
                omega=omega,
                sensor_response=np.ones_like(measured),
                explained=modelled.acceleration[kept],
                by_force=by_force,
                displaced=np.zeros_like(measured),
                bodies=bodies,
            )
        )
    )
    if not changes:
        return [], np.zeros(0)
    columns = np.stack([_whole(c, measured.shape) for c in changes])
    candidates, added = _candidates(changes, columns, bodies, sensors, by_force, omega, tolerances)
    project = Projector(check, kept)
    left = project(measured - by_force)
    own, beside = project.of(columns), project.of(added)
    whole = np.concatenate([own, beside])
    found: list[Broken] = []
    free: list[int] = []
    weights = np.ones(left.shape[1])
    for _ in range(MOST + 1):
        pulls, z, size = _scores(left, own, whole, free, weights)
        for _ in range(3):  # lines that nothing explains weigh little
            unexplained = left - np.tensordot(pulls, own, axes=1) - _along(whole, free, size.free)
            per_line = np.mean(unexplained**2, axis=0)
            weights = 1 / np.sqrt(1 + per_line / max(4 * float(np.median(per_line)), 1.0))
            pulls, z, size = _scores(left, own, whole, free, weights)
        ranked = sorted(range(len(candidates)), key=lambda k: -abs(z[k]))
        least = NEXT * abs(found[0].pull) if found else 0.0

        def asked(k: int, z: np.ndarray = z, size: _Sizes = size, least: float = least) -> bool:
            return abs(z[k]) > max(_broken(candidates[k]), least) and _matters(candidates[k], size.of[k], tolerances)

        best = next((k for k in ranked if k not in free and asked(k)), None)
        if best is None or len(found) == MOST:
            break
        found.append(Broken(candidates[best], float(size.of[best]), float(z[best])))
        free.append(best)
    return found, pulls


def _along(whole: np.ndarray, free: list[int], values: np.ndarray) -> np.ndarray | float:
    return np.tensordot(values, whole[free], axes=1) if free else 0.0


@dataclass(frozen=True)
class _Sizes:
    of: Float[np.ndarray, " candidates"]
    free: Float[np.ndarray, " some"]


def _scores(
    left: np.ndarray, own: np.ndarray, whole: np.ndarray, free: list[int], weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, _Sizes]:
    """The pulls, each candidate's score and its size, with the free ones without a prior."""
    wide = np.concatenate([own, whole[free]]) if free else own
    flat, rows, target = ((x * weights).reshape(*x.shape[:-2], -1) for x in (wide, whole, left))
    prior = np.r_[np.ones(len(own)), np.full(len(free), 1e-9)]
    inverse = np.linalg.inv(flat @ flat.T + np.diag(prior))
    across = rows @ flat.T
    best = inverse @ (flat @ target)
    asked = rows @ target - across @ best
    room = np.maximum(np.sum(rows**2, axis=1) - np.einsum("ij,jk,ik->i", across, inverse, across), 1e-12)
    return best[: len(own)], asked / np.sqrt(room), _Sizes(asked / room, best[len(own) :])


def _broken(candidate: Candidate) -> float:
    """A clock is one question, each of the many tolerances another."""
    return CLOCK if candidate.kind == "clock" else BROKEN


def _matters(candidate: Candidate, size: float, tolerances: Tolerances) -> bool:
    """Whether so much is beyond the tolerance."""
    if candidate.kind == "clock":
        return abs(size) > 1.5 * tolerances.frequency
    return abs(size) > FAR * (candidate.unit if candidate.kind in ("density", "common delay") else 1.0)


class Projector:
    """Over the scale, with the contact forces projected out, as real numbers; scaled so that a sound record has one."""

    def __init__(self, check: LinearCheck, kept: list[int]) -> None:
        noise = check.spectra.noise[kept]
        level = np.sqrt(np.maximum(check.scale[kept] ** 2 - noise**2, 0)) / ROUGH
        self._scale = np.hypot(FLOOR * level, noise)
        self._scale = np.maximum(self._scale, 1e-9 * self._scale.max())
        unknown = (check.accelerance[1:][:, kept] / self._scale).transpose(2, 1, 0)
        self._basis = np.linalg.qr(unknown)[0] if unknown.shape[2] else None
        self._spectra = check.spectra

    def __call__(self, rows: Complex[np.ndarray, "sensors lines"]) -> Float[np.ndarray, "sensors times"]:
        return np.asarray(self.of(rows[None])[0])

    def of(self, columns: Columns) -> Float[np.ndarray, "some sensors times"]:
        weighted = columns / self._scale
        if self._basis is not None:
            inputs = np.einsum("lsi,ksl->kil", self._basis.conj(), weighted, optimize=True)
            weighted = weighted - np.einsum("lsi,kil->ksl", self._basis, inputs, optimize=True)
        found = self._spectra.in_time(weighted)
        begin, end = self._spectra.taken_s
        return np.asarray(found * np.float32(np.sqrt(min(1.0, COUNTED_HZ * (end - begin) / found.shape[-1]))))


def _whole(change: Change, shape: tuple[int, ...]) -> Complex[np.ndarray, "sensors lines"]:
    found = np.zeros(shape, dtype=complex)
    found[change.sensors] = change.delivered
    return found


def _body(rig: Rig, response: Response, check: LinearCheck, kept: list[int], modelled: Predicted) -> BodyMotion:
    """Modal accelerations as the force and the contact forces make them; as many modes as sensors may be off."""
    pushed = np.concatenate([response.shapes([rig.force_at]), -across(rig, response)])
    forces = np.concatenate([modelled.force[None], modelled.contacts])
    told = sum(check.spectra.sensors[i].station.body == response.body.name for i in kept)
    elastic = np.arange(response.body.rigid_modes, min(told, response.count))
    return BodyMotion(response, response.accelerance * times(pushed.T, forces), elastic)


def _candidates(
    changes: list[Change],
    columns: Columns,
    bodies: tuple[BodyMotion, ...],
    sensors: tuple,
    by_force: Complex[np.ndarray, "sensors lines"],
    omega: Float[np.ndarray, " lines"],
    tolerances: Tolerances,
) -> tuple[list[Candidate], Columns]:
    """All nuisance parameters; then a clock that is off, a density, and delays and gains that several share."""
    found = [_named(c.parameter, tolerances) for c in changes]
    added = []
    clock = np.zeros_like(by_force)
    for body in bodies:
        r = body.response
        rows = [i for i, s in enumerate(sensors) if s.station.body == r.body.name]
        shapes = r.shapes([sensors[i].station for i in rows])
        tuned = times(shapes, r.sensitivities["frequency"] * body.acceleration)
        clock[rows] += tuned
        heavier = np.zeros_like(by_force)
        heavier[rows] = -tolerances.mass * (times(shapes, body.acceleration) + 0.5 * tuned)
        if r.body.length_m and tolerances.mass:
            added.append((Candidate("density", r.body.name, 1.0), heavier))
    added.append((Candidate("clock", "", 1.0), clock))
    if tolerances.delay_s:
        late = -1j * omega * tolerances.delay_s * -by_force
        added.append((Candidate("force delay", "force", tolerances.delay_s), late))
    return [*found, *(a for a, _ in added)], np.concatenate([columns, np.stack([c for _, c in added])])[len(columns) :]


def _named(parameter: Nuisance, tolerances: Tolerances) -> Candidate:
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
    return Candidate(parameter.kind, of, unit)


def broken_finding(found: Broken) -> Finding:
    """In words."""
    what, size = found.what, found.size * found.what.unit
    asked = f"({abs(found.size):.0f} tolerances)"
    if what.kind == "clock":
        return Finding(
            cause="clock",
            evidence=f"all modes of all bodies lie {100 * size:+.2g} % off the frequencies of rig.json",
            mend="check the sampling rate: a clock that is off shifts all frequencies alike",
        )
    if what.kind in ("force gain",):
        return Finding(
            cause="gain",
            channels=("force",),
            evidence=f"the force is {100 * size:+.2g} % off what all sensors imply {asked}",
            mend="calibrate the load cell, or check all masses of rig.json",
        )
    if what.kind == "force delay":
        return Finding(
            cause="delay",
            channels=("force",),
            evidence=f"the force comes {1e3 * abs(size):.2g} ms {'late' if size > 0 else 'early'} against all sensors",
            mend="synchronise the force's clock with the sensors'",
        )
    if what.kind in ("mass", "density"):
        return Finding(
            cause="mass",
            of=what.of,
            evidence=f"{what.of} moves as if its {what.kind} were {100 * size * (1 if what.kind == 'mass' else 0.003):+.2g} % off rig.json {asked}",
            mend="weigh it and correct rig.json",
        )
    if what.kind in ("frequency", "damping"):
        return Finding(
            cause="frequency" if what.kind == "frequency" else "damping",
            of=what.of,
            evidence=f"the {what.kind} of {what.of} is {100 * size:+.2g} % off rig.json {asked}",
            mend="fit rig.json to a modal test, or widen its tolerance if it is known no better",
        )
    sizes = {
        "gain": f"delivers {100 * size:+.2g} % more or less than the others and the model say",
        "position": f"moves as if it stood {1e3 * size:+.3g} mm from its station",
        "delay": f"comes {1e3 * abs(size):.2g} ms {'late' if size > 0 else 'early'} against the others",
        "high-pass": f"is high-passed at about {abs(size):.2g} Hz",
    }
    mends = {
        "gain": "calibrate it again",
        "position": "measure its place and correct rig.json",
        "delay": f"set delay_s = {size:.2g} in rig.json, or synchronise its clock",
        "high-pass": "take the coupling off, or widen high_pass_hz of its tolerance",
    }
    cause = {"gain": "gain", "position": "station", "delay": "delay", "high-pass": "filtered"}[what.kind]
    return Finding(
        cause=cause, channels=(what.of,), evidence=f"{what.of} {sizes[what.kind]} {asked}", mend=mends[what.kind]
    )
