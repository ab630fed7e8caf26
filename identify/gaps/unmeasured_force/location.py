"""Location of an unmeasured force: the candidate of the lowest J among places of every body, pairs of opposite forces
between bodies, sensors with a signal of their own, and moduli that drift."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from identify.gaps.unmeasured_force.evidence import (
    ForceEvidence,
    evidence_with_force,
    evidence_without_force,
    nuisance_equations,
    residual_without_nuisance,
)
from identify.gaps.unmeasured_force.nuisance import modulus_drift_column
from identify.gaps.unmeasured_force.whitened_record import WhitenedRecord, with_columns, without_nuisance_columns
from identify.linear.nuisance import Nuisance, NuisanceKind
from rig.model.description import Rig, Sensor, Station

PlaceKind = Literal["force", "pair", "sensor", "distributed"]
PLACE_SPACING_M, FINE_SPACING_M = 0.05, 0.002
"""Spacing of the scan over places, and of its refinement. Set by hand: below the wavelength of any mode in the band;
the place of a strong force is known to some mm."""
REFITTED_COUNT_PER_KIND = 3
"""Count of candidates of each kind, the best with theta fixed, whose J is computed again with theta fitted. Effort."""
FLAT_PRIOR_COLUMN_NORM = 1e4
"""Norm of a drift's column at one prior standard deviation: in effect no prior."""
DRIFT_ERROR_SHARE = 0.01
"""Standard error of a drift, relative to it, beside scatter: it is linearised, and the model of the rest is not exact.
Set by hand on five blind cases (seeds 99403, 99406, 99412 to 99414)."""


@dataclass(frozen=True)
class ForcePlace:
    """Candidate of an unmeasured force by its kind: "force" at one station, "pair" with the opposite force at a second
    station, "sensor" with a signal of its own, or "distributed", a modulus of the `body_names` that drifts.
    """

    kind: PlaceKind
    stations: tuple[Station, ...] = ()
    sensor_name: str = ""
    body_names: tuple[str, ...] = ()

    def is_near(self, compared_place: "ForcePlace", distance_m: float) -> bool:
        """True if both are of one kind, on the same sensor or bodies, with no station further off than distance_m."""
        if replace(self, stations=()) != replace(compared_place, stations=()):
            return False
        return all(
            station.body == other_station.body and abs(station.position_m - other_station.position_m) <= distance_m
            for station, other_station in zip(self.stations, compared_place.stations, strict=True)
        )


@dataclass(frozen=True)
class LocatedForce:
    """Candidate of an unmeasured force fitted to a record.

    residual_per_force is g; position_error_m is the standard error by the curvature of J. modulus_growth is the
    relative change of the modulus of each body over the record, with its standard errors.
    """

    force_place: ForcePlace
    without_force: ForceEvidence
    with_force: ForceEvidence
    whitened_record: WhitenedRecord
    residual_per_force: Complex[np.ndarray, "lines rows"]
    position_error_m: float = 0.0
    modulus_growth: tuple[float, ...] = ()
    modulus_growth_errors: tuple[float, ...] = ()

    @property
    def criterion_decrease(self) -> float:
        """Decrease of J against the record without a force."""
        return self.without_force.criterion - self.with_force.criterion

    @property
    def noise_by_line(self) -> Float[np.ndarray, " lines"]:
        """Variance s of the unexplained rest at each line."""
        return self.whitened_record.at_each_line(self.with_force.noise_variance)

    @property
    def spectrum_by_line(self) -> Float[np.ndarray, " lines"]:
        """Spectrum S of the force at each line."""
        return self.whitened_record.at_each_line(self.with_force.force_spectrum)


def response_of(whitened: WhitenedRecord, force_place: ForcePlace) -> Complex[np.ndarray, "lines rows"]:
    """Response g of the residual per newton of a candidate's force, or per m/s^2 of a sensor's own signal."""
    if force_place.kind == "sensor":
        sensor_names = [sensor.name for sensor in whitened.record.sensors]
        unit_signal = np.zeros((len(sensor_names), whitened.record.omega.size), dtype=complex)
        unit_signal[sensor_names.index(force_place.sensor_name)] = 1.0
        return whitened.ungated_residual(unit_signal)
    station, *opposing_stations = force_place.stations
    accelerances = whitened.accelerance(station)
    for station in opposing_stations:
        accelerances = accelerances - whitened.accelerance(station)
    return whitened.ungated_residual(accelerances)


def locate_force(
    whitened: WhitenedRecord, expected_place: ForcePlace | None = None, search_radius_m: float = 0.1
) -> LocatedForce:
    """Candidate with the largest gain, its position refined.

    With an `expected_place` its kind alone is tried, no further than search_radius_m from it.
    """
    without_force = evidence_without_force(whitened)
    candidate_places = list(force_places(whitened.record.rig, whitened.record.motion_sensors))
    if expected_place:
        candidate_places = [place for place in candidate_places if place.is_near(expected_place, search_radius_m)]
        candidate_places += [expected_place] * (expected_place.kind != "distributed")
    cleared_residual = residual_without_nuisance(whitened, without_force.theta)
    criteria = {
        place: evidence_with_force(whitened, response_of(whitened, place), without_force, cleared_residual).criterion
        for place in candidate_places
    }
    best_by_kind: list[LocatedForce] = []
    for kind in ("force", "pair", "sensor"):
        places_of_kind = sorted((place for place in criteria if place.kind == kind), key=criteria.__getitem__)
        refitted_forces = []
        for place in places_of_kind[:REFITTED_COUNT_PER_KIND]:
            residual_response = response_of(whitened, place)
            with_force = evidence_with_force(whitened, residual_response, without_force)
            refitted_forces.append(LocatedForce(place, without_force, with_force, whitened, residual_response))
        if refitted_forces:
            best_by_kind.append(min(refitted_forces, key=lambda located: located.with_force.criterion))
    if expected_place is None or expected_place.kind == "distributed":
        drift_force = _locate_modulus_drift(whitened, without_force, expected_place)
        best_by_kind += [drift_force] if drift_force else []
    return _with_refined_position(max(best_by_kind, key=lambda located: located.criterion_decrease))


def force_places(rig: Rig, sensors: Sequence[Sensor]) -> Iterator[ForcePlace]:
    """Candidates: every 0.05 m of each body, pairs side by side on two bodies, and the record's sensors if several."""
    for body in rig.bodies:
        for position_m in _position_grid_m(body.length_m):
            yield ForcePlace("force", (Station(body.name, position_m),))
    for first_body, second_body in combinations(rig.bodies, 2):
        shift_m = position_offset_m(rig, first_body.name, second_body.name)
        for position_m in _position_grid_m(first_body.length_m):
            if 0 <= position_m + shift_m <= second_body.length_m:
                stations = Station(first_body.name, position_m), Station(second_body.name, position_m + shift_m)
                yield ForcePlace("pair", stations)
    if len(sensors) > 1:
        for sensor in sensors:
            yield ForcePlace("sensor", sensor_name=sensor.name)


def position_offset_m(rig: Rig, from_body_name: str, to_body_name: str) -> float:
    """Offset from a position on one body to that beside it on the other: the median over the contacts between them, 0
    without any."""
    offsets_m = []
    for contact in rig.contacts:
        if contact.against is not None and {contact.at.body, contact.against.body} == {from_body_name, to_body_name}:
            distance_m = contact.against.position_m - contact.at.position_m
            offsets_m.append(distance_m if contact.at.body == from_body_name else -distance_m)
    return float(np.median(offsets_m)) if offsets_m else 0.0


def _shifted_place(place: ForcePlace, shift_m: float) -> ForcePlace:
    shifted_stations = tuple(Station(station.body, station.position_m + shift_m) for station in place.stations)
    return replace(place, stations=shifted_stations)


def _shift_range_m(rig: Rig, place: ForcePlace) -> tuple[float, float]:
    """Lowest and highest shift (m) with which every station stays on its body."""
    return (
        max(-station.position_m for station in place.stations),
        min(rig.body(station.body).length_m - station.position_m for station in place.stations),
    )


def _position_grid_m(length_m: float) -> list[float]:
    """Positions (m) along a body, evenly spaced by about `PLACE_SPACING_M`; 0 alone on a point mass."""
    if not length_m:
        return [0.0]
    return np.linspace(0, length_m, max(2, round(length_m / PLACE_SPACING_M) + 1)).tolist()


def _with_refined_position(located: LocatedForce) -> LocatedForce:
    """Candidate at the minimum of J over its shift, to `FINE_SPACING_M`: each round takes the vertex of a parabola
    through J at three shifts, then a shorter step. Its standard error follows from the curvature of J."""
    whitened, place = located.whitened_record, located.force_place
    if not place.stations or not whitened.record.rig.body(place.stations[0].body).length_m:
        return located
    located_by_shift: dict[float, LocatedForce] = {}

    def criterion_at(shift_m: float) -> float:
        if shift_m not in located_by_shift:
            shifted_place = _shifted_place(place, shift_m)
            residual_response = response_of(whitened, shifted_place)
            with_force = evidence_with_force(whitened, residual_response, located.with_force)
            located_by_shift[shift_m] = replace(
                located, force_place=shifted_place, with_force=with_force, residual_per_force=residual_response
            )
        return located_by_shift[shift_m].with_force.criterion

    shift_limits_m = _shift_range_m(whitened.record.rig, place)

    def shifts_around_m(shift_m: float, step_m: float, step_counts: range) -> list[float]:
        return [float(np.clip(shift_m + count * step_m, *shift_limits_m)) for count in step_counts]

    best_shift_m, step_m = 0.0, PLACE_SPACING_M / 2
    while True:
        shifts_m = shifts_around_m(best_shift_m, step_m, range(-1, 2))
        best_shift_m = min(shifts_m, key=criterion_at)
        if step_m <= FINE_SPACING_M:
            break
        vertex_shift_m = float(np.clip(_parabola_vertex(shifts_m, list(map(criterion_at, shifts_m))), *shift_limits_m))
        best_shift_m, step_m = min((best_shift_m, vertex_shift_m), key=criterion_at), step_m / 3.5
    shifts_m = shifts_around_m(best_shift_m, 2 * FINE_SPACING_M, range(-2, 3))
    curvature = 2 * float(np.polyfit(shifts_m, list(map(criterion_at, shifts_m)), 2)[0])
    position_error_m = float(np.sqrt(2 / curvature)) if curvature > 0 else PLACE_SPACING_M
    return replace(located_by_shift[best_shift_m], position_error_m=min(position_error_m, PLACE_SPACING_M))


def _parabola_vertex(positions_m: list[float], criterion_values: list[float]) -> float:
    """Minimum of the parabola through three points within their range, or the lowest point if it has none."""
    lowest_m = positions_m[int(np.argmin(criterion_values))]
    if len(set(positions_m)) < 3:
        return lowest_m
    quadratic, linear, _ = np.polyfit(positions_m, criterion_values, 2)
    is_convex = quadratic > 0
    return float(np.clip(-linear / (2 * quadratic), positions_m[0], positions_m[-1])) if is_convex else lowest_m


def _locate_modulus_drift(
    whitened: WhitenedRecord, without_force: ForceEvidence, expected_place: ForcePlace | None
) -> LocatedForce | None:
    """Drift of the modulus of one body, or of all bodies together if that gains 5 % more; None if no body shows any."""
    elastic_names = tuple(body.name for body in whitened.record.rig.bodies if body.length_m)
    body_names = expected_place.body_names if expected_place else elastic_names
    column_by_body = {name: modulus_drift_column(whitened, name) for name in body_names}
    column_by_body = {name: column for name, column in column_by_body.items() if np.any(column)}
    if not column_by_body:
        return None
    single_bodies = [] if expected_place else [(name,) for name in column_by_body]
    no_response = np.zeros(whitened.whitened_residual.shape, dtype=complex)
    best: LocatedForce | None = None
    for bodies in dict.fromkeys([*single_bodies, tuple(column_by_body)]):
        scales = [FLAT_PRIOR_COLUMN_NORM / max(float(np.linalg.norm(column_by_body[body])), 1e-300) for body in bodies]
        drift_columns = np.stack([scale * column_by_body[body] for scale, body in zip(scales, bodies, strict=True)])
        drift_parameters = tuple(Nuisance(NuisanceKind.MODULUS_DRIFT, body) for body in bodies)
        with_drift = with_columns(
            whitened,
            (*whitened.nuisance_parameters, *drift_parameters),
            [whitened.nuisance_columns, drift_columns],
            np.append(whitened.trace_terms, np.zeros(len(bodies))),
        )
        with_force = evidence_without_force(with_drift)
        place = ForcePlace("distributed", body_names=bodies)
        located = LocatedForce(place, without_force, with_force, without_nuisance_columns(with_drift), no_response)
        best_decrease = best.criterion_decrease if best else -np.inf
        if located.criterion_decrease > max(best_decrease, 1.05 * best_decrease):
            covariance = np.linalg.inv(nuisance_equations(with_drift, with_force.noise_variance)[0])
            growth = with_force.theta[-len(bodies) :] * scales
            scatter = np.sqrt(np.diag(covariance)[-len(bodies) :]) * scales
            errors = np.hypot(scatter, DRIFT_ERROR_SHARE * growth)
            best = replace(located, modulus_growth=tuple(growth.tolist()), modulus_growth_errors=tuple(errors.tolist()))
    return best
