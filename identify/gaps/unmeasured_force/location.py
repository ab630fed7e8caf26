"""Location of an unmeasured force: the candidate of the lowest J among places of every body, pairs of opposite forces
between bodies, sensors with a signal of their own, and moduli that drift."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Complex

from identify.gaps.unmeasured_force.evidence import (
    ForceEvidence,
    evidence_with_force,
    evidence_without_force,
    nuisance_equations,
    subtract_nuisance,
)
from identify.gaps.unmeasured_force.nuisance import modulus_drift_column
from identify.gaps.unmeasured_force.whitened_record import WhitenedRecord, with_columns
from identify.linear.nuisance import Nuisance, NuisanceKind
from rig.model.description import Rig, Sensor, Station

Kind = Literal["force", "pair", "sensor", "distributed"]
SPACING_M, FINE_M = 0.05, 0.002
"""Spacing of the scan over places, and of its refinement. Set by hand: below the wavelength of any mode in the band;
the place of a strong force is known to some mm."""
REFITTED_PER_KIND = 3
"""Count of candidates of each kind, the best with theta fixed, whose J is computed again with theta fitted. Effort."""
FLAT_PRIOR = 1e4
"""Norm of a drift's column at one prior standard deviation: in effect no prior."""


@dataclass(frozen=True)
class ForcePlace:
    """Candidate of an unmeasured force by its kind: "force" at one station, "pair" with the opposite force at a second
    station, "sensor" with a signal of its own, or "distributed", a modulus of the `bodies` that drifts.
    """

    kind: Kind
    stations: tuple[Station, ...] = ()
    sensor: str = ""
    bodies: tuple[str, ...] = ()


@dataclass(frozen=True)
class LocatedForce:
    """Candidate fitted to a record; criterion_decrease is that of J against the record without a force.

    error_m is the standard error of the position by the curvature of J. response is g, the residual per unit force.
    growth is the relative change of the modulus of each body over the record, with its standard errors.
    """

    candidate: ForcePlace
    criterion_decrease: float
    error_m: float
    without_force: ForceEvidence
    with_force: ForceEvidence
    whitened: WhitenedRecord
    response: Complex[np.ndarray, "lines rows"]
    growth: tuple[float, ...] = ()
    growth_errors: tuple[float, ...] = ()


def response_of(whitened: WhitenedRecord, candidate: ForcePlace) -> Complex[np.ndarray, "lines rows"]:
    """Response g of the residual per newton of a candidate's force, or per m/s^2 of a sensor's own signal."""
    if candidate.kind == "sensor":
        row = [s.name for s in whitened.record.sensors].index(candidate.sensor)
        unit_signal = np.zeros((len(whitened.record.sensors), whitened.record.omega.size), dtype=complex)
        unit_signal[row] = 1.0
        return whitened.ungated_residual(unit_signal)
    first, *opposing = candidate.stations
    accelerances = whitened.accelerance(first)
    for station in opposing:
        accelerances = accelerances - whitened.accelerance(station)
    return whitened.ungated_residual(accelerances)


def locate_force(whitened: WhitenedRecord, expected: ForcePlace | None = None, radius_m: float = 0.1) -> LocatedForce:
    """Candidate with the largest gain, its position refined.

    With an `expected` one only its kind, no further than radius_m from it, is tried.
    """
    without_force = evidence_without_force(whitened)
    places = [
        c
        for c in candidates(whitened.record.rig, whitened.record.sensors)
        if expected is None or _within_radius(c, expected, radius_m)
    ]
    if expected is not None and expected.kind != "distributed":
        places.append(expected)
    cleared_residual = subtract_nuisance(whitened, without_force.theta)
    screened = {
        c: evidence_with_force(whitened, response_of(whitened, c), without_force, cleared_residual) for c in places
    }
    best_of_kinds: list[LocatedForce] = []
    for kind in ("force", "pair", "sensor"):
        chosen = sorted((c for c in screened if c.kind == kind), key=lambda c: screened[c].criterion)[
            :REFITTED_PER_KIND
        ]
        refitted = [(evidence_with_force(whitened, response_of(whitened, c), without_force), c) for c in chosen]
        if refitted:
            with_force, candidate = min(refitted, key=lambda choice: choice[0].criterion)
            best_of_kinds.append(_located_force(whitened, candidate, without_force, with_force))
    if expected is None or expected.kind == "distributed":
        best_of_kinds += [d for d in [_locate_drift(whitened, without_force, expected)] if d is not None]
    return _refine_position(max(best_of_kinds, key=lambda choice: choice.criterion_decrease))


def candidates(rig: Rig, sensors: Sequence[Sensor]) -> Iterator[ForcePlace]:
    """Candidates: every 0.05 m of each body, pairs side by side on two bodies, and the record's sensors if several."""
    for body in rig.bodies:
        for position_m in _grid_m(body.length_m):
            yield ForcePlace("force", (Station(body.name, position_m),))
    for first, second in combinations(rig.bodies, 2):
        shift_m = offset_m(rig, first.name, second.name)
        for position_m in _grid_m(first.length_m):
            if 0 <= position_m + shift_m <= second.length_m:
                yield ForcePlace("pair", (Station(first.name, position_m), Station(second.name, position_m + shift_m)))
    if len(sensors) > 1:
        for sensor in sensors:
            yield ForcePlace("sensor", sensor=sensor.name)


def offset_m(rig: Rig, from_body: str, to_body: str) -> float:
    """Offset from a position on one body to that beside it on the other: the median over the contacts between them, 0
    without any."""
    offsets_m = []
    for contact in rig.contacts:
        if contact.against is not None and {contact.at.body, contact.against.body} == {from_body, to_body}:
            distance_m = contact.against.position_m - contact.at.position_m
            offsets_m.append(distance_m if contact.at.body == from_body else -distance_m)
    return float(np.median(offsets_m)) if offsets_m else 0.0


def _shifted(candidate: ForcePlace, shift_m: float) -> ForcePlace:
    return replace(candidate, stations=tuple(Station(s.body, s.position_m + shift_m) for s in candidate.stations))


def _shift_range_m(rig: Rig, candidate: ForcePlace) -> tuple[float, float]:
    """Lowest and highest shift (m) with which every station stays on its body."""
    lengths = [rig.body(s.body).length_m for s in candidate.stations]
    return (
        max(-s.position_m for s in candidate.stations),
        min(length - s.position_m for s, length in zip(candidate.stations, lengths, strict=True)),
    )


def _grid_m(length_m: float) -> list[float]:
    """Positions (m) along a body, evenly spaced by about `SPACING_M`; 0 alone on a point mass."""
    if not length_m:
        return [0.0]
    return [float(x) for x in np.linspace(0, length_m, max(2, round(length_m / SPACING_M) + 1))]


def _within_radius(candidate: ForcePlace, expected: ForcePlace, radius_m: float) -> bool:
    if candidate.kind != expected.kind or candidate.sensor != expected.sensor:
        return False
    return all(
        a.body == b.body and abs(a.position_m - b.position_m) <= radius_m
        for a, b in zip(candidate.stations, expected.stations, strict=True)
    )


def _located_force(
    whitened: WhitenedRecord, candidate: ForcePlace, without_force: ForceEvidence, with_force: ForceEvidence
) -> LocatedForce:
    criterion_decrease = without_force.criterion - with_force.criterion
    return LocatedForce(
        candidate, criterion_decrease, 0.0, without_force, with_force, whitened, response_of(whitened, candidate)
    )


def _refine_position(estimate: LocatedForce) -> LocatedForce:
    """Candidate at the minimum of J over its shift, to `FINE_M`: each round takes the vertex of a parabola through J at
    three shifts, then a shorter step. Its standard error follows from the curvature of J."""
    whitened, candidate = estimate.whitened, estimate.candidate
    if not candidate.stations or not whitened.record.rig.body(candidate.stations[0].body).length_m:
        return estimate
    evidence: dict[float, ForceEvidence] = {}

    def criterion_at(shift_m: float) -> float:
        if shift_m not in evidence:
            evidence[shift_m] = evidence_with_force(
                whitened, response_of(whitened, _shifted(candidate, shift_m)), estimate.with_force
            )
        return evidence[shift_m].criterion

    low, high = _shift_range_m(whitened.record.rig, candidate)
    best_m, step_m = 0.0, SPACING_M / 2
    while True:
        shifts_m = [float(np.clip(best_m + k * step_m, low, high)) for k in (-1, 0, 1)]
        best_m = min(shifts_m, key=criterion_at)
        if step_m <= FINE_M:
            break
        vertex_m = float(np.clip(_parabola_vertex(shifts_m, [criterion_at(x) for x in shifts_m]), low, high))
        best_m, step_m = min((best_m, vertex_m), key=criterion_at), step_m / 3.5
    shifts_m = [float(np.clip(best_m + k * 2 * FINE_M, low, high)) for k in (-2, -1, 0, 1, 2)]
    curvature = 2 * float(np.polyfit(shifts_m, [criterion_at(x) for x in shifts_m], 2)[0])
    error = float(np.sqrt(2 / curvature)) if curvature > 0 else SPACING_M
    place = _shifted(candidate, best_m)
    return replace(
        _located_force(whitened, place, estimate.without_force, evidence[best_m]), error_m=min(error, SPACING_M)
    )


def _parabola_vertex(x: list[float], y: list[float]) -> float:
    """Minimum of the parabola through three points within their range, or the lowest point if it has none."""
    if len(set(x)) < 3:
        return x[int(np.argmin(y))]
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-b / (2 * a), x[0], x[-1])) if a > 0 else x[int(np.argmin(y))]


def _locate_drift(
    whitened: WhitenedRecord, without_force: ForceEvidence, expected: ForcePlace | None
) -> LocatedForce | None:
    """Drift of the modulus of one body, or of all bodies together if that gains 5 % more; None if no body shows any."""
    names = expected.bodies if expected else tuple(b.name for b in whitened.record.rig.bodies if b.length_m)
    columns = {name: modulus_drift_column(whitened, name) for name in names}
    columns = {name: c for name, c in columns.items() if np.any(c)}
    if not columns:
        return None
    choices = [tuple(columns)] if expected else [*((name,) for name in columns), tuple(columns)]
    best: LocatedForce | None = None
    for bodies in dict.fromkeys(choices):
        scale = [FLAT_PRIOR / max(float(np.linalg.norm(columns[b])), 1e-300) for b in bodies]
        drift_columns = np.stack([s * columns[b] for s, b in zip(scale, bodies, strict=True)])
        extended = with_columns(
            whitened,
            (*whitened.parameters, *(Nuisance(NuisanceKind.MODULUS_DRIFT, body) for body in bodies)),
            np.concatenate([whitened.columns, drift_columns]),
            np.append(whitened.trace_terms, 0.0 * np.array(scale)),
        )
        with_force = evidence_without_force(extended)
        criterion_decrease = without_force.criterion - with_force.criterion
        growth = tuple(float(v) for v in with_force.theta[-len(bodies) :] * scale)
        if best is None or criterion_decrease > max(best.criterion_decrease, 1.05 * best.criterion_decrease):
            no_response = np.zeros(whitened.residual.shape, dtype=complex)
            covariance = np.linalg.inv(nuisance_equations(extended, with_force.noise)[0])
            errors = tuple(float(e) for e in np.sqrt(np.diag(covariance)[-len(bodies) :]) * scale)
            place = ForcePlace("distributed", bodies=bodies)
            best = LocatedForce(
                place, criterion_decrease, 0.0, without_force, with_force, extended, no_response, growth, errors
            )
    return best
