"""Files as loggers write them: the map proposed for each imports the measurement that was written."""

import json
import os
from pathlib import Path

import h5py
import msgspec
import numpy as np
import pytest
import pyuff
from msgspec.structs import replace
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from rig.errors import RigError
from rig.lab.importing import import_file
from rig.lab.looking import proposed_import_map
from rig.model.description import ON_GROUND, Sensor, to_json
from rig.recording import read
from rig.simulation.reference import BarrelCradle, Sdof
from tests.rig.lab.looking.loggers import ACCELERATION, FORCE_N, LOGGERS, RATE_HZ, SAMPLES, TABLE, TIME_S, rows
from tests.running import exit_status
from tests.uff_histories import time_history

RIG = Sdof().rig()
FORCE_LINE = 'force = {{ column = {}, unit = "N"{} }}'
UNKNOWN = {'unit = "?"': 'unit = "m/s^2"', 'quantity = "?"': 'quantity = "acceleration"'}
VOLTS = UNKNOWN | {'scale = "?"': "scale = 10.0"}
OWNER = {
    "writematrix": ({"force": FORCE_LINE.format(2, ""), '"channel_2"': None}, UNKNOWN),
    "writetable": ({}, UNKNOWN),
    "savetxt": ({"force": FORCE_LINE.format('"F"', "")}, UNKNOWN),
    "tektronix": ({"force": FORCE_LINE.format('"CH1"', ", scale = 100.0"), '"CH1"': None}, VOLTS),
    "keysight": ({"force": FORCE_LINE.format(2, ", scale = 100.0"), '"channel_2"': None}, VOLTS),
    "rigol": (
        {"force": FORCE_LINE.format('"CH1"', ", scale = 100.0"), '"CH1"': None},
        UNKNOWN | {'unit = "?"': 'unit = "m/s^2", scale = 10.0'},
    ),
}
"""What only the owner knows: lines in place of those that begin so (None: deleted), and texts in place of others."""
DATED = {
    "labview": "2024-03-01T14:05:06.789000",
    "milliseconds": "2024-03-14T14:05:06",
    **dict.fromkeys(
        ("catman", "bruel_kjaer", "simcenter", "dewesoft", "excel_german", "to_csv_dated", "imc", "yokogawa"),
        "2024-03-01T14:05:06",
    ),
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.json").write_bytes(to_json(RIG))
    return tmp_path


def filled(text, lines=(), words=()):
    """Map text with what its owner knows."""
    kept = []
    for line in text.splitlines():
        beginning = next((b for b in lines if line.startswith(b)), None)
        kept += [line] if beginning is None else [lines[beginning]] if lines[beginning] else []
    text = "\n".join(kept)
    for old, new in dict(words).items():
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize("name", LOGGERS)
def test_the_proposed_map_imports_what_the_logger_wrote(folder, name):
    ending, write = LOGGERS[name]
    source, map_path = folder / f"run{ending}", folder / "map.toml"
    source.write_bytes(write())
    proposal = proposed_import_map(source, RIG)
    text = filled(proposal.text, *OWNER.get(name, ()))
    map_path.write_text(text, encoding="utf-8")
    if proposal.placeholder_count:
        unfilled = folder / "unfilled.toml"
        unfilled.write_text(proposal.text, encoding="utf-8")
        with pytest.raises(RigError, match=f"{proposal.placeholder_count} value.* left to fill in, marked '\\?'"):
            import_file(source, unfilled, folder / "r.mcap")
    steps = import_file(source, map_path, folder / "r.mcap")
    recording = read(folder / "r.mcap")
    assert recording.samples == SAMPLES
    np.testing.assert_allclose(recording.force_n, FORCE_N, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(recording.signals["acceleration"].values, ACCELERATION[None], rtol=1e-7, atol=1e-6)
    (sensor,) = recording.rig.sensors
    assert (sensor.station, recording.rig.force_at) == (RIG.force_at, RIG.force_at)
    origin = "header" if name in DATED else "modification time"
    assert any(f"by the file's {origin}" in step for step in steps)
    if name in DATED:
        assert recording.provenance["recorded"] == DATED[name]


@pytest.mark.parametrize("name", ["dewesoft", "catman"])
def test_two_commands_and_places_make_a_recording(tmp_path, capsys, name):
    ending, write = LOGGERS[name]
    source, map_path, out = tmp_path / f"run{ending}", tmp_path / "run.toml", tmp_path / "run.mcap"
    source.write_bytes(write())
    assert exit_status("rig", "import", source, "--write-map", map_path) == 0
    assert "4 values marked ?" in capsys.readouterr().out
    assert exit_status("rig", "import", source, "--map", map_path, "--out", out) == 1
    told = capsys.readouterr().err
    assert "4 values are left to fill in" in told
    assert "body and position_m of force; body and position_m of sensor " in told
    text = map_path.read_text(encoding="utf-8").replace('body = "?"', 'body = "mass"')
    map_path.write_text(text.replace('position_m = "?"', "position_m = 0.0"), encoding="utf-8")
    assert exit_status("rig", "import", source, "--map", map_path, "--out", out) == 1
    assert "write it by `rig init`" in capsys.readouterr().err
    (tmp_path / "rig.json").write_bytes(to_json(RIG))
    assert exit_status("rig", "import", source, "--map", map_path, "--out", out) == 0
    np.testing.assert_allclose(read(out).force_n, FORCE_N, atol=1e-6)


def test_without_a_place_to_write_it_the_map_is_printed(folder, capsys):
    (folder / "run.csv").write_bytes(LOGGERS["dewesoft"][1]())
    assert exit_status("rig", "import", folder / "run.csv") == 0
    text = capsys.readouterr().out
    assert set(msgspec.toml.decode(text)) == {"rig", "time", "csv", "force", "sensors"}
    (folder / "run.toml").write_text(text, encoding="utf-8")
    assert (
        exit_status("rig", "import", folder / "run.csv", "--map", folder / "run.toml", "--out", folder / "r.mcap") == 0
    )
    capsys.readouterr()
    assert exit_status("rig", "import", folder / "run.csv", "--json") == 0
    assert json.loads(capsys.readouterr().out)["left"] == 0
    assert exit_status("rig", "import", folder / "run.csv", "--out", folder / "other.mcap") == 2
    assert exit_status("rig", "import", folder / "run.csv", "--write-map", folder / "run.json") == 1


def test_the_map_in_the_readme_is_the_one_proposed(tmp_path):
    (tmp_path / "run7.csv").write_bytes(LOGGERS["excel_german"][1]())
    readme = (Path(__file__).parents[4] / "rig" / "lab" / "README.md").read_text(encoding="utf-8")
    assert f"```\n{proposed_import_map(tmp_path / 'run7.csv', None).text}```\n" in readme


def test_of_several_bodies_the_owner_gives_the_place_and_known_names_need_none(tmp_path):
    rig = BarrelCradle().rig()
    known = next(s for s in rig.sensors if s.quantity == "acceleration")
    (tmp_path / "rig.json").write_bytes(to_json(rig))
    source, map_path = tmp_path / "run.csv", tmp_path / "map.toml"
    names = f"time_s,F [N],{known.name} [m/s^2],tip [m/s^2]\n"
    table = np.column_stack([TABLE[:, 1:], TABLE[:, 2] * 2])
    source.write_text(names + rows(np.column_stack([np.arange(SAMPLES) / rig.sample_rate_hz, table]), digits="%.12g"))
    proposal = proposed_import_map(source, rig)
    assert proposal.placeholder_count == 2
    text = proposal.text.replace('body = "?", position_m = "?"', 'body = "barrel", position_m = 0.75')
    map_path.write_text(text)
    import_file(source, map_path, tmp_path / "r.mcap")
    recording = read(tmp_path / "r.mcap")
    placed = {s.name: (s.station.body, s.station.position_m) for s in recording.rig.sensors}
    assert placed == {known.name: (known.station.body, known.station.position_m), "tip": ("barrel", 0.75)}
    map_path.write_text(text.replace("0.75", "125.0"))
    with pytest.raises(RigError, match=r"sensor 'tip' stands at 125\.0 m, off 'barrel'"):
        import_file(source, map_path, tmp_path / "other.mcap")


def test_the_map_of_a_rig_on_a_shaking_base_asks_for_no_force(tmp_path):
    """A sensor on the ground, no force_at and no column of a force: the record is imported without a value added."""
    table = Sensor(name="table", station=ON_GROUND, quantity="acceleration")
    mass = replace(table, name="mass", station=RIG.sensors[0].station)
    rig = replace(RIG, force_at=ON_GROUND, sensors=(table, mass))
    (tmp_path / "rig.json").write_bytes(to_json(rig))
    table_text = rows(np.column_stack([TIME_S, TABLE[:, 2], TABLE[:, 2]]), digits="%.12g")
    (tmp_path / "run.csv").write_text(f"time_s,table [m/s^2],mass [m/s^2]\n{table_text}")
    proposal = proposed_import_map(tmp_path / "run.csv", rig)
    assert proposal.placeholder_count == 0
    (tmp_path / "map.toml").write_text(proposal.text)
    import_file(tmp_path / "run.csv", tmp_path / "map.toml", tmp_path / "r.mcap")
    assert not read(tmp_path / "r.mcap").signals["force"].values.any()


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"a,b\nnone,of these\nis,numbers\n", "no lines of numbers are found"),
        (b'"0,5","1,5"\n"0,6","1,6"\n', "commas in quotes between commas"),
        (b"\x00\x01\xff\xfe" * 50 + b"\x81", "no lines of numbers|is not text"),
        (b"t,F [N]\n0.0,1\n0.1,3\n0.2,2\nt,F [N]\n0.0,1\n0.1,2\n", "line 5 is no line of samples, and samples follow"),
        (b"t,on\n0.0,1\n0.1,1\n0.2,1\n", r"no column of it is a measured channel \(column 1 't': it is a time; .*'on'"),
        (b"", "is empty"),
    ],
)
def test_what_no_map_can_import_is_refused_in_one_sentence(tmp_path, content, sentence):
    (tmp_path / "run.csv").write_bytes(content)
    with pytest.raises(RigError, match=sentence) as caught:
        proposed_import_map(tmp_path / "run.csv", None)
    assert "\n" not in str(caught.value)


def test_a_hole_in_a_channel_leaves_that_one_out_and_uneven_stamps_are_resampled(tmp_path):
    jittered_s = TIME_S + 2e-4 * (np.arange(SAMPLES) % 2)
    lines = rows(np.column_stack([jittered_s, TABLE[:, 1:], TABLE[:, 2]])).splitlines()
    lines[40] = lines[40].rpartition(",")[0] + ","
    (tmp_path / "run.csv").write_text("\n".join(["t [s],F [N],a [g],b [g]", *lines, ""]))
    text = proposed_import_map(tmp_path / "run.csv", RIG).text
    assert "left out: column 4 'b [g]' (it has no number in line 42)" in text
    assert "resample = true  # its time stamps are uneven" in text


def written(folder, form):
    """The measurement in a binary format, with what the owner must add to its map."""
    path = folder / f"run.{form}"
    if form == "mat":
        data = {"Fs": RATE_HZ, "run": {"Force": FORCE_N, "acc": np.stack([ACCELERATION, 2 * ACCELERATION], axis=1)}}
        savemat(path, data)
        return path, {'unit = "?"': 'unit = "m/s^2"', '"run.Force", unit = "m/s^2"': '"run.Force", unit = "N"'}
    if form == "tdms":
        date = np.datetime64("2024-03-01T14:05:06")
        with TdmsWriter(str(path)) as writer:
            for name, unit, values in (("F", "N", FORCE_N), ("a", "m/s^2", ACCELERATION)):
                properties = {"wf_increment": 1 / RATE_HZ, "unit_string": unit, "wf_start_time": date}
                writer.write_segment([ChannelObject("run", name, values, properties)])
    elif form == "h5":
        with h5py.File(path, "w") as file:
            file.attrs["date"] = "2024-03-01 14:05:06"
            for name, unit, values in (("t", "s", TIME_S), ("F", "N", FORCE_N), ("a", "m/s^2", ACCELERATION)):
                file.create_dataset(name, data=values).attrs["unit"] = unit
    else:
        fields = {"binary": 1, "id3": "01-Mar-24 14:05:06"}
        datasets = [
            time_history(name, TIME_S, values, ordinate_axis_units_lab=unit, **fields)
            for name, unit, values in (("F", "N", FORCE_N), ("a", "m/s^2", ACCELERATION))
        ]
        pyuff.UFF(str(path)).write_sets(datasets, "add")
    return path, {}


@pytest.mark.parametrize("form", ["mat", "tdms", "h5", "uff"])
def test_other_formats_are_looked_at_too(folder, form):
    source, words = written(folder, form)
    proposal = proposed_import_map(source, RIG)
    (folder / "map.toml").write_text(filled(proposal.text, (), words))
    import_file(source, folder / "map.toml", folder / "r.mcap")
    recording = read(folder / "r.mcap")
    np.testing.assert_allclose(recording.force_n, FORCE_N)
    np.testing.assert_allclose(recording.signals["acceleration"].values[0], ACCELERATION)
    if form != "mat":  # which is dated when it is saved
        assert recording.provenance["recorded"].startswith("2024-03-01T14:05:06")


@pytest.mark.parametrize(
    ("folder_variable", "name", "seen"),
    [
        ("SILVERBOX", "SNLS80mV.csv", "131072 samples of 2 channels; the file states neither time nor sampling rate"),
        ("SILVERBOX", "Schroeder80mV.csv", "left out: column 1 'Ovld2' (it has numbers in 1 of 131072 lines)"),
        ("F16", "F16Data_FullMSine_Level1.mat", "73728 samples of 5 channels; 400 Hz by 'Fs'"),
        ("EMPS", "DATA_EMPS.mat", "24841 samples of 3 channels; 1000 Hz by column 't'"),
    ],
)
def test_measured_files_are_seen_as_they_are(folder_variable, name, seen):
    path = Path(os.environ.get(folder_variable, folder_variable.lower())) / name
    if not path.exists():
        pytest.skip(f"no {name}: let the environment variable {folder_variable} name its folder")
    assert seen in proposed_import_map(path, None).text
