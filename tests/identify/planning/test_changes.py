"""Changes of a planned test: each changes one thing."""

import pytest
from msgspec.structs import replace

from identify.planning.changes import changes_of
from identify.planning.planned_test import planned_test
from rig.model.description import contact_stations
from rig.model.sensing import sensors_of
from rig.model.tolerances import EXACT, LABORATORY, ModeTolerance, SensorTolerance
from rig.simulation.reference import BarrelCradle, Sdof

BEAMS = planned_test(BarrelCradle(sensors="acceleration", noise_density=1e-3).rig(), duration_s=20.0)
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


def test_each_change_changes_one_thing():
    changes = list(changes_of(BEAMS))
    assert {change.kind for change in changes} == set(PARTS)
    assert len({change.words for change in changes}) == len(changes)
    for change in changes:
        part = PARTS[change.kind]
        if part in ("sensors", "force_at"):
            assert replace(change.test, rig=BEAMS.rig) == BEAMS
            assert replace(change.test.rig, **{part: getattr(BEAMS.rig, part)}) == BEAMS.rig
            assert getattr(change.test.rig, part) != getattr(BEAMS.rig, part)
        else:
            assert replace(change.test, **{part: getattr(BEAMS, part)}) == BEAMS
            assert change.test != BEAMS


def test_displacement_sensors_come_to_both_sides_of_a_contact_that_has_none():
    added = [change.test.rig for change in changes_of(BEAMS) if "displacement" in change.words]
    stations = [{sensor.station for sensor in sensors_of(rig, "displacement")} for rig in added]
    of_contacts = [set(contact_stations(contact)) for contact in BEAMS.rig.contacts]
    assert stations == [*of_contacts, set.union(*of_contacts)]
    both = planned_test(BarrelCradle().rig(), duration_s=20.0)
    assert not [change for change in changes_of(both) if "displacement sensor" in change.words]


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
