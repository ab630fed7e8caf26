"""The reference rigs are those of the paper, and their settings are checked."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.model.description import Station
from rig.simulation.excitation import FreeDecay, force_history
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular, Sdof, reference


def test_the_barrel_bends_first_at_53_hz():
    rig = BarrelCradle().rig()
    assert rig.body("barrel").frequencies_hz(3)[2] == pytest.approx(53, abs=0.5)


@pytest.mark.parametrize("overlap_start_m", [0.45, 0.4])
def test_contacts_join_the_same_place_of_both_beams(overlap_start_m):
    settings = BarrelCradle(overlap_start_m=overlap_start_m)
    for contact in settings.rig().contacts:  # the barrel's left end lies over overlap_start_m of the cradle
        assert contact.at.body == "barrel"
        assert contact.against.body == "cradle"
        assert contact.against.position_m - contact.at.position_m == pytest.approx(overlap_start_m)


@pytest.mark.parametrize("stations", [4, 6, 8, 10])
def test_each_beam_has_its_sensors_with_the_contacts_among_them(stations):
    rig = BarrelCradle(stations=stations, sensors="acceleration").rig()
    places = [s.station for s in rig.sensors]
    assert [p.body for p in places] == ["cradle"] * stations + ["barrel"] * stations
    assert {c.at for c in rig.contacts} | {c.against for c in rig.contacts} | {rig.force_at} <= set(places)


def test_the_barrel_in_its_rings_has_four_places_a_tube_in_both_directions_with_its_contacts_among_them():
    rig = BarrelCradleAnnular(sensors="acceleration").rig()
    places = {(s.station.body, s.station.position_m) for s in rig.sensors}
    for direction in ("y", "z"):
        in_direction = [s.station for s in rig.sensors if s.station.direction == direction]
        assert [s.body for s in in_direction] == ["cradle"] * 4 + ["barrel"] * 4
        assert {(s.body, s.position_m) for s in in_direction} == places
    assert {(s.body, s.position_m) for c in rig.contacts for s in (c.at, c.against)} < places
    assert all(c.against.position_m - c.at.position_m == pytest.approx(0.45) for c in rig.contacts)


def test_both_kinds_of_sensors_stand_at_the_same_places():
    rig = BarrelCradle(noise_density=1e-3).rig()
    by_quantity = {q: [s for s in rig.sensors if s.quantity == q] for q in ("displacement", "acceleration")}
    assert [s.station for s in by_quantity["displacement"]] == [s.station for s in by_quantity["acceleration"]]
    assert {s.noise_density for s in by_quantity["displacement"]} == {0.0}
    assert {s.noise_density for s in by_quantity["acceleration"]} == {1e-3}


def test_the_mass_meets_its_stops_hard_enough():
    settings = Sdof(duration_s=100.0, sensors="displacement")
    rig = settings.rig()
    force = force_history(settings.force(), settings.duration_s, settings.step_s)
    motion = concatenated(modal.simulate(rig, force, settings.step_s, lambda _: None))
    linear = rig.bodies[0].stiffness_n_per_m * motion.sensed[0]
    assert np.std(motion.contact_force_n) >= 0.15 * np.std(linear)


def test_settings_come_as_text():
    settings = reference("barrel_cradle", {"stations": "8", "rms_n": "20", "excitation": "free_decay"})
    assert settings == BarrelCradle(stations=8, rms_n=20.0, excitation="free_decay")
    assert settings.force() == FreeDecay(rms_n=20.0, low_hz=0.5, high_hz=100.0)
    assert reference("sdof", {}).rig().force_at == Station("mass")


@pytest.mark.parametrize(
    ("scenario", "settings", "sentence"),
    [
        ("bicycle", {}, "no scenario 'bicycle'; there are sdof, barrel_cradle"),
        ("sdof", {"weight": "1"}, "sdof has no setting 'weight'; it has mass_kg"),
        ("sdof", {"mass_kg": "heavy"}, "mass_kg"),
        ("barrel_cradle", {"stations": "5"}, "stations"),
    ],
)
def test_settings_that_do_not_fit_are_refused(scenario, settings, sentence):
    with pytest.raises(RigError) as caught:
        reference(scenario, settings)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "settings", "sentence"),
    [
        (Sdof, {"mass_kg": 0.0}, "mass_kg is 0.0"),
        (BarrelCradle, {"clearance_1_m": -1.0}, "contact law: clearance_m is -1.0; give"),
        (BarrelCradle, {"overlap_start_m": 1.5}, "off"),
        (Sdof, {"sensors": "strain"}, "measures strain of 'mass', a mass; put it on a beam"),
        (BarrelCradle, {"sensors": "acceleration+speed"}, "no quantity 'speed'; join any of acceleration"),
    ],
)
def test_a_rig_with_a_bad_setting_is_refused(kind, settings, sentence):
    with pytest.raises(RigError) as caught:
        kind(**settings).rig()
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("sensors", "measured"),
    [("acceleration+strain", ["acceleration", "strain"]), ("both", ["displacement", "acceleration"])],
)
def test_every_station_has_the_sensors_that_a_setting_joins(sensors, measured):
    rig = BarrelCradle(stations=4, sensors=sensors, noise_density=1e-3).rig()
    assert [s.quantity for s in rig.sensors] == [m for m in measured for _ in range(8)]
    assert all(s.noise_density == 1e-3 * (s.quantity == "acceleration") for s in rig.sensors)
