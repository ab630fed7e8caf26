"""Recordings in the files of other programs, and back."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.lab.exporting import WRITERS, export
from rig.lab.importing import import_file
from rig.lab.tables import READERS
from rig.model.description import Sensor, Station
from rig.recording import channel_groups, read, writing
from rig.simulation.reference import BarrelCradle


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("form", [form for form in WRITERS if f".{form}" in READERS])
def test_an_exported_recording_comes_back_by_the_map_beside_it(tmp_path, form, several):
    rig, rng = BarrelCradle(stations=4).rig(), np.random.default_rng(2)
    if several:
        rig = replace(rig, force_at=(rig.force_at, Station("cradle", 0.6), rig.force_at))
    gauge = Sensor(name="root", station=Station("cradle", 0.0), quantity="strain")
    rig = replace(rig, sensors=(*rig.sensors, gauge))
    groups = channel_groups(rig)
    with writing(tmp_path / "r.mcap", rig, groups, {}) as recording:
        for name, group in groups.items():
            recording.append(name, rng.standard_normal((len(group.names), 1500)))
    before = read(tmp_path / "r.mcap")
    export(before, form, tmp_path / f"out.{form}", tmp_path / "map.toml")
    import_file(tmp_path / f"out.{form}", tmp_path / "map.toml", tmp_path / "back.mcap")
    back = read(tmp_path / "back.mcap")
    assert back.rig == before.rig
    for name, signals in before.signals.items():
        np.testing.assert_array_equal(back.signals[name].values, signals.values)
    assert not list(tmp_path.glob("*.part"))
