"""Measured data made recordings: the same numbers, or one sentence that says why not."""

import json
import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest
import pyuff
from msgspec.structs import replace
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from rig.errors import RigError
from rig.lab.column import Column
from rig.lab.importing import import_columns, import_file
from rig.model.description import to_json
from rig.recording import read
from rig.simulation.reference import Sdof
from tests.running import exit_status
from tests.uff_histories import time_history

RIG = Sdof().rig()
RATE_HZ = RIG.sample_rate_hz
SAMPLES = 2000
X, A = (s.name for s in RIG.sensors)
UNITS = {"force": "kN", X: "mm", A: "g"}
SI = {"force": 1e3, X: 1e-3, A: 9.80665}
VALUES = dict(zip(UNITS, np.random.default_rng(1).standard_normal((3, SAMPLES)), strict=True))
TIME_S = np.arange(SAMPLES) / RATE_HZ


def mapped(**changes):
    """The map of the CSV that `csv_text` writes, as a dictionary; a value None takes an entry out."""
    entries = {
        "rig": "rig.json",
        "time": {"column": "t", "unit": "s"},
        "force": {"column": "F", "unit": "kN"},
        "sensors": {X: {"column": "x", "unit": "mm"}, A: {"column": "a", "unit": "g"}},
        **changes,
    }
    return {key: value for key, value in entries.items() if value is not None}


def toml(content):
    """A TOML inline table holds what a JSON object does."""
    if isinstance(content, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(value)}" for key, value in content.items()) + " }"
    return json.dumps(content)


def csv_text(time_s=TIME_S, values=VALUES, names="t,F,x,a"):
    rows = np.stack([time_s, *values.values()], axis=1)
    return names + "\n" + "\n".join(",".join(f"{v!r}" for v in row) for row in rows.tolist()) + "\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.json").write_bytes(to_json(RIG))
    return tmp_path


def imported(folder, mapping, name="lab.csv", text=None):
    """Recording that `rig import` makes of a file in the folder, which is first written if a text is given."""
    if text is not None:
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    (folder / "map.toml").write_text("\n".join(f"{key} = {toml(value)}" for key, value in mapping.items()))
    import_file(folder / name, folder / "map.toml", folder / "r.mcap")
    return read(folder / "r.mcap")


def check(recording, values=VALUES, si=SI):
    """Every channel is the value times the unit, to the last bit."""
    rows = {
        name: row
        for signals in recording.signals.values()
        for name, row in zip(signals.channels.names, signals.values, strict=True)
    }
    assert set(rows) == set(values)
    for name, row in values.items():
        np.testing.assert_array_equal(rows[name], si[name] * row)


def test_csv_in_the_units_of_a_laboratory(folder):
    recording = imported(folder, mapped(), text=csv_text())
    check(recording)
    assert recording.rig == RIG
    assert recording.provenance["source"] == "lab.csv"
    assert recording.provenance["history 1"] == f"{SAMPLES} samples of 3 columns read from lab.csv"
    assert f"{A} = 9.80665 x column 'a'" in recording.provenance["history 2"]


def test_the_map_of_the_readme_works(folder):
    readme = (Path(__file__).parents[3] / "rig" / "lab" / "README.md").read_text(encoding="utf-8")
    mapping = msgspec.toml.decode(readme.split("```toml\n")[1].split("```")[0])
    rig = Sdof(sensors="acceleration").rig()
    (folder / "rig.json").write_bytes(to_json(rig))
    values = {"force": VALUES["force"], A: VALUES[A]}
    check(imported(folder, mapping, text=csv_text(values=values, names="time_s,load cell,acc 1")), values)


def test_a_free_decay_has_no_force(folder):
    recording = imported(folder, mapped(force="none"), text=csv_text())
    check(recording, VALUES | {"force": np.zeros(SAMPLES)})


def test_several_forces_are_columns_of_their_own_units(folder):
    rig = replace(RIG, force_at=(RIG.force_at, RIG.force_at))
    (folder / "rig.json").write_bytes(to_json(rig))
    lines = ['time = { column = "t" }', f"sensors = {toml(mapped()['sensors'])}"]
    entries = ['[[force]]\ncolumn = "F"\nunit = "kN"', '[[force]]\ncolumn = "G"\nunit = "N"\nscale = -2.0']
    (folder / "map.toml").write_text("\n".join([*lines, *entries]))
    second = np.sin(TIME_S)
    (folder / "lab.csv").write_text(csv_text(values=VALUES | {"G": second}, names="t,F,x,a,G"))
    import_file(folder / "lab.csv", folder / "map.toml", folder / "r.mcap")
    np.testing.assert_array_equal(read(folder / "r.mcap").forces_n, [1e3 * VALUES["force"], -2.0 * second])
    for count, force_text in ((1, entries[0]), (0, "force = []")):
        (folder / "map.toml").write_text("\n".join([*lines, force_text]))
        with pytest.raises(RigError, match=rf"force has {count} columns, and its rig\.json 2 forces"):
            import_file(folder / "lab.csv", folder / "map.toml", folder / "other.mcap")


def test_csv_from_another_country(folder):
    text = "Messung Müller; 20 °C\n" + csv_text(names="Zeit,Kraft,Weg,Beschl.").replace(",", ";").replace(".", ",")
    mapping = mapped(
        time={"column": "Zeit"},
        force={"column": 2, "unit": "kN", "scale": -1.0},
        sensors={X: {"column": "Weg", "unit": "mm"}, A: {"column": "Beschl,", "unit": "m/s²"}},
        csv={"encoding": "latin-1", "delimiter": ";", "decimal": ",", "lines_before_names": 1},
    )
    check(imported(folder, mapping, text=text.encode("latin-1")), si=SI | {"force": -1e3, A: 1.0})


def test_csv_without_names(folder):
    mapping = mapped(
        time={"column": 1},
        force={"column": 2, "unit": "kN"},
        sensors={X: {"column": 3, "unit": "mm"}, A: {"column": "column 4", "unit": "g"}},
    )
    check(imported(folder, mapping, text=csv_text().split("\n", 1)[1]))


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("spacing", [0, 1])
def test_uff(folder, binary, spacing):
    datasets = [
        time_history(name, TIME_S, VALUES[name], binary=binary, abscissa_spacing=spacing, ordinate_axis_units_lab=unit)
        for name, unit in UNITS.items()
    ]
    pyuff.UFF(str(folder / "lab.uff")).write_sets(datasets, "add")
    mapping = mapped(
        time={"column": "force time"} if spacing == 0 and binary else None,
        sample_rate_hz=None if binary else RATE_HZ,  # the text form's time has six digits
        force={"column": "force"},
        sensors={X: {"column": X}, A: {"column": A, "unit": "g"}},
    )
    recording = imported(folder, mapping, "lab.uff")
    for name, rows in (("force", recording.signals["force"]), (X, recording.signals["displacement"])):
        error = 0 if binary else 1e-11 * SI[name]  # the text form has twelve digits
        np.testing.assert_allclose(rows.values[0], SI[name] * VALUES[name], rtol=error, atol=error)


def test_matlab(folder):
    matrix = np.stack([VALUES[X], VALUES[A]], axis=1)
    savemat(folder / "lab.mat", {"F": VALUES["force"], "data": matrix, "t": TIME_S[:, None], "note": "by hand"})
    mapping = mapped(sensors={X: {"column": "data[1]", "unit": "mm"}, A: {"column": "data[2]", "unit": "g"}})
    check(imported(folder, mapping, "lab.mat"))


def test_matlab_structs(folder):
    savemat(folder / "lab.mat", {"run": {"F": VALUES["force"], "data": {"x": VALUES[X], "a": VALUES[A]}, "t": TIME_S}})
    mapping = mapped(
        time={"column": "run.t"},
        force={"column": "run.F", "unit": "kN"},
        sensors={X: {"column": "run.data.x", "unit": "mm"}, A: {"column": "run.data.a", "unit": "g"}},
    )
    check(imported(folder, mapping, "lab.mat"))


def test_matlab_4_is_read_too(folder):
    savemat(folder / "lab.mat", {"F": VALUES["force"], "x": VALUES[X], "a": VALUES[A], "t": TIME_S}, format="4")
    check(imported(folder, mapped(), "lab.mat"))


@pytest.mark.parametrize("compressed", [False, True])
def test_a_matlab_file_that_is_cut_or_of_an_unknown_type_is_refused(folder, compressed):
    """A damaged type makes scipy's reader end the process."""
    path = folder / "lab.mat"
    savemat(path, {"F": VALUES["force"]}, do_compression=compressed)
    content = path.read_bytes()
    for size in (len(content) - 1, len(content) // 2, 130):
        with pytest.raises(RigError, match=r"lab\.mat: "):
            imported(folder, mapped(), "lab.mat", content[:size])
    with pytest.raises(RigError, match=r"lab\.mat: .*its header is damaged"):
        imported(folder, mapped(), "lab.mat", b"W" + content[1:])
    if not compressed:
        offset = content.rindex(struct.pack("<II", 9, 8 * SAMPLES))
        with pytest.raises(RigError, match="is of the unknown type 8"):
            imported(folder, mapped(), "lab.mat", content[:offset] + b"\x08" + content[offset + 1 :])


def write_tdms(path, rates=(RATE_HZ,) * 3):
    with TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [
                ChannelObject("run", name, VALUES[name], {"wf_increment": 1 / rate, "unit_string": unit})
                for (name, unit), rate in zip(UNITS.items(), rates, strict=True)
            ]
        )


def test_tdms(folder):
    write_tdms(folder / "lab.tdms")
    mapping = mapped(time=None, force={"column": "run/force"}, sensors={n: {"column": f"run/{n}"} for n in (X, A)})
    check(imported(folder, mapping, "lab.tdms"))
    write_tdms(folder / "lab.tdms", (RATE_HZ, RATE_HZ, 2 * RATE_HZ))
    with pytest.raises(
        RigError, match=r"is sampled at 512 Hz from 0 to .* and column .* is sampled at 1024 Hz from 0 to"
    ):
        imported(folder, mapping, "lab.tdms")
    write_tdms(folder / "lab.tdms")
    mapping["sensors"][X]["unit"] = "m"
    with pytest.raises(RigError, match=f"column 'run/{X}' is in 'mm' by the file, 'm' by the map"):
        imported(folder, mapping, "lab.tdms")


def test_a_tdms_file_that_is_cut_is_refused(folder, capfd):
    write_tdms(folder / "lab.tdms")
    content = (folder / "lab.tdms").read_bytes()
    mapping = mapped(time=None, force={"column": "run/force"}, sensors={n: {"column": f"run/{n}"} for n in (X, A)})
    check(imported(folder, mapping, "lab.tdms", content))
    for text in (content[:-8], content[: len(content) // 2], content + content[:40], content[:20]):
        with pytest.raises(RigError, match=r"is cut off|has no whole segment"):
            imported(folder, mapping, "lab.tdms", text)
    assert capfd.readouterr() == ("", "")  # its library warns by itself


def nan_at(row, sample):
    rows = {name: values.copy() for name, values in VALUES.items()}
    rows[row][sample] = np.nan
    return rows


def stamps(**changes):
    time_s = TIME_S.copy()
    for sample, step in changes.items():
        time_s[int(sample[1:]) :] += step / RATE_HZ
    return time_s


@pytest.mark.parametrize(
    ("mapping", "text", "sentence"),
    [
        (mapped(force={"column": "F", "unit": "mm"}), csv_text(), "map.toml: 'mm' is no unit of force; give one of N"),
        (mapped(force={"column": "F"}), csv_text(), "map.toml: column 'F' has no unit"),
        (mapped(force={"column": "G", "unit": "N"}), csv_text(), "no column 'G'; the file has 't', 'F', 'x', 'a'"),
        (mapped(force={"column": 9, "unit": "N"}), csv_text(), "there is no column 9; the file has 1 to 4"),
        (mapped(force={"column": "x", "unit": "N"}), csv_text(), "column 'x' is given to both 'force' and"),
        (mapped(force={"column": "F", "unit": "N", "scale": 0.0}), csv_text(), "scale is 0.0"),
        (mapped(force={"column": "F", "unit": "kN", "scale": 1e308}), csv_text(), "'F' times inf is too large"),
        (mapped(), csv_text(names="t,F,x,F"), "2 columns are named 'F'; give the number"),
        (mapped(sensors={X: {"column": "x", "unit": "mm"}}), csv_text(), f"sensor {A!r} is missing"),
        (mapped(sensors={"y": {"column": "x"}}), csv_text(), "sensor 'y' is no sensor of the rig"),
        (mapped(force=None), csv_text(), "map.toml: is no map (it lacks 'force'; it needs force, sensors"),
        (mapped(speed=1), csv_text(), "map.toml: is no map (it has no field 'speed'; it has rig, force, sensors"),
        (mapped(rig="none.json"), csv_text(), "none.json: cannot be opened"),
        (mapped(sample_rate_hz=512.0), csv_text(), "time and sample_rate_hz are both given"),
        (mapped(time=None), csv_text(), "lab.csv: it does not say when its samples were taken"),
        (mapped(time=None, sample_rate_hz=100.0), csv_text(), "sampled at 100 Hz, below sample_rate_hz 512"),
        (mapped(time=None, sample_rate_hz=1024.0), csv_text(), "sampled at 1024 Hz, sample_rate_hz of the rig is 512"),
        (mapped(), b"", "lab.csv: is empty"),
        (mapped(), "t,F,x,a\n", "lab.csv: holds no samples"),
        (mapped(), csv_text().encode("utf-16"), "lab.csv: is not text in utf-8-sig (after line 0)"),
        (mapped(csv={"encoding": "klingon"}), csv_text(), "there is no encoding 'klingon'"),
        (mapped(csv={"delimiter": "."}), csv_text(), "give two different characters"),
        (mapped(csv={"lines_before_names": 99999}), csv_text(), "has no line after the first 99999"),
        (mapped(), csv_text() + "0,1,2\n", "the number of columns changed from 4 to 3"),
        (mapped(), csv_text() + "0,1,2,loud\n", "line 2002 has 'loud' in column 'a', which is no number"),
        (mapped(), csv_text(names="t,F,x"), "3 names for 4 columns"),
        (mapped(), csv_text(values=nan_at(A, 7)), "line 9 has 'nan' in column 'a', which is no number"),
        (mapped(), csv_text(stamps(_9=1)), f"1 gaps, the first after {8 / RATE_HZ:.6f} s"),
        (mapped(), csv_text(stamps(_9=0.1, _10=-0.1)), f"uneven, by 0.1 of a sampling interval at {9.1 / RATE_HZ:.6f}"),
        (mapped(resample=True), csv_text(stamps(_9=20)), f"a gap of {21 / RATE_HZ:.6g} s after {8 / RATE_HZ:.6f} s"),
        (mapped(resample=True), csv_text(stamps(_9=-1)), f"does not increase after {8 / RATE_HZ:.6f} s (sample 8)"),
        (mapped(), csv_text(np.where(TIME_S == 1.0, np.nan, TIME_S)), "line 514 has 'nan' in column 't', which"),
    ],
)
def test_what_cannot_be_imported_is_refused_in_one_sentence(folder, mapping, text, sentence):
    with pytest.raises(RigError) as caught:
        imported(folder, mapping, text=text)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(folder.glob("r.mcap*"))


def test_uneven_stamps_are_led_to_an_even_grid(folder):
    rng = np.random.default_rng(3)
    time_s = TIME_S + rng.uniform(-0.2, 0.2, SAMPLES) / RATE_HZ
    time_s[[0, -1]] = TIME_S[[0, -1]]
    keep = np.ones(SAMPLES, dtype=bool)
    keep[[300, 901, 902]] = False
    omega = 2 * np.pi * 10.0
    values = {name: np.sin(omega * time_s[keep] + phase) for phase, name in enumerate(UNITS)}
    recording = imported(folder, mapped(resample=True), text=csv_text(time_s[keep], values))
    assert recording.samples == SAMPLES
    widest = 3.4 / RATE_HZ
    bound = 4 * 5 / 384 * (omega * widest) ** 4 * SI["force"]  # over a gap of two samples, and for an uneven grid
    np.testing.assert_allclose(recording.force_n, SI["force"] * np.sin(omega * TIME_S), atol=bound)
    assert "by a cubic spline, since its time stamps have 2 gaps" in recording.provenance["history 3"]


def test_another_rate_is_reached_by_a_filter_that_keeps_the_passband_and_nothing_else(folder):
    rate_hz = RATE_HZ * 25 / 16
    time_s = np.arange(5 * SAMPLES) / rate_hz
    low, high = 0.3 * RATE_HZ, 0.7 * RATE_HZ  # the latter would fold to the former
    values = dict.fromkeys(UNITS, np.sin(2 * np.pi * low * time_s)) | {A: np.sin(2 * np.pi * high * time_s)}
    mapping = mapped(time=None, sample_rate_hz=rate_hz, resample=True)
    recording = imported(folder, mapping, text=csv_text(time_s, values))
    inside = slice(100, -100)
    expected = SI["force"] * np.sin(2 * np.pi * low * recording.signals["force"].time_s)
    np.testing.assert_allclose(recording.force_n[inside], expected[inside], atol=1e-3 * SI["force"])
    assert np.abs(recording.signals["acceleration"].values[0, inside]).max() < 1e-3 * SI[A]
    assert recording.provenance["history 3"] == "resampled from 800 to 512 Hz by a linear-phase filter"


def test_the_commands(folder, capsys):
    def rig(*words):
        return exit_status("rig", *words), *capsys.readouterr()

    path, out_csv, map_path = folder / "r.mcap", folder / "out" / "out.csv", folder / "out" / "map.toml"
    out_csv.parent.mkdir()
    imported(folder, mapped(), text=csv_text())
    words = ("import", folder / "lab.csv", "--map", folder / "map.toml", "--out", path)
    status, out, err = rig(*words)
    assert (status, out) == (1, "")
    assert "exists already" in err
    status, out, err = rig(*words, "--force", "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["history"][0] == f"{SAMPLES} samples of 3 columns read from lab.csv"
    assert rig("export", path, "--format", "csv", "--out", out_csv, "--map", map_path)[0] == 0
    assert msgspec.toml.decode(map_path.read_bytes())["rig"] == "rig.json"
    status, out, err = rig("import", out_csv, "--map", map_path, "--out", folder / "back.mcap")
    assert (status, err) == (0, "")
    check(read(folder / "back.mcap"))
    assert rig("export", path, "--format", "csv", "--out", out_csv)[0] == 1
    assert rig("export", path, "--format", "wav", "--out", out_csv)[0] == 2
    assert rig("export", path, "--format", "csv", "--out", path, "--force")[0] == 1
    (folder / "lab.csv").unlink()
    status, out, err = rig(*words, "--force")
    assert (status, out) == (1, "")
    assert err == f"rig: {folder / 'lab.csv'}: cannot be opened (No such file or directory); check the name\n"


def test_endings_that_do_not_fit_are_refused(folder, capsys):
    imported(folder, mapped(), text=csv_text())
    path, kept = folder / "r.mcap", sorted(folder.iterdir())
    for words, name in (
        (("import", folder / "lab.csv", "--map", folder / "map.toml", "--out", folder / "x.mat"), "x.mcap"),
        (("import", folder / "lab.csv", "--write-map", folder / "x.csv"), "x.toml"),
        (("export", path, "--format", "csv", "--out", folder / "x.mat"), "x.csv"),
        (("export", path, "--format", "mat", "--out", folder / "x"), "x.mat"),
        (("export", path, "--format", "csv", "--out", folder / "x.csv", "--map", folder / "x.json"), "x.toml"),
        (("recover", path, "--out", folder / "x.csv"), "x.mcap"),
        (("record", "sdof", "--out", folder / "x.csv"), "x.mcap"),
        (("draw", path, "--out", folder / "x.png"), "x.svg"),
        (("view", path, "--out", folder / "x.html"), "x.rrd"),
        (("fmu", path, "--out", folder / "x.zip"), "x.fmu"),
    ):
        assert exit_status("rig", *words) == 1
        assert f"; name it {name}\n" in capsys.readouterr().err
    assert sorted(folder.iterdir()) == kept


@pytest.mark.parametrize(("starts_s", "kept"), [((10.25, 10.0, 10.0), SAMPLES - 128), ((7.0, 7.0, 7.0), SAMPLES)])
def test_columns_that_state_their_starts_are_cut_to_their_common_time(folder, starts_s, kept):
    columns = [
        Column(name, values, UNITS[name], RATE_HZ, start_s=start_s)
        for (name, values), start_s in zip(VALUES.items(), starts_s, strict=True)
    ]
    mapping = mapped(time=None, force={"column": "force"}, sensors={n: {"column": n} for n in (X, A)})
    (folder / "map.toml").write_text("\n".join(f"{key} = {toml(value)}" for key, value in mapping.items()))
    import_columns(columns, "columns", folder / "map.toml", folder / "r.mcap")
    surplus = SAMPLES - kept
    check(read(folder / "r.mcap"), {name: v[:kept] if name == "force" else v[surplus:] for name, v in VALUES.items()})
    silent = [columns[0], columns[1], Column(A, VALUES[A], "g", RATE_HZ)]
    if surplus:
        with pytest.raises(
            RigError, match=f"it does not say when column '{A}' begins, and other columns begin up to 0.25"
        ):
            import_columns(silent, "columns", folder / "map.toml", folder / "other.mcap")
