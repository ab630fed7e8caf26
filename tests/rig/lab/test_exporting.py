"""Recordings in the files of other programs and back, HDF5 files of other programs, MDF files and SEP005 channels."""

import h5py
import numpy as np
import pytest
from asammdf import MDF
from msgspec.structs import replace
from sdypy_sep005.sep005 import assert_sep005

from rig.errors import RigError
from rig.lab.csv_text import TextForm
from rig.lab.exporting import WRITERS, export
from rig.lab.importing import import_file
from rig.lab.sep005 import import_sep005, to_sep005
from rig.lab.tables import READERS, read_table
from rig.model.description import Sensor, Station
from rig.recording import channel_groups, read, writing
from rig.simulation.reference import BarrelCradle, Sdof


@pytest.mark.parametrize("several_forces", [False, True])
@pytest.mark.parametrize("form", [form for form in WRITERS if f".{form}" in READERS])
def test_an_exported_recording_comes_back_by_the_map_beside_it(tmp_path, form, several_forces):
    rig, rng = BarrelCradle(stations=4).rig(), np.random.default_rng(2)
    if several_forces:
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
    imported = read(tmp_path / "back.mcap")
    assert imported.rig == before.rig
    for name, signals in before.signals.items():
        np.testing.assert_array_equal(imported.signals[name].values, signals.values)
    assert not list(tmp_path.glob("*.part"))


RNG = np.random.default_rng(4)
FORCE, BOTH = RNG.standard_normal(400), RNG.standard_normal((400, 2))


@pytest.fixture
def recorded(tmp_path):
    rig = Sdof(sensors="displacement+acceleration").rig()
    groups = channel_groups(rig)
    with writing(tmp_path / "r.mcap", rig, groups, {}) as recording:
        for name, group in groups.items():
            recording.append(name, RNG.standard_normal((len(group.names), 1500)))
    before = read(tmp_path / "r.mcap")
    export(before, "h5", tmp_path / "unused.h5", tmp_path / "map.toml")
    return before


def test_hdf5_of_others_is_read_by_paths_attributes_and_columns(tmp_path):
    with h5py.File(tmp_path / "lab.h5", "w") as file:
        file["run/force"] = FORCE
        file["run/force"].attrs["units"] = "kN"
        file["run/force"].attrs["fs"] = 512
        file["run/acc"] = BOTH
        file["note"], file["gain"] = "by hand", 2.0
    columns = read_table(tmp_path / "lab.h5", TextForm()).columns.values()
    assert [(c.name, c.unit, c.sample_rate_hz) for c in columns] == [
        ("run/acc[1]", None, None),
        ("run/acc[2]", None, None),
        ("run/force", "kN", 512.0),
    ]
    np.testing.assert_array_equal([c.values for c in columns], [*BOTH.T, FORCE])


def test_mdf_holds_every_channel_over_its_time(tmp_path, recorded):
    export(recorded, "mf4", tmp_path / "out.mf4", None)
    with MDF(tmp_path / "out.mf4") as file:
        channels = list(file.iter_channels())
    rows = [
        (name, s.channels.unit, row)
        for s in recorded.signals.values()
        for name, row in zip(s.channels.names, s.values, strict=True)
    ]
    assert [(s.name, s.unit) for s in channels] == [(name, unit) for name, unit, _ in rows]
    for signal, (_, _, row) in zip(channels, rows, strict=True):
        np.testing.assert_array_equal(signal.samples, row)
        np.testing.assert_array_equal(signal.timestamps, recorded.signals["force"].time_s)


def test_what_is_no_hdf5_is_said(tmp_path):
    (tmp_path / "lab.h5").write_bytes(b"nothing of the kind" * 50)
    with pytest.raises(RigError, match=r"lab.h5: cannot be read as .h5 \(its beginning is another\); export it again"):
        read_table(tmp_path / "lab.h5", TextForm())


def test_sep005_channels_are_valid_and_come_back(tmp_path, recorded):
    channels = to_sep005(recorded)
    assert_sep005(channels)
    import_sep005(channels, tmp_path / "map.toml", tmp_path / "back.mcap")
    imported = read(tmp_path / "back.mcap")
    assert imported.rig == recorded.rig
    for name, signals in recorded.signals.items():
        np.testing.assert_array_equal(imported.signals[name].values, signals.values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": None}, "channel 1 of SEP005 lacks 'name'; add it"),
        ({"fs": None}, "channel 1 of SEP005 lacks 'fs or time'; add it"),
        ({"data": "abc"}, "channel 'force' of SEP005 is not of numbers"),
        ({"name": "power"}, "there is no column 'force'"),
    ],
)
def test_a_sep005_channel_that_is_none_is_refused(tmp_path, recorded, change, said):
    first, *further = to_sep005(recorded)
    wrong = {key: value for key, value in (first | change).items() if value is not None}
    with pytest.raises(RigError, match=said):
        import_sep005([wrong, *further], tmp_path / "map.toml", tmp_path / "back.mcap")
    assert not (tmp_path / "back.mcap").exists()
