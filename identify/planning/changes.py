"""Changes of a planned test that may shorten its intervals: each is another planned test, and words for it."""

from collections.abc import Iterator
from typing import Literal, TypeVar

import msgspec
import numpy as np
from msgspec.structs import replace

from identify.pages.wording import number
from identify.planning.planned_test import HIGHEST_TO_SAMPLE_RATE, LONGEST_S, PlannedTest
from rig.model.description import Body, Rig, Sensor, Station, contact_stations
from rig.model.sensing import named_sensor, sensors_of
from rig.model.tolerances import ModeTolerance, SensorTolerance, Tolerances

ChangeKind = Literal["add sensor", "leave out sensor", "force", "place", "band", "duration", "noise", "tolerance"]

DISPLACEMENT_NOISE_M, ACCELERATION_NOISE_M_PER_S2 = 1e-7, 1e-3
"""Noise densities of an added displacement sensor, as of a usual laser, m/sqrt(Hz), and of an added accelerometer
where the rig has none, as of a usual piezoelectric one, m/s^2/sqrt(Hz)."""
FORCE_FACTORS, BAND_FACTORS = (2.0, 4.0, 0.5), (2.0, 0.5)
"""Factors of the force and of the upper end of its band that are tried."""
MOST_PLACES = 3
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
    yield from _displacement_sensors(test)
    yield from _accelerometers(test)
    yield from _levels(test)
    if 2 * test.duration_s <= LONGEST_S:
        yield PlannedChange("duration", f"record {2 * test.duration_s:g} s", test.with_duration(2 * test.duration_s))
    yield from _noise(test)
    yield from _tolerances(test)
    yield from _bands(test)
    yield from _places(test)
    yield from _without_sensors(test)


def _with_sensors(test: PlannedTest, sensors: tuple[Sensor, ...]) -> PlannedTest:
    return replace(test, rig=replace(test.rig, sensors=sensors))


def _added(rig: Rig, station: Station, quantity: Literal["displacement", "acceleration"], noise: float) -> Sensor:
    """Sensor with a name that is free."""
    sensor = replace(named_sensor(station, quantity), noise_density=noise)
    taken = {*rig.force_names, *(other.name for other in rig.sensors)}
    return sensor if sensor.name not in taken else replace(sensor, name=f"{sensor.name}_added")


def _displacement_sensors(test: PlannedTest) -> Iterator[PlannedChange]:
    """Displacement sensors on both sides of each contact, and of all contacts."""
    measured = {sensor.station for sensor in sensors_of(test.rig, "displacement")}
    added_for_all: dict[Station, Sensor] = {}
    contact_names = []
    for contact in test.rig.contacts:
        added = {
            station: _added(test.rig, station, "displacement", DISPLACEMENT_NOISE_M)
            for station in contact_stations(contact)
            if station not in measured
        }
        if added and not added.keys() <= added_for_all.keys():
            contact_names.append(contact.name)
            added_for_all |= added
            yield _addition(test, f"{_count(added)} at {contact.name} ({_places_text(added)})", tuple(added.values()))
    if len(contact_names) > 1:
        words = f"{_count(added_for_all)} at {', '.join(contact_names)} ({_places_text(added_for_all)})"
        yield _addition(test, words, tuple(added_for_all.values()))


def _count(sensors: dict[Station, Sensor]) -> str:
    return f"{len(sensors)} displacement sensors" if len(sensors) > 1 else "a displacement sensor"


def _places_text(sensors: dict[Station, Sensor]) -> str:
    return ", ".join(_place_text(station) for station in sensors)


def _place_text(station: Station) -> str:
    return f"{station.position_m:g} m of {station.body}"


def _addition(test: PlannedTest, words: str, sensors: tuple[Sensor, ...]) -> PlannedChange:
    return PlannedChange("add sensor", f"add {words}", _with_sensors(test, test.rig.sensors + sensors))


def _accelerometers(test: PlannedTest) -> Iterator[PlannedChange]:
    """An accelerometer at each side of a contact that has none, and in the widest interval without a sensor of each
    body."""
    rig, accelerometers = test.rig, sensors_of(test.rig, "acceleration")
    densities = [sensor.noise_density for sensor in accelerometers]
    noise = float(np.median(densities)) if densities else ACCELERATION_NOISE_M_PER_S2
    measured = {sensor.station for sensor in accelerometers}
    stations = dict.fromkeys(station for contact in rig.contacts for station in contact_stations(contact))
    wanted = [station for station in stations if station not in measured]
    wanted += [station for body in rig.bodies if (station := _widest_middle(rig, body)) and station not in wanted]
    for station in wanted:
        words = f"an accelerometer at {_place_text(station)}"
        yield _addition(test, words, (_added(rig, station, "acceleration", noise),))


def _widest_middle(rig: Rig, body: Body) -> Station | None:
    """Middle of the widest interval of a beam without a sensor; None for other bodies."""
    if body not in rig.beams:
        return None
    positions_m = {sensor.station.position_m for sensor in rig.sensors if sensor.station.body == body.name}
    edges_m = np.array(sorted({0.0, body.length_m, *positions_m}))
    widest = int(np.argmax(np.diff(edges_m)))
    return Station(body.name, float(round((edges_m[widest] + edges_m[widest + 1]) / 2, 4)))


def _levels(test: PlannedTest) -> Iterator[PlannedChange]:
    for factor in FORCE_FACTORS:
        changed = replace(test, force_rms_n=tuple(factor * rms_n for rms_n in test.force_rms_n))
        yield PlannedChange("force", f"excite with {changed.level} ({factor:g} times)", changed)


def _noise(test: PlannedTest) -> Iterator[PlannedChange]:
    for quantity in dict.fromkeys(sensor.quantity for sensor in test.rig.sensors if sensor.noise_density):
        quieter = tuple(
            replace(sensor, noise_density=sensor.noise_density / 2) if sensor.quantity == quantity else sensor
            for sensor in test.rig.sensors
        )
        yield PlannedChange("noise", f"take {quantity} sensors of half the noise", _with_sensors(test, quieter))


def _tolerances(test: PlannedTest) -> Iterator[PlannedChange]:
    for field, words in TOLERANCE_WORDS.items():
        if halved := _halved(test.tolerances, field):
            value = number(getattr(halved, field), 2)
            yield PlannedChange(
                "tolerance", f"know {words} twice as well ({field} = {value})", replace(test, tolerances=halved)
            )


def _halved(tolerances: Tolerances, field: str) -> Tolerances | None:
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
    value = getattr(override, field, None)
    return override if value is None else replace(override, **{field: value / 2})


def _bands(test: PlannedTest) -> Iterator[PlannedChange]:
    low_hz, high_hz = test.band_hz
    for factor in BAND_FACTORS:
        changed_hz = factor * high_hz
        if low_hz < changed_hz <= HIGHEST_TO_SAMPLE_RATE * test.rig.sample_rate_hz:
            words = f"excite from {low_hz:.3g} to {changed_hz:.3g} Hz with the same {test.level}"
            yield PlannedChange("band", words, replace(test, band_hz=(low_hz, changed_hz)))


def _places(test: PlannedTest) -> Iterator[PlannedChange]:
    """The only force at other stations with sensors, evenly chosen."""
    if len(test.rig.forces) > 1:
        return
    stations = list(dict.fromkeys(s.station for s in test.rig.sensors if s.station != test.rig.forces[0]))
    for index in np.unique(np.linspace(0, len(stations) - 1, MOST_PLACES).round().astype(int)) if stations else ():
        rig = replace(test.rig, force_at=stations[index])
        yield PlannedChange("place", f"excite at {_place_text(stations[index])}", replace(test, rig=rig))


def _without_sensors(test: PlannedTest) -> Iterator[PlannedChange]:
    sensors = test.rig.sensors
    for sensor in sensors if len(sensors) > 1 else ():
        remaining_sensors = tuple(candidate for candidate in sensors if candidate != sensor)
        yield PlannedChange("leave out sensor", sensor.name, _with_sensors(test, remaining_sensors))
