"""Changes of a planned test that may shorten its intervals: each is another planned test, and words for it."""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Literal, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from identify.pages.wording import number
from identify.planning.planned_test import LONGEST_S, MAX_BAND_TO_RATE, PlannedTest
from rig.model.components import DIRECTIONS
from rig.model.description import ON_GROUND, Body, Contact, Rig, Sensor, Station, contact_stations
from rig.model.sensing import named_sensor, sensors_of
from rig.model.tolerances import ModeTolerance, SensorTolerance, Tolerances

ChangeKind = Literal["add sensor", "leave out sensor", "force", "place", "band", "duration", "noise", "tolerance"]

DISPLACEMENT_NOISE_DENSITY, ACCELERATION_NOISE_DENSITY = 1e-7, 1e-3
"""Noise densities of an added displacement sensor, as of a usual laser, m/sqrt(Hz), and of an added accelerometer
where the rig has none, as of a usual piezoelectric one, m/s^2/sqrt(Hz)."""
FORCE_FACTORS, BAND_END_FACTORS = (2.0, 4.0, 0.5), (2.0, 0.5)
"""Factors of the force and of the upper end of its band that are tried."""
MAX_PLACE_COUNT = 3
"""Number of other places of the force that are tried. Effort."""
TOLERANCE_WORDS = {
    "gain": "the gains of all sensors",
    "position_m": "the positions of all sensors",
    "delay_s": "the delays of all sensors",
    "high_pass_hz": "the high-pass corners of all accelerometers",
    "force_gain": "the gain of the force cell",
    "mass": "the masses of all bodies",
    "frequency": "the natural frequencies",
    "damping": "the damping ratios",
    "cross_axis": "the cross-axis sensitivities of all sensors",
}
"""Tolerances that are halved, and what is then known twice as well."""


Override = TypeVar("Override", SensorTolerance, ModeTolerance)


class PlannedChange(msgspec.Struct, frozen=True):
    """Changed test, the kind of the change, and what to do in words."""

    kind: ChangeKind
    words: str
    test: PlannedTest


def changes_of(test: PlannedTest) -> Iterator[PlannedChange]:
    """Yield the changes to try, the usual ones first; the sensors to leave out last."""
    yield from _displacement_sensor_changes(test)
    yield from _accelerometer_changes(test)
    yield from _force_level_changes(test)
    if 2 * test.duration_s <= LONGEST_S:
        yield PlannedChange("duration", f"record {2 * test.duration_s:g} s", test.with_duration(2 * test.duration_s))
    yield from _noise_changes(test)
    yield from _tolerance_changes(test)
    yield from _band_changes(test)
    yield from _force_place_changes(test)
    yield from _sensor_removals(test)


def _with_sensors(test: PlannedTest, sensors: tuple[Sensor, ...]) -> PlannedTest:
    return replace(test, rig=replace(test.rig, sensors=sensors))


def _added_sensor(
    rig: Rig, station: Station, quantity: Literal["displacement", "acceleration"], noise_density: float
) -> Sensor:
    """Sensor with a name that is free."""
    sensor = replace(named_sensor(station, quantity), noise_density=noise_density)
    used_names = {*rig.force_names, *(used_sensor.name for used_sensor in rig.sensors)}
    return sensor if sensor.name not in used_names else replace(sensor, name=f"{sensor.name}_added")


def _displacement_sensor_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    """Displacement sensors on both sides of each contact, and of all contacts."""
    measured_stations = {sensor.station for sensor in sensors_of(test.rig, "displacement")}
    all_added: dict[Station, Sensor] = {}
    contact_names = []
    for contact in test.rig.contacts:
        new_sensors = {
            station: _added_sensor(test.rig, station, "displacement", DISPLACEMENT_NOISE_DENSITY)
            for station in (*_side_stations(contact), *([ON_GROUND] if test.rig.base_sensors else []))
            if station not in measured_stations
        }
        if new_sensors and not new_sensors.keys() <= all_added.keys():
            contact_names.append(contact.name)
            all_added |= new_sensors
            yield _sensor_addition(
                test,
                f"{_count_text(new_sensors)} at {contact.name} ({_places_text(test.rig, new_sensors)})",
                tuple(new_sensors.values()),
            )
    if len(contact_names) > 1:
        addition_words = f"{_count_text(all_added)} at {', '.join(contact_names)} ({_places_text(test.rig, all_added)})"
        yield _sensor_addition(test, addition_words, tuple(all_added.values()))


def _side_stations(contact: Contact) -> tuple[Station, ...]:
    """Stations of a contact, of an annular one in y and then in z."""
    directions = DIRECTIONS if contact.law.spatial else (contact.at.direction,)
    return tuple(replace(station, direction=d) for d in directions for station in contact_stations(contact))


def _count_text(sensors: dict[Station, Sensor]) -> str:
    return f"{len(sensors)} displacement sensors" if len(sensors) > 1 else "a displacement sensor"


def _places_text(rig: Rig, stations: Iterable[Station]) -> str:
    """Places in words, of a rig in space with their directions."""
    directions_by_place: dict[str, list[str]] = {}
    for station in stations:
        directions_by_place.setdefault(_place_text(station), []).append(station.direction)
    if not rig.in_space:
        return ", ".join(directions_by_place)
    return ", ".join(f"{place} in {' and '.join(directions)}" for place, directions in directions_by_place.items())


def _place_text(station: Station) -> str:
    if station == ON_GROUND:
        return "the ground"
    return f"{station.position_m:g} m of {station.body}"


def _sensor_addition(test: PlannedTest, words: str, sensors: tuple[Sensor, ...]) -> PlannedChange:
    return PlannedChange("add sensor", f"add {words}", _with_sensors(test, test.rig.sensors + sensors))


def _accelerometer_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    """An accelerometer at each side of a contact that has none, and in the widest interval without a sensor of each
    body; in every direction of the rig."""
    rig, accelerometers = test.rig, sensors_of(test.rig, "acceleration")
    noise_densities = [sensor.noise_density for sensor in accelerometers]
    noise_density = float(np.median(noise_densities)) if noise_densities else ACCELERATION_NOISE_DENSITY
    measured_stations = {sensor.station for sensor in accelerometers}
    sides = (side for contact in rig.contacts for side in _side_stations(contact) if side not in measured_stations)
    interval_middles = (station for body in rig.bodies if (station := _widest_interval_middle(rig, body)))
    for place in dict.fromkeys(replace(station, direction="y") for station in (*sides, *interval_middles)):
        new_stations = [s for d in rig.directions if (s := replace(place, direction=d)) not in measured_stations]
        count_text = "an accelerometer" if len(new_stations) == 1 else f"{len(new_stations)} accelerometers"
        new_sensors = tuple(_added_sensor(rig, station, "acceleration", noise_density) for station in new_stations)
        yield _sensor_addition(test, f"{count_text} at {_places_text(rig, new_stations)}", new_sensors)


def _widest_interval_middle(rig: Rig, body: Body) -> Station | None:
    """Middle of the widest interval of a beam without a sensor; None for other bodies."""
    if body not in rig.beams:
        return None
    positions_m = {sensor.station.position_m for sensor in rig.sensors if sensor.station.body == body.name}
    edges_m = np.array(sorted({0.0, body.length_m, *positions_m}))
    widest_index = int(np.argmax(np.diff(edges_m)))
    return Station(body.name, float(round((edges_m[widest_index] + edges_m[widest_index + 1]) / 2, 4)))


def _force_level_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    for level_factor in FORCE_FACTORS:
        changed_test = test.with_level_factor(level_factor)
        yield PlannedChange("force", f"excite with {changed_test.level_text} ({level_factor:g} times)", changed_test)


def _noise_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    for quantity in dict.fromkeys(sensor.quantity for sensor in test.rig.sensors if sensor.noise_density):
        quieter_sensors = tuple(
            replace(sensor, noise_density=sensor.noise_density / 2) if sensor.quantity == quantity else sensor
            for sensor in test.rig.sensors
        )
        yield PlannedChange("noise", f"take {quantity} sensors of half the noise", _with_sensors(test, quieter_sensors))


def _tolerance_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    idle_fields = {"cross_axis": not test.rig.in_space, "force_gain": not test.force_rms_n}
    tried_fields = [field for field in TOLERANCE_WORDS if not idle_fields.get(field)]
    for field in tried_fields:
        if halved_tolerances := _with_halved_tolerance(test.tolerances, field):
            value_text = number(getattr(halved_tolerances, field), 2)
            yield PlannedChange(
                "tolerance",
                f"know {TOLERANCE_WORDS[field]} twice as well ({field} = {value_text})",
                replace(test, tolerances=halved_tolerances),
            )


def _with_halved_tolerance(tolerances: Tolerances, field: str) -> Tolerances | None:
    """Tolerances of which one is halved, with those of single sensors and modes; None if it is zero."""
    if not getattr(tolerances, field):
        return None

    return replace(
        tolerances,
        **{field: getattr(tolerances, field) / 2},
        sensors={name: _halved_override(override, field) for name, override in tolerances.sensors.items()},
        modes={name: _halved_override(override, field) for name, override in tolerances.modes.items()},
    )


def _halved_override(override: Override, field: str) -> Override:
    tolerance = getattr(override, field, None)
    return override if tolerance is None else replace(override, **{field: tolerance / 2})


def _band_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    low_hz, high_hz = test.band_hz
    for end_factor in BAND_END_FACTORS:
        new_high_hz = end_factor * high_hz
        if low_hz < new_high_hz <= MAX_BAND_TO_RATE * test.rig.sample_rate_hz:
            band_words = f"excite from {low_hz:.3g} to {new_high_hz:.3g} Hz with the same {test.level_text}"
            yield PlannedChange("band", band_words, replace(test, band_hz=(low_hz, new_high_hz)))


def _force_place_changes(test: PlannedTest) -> Iterator[PlannedChange]:
    """The only force, or those of both directions at one place, at other places with sensors, evenly chosen."""
    forces = test.rig.forces
    forces_in_y = {replace(force, direction="y") for force in forces}
    if len(forces_in_y) > 1 or len(set(forces)) < len(forces) or not test.force_rms_n:
        return
    body_sensors = (sensor for sensor in test.rig.sensors if sensor not in test.rig.base_sensors)
    places = [place for s in body_sensors if (place := replace(s.station, direction="y")) not in forces_in_y]
    places = list(dict.fromkeys(places))
    for index in np.unique(np.linspace(0, len(places) - 1, MAX_PLACE_COUNT).round().astype(int)) if places else ():
        moved_forces = tuple(replace(places[index], direction=force.direction) for force in forces)
        changed_rig = replace(test.rig, force_at=moved_forces if len(moved_forces) > 1 else moved_forces[0])
        yield PlannedChange("place", f"excite at {_place_text(places[index])}", replace(test, rig=changed_rig))


def _sensor_removals(test: PlannedTest) -> Iterator[PlannedChange]:
    """Each sensor left out, except the only one of a body in its direction."""
    all_sensors = test.rig.sensors
    sensor_counts = Counter((s.station.body, s.station.direction) for s in all_sensors if s.measures.translates)
    for sensor in all_sensors:
        if sensor_counts[sensor.station.body, sensor.station.direction] > sensor.measures.translates:
            remaining_sensors = tuple(other_sensor for other_sensor in all_sensors if other_sensor != sensor)
            yield PlannedChange("leave out sensor", sensor.name, _with_sensors(test, remaining_sensors))
