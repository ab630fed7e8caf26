"""Location of an unmeasured force: places of every body, pairs between bodies, sensors, a drifting modulus."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Complex

from identify.gaps.unmeasured_force.evidence import Explained, cleared_of, explained, normal, without
from identify.gaps.unmeasured_force.nuisance import drifting
from identify.gaps.unmeasured_force.observed import WhitenedRecord, with_columns
from identify.linear.nuisance import Nuisance, NuisanceKind
from rig.model.description import Rig, Sensor, Station

Kind = Literal["force", "pair", "sensor", "distributed"]
SPACING_M, FINE_M = 0.05, 0.002
LOOKED_AT = 3
"""So many places of each kind, the best with the nuisances held, are judged with them fitted."""
FLAT_PRIOR = 1e4


@dataclass(frozen=True)
class ForcePlace:
    """Place of what may act unmeasured: a force at `stations[0]`, less the same at `stations[1]` of a pair; or a
    sensor's signal of its own; or a modulus of the `bodies` that drifts.
    """

    kind: Kind
    stations: tuple[Station, ...] = ()
    sensor: str = ""
    bodies: tuple[str, ...] = ()


@dataclass(frozen=True)
class Located:
    """The candidate that explains a record best: gain is by how much -2 ln L falls against the same without any.

    error_m is the standard error of the place by the curvature of J. growth is the relative change of the modulus of
    each body over the record, with its standard errors.
    """

    candidate: ForcePlace
    gain: float
    error_m: float
    before: Explained
    after: Explained
    observed: WhitenedRecord
    response: Complex[np.ndarray, "lines rows"]
    growth: tuple[float, ...] = ()
    growth_errors: tuple[float, ...] = ()


def response_of(own: WhitenedRecord, candidate: ForcePlace) -> Complex[np.ndarray, "lines rows"]:
    """Response of the residual to a candidate per newton; to a sensor's per m/s^2."""
    if candidate.kind == "sensor":
        row = [s.name for s in own.record.sensors].index(candidate.sensor)
        only = np.zeros((len(own.record.sensors), own.record.omega.size), dtype=complex)
        only[row] = 1.0
        return own.seen(only)
    first, *others = candidate.stations
    found = own.accelerance(first)
    for other in others:
        found = found - own.accelerance(other)
    return own.seen(found)


def located(own: WhitenedRecord, near: ForcePlace | None = None, within_m: float = 0.1) -> Located:
    """The best candidate of all; `near` looks at its kind only, no further than `within_m` from it."""
    before = without(own)
    places = [c for c in candidates(own.record.rig, own.record.sensors) if near is None or _beside(c, near, within_m)]
    if near is not None and near.kind != "distributed":
        places.append(near)
    cleared = cleared_of(own, before.theta)
    firsts = {c: explained(own, response_of(own, c), before, cleared) for c in places}
    best: list[Located] = []
    for kind in ("force", "pair", "sensor"):
        chosen = sorted((c for c in firsts if c.kind == kind), key=lambda c: firsts[c].criterion)[:LOOKED_AT]
        judged = [(explained(own, response_of(own, c), before), c) for c in chosen]
        if judged:
            after, candidate = min(judged, key=lambda one: one[0].criterion)
            best.append(_located(own, candidate, before, after))
    if near is None or near.kind == "distributed":
        best += [d for d in [_distributed(own, before, near)] if d is not None]
    return _refined(max(best, key=lambda one: one.gain))


def candidates(rig: Rig, sensors: Sequence[Sensor]) -> Iterator[ForcePlace]:
    """Places at every 0.05 m, pairs of bodies side by side, and the sensors that the record is taken from."""
    for body in rig.bodies:
        for place in _places(body.length_m):
            yield ForcePlace("force", (Station(body.name, place),))
    for one, other in combinations(rig.bodies, 2):
        shift = offset_m(rig, one.name, other.name)
        for place in _places(one.length_m):
            if 0 <= place + shift <= other.length_m:
                yield ForcePlace("pair", (Station(one.name, place), Station(other.name, place + shift)))
    if len(sensors) > 1:
        for sensor in sensors:
            yield ForcePlace("sensor", sensor=sensor.name)


def offset_m(rig: Rig, one: str, other: str) -> float:
    """Offset from a place on one body to that beside it on another, by the contacts between them; 0 without any."""
    shifts = []
    for contact in rig.contacts:
        if contact.against is not None and {contact.at.body, contact.against.body} == {one, other}:
            shift = contact.against.position_m - contact.at.position_m
            shifts.append(shift if contact.at.body == one else -shift)
    return float(np.median(shifts)) if shifts else 0.0


def moved(candidate: ForcePlace, by_m: float) -> ForcePlace:
    return replace(candidate, stations=tuple(Station(s.body, s.position_m + by_m) for s in candidate.stations))


def reach_m(rig: Rig, candidate: ForcePlace) -> tuple[float, float]:
    """Reach of a candidate to either side, m."""
    lengths = [rig.body(s.body).length_m for s in candidate.stations]
    return (
        max(-s.position_m for s in candidate.stations),
        min(length - s.position_m for s, length in zip(candidate.stations, lengths, strict=True)),
    )


def _places(length_m: float) -> list[float]:
    if not length_m:
        return [0.0]
    return [float(x) for x in np.linspace(0, length_m, max(2, round(length_m / SPACING_M) + 1))]


def _beside(candidate: ForcePlace, near: ForcePlace, within_m: float) -> bool:
    if candidate.kind != near.kind or candidate.sensor != near.sensor:
        return False
    return all(
        a.body == b.body and abs(a.position_m - b.position_m) <= within_m
        for a, b in zip(candidate.stations, near.stations, strict=True)
    )


def _located(own: WhitenedRecord, candidate: ForcePlace, before: Explained, after: Explained) -> Located:
    gain = before.criterion - after.criterion
    return Located(candidate, gain, 0.0, before, after, own, response_of(own, candidate))


def _refined(found: Located) -> Located:
    """The place to 2 mm by halving steps, each a parabola through J at three places."""
    own, candidate = found.observed, found.candidate
    if not candidate.stations or not own.record.rig.body(candidate.stations[0].body).length_m:
        return found
    known: dict[float, Explained] = {}

    def at(by_m: float) -> float:
        if by_m not in known:
            known[by_m] = explained(own, response_of(own, moved(candidate, by_m)), found.after)
        return known[by_m].criterion

    low, high = reach_m(own.record.rig, candidate)
    best, step = 0.0, SPACING_M / 2
    while True:
        around = [float(np.clip(best + k * step, low, high)) for k in (-1, 0, 1)]
        best = min(around, key=at)
        if step <= FINE_M:
            break
        middle = float(np.clip(_vertex(around, [at(x) for x in around]), low, high))
        best, step = min((best, middle), key=at), step / 3.5
    around = [float(np.clip(best + k * 2 * FINE_M, low, high)) for k in (-2, -1, 0, 1, 2)]
    curved = 2 * float(np.polyfit(around, [at(x) for x in around], 2)[0])
    error = float(np.sqrt(2 / curved)) if curved > 0 else SPACING_M
    there = moved(candidate, best)
    return replace(_located(own, there, found.before, known[best]), error_m=min(error, SPACING_M))


def _vertex(x: list[float], y: list[float]) -> float:
    if len(set(x)) < 3:
        return x[int(np.argmin(y))]
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-b / (2 * a), x[0], x[-1])) if a > 0 else x[int(np.argmin(y))]


def _distributed(own: WhitenedRecord, before: Explained, near: ForcePlace | None) -> Located | None:
    """A modulus that drifts, of one body or of all; the one body where others add little."""
    names = near.bodies if near else tuple(b.name for b in own.record.rig.bodies if b.length_m)
    columns = {name: drifting(own, name) for name in names}
    columns = {name: c for name, c in columns.items() if np.any(c)}
    if not columns:
        return None
    choices = [tuple(columns)] if near else [*((name,) for name in columns), tuple(columns)]
    best: Located | None = None
    for bodies in dict.fromkeys(choices):
        scale = [FLAT_PRIOR / max(float(np.linalg.norm(columns[b])), 1e-300) for b in bodies]
        added = np.stack([s * columns[b] for s, b in zip(scale, bodies, strict=True)])
        wider = with_columns(
            own,
            (*own.parameters, *(Nuisance(NuisanceKind.MODULUS_DRIFT, body) for body in bodies)),
            np.concatenate([own.columns, added]),
            np.append(own.trace, 0.0 * np.array(scale)),
        )
        after = without(wider)
        gain = before.criterion - after.criterion
        growth = tuple(float(v) for v in after.theta[-len(bodies) :] * scale)
        if best is None or gain > 1.05 * best.gain:
            rest = np.zeros(own.residual.shape, dtype=complex)
            covariance = np.linalg.inv(normal(wider, after.noise)[0])
            errors = tuple(float(e) for e in np.sqrt(np.diag(covariance)[-len(bodies) :]) * scale)
            found = ForcePlace("distributed", bodies=bodies)
            best = Located(found, gain, 0.0, before, after, wider, rest, growth, errors)
    return best
