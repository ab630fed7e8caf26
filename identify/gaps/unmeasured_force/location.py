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

PlaceKind = Literal["force", "pair", "sensor", "distributed"]
PLACE_SPACING_M, FINE_SPACING_M = 0.05, 0.002
"""Spacing of the scan over places, and of its refinement. Set by hand: below the wavelength of any mode in the band;
the place of a strong force is known to some mm."""
REFITTED_PER_KIND = 3
"""Count of candidates of each kind, the best with theta fixed, whose J is computed again with theta fitted. Effort."""
FLAT_PRIOR = 1e4
"""Norm of a drift's column at one prior standard deviation: in effect no prior."""


@dataclass(frozen=True)
class ForcePlace:
    """Candidate of an unmeasured force by its kind: "force" at one station, "pair" with the opposite force at a second
    station, "sensor" with a signal of its own, or "distributed", a modulus of the `body_names` that drifts.
    """

    kind: PlaceKind
    stations: tuple[Station, ...] = ()
    sensor_name: str = ""
    body_names: tuple[str, ...] = ()


@dataclass(frozen=True)
class LocatedForce:
    """Candidate fitted to a record; criterion_decrease is that of J against the record without a force.

    position_error_m is the standard error by the curvature of J. residual_per_force is g. modulus_growth is the
    relative change of the modulus of each body over the record, with its standard errors.
    """

    force_place: ForcePlace
    criterion_decrease: float
    position_error_m: float
    fit_without_force: ForceEvidence
    fit_with_force: ForceEvidence
    whitened_record: WhitenedRecord
    residual_per_force: Complex[np.ndarray, "lines rows"]
    modulus_growth: tuple[float, ...] = ()
    modulus_growth_errors: tuple[float, ...] = ()


def response_of(whitened: WhitenedRecord, force_place: ForcePlace) -> Complex[np.ndarray, "lines rows"]:
    """Response g of the residual per newton of a candidate's force, or per m/s^2 of a sensor's own signal."""
    if force_place.kind == "sensor":
        sensor_index = [sensor.name for sensor in whitened.record.sensors].index(force_place.sensor_name)
        unit_signal = np.zeros((len(whitened.record.sensors), whitened.record.omega.size), dtype=complex)
        unit_signal[sensor_index] = 1.0
        return whitened.ungated_residual(unit_signal)
    first_station, *opposing_stations = force_place.stations
    accelerances = whitened.accelerance(first_station)
    for station in opposing_stations:
        accelerances = accelerances - whitened.accelerance(station)
    return whitened.ungated_residual(accelerances)


def locate_force(
    whitened: WhitenedRecord, expected_place: ForcePlace | None = None, search_radius_m: float = 0.1
) -> LocatedForce:
    """Candidate with the largest gain, its position refined.

    With an `expected_place` one only its kind, no further than search_radius_m from it, is tried.
    """
    fit_without_force = evidence_without_force(whitened)
    possible_places = [
        place
        for place in force_places(whitened.record.rig, whitened.record.sensors)
        if expected_place is None or _within_radius(place, expected_place, search_radius_m)
    ]
    if expected_place is not None and expected_place.kind != "distributed":
        possible_places.append(expected_place)
    cleared_residual = subtract_nuisance(whitened, fit_without_force.theta)
    evidence_by_place = {
        place: evidence_with_force(whitened, response_of(whitened, place), fit_without_force, cleared_residual)
        for place in possible_places
    }
    best_of_kinds: list[LocatedForce] = []
    for kind in ("force", "pair", "sensor"):
        best_places = sorted(
            (place for place in evidence_by_place if place.kind == kind),
            key=lambda place: evidence_by_place[place].criterion,
        )[:REFITTED_PER_KIND]
        refitted_evidence = [
            (evidence_with_force(whitened, response_of(whitened, place), fit_without_force), place)
            for place in best_places
        ]
        if refitted_evidence:
            fit_with_force, best_place = min(refitted_evidence, key=lambda located_force: located_force[0].criterion)
            best_of_kinds.append(_located_force(whitened, best_place, fit_without_force, fit_with_force))
    if expected_place is None or expected_place.kind == "distributed":
        best_of_kinds += [
            drift for drift in [_locate_drift(whitened, fit_without_force, expected_place)] if drift is not None
        ]
    return _refine_position(max(best_of_kinds, key=lambda located_force: located_force.criterion_decrease))


def force_places(rig: Rig, sensors: Sequence[Sensor]) -> Iterator[ForcePlace]:
    """Candidates: every 0.05 m of each body, pairs side by side on two bodies, and the record's sensors if several."""
    for body in rig.bodies:
        for position_m in _position_grid_m(body.length_m):
            yield ForcePlace("force", (Station(body.name, position_m),))
    for first_body, second_body in combinations(rig.bodies, 2):
        shift_m = offset_m(rig, first_body.name, second_body.name)
        for position_m in _position_grid_m(first_body.length_m):
            if 0 <= position_m + shift_m <= second_body.length_m:
                yield ForcePlace(
                    "pair", (Station(first_body.name, position_m), Station(second_body.name, position_m + shift_m))
                )
    if len(sensors) > 1:
        for sensor in sensors:
            yield ForcePlace("sensor", sensor_name=sensor.name)


def offset_m(rig: Rig, from_body_name: str, to_body_name: str) -> float:
    """Offset from a position on one body to that beside it on the other: the median over the contacts between them, 0
    without any."""
    offsets_m = []
    for contact in rig.contacts:
        if contact.against is not None and {contact.at.body, contact.against.body} == {from_body_name, to_body_name}:
            distance_m = contact.against.position_m - contact.at.position_m
            offsets_m.append(distance_m if contact.at.body == from_body_name else -distance_m)
    return float(np.median(offsets_m)) if offsets_m else 0.0


def _shifted_place(place: ForcePlace, shift_m: float) -> ForcePlace:
    return replace(
        place, stations=tuple(Station(station.body, station.position_m + shift_m) for station in place.stations)
    )


def _shift_range_m(rig: Rig, place: ForcePlace) -> tuple[float, float]:
    """Lowest and highest shift (m) with which every station stays on its body."""
    lengths_m = [rig.body(station.body).length_m for station in place.stations]
    return (
        max(-station.position_m for station in place.stations),
        min(length_m - station.position_m for station, length_m in zip(place.stations, lengths_m, strict=True)),
    )


def _position_grid_m(length_m: float) -> list[float]:
    """Positions (m) along a body, evenly spaced by about `PLACE_SPACING_M`; 0 alone on a point mass."""
    if not length_m:
        return [0.0]
    return [float(position_m) for position_m in np.linspace(0, length_m, max(2, round(length_m / PLACE_SPACING_M) + 1))]


def _within_radius(force_place: ForcePlace, expected_place: ForcePlace, search_radius_m: float) -> bool:
    if force_place.kind != expected_place.kind or force_place.sensor_name != expected_place.sensor_name:
        return False
    return all(
        station.body == expected_station.body
        and abs(station.position_m - expected_station.position_m) <= search_radius_m
        for station, expected_station in zip(force_place.stations, expected_place.stations, strict=True)
    )


def _located_force(
    whitened: WhitenedRecord, force_place: ForcePlace, fit_without_force: ForceEvidence, fit_with_force: ForceEvidence
) -> LocatedForce:
    criterion_decrease = fit_without_force.criterion - fit_with_force.criterion
    return LocatedForce(
        force_place,
        criterion_decrease,
        0.0,
        fit_without_force,
        fit_with_force,
        whitened,
        response_of(whitened, force_place),
    )


def _refine_position(located_force: LocatedForce) -> LocatedForce:
    """Candidate at the minimum of J over its shift, to `FINE_SPACING_M`: each round takes the vertex of a parabola
    through J at three shifts, then a shorter step. Its standard error follows from the curvature of J."""
    whitened, force_place = located_force.whitened_record, located_force.force_place
    if not force_place.stations or not whitened.record.rig.body(force_place.stations[0].body).length_m:
        return located_force
    evidence_by_shift: dict[float, ForceEvidence] = {}

    def criterion_at(shift_m: float) -> float:
        if shift_m not in evidence_by_shift:
            evidence_by_shift[shift_m] = evidence_with_force(
                whitened, response_of(whitened, _shifted_place(force_place, shift_m)), located_force.fit_with_force
            )
        return evidence_by_shift[shift_m].criterion

    lowest_m, highest_m = _shift_range_m(whitened.record.rig, force_place)
    best_shift_m, step_m = 0.0, PLACE_SPACING_M / 2
    while True:
        shifts_m = [
            float(np.clip(best_shift_m + step_count * step_m, lowest_m, highest_m)) for step_count in (-1, 0, 1)
        ]
        best_shift_m = min(shifts_m, key=criterion_at)
        if step_m <= FINE_SPACING_M:
            break
        vertex_m = float(
            np.clip(
                _parabola_vertex(shifts_m, [criterion_at(trial_shift_m) for trial_shift_m in shifts_m]),
                lowest_m,
                highest_m,
            )
        )
        best_shift_m, step_m = min((best_shift_m, vertex_m), key=criterion_at), step_m / 3.5
    shifts_m = [
        float(np.clip(best_shift_m + step_count * 2 * FINE_SPACING_M, lowest_m, highest_m))
        for step_count in (-2, -1, 0, 1, 2)
    ]
    curvature = 2 * float(np.polyfit(shifts_m, [criterion_at(trial_shift_m) for trial_shift_m in shifts_m], 2)[0])
    position_error_m = float(np.sqrt(2 / curvature)) if curvature > 0 else PLACE_SPACING_M
    best_place = _shifted_place(force_place, best_shift_m)
    return replace(
        _located_force(whitened, best_place, located_force.fit_without_force, evidence_by_shift[best_shift_m]),
        position_error_m=min(position_error_m, PLACE_SPACING_M),
    )


def _parabola_vertex(positions_m: list[float], criterion_values: list[float]) -> float:
    """Minimum of the parabola through three points within their range, or the lowest point if it has none."""
    if len(set(positions_m)) < 3:
        return positions_m[int(np.argmin(criterion_values))]
    quadratic_coefficient, linear_coefficient, _ = np.polyfit(positions_m, criterion_values, 2)
    return (
        float(np.clip(-linear_coefficient / (2 * quadratic_coefficient), positions_m[0], positions_m[-1]))
        if quadratic_coefficient > 0
        else positions_m[int(np.argmin(criterion_values))]
    )


def _locate_drift(
    whitened: WhitenedRecord, fit_without_force: ForceEvidence, expected_place: ForcePlace | None
) -> LocatedForce | None:
    """Drift of the modulus of one body, or of all bodies together if that gains 5 % more; None if no body shows any."""
    body_names = (
        expected_place.body_names
        if expected_place
        else tuple(body.name for body in whitened.record.rig.bodies if body.length_m)
    )
    column_by_body = {body_name: modulus_drift_column(whitened, body_name) for body_name in body_names}
    column_by_body = {
        body_name: drift_column for body_name, drift_column in column_by_body.items() if np.any(drift_column)
    }
    if not column_by_body:
        return None
    body_choices = (
        [tuple(column_by_body)]
        if expected_place
        else [*((body_name,) for body_name in column_by_body), tuple(column_by_body)]
    )
    best_drift: LocatedForce | None = None
    for drifting_bodies in dict.fromkeys(body_choices):
        column_scales = [
            FLAT_PRIOR / max(float(np.linalg.norm(column_by_body[drifting_body])), 1e-300)
            for drifting_body in drifting_bodies
        ]
        drift_columns = np.stack(
            [
                column_scale * column_by_body[drifting_body]
                for column_scale, drifting_body in zip(column_scales, drifting_bodies, strict=True)
            ]
        )
        with_drift_columns = with_columns(
            whitened,
            (*whitened.nuisance_parameters, *(Nuisance(NuisanceKind.MODULUS_DRIFT, body) for body in drifting_bodies)),
            [whitened.nuisance_columns, drift_columns],
            np.append(whitened.trace_terms, 0.0 * np.array(column_scales)),
        )
        fit_with_force = evidence_without_force(with_drift_columns)
        criterion_decrease = fit_without_force.criterion - fit_with_force.criterion
        modulus_growth = tuple(
            float(growth_value) for growth_value in fit_with_force.theta[-len(drifting_bodies) :] * column_scales
        )
        if best_drift is None or criterion_decrease > max(
            best_drift.criterion_decrease, 1.05 * best_drift.criterion_decrease
        ):
            no_response = np.zeros(whitened.whitened_residual.shape, dtype=complex)
            covariance = np.linalg.inv(nuisance_equations(with_drift_columns, fit_with_force.noise_variance)[0])
            growth_errors = tuple(
                float(growth_error)
                for growth_error in np.sqrt(np.diag(covariance)[-len(drifting_bodies) :]) * column_scales
            )
            drift_place = ForcePlace("distributed", body_names=drifting_bodies)
            best_drift = LocatedForce(
                drift_place,
                criterion_decrease,
                0.0,
                fit_without_force,
                fit_with_force,
                with_drift_columns,
                no_response,
                modulus_growth,
                growth_errors,
            )
    return best_drift
