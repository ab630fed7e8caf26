"""Broken tolerances of rig.json: the nuisance parameter of the linear residual that pulls most.

With the residual r of the linear model (contact forces projected out), columns X of one standard deviation of each
nuisance parameter and a prior of one,

    M = I - X (X' X + I)^-1 X',   z = d' M r / sqrt(d' M d)

is how strongly the record asks for more of a column d than the tolerances allow: a standard normal number, if they
hold. The largest is freed, and the rest are asked again.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import uniform_filter1d

from identify.checks.candidates import Suspect, candidates_of
from identify.checks.prediction import ROUGH, LinearCheck, Predicted
from identify.linear.model import Response, ResponseCache, input_shapes, response_of, times
from identify.linear.nuisance import BodyMotion, Observed, changes_of, elastic_modes
from identify.linear.projection import projection
from rig.model.description import Rig
from rig.model.tolerances import Tolerances

COUNTED_HZ = 20.0
"""So many samples a second count as independent against the tolerances, as errors of a model last."""
BROKEN, CLOCK, FAR = 5.0, 2.7, 4.0
"""A parameter is off if the record asks for it by so many standard deviations, and for so many tolerances."""
MOST, NEXT = 4, 0.25
"""No more are named, and none that is asked for by less than this share of the first."""
STEADY = 2.0
"""Motion that lasts for half of the record is taken to last for all of it."""
AT_ONCE = 1024
"""Samples of all columns that are worked on at once."""
FLOOR = 0.003
"""No model is believed to fit better than to this share of what a body does at a line."""


@dataclass(frozen=True)
class Broken:
    """Broken candidate: its kind, its error in tolerances (or its own unit), how strongly the record asks for it."""

    what: Suspect
    size: float
    pull: float


def broken(
    rig: Rig, check: LinearCheck, kept: list[int], tolerances: Tolerances
) -> tuple[list[Broken], Float[np.ndarray, " nuisances"]]:
    """Up to four parameters that break their tolerances, the strongest first; and the pulls of all others with those
    free."""
    if len(kept) <= check.contacts:
        return [], np.zeros(0)
    observed = _observed(rig, check, kept, tolerances)
    project = Projector(check, kept)
    parameters, columns = [], []
    for change in changes_of(observed):
        parameters.append(change.parameter)
        columns.append(_Column.of(project(change.at_all(len(kept)))))
    if not parameters:
        return [], np.zeros(0)
    candidates, added = candidates_of(
        parameters, observed.bodies, observed.sensors, observed.by_force, observed.omega, tolerances
    )
    columns += [_Column.of(project(spectra)) for spectra in added]
    residual = project((check.spectra.acceleration - check.by_force)[kept])
    return _freed(residual, columns, len(parameters), candidates, tolerances)


def _observed(rig: Rig, check: LinearCheck, kept: list[int], tolerances: Tolerances) -> Observed:
    """The motion as the channels kept show it, with the contact forces that explain it best."""
    sensors, omega = tuple(check.spectra.sensors[i] for i in kept), check.spectra.omega
    modelled, cache = check.predicted(kept), ResponseCache(omega, 0)
    explained = modelled.acceleration[kept]
    return Observed(
        sensors=sensors,
        displaced_by=sensors,
        tolerances=tolerances,
        omega=omega,
        sensor_response=np.ones_like(explained),
        explained=explained,
        by_force=check.by_each_force[:, kept],
        displaced=np.zeros_like(explained),
        bodies=tuple(_body(rig, response_of(rig, body, cache), check, kept, modelled) for body in rig.bodies),
    )


def _freed(
    residual: np.ndarray, columns: list["_Column"], count: int, candidates: list[Suspect], tolerances: Tolerances
) -> tuple[list[Broken], Float[np.ndarray, " nuisances"]]:
    """Candidates freed one after the other, the one that is asked for most strongly first; the first `count` columns
    are those with a prior."""
    freed: list[Broken] = []
    free: list[int] = []
    weights = np.ones(residual.shape[1], residual.dtype)
    while True:
        pulls, z, size = _scores(residual, columns, count, free, weights)
        for _ in range(3):  # lines that nothing explains weigh little
            rest = residual - _along(columns[:count], pulls) - _along([columns[k] for k in free], size.free)
            per_line = np.mean(rest**2, axis=0)
            weights = 1 / np.sqrt(1 + per_line / max(4 * np.median(per_line), np.float32(1)))
            pulls, z, size = _scores(residual, columns, count, free, weights)
        least = NEXT * abs(freed[0].pull) if freed else 0.0
        asked = [
            k
            for k, candidate in enumerate(candidates)
            if k not in free
            and abs(z[k]) > max(_broken(candidate), least)
            and _matters(candidate, float(size.of[k]), tolerances)
        ]
        if not asked or len(freed) == MOST:
            return freed, pulls
        best = max(asked, key=lambda k: abs(z[k]))
        freed.append(Broken(candidates[best], float(size.of[best]), float(z[best])))
        free.append(best)


@dataclass(frozen=True)
class _Column:
    """Column in half precision, in units of its largest value: there are hundreds, and scores need no more."""

    halves: np.ndarray
    largest: np.float32

    @classmethod
    def of(cls, values: np.ndarray) -> "_Column":
        largest = np.float32(max(float(np.max(np.abs(values))), 1e-30))
        return cls((values / largest).astype(np.float16), largest)

    def values(self, part: slice = slice(None)) -> np.ndarray:
        return np.asarray(self.largest * self.halves[:, part].astype(np.float32))


def _along(columns: list[_Column], values: np.ndarray) -> np.ndarray | float:
    return sum((np.float32(value) * column.values() for value, column in zip(values, columns, strict=True)), start=0.0)


@dataclass(frozen=True)
class _Sizes:
    of: Float[np.ndarray, " candidates"]
    free: Float[np.ndarray, " some"]


def _scores(
    left: np.ndarray, columns: list[_Column], count: int, free: list[int], weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, _Sizes]:
    """The pulls of the first `count`, each candidate's score and its size, with the free ones without a prior."""
    fitted = [*range(count), *free]
    products, along = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for first in range(0, left.shape[1], AT_ONCE):
        part = slice(first, first + AT_ONCE)
        rows = np.stack([column.values(part) * weights[part] for column in columns]).reshape(len(columns), -1)
        products += rows @ rows.T
        along += rows @ (left[:, part] * weights[part]).reshape(-1)
    prior = np.r_[np.ones(count), np.full(len(free), 1e-9)]
    inverse = np.linalg.inv(products[np.ix_(fitted, fitted)] + np.diag(prior))
    across = products[:, fitted]
    best = inverse @ along[fitted]
    asked = along - across @ best
    room = np.maximum(np.diag(products) - np.einsum("ij,jk,ik->i", across, inverse, across), 1e-12)
    return best[:count], asked / np.sqrt(room), _Sizes(asked / room, best[count:])


def _broken(candidate: Suspect) -> float:
    """A clock is one question, each of the many tolerances another."""
    return CLOCK if candidate.kind == "clock" else BROKEN


def _matters(candidate: Suspect, size: float, tolerances: Tolerances) -> bool:
    """True if this value is beyond the tolerance."""
    return abs(size) > (1.5 * tolerances.frequency if candidate.kind == "clock" else FAR)


class Projector:
    """Over the scale, with the contact forces, and a force that is doubted, projected out, as real numbers; scaled so
    that a sound record has one."""

    def __init__(self, check: LinearCheck, kept: list[int], doubted: int | None = None) -> None:
        noise = check.spectra.noise[kept]
        level = np.sqrt(np.maximum(check.scale[kept] ** 2 - noise**2, 0)) / ROUGH
        self._scale = np.hypot(FLOOR * level, noise)
        self._scale = np.maximum(self._scale, 1e-9 * self._scale.max())
        unknown = check.unknown(doubted)[:, kept]
        self._projection = projection(unknown / self._scale, self._scale, len(unknown))
        self._spectra = check.spectra
        moving = self._spectra.in_time(check.spectra.acceleration[kept] / self._scale)
        self._counted = np.float32(
            np.sqrt(min(1.0, COUNTED_HZ * lasting_s(moving, self._spectra.per_s) / len(moving.T)))
        )

    def __call__(self, rows: Complex[np.ndarray, "sensors lines"]) -> Float[np.ndarray, "sensors times"]:
        return np.asarray(self._spectra.in_time(self._projection.of(rows)[0]) * self._counted)


def lasting_s(moving: Float[np.ndarray, "sensors times"], per_s: float) -> float:
    """Seconds for which the record tells something: all of it, unless most of the motion falls into less than half.

    Of its power p over time, over a second each, (sum of p)^2 / sum of p^2 is the time for which it lasts.
    """
    power = uniform_filter1d(np.mean(moving**2, axis=0, dtype=float), max(1, round(per_s)))
    return float(min(power.size, STEADY * np.sum(power) ** 2 / np.sum(power**2)) / per_s)


def _body(rig: Rig, response: Response, check: LinearCheck, kept: list[int], modelled: Predicted) -> BodyMotion:
    """Modal accelerations as the forces and the contact forces make them; as many modes as sensors may be off."""
    inputs = input_shapes(rig, response, rig.forces)
    forces = np.concatenate([modelled.forces, modelled.contacts])
    sensors = sum(check.spectra.sensors[i].station.body == response.body.name for i in kept)
    elastic = elastic_modes(response, min(sensors, response.count))
    return BodyMotion(response, response.accelerance * times(inputs.T, forces), elastic)
