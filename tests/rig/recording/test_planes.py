"""Recordings in space: written and read with their directions, and split into those of the plane rigs."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.recording import channel_groups, plane_recording, read, truth_groups, writing
from rig.simulation.reference import BarrelCradle, BarrelCradleAnnular

RIG = BarrelCradleAnnular(sensors="acceleration").rig()


def written(rig, path, stated=None):
    groups = channel_groups(rig)
    rng = np.random.default_rng(1)
    values = {name: rng.standard_normal((len(group.names), 2000)) for name, group in groups.items()}
    with writing(path, stated or rig, groups, {"made_by": "a test"}) as recording:
        recording.append_all(values)
    return values


def test_a_recording_in_space_holds_both_directions(tmp_path):
    values = written(RIG, tmp_path / "r.mcap")
    recording = read(tmp_path / "r.mcap")
    assert recording.rig == RIG
    assert recording.signals["force"].channels.stations == RIG.forces
    tip = recording["barrel_1000mm_z_acceleration"]
    assert tip.station == RIG.sensors[-1].station
    np.testing.assert_array_equal(tip.values, values["acceleration"][-1])
    contacts = truth_groups(RIG)["contact_force"].names
    assert contacts == ("contact_1_y", "contact_1_z", "contact_2_y", "contact_2_z")


def test_each_plane_recording_has_the_channels_of_its_direction(tmp_path):
    values = written(RIG, tmp_path / "r.mcap")
    recording = read(tmp_path / "r.mcap")
    for k, direction in enumerate(("y", "z")):
        plane = plane_recording(recording, direction)
        assert plane.force_names == ("force",)
        np.testing.assert_array_equal(plane.force_n, values["force"][k])
        assert [s.name for s in plane.rig.sensors] == list(plane.signals["acceleration"].channels.names)
        np.testing.assert_array_equal(plane.signals["acceleration"].values, values["acceleration"][8 * k : 8 * k + 8])
        assert plane_recording(plane, "y") is plane


def test_where_no_force_acts_in_a_direction_its_channel_is_zero(tmp_path):
    written(replace(RIG, force_at=RIG.forces[0]), tmp_path / "r.mcap")
    plane = plane_recording(read(tmp_path / "r.mcap"), "z")
    assert not plane.force_n.any()
    assert plane.rig.force_at.direction == "y"


def test_a_channel_in_another_direction_than_its_sensor_is_named(tmp_path):
    rig = BarrelCradle(stations=4, sensors="acceleration").rig()
    turned = replace(rig.sensors[0], station=replace(rig.sensors[0].station, direction="z"))
    written(rig, tmp_path / "r.mcap", stated=replace(rig, sensors=(turned, *rig.sensors[1:])))
    with pytest.raises(RigError, match=f"channel '{turned.name}' of group acceleration is no sensor of rig.json, or"):
        read(tmp_path / "r.mcap")
