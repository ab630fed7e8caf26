"""Modes that a description leaves out, as nuisance parameters of the sensors' signals.

A body is described by its first N modes. Those beyond follow a force almost at once and add, at a sensor's place x,

    dA(x) = sum_{m > N} phi_m(x) A_m phi_m(x_F) F,

most where the force acts. Nobody knows them. The same sum over the highest modes of the description, beyond the band
and from CONVERGED_SHARE of them on, times the tolerance `truncation`, is taken as one standard deviation, for each
force and place by itself. What N modes leave of a plate's sum falls as 1/N, as its modes are equally dense, and of a
beam's as 1/N^3: it is at most about as large as what the highest ones add.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex

from identify.linear.model import Response, input_shapes, real_product
from identify.linear.nuisance import BAND_MARGIN, Change, Nuisance, NuisanceKind, mode_count_below_band_margin
from rig.model.description import Rig, Sensor, Station, force_names

CONVERGED_SHARE = 0.4
"""Share of a body's modes, the lowest, whose sum is certain. Set by hand, for gauges near a force."""


@dataclass(frozen=True)
class Truncation:
    """One standard deviation of what modes left out add to the signals of the sensors at a place, per newton."""

    parameter: Nuisance
    input_index: int
    rows: list[int]
    signals_per_newton: Complex[np.ndarray, "some lines"]

    def change(self, input_spectra: Complex[np.ndarray, "inputs lines"]) -> Change:
        """Change of the signals, given the exciting and the contact forces."""
        return Change(self.parameter, self.rows, self.signals_per_newton * input_spectra[self.input_index])


def truncations_of(
    rig: Rig,
    responses: Sequence[Response],
    force_stations: Sequence[Station],
    sensors: Mapping[int, Sensor],
    sensor_response: Complex[np.ndarray, "rows lines"],
    tolerance: float,
    band_margin: float = BAND_MARGIN,
) -> tuple[Truncation, ...]:
    """Truncations by each exciting and contact force at each place of its body, of sensors by their rows; a force on
    the ground is that of a base. None if the tolerance is zero.

    Sensors of one kind of motion at one place share theirs. Modes up to `band_margin` times the band's end are seen,
    and have tolerances of their own: a chain of masses whose modes all lie there leaves nothing out.
    """
    names = zip(force_stations, force_names(len(force_stations)), strict=True)
    exciting_names = ("the base" if rig.is_on_ground(station) else name for station, name in names)
    input_names = (*exciting_names, *(contact.name for contact in rig.contacts))
    truncations = []
    for response in responses if tolerance else ():
        first_mode = max(
            mode_count_below_band_margin(response, band_margin), int(CONVERGED_SHARE * response.mode_count)
        )
        rows_by_place: dict[tuple[object, bool], list[int]] = {}
        for row, sensor in sensors.items():
            if sensor.station.body == response.body.name and not response.body.is_mass:
                rows_by_place.setdefault((sensor.station, sensor.measures.translates), []).append(row)
        place_sensors = [sensors[rows[0]] for rows in rows_by_place.values()]
        place_shapes = response.shapes(place_sensors)[:, first_mode:]
        force_shapes = input_shapes(rig, response, force_stations)[:, first_mode:]
        for input_index in np.flatnonzero(force_shapes.any(axis=1)).tolist():
            high_accelerance = response.accelerance[first_mode:]
            per_newton = real_product(place_shapes * force_shapes[input_index], high_accelerance)
            for rows, acceleration in zip(rows_by_place.values(), per_newton, strict=True):
                owner = f"{sensors[rows[0]].name} by {input_names[input_index]}"
                parameter = Nuisance(NuisanceKind.TRUNCATION, owner)
                truncations.append(
                    Truncation(parameter, input_index, rows, tolerance * sensor_response[rows] * acceleration)
                )
    return tuple(truncations)
