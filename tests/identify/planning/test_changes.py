"""Changes of a planned test: each changes one thing."""

import pytest
from msgspec.structs import replace

from identify.planning.changes import changes_of
from identify.planning.planned_test import planned_test
from rig.model.description import contact_stations
from rig.model.sensing import sensors_of
from rig.model.tolerances import EXACT, LABORATORY, ModeTolerance, SensorTolerance
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof
from tests.identify.small_rigs import MASS_ON_TABLE

BEAMS = planned_test(BarrelCradle(sensors="acceleration", noise_density=1e-3).rig(), duration_s=20.0)
TUBES = planned_test(BarrelCradleAnnular(sensors="acceleration", noise_density=1e-3).rig(), duration_s=20.0)
PARTS = {
    "add sensor": "sensors",
    "leave out sensor": "sensors",
    "noise": "sensors",
    "place": "force_at",
    "force": "force_rms_n",
    "band": "band_hz",
    "duration": "duration_s",
    "tolerance": "tolerances",
}


@pytest.mark.parametrize("test", [BEAMS, TUBES], ids=["beams", "tubes"])
def test_each_change_changes_one_thing(test):
    changes = list(changes_of(test))
    assert {change.kind for change in changes} == set(PARTS)
    assert len({change.words for change in changes}) == len(changes)
    for change in changes:
        part = PARTS[change.kind]
        if part in ("sensors", "force_at"):
            assert replace(change.test, rig=test.rig) == test
            assert replace(change.test.rig, **{part: getattr(test.rig, part)}) == test.rig
            assert getattr(change.test.rig, part) != getattr(test.rig, part)
        else:
            assert replace(change.test, **{part: getattr(test, part)}) == test
            assert change.test != test


def test_displacement_sensors_come_to_both_sides_of_a_contact_that_has_none():
    added = [change.test.rig for change in changes_of(BEAMS) if "displacement" in change.words]
    stations = [{sensor.station for sensor in sensors_of(rig, "displacement")} for rig in added]
    of_contacts = [set(contact_stations(contact)) for contact in BEAMS.rig.contacts]
    assert stations == [*of_contacts, set.union(*of_contacts)]
    both = planned_test(BarrelCradle().rig(), duration_s=20.0)
    assert not [change for change in changes_of(both) if "displacement sensor" in change.words]


def test_sensors_and_forces_of_a_rig_in_space_come_and_move_in_both_directions():
    changes = list(changes_of(TUBES))
    of_rings = [{replace(s, direction=d) for s in contact_stations(c) for d in "yz"} for c in TUBES.rig.contacts]
    added = [change for change in changes if "displacement" in change.words]
    assert [{s.station for s in sensors_of(c.test.rig, "displacement")} for c in added] == [
        *of_rings,
        set.union(*of_rings),
    ]
    assert "(0 m of barrel in y and z, 0.45 m of cradle in y and z)" in added[0].words
    for change in changes:
        new = {s.station for s in change.test.rig.sensors} - {s.station for s in TUBES.rig.sensors}
        assert {replace(station, direction="z") for station in new} <= new
    moved = [change.test.rig.forces for change in changes if change.kind == "place"]
    assert len(moved) == 3
    assert all(first == replace(second, direction="y") and second.direction == "z" for first, second in moved)
    one_in_z = [s for s in TUBES.rig.sensors if s.station.direction == "y"] + [sensor_in_z(b) for b in TUBES.rig.bodies]
    left_out = [c.words for c in changes_of(replace(TUBES, rig=replace(TUBES.rig, sensors=tuple(one_in_z))))]
    assert not {sensor_in_z(body).name for body in TUBES.rig.bodies} & {*left_out}


def sensor_in_z(body):
    return next(s for s in TUBES.rig.sensors if s.station.body == body.name and s.station.direction == "z")


def test_changes_of_a_rig_on_a_shaken_base_are_of_the_base_and_of_what_measures_it():
    test = planned_test(MASS_ON_TABLE, base_rms_m_per_s2=2.0, band_hz=(2.0, 20.0))
    changes = list(changes_of(test))
    assert {change.kind for change in changes} == set(PARTS) - {"place", "leave out sensor"}
    levels = [change.test.base_rms_m_per_s2 for change in changes if change.kind == "force"]
    assert levels == [4.0, 8.0, 1.0]
    assert "excite with 4.00 m/s² rms (2 times)" in {change.words for change in changes}
    (added,) = (change for change in changes if change.kind == "add sensor")
    assert added.words == "add 2 displacement sensors at stops (0 m of mass, the ground)"
    assert len(added.test.rig.base_sensors) == 2
    assert not [change for change in changes if "force_gain" in change.words]


def test_every_sensor_is_left_out_once():
    left_out = [change for change in changes_of(BEAMS) if change.kind == "leave out sensor"]
    assert [change.words for change in left_out] == [sensor.name for sensor in BEAMS.rig.sensors]
    assert all(change.words not in {s.name for s in change.test.rig.sensors} for change in left_out)
    only_one = planned_test(Sdof(sensors="acceleration").rig())
    assert not [change for change in changes_of(only_one) if change.kind == "leave out sensor"]
    first, *_, last = BEAMS.rig.sensors
    one_a_body = replace(BEAMS, rig=replace(BEAMS.rig, sensors=(first, last)))
    assert first.station.body != last.station.body
    assert not [change for change in changes_of(one_a_body) if change.kind == "leave out sensor"]


def test_tolerances_of_single_sensors_and_modes_are_halved_with_the_common_one():
    own = replace(
        LABORATORY,
        sensors={"a": SensorTolerance(gain=0.01, delay_s=1e-4)},
        modes={"barrel 3": ModeTolerance(damping=0.1)},
    )
    halved = {c.words: c.test.tolerances for c in changes_of(replace(BEAMS, tolerances=own)) if c.kind == "tolerance"}
    (gain,) = (tolerances for words, tolerances in halved.items() if "(gain =" in words)
    assert (gain.gain, gain.sensors["a"].gain, gain.sensors["a"].delay_s) == pytest.approx((0.001, 0.005, 1e-4))
    (damping,) = (tolerances for words, tolerances in halved.items() if "(damping =" in words)
    assert (damping.damping, damping.modes["barrel 3"].damping) == pytest.approx((0.15, 0.05))
    assert not [c for c in changes_of(replace(BEAMS, tolerances=EXACT)) if c.kind == "tolerance"]
