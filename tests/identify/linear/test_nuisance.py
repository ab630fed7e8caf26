"""Nuisance parameters: what each adds to what sensors deliver, in standard deviations of the tolerances."""

from dataclasses import replace as replace_fields

import numpy as np
import pytest
from msgspec.structs import replace

from identify.linear.model import ResponseCache, real_product, response_of
from identify.linear.nuisance import (
    Nuisance,
    NuisanceKind,
    ObservedSignals,
    changes_of,
    crosstalk_changes,
    elastic_mode_indices,
)
from identify.linear.observed_motion import BodyMotion
from rig.model.tolerances import EXACT, LABORATORY, Tolerances
from rig.simulation.reference import BarrelCradle, Sdof

OMEGA = 2 * np.pi * np.linspace(2.0, 40.0, 30)


def observed(rig, tolerances: Tolerances = LABORATORY, read: bool = True) -> ObservedSignals:
    """Random accelerations at all sensors, and the motion of as many modes as each body has sensors."""
    rng = np.random.default_rng(2)
    sensors, cache = rig.sensors, ResponseCache(OMEGA)
    real, imaginary = (rng.standard_normal((len(sensors), OMEGA.size)) for _ in range(2))
    accelerations = real + 1j * imaginary
    sensor_response = np.stack([s.response(OMEGA) for s in sensors])
    bodies = []
    for body in rig.bodies:
        rows = [i for i, s in enumerate(sensors) if s.station.body == body.name]
        response = response_of(rig, body, cache)
        count = min(len(rows), response.mode_count)
        inverse = np.zeros((count, len(sensors)))
        inverse[:, rows] = np.linalg.pinv(response.shapes([sensors[i].station for i in rows])[:, :count])
        motion = real_product(inverse, accelerations)
        bodies.append(BodyMotion(response, motion, elastic_mode_indices(response, count), inverse if read else None))
    return ObservedSignals(
        sensors=sensors,
        displacement_sensors=sensors,
        tolerances=tolerances,
        omega=OMEGA,
        sensor_response=sensor_response,
        signals=sensor_response * accelerations,
        force_accelerations=accelerations[None] / 3,
        displacements=accelerations / -(OMEGA**2),
        bodies=tuple(bodies),
    )


@pytest.fixture(scope="module")
def beams():
    return BarrelCradle(sensors="acceleration").rig()


def test_every_parameter_has_one_key_and_one_column(beams):
    parameters = [change.parameter for change in changes_of(observed(beams))]
    assert len(set(parameters)) == len(parameters)
    assert len({p.name for p in parameters}) == len(parameters)
    bodywise = {p for p in parameters if p.mode_number is None}
    sensors, bodies = [s.name for s in beams.sensors], [b.name for b in beams.bodies]
    owners = dict.fromkeys((NuisanceKind.GAIN, NuisanceKind.DELAY, NuisanceKind.POSITION), sensors)
    owners |= dict.fromkeys((NuisanceKind.MASS, NuisanceKind.FREQUENCY, NuisanceKind.DAMPING), bodies)
    for kind, of in {**owners, NuisanceKind.FORCE_GAIN: ["the force"]}.items():
        assert sorted(p.owner for p in bodywise if p.kind == kind) == sorted(of)


def test_what_all_modes_share_is_the_sum_of_what_each_does(beams):
    """Of frequencies and damping, where every moving mode bends the body."""
    changes = {change.parameter: change for change in changes_of(observed(beams))}
    for body in beams.bodies:
        for kind in (NuisanceKind.FREQUENCY, NuisanceKind.DAMPING):
            signals = {p: c.signals for p, c in changes.items() if (p.kind, p.owner) == (kind, body.name)}
            common = signals.pop(Nuisance(kind, body.name))
            np.testing.assert_allclose(sum(signals.values()), common, rtol=1e-9, atol=1e-12)
    separate = {c.parameter for c in changes_of(observed(beams), with_common_tolerances=False)}
    kinds = (NuisanceKind.MASS, NuisanceKind.FREQUENCY, NuisanceKind.DAMPING)
    assert set(changes) - separate == {p for p in changes if p.mode_number is None and p.kind in kinds}


def test_a_change_is_one_tolerance_long(beams):
    linear = ("gain", "position_m", "delay_s", "force_gain", "mass", "frequency", "damping")
    doubled = replace(LABORATORY, **{name: 2 * getattr(LABORATORY, name) for name in linear})
    for single, double in zip(changes_of(observed(beams)), changes_of(observed(beams, doubled)), strict=True):
        assert single.parameter == double.parameter
        ratio = 1 if single.parameter.kind is NuisanceKind.HIGH_PASS else 2  # which is no linear matter
        np.testing.assert_allclose(double.signals, ratio * single.signals)
    assert not list(changes_of(observed(beams, EXACT)))


def test_a_gain_and_a_delay_change_what_a_sensor_delivers_as_its_own_response_does(beams):
    """To first order: the response of the sensor with one tolerance more, less that without."""
    signals, share = observed(beams), 1e-3
    accelerations = signals.signals / signals.sensor_response
    for change in changes_of(signals):
        if change.parameter.kind not in (NuisanceKind.GAIN, NuisanceKind.DELAY):
            continue
        (i,) = change.sensors
        sensor = beams.sensors[i]
        if change.parameter.kind is NuisanceKind.GAIN:
            changed_sensor = replace(sensor, gain=sensor.gain * (1 + share * LABORATORY.gain))
        else:
            changed_sensor = replace(sensor, delay_s=sensor.delay_s + share * LABORATORY.delay_s)
        expected = (changed_sensor.response(OMEGA) - sensor.response(OMEGA)) * accelerations[i] / share
        np.testing.assert_allclose(change.signals[0], expected, rtol=1e-5)


def test_of_two_sensors_at_a_station_each_changes_the_lines_that_it_gives(beams):
    """Gain, delay and position of either one together are those of a station with a single sensor."""
    single = observed(beams)
    displacement_sensors = tuple(replace(s, name=f"{s.name} 2", quantity="displacement") for s in beams.sensors)
    by_displacements = np.tile(np.arange(OMEGA.size) < 10, (len(beams.sensors), 1))
    both = replace_fields(single, displacement_sensors=displacement_sensors, is_from_displacement=by_displacements)
    changes, singles = ({c.parameter: c.signals for c in changes_of(o)} for o in (both, single))
    for kind in (NuisanceKind.GAIN, NuisanceKind.DELAY, NuisanceKind.POSITION):
        for sensor, other in zip(beams.sensors, displacement_sensors, strict=True):
            by_sensor, by_other = (changes[Nuisance(kind, s.name)] for s in (sensor, other))
            assert not np.any(by_sensor[:, :10])
            assert not np.any(by_other[:, 10:])
            np.testing.assert_allclose(by_sensor + by_other, singles[Nuisance(kind, sensor.name)])


def test_crosstalk_is_a_share_of_a_channel_beside_that_measures_the_same(beams):
    signals = observed(beams)
    changes = list(crosstalk_changes(signals))
    assert len(changes) == 2 * (len(beams.sensors) - 1)
    names = [s.name for s in beams.sensors]
    for change in changes:
        source, target = (names.index(name) for name in change.parameter.owner.split(" in "))
        assert abs(source - target) == 1
        assert change.sensors == [target]
        np.testing.assert_allclose(change.signals[0], LABORATORY.crosstalk * signals.signals[source])
        accelerations = signals.signals / signals.sensor_response
        np.testing.assert_allclose(
            change.sensor_pattern.pattern * (change.sensor_pattern.weights @ accelerations), change.signals, rtol=1e-9
        )
    assert not list(crosstalk_changes(observed(beams, EXACT)))
    mixed = replace(beams, sensors=(replace(beams.sensors[0], quantity="displacement"), *beams.sensors[1:]))
    assert len(list(crosstalk_changes(observed(mixed)))) == len(changes) - 2


@pytest.mark.parametrize("settings", [BarrelCradle(sensors="acceleration"), Sdof(sensors="acceleration")])
def test_a_reading_gives_the_change_from_the_accelerations(settings):
    now = observed(settings.rig())
    accelerations = now.signals / now.sensor_response
    read = [c for c in changes_of(now) if c.parameter.mode_number is not None or len(c.sensors) == 1]
    kinds = {c.parameter.kind for c in read if c.sensor_pattern is not None}
    assert {NuisanceKind.GAIN, NuisanceKind.DELAY} <= kinds
    for change in read:
        if change.sensor_pattern is not None:
            made = change.sensor_pattern.pattern * (change.sensor_pattern.weights @ accelerations)
            np.testing.assert_allclose(made, change.signals, rtol=1e-9, atol=1e-12)
    assert all(c.sensor_pattern is None for c in changes_of(observed(settings.rig(), read=False)))


def test_a_single_mass_bends_in_no_mode():
    rig = Sdof().rig()
    response = response_of(rig, rig.bodies[0], ResponseCache(OMEGA))
    assert elastic_mode_indices(response, 5).size == 0


def test_what_some_sensors_deliver_stands_in_the_rows_of_these(beams):
    change = next(c for c in changes_of(observed(beams)) if c.parameter.kind is NuisanceKind.MASS)
    at_all = change.at_all_sensors(len(beams.sensors))
    np.testing.assert_array_equal(at_all[change.sensors], change.signals)
    assert not np.any(np.delete(at_all, change.sensors, axis=0))
