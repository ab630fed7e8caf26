"""One layout of a text file: what is proposed is imported, under the right names, or a word of it is quoted."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.errors import RigError
from rig.lab.csv_layout import layout_of
from rig.lab.csv_text import TextForm
from rig.lab.importing import import_file
from rig.lab.looking import proposed_import_map
from rig.model.description import Sensor, to_json
from rig.recording import read
from rig.simulation.reference import Sdof

RIG = Sdof(sensors="acceleration").rig()
(A,) = (sensor.name for sensor in RIG.sensors)
SAMPLES = 300
TIME_S = np.arange(SAMPLES) / RIG.sample_rate_hz
FORCE, ACC, TIP = np.round(np.random.default_rng(8).standard_normal((3, SAMPLES)), 6)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.json").write_bytes(to_json(RIG))
    return tmp_path


def lines_of(*columns, delimiter="\t", end=""):
    return [delimiter.join(f"{value:.9g}" for value in row) + end for row in zip(*columns, strict=True)]


def imported(folder, text, name="run.txt", changes=()):
    (folder / name).write_text(text)
    proposal = proposed_import_map(folder / name, RIG)
    map_text = proposal.text
    for old, new in dict(changes).items():
        assert old in map_text
        map_text = map_text.replace(old, new)
    (folder / "map.toml").write_text(map_text)
    steps = import_file(folder / name, folder / "map.toml", folder / "r.mcap")
    return proposal.text, read(folder / "r.mcap"), steps


def check(recording, rows=None):
    np.testing.assert_allclose(recording.force_n, FORCE if rows is None else FORCE[rows], atol=1e-9)
    acceleration = recording.signals["acceleration"].values[0]
    np.testing.assert_allclose(acceleration, ACC if rows is None else ACC[rows], atol=1e-9)


@pytest.mark.parametrize("delimiter", ["\t", ";", ","])
@pytest.mark.parametrize("end", ["", "delimiter"])
@pytest.mark.parametrize(
    "header",
    [
        ["X_Value|force [N]|ACC [m/s^2]|Comment"],
        ["t|force|ACC|Remarks", "s|N|m/s^2|"],
        ["Y_Unit_Label|N|m/s^2", "X_Value|force|ACC|Comment"],
        ["Title|Time [s]|force [N]|ACC [m/s^2]"],
        ["Data|Time|force|ACC", "Unit|s|N|m/s^2"],
        ["Channel:|Time|force|ACC", "s|N|m/s^2"],
        ["Run 7|Time [s]|force [N]|ACC [m/s^2]"],
        ["Time [s]|force [N]|ACC [m/s^2]|Operator Miller"],
    ],
)
def test_names_that_belong_to_no_column_are_told_from_those_that_do(folder, header, delimiter, end):
    """A name at the end has no cells; a label at the beginning shifts the names: neither takes a force for another."""
    names = "\n".join(header).replace("|", delimiter).replace("ACC", A)
    body = lines_of(TIME_S, FORCE, ACC, delimiter=delimiter, end=delimiter if end else "")
    text, recording, _ = imported(folder, "\n".join([names, *body, ""]))
    check(recording)
    assert "512 Hz by column" in text
    assert '"?"' not in text


def test_where_nothing_tells_the_names_apart_columns_have_numbers(folder):
    body = lines_of(FORCE, ACC, delimiter=",")
    (folder / "run.csv").write_text("\n".join(["one,two,three", *body, ""]))
    text = proposed_import_map(folder / "run.csv", RIG).text
    assert "3 names (one, two, three) for 2 columns, and nothing tells which of them belong to the columns" in text
    assert "column = 1" in text
    assert "column = 2" in text
    assert 'force = "?"' in text


@pytest.mark.parametrize("channel_count", [1, 2, 5, 8])
def test_labview_files_without_trailing_tabs(folder, channel_count):
    """LVM with as many channels as may be; the last name, Comment, has no cells."""
    names = ["force", A, *(f"extra {k}" for k in range(channel_count))]
    columns = [FORCE, ACC, *np.random.default_rng(3).standard_normal((channel_count, SAMPLES))]
    per_channel = {
        "Samples": [str(SAMPLES)] * len(names),
        "Date": ["2024/03/01"] * len(names),
        "Time": ["14:05:06.7890000000000000000"] * len(names),
        "Y_Unit_Label": ["N"] + ["m/s^2"] * (len(names) - 1),
        "X_Dimension": ["Time"] * len(names),
        "X0": ["0.0E+0"] * len(names),
        "Delta_X": ["0.001953125"] * len(names),
    }
    head = ["LabVIEW Measurement", "X_Columns\tOne", "***End_of_Header***", "", f"Channels\t{len(names)}"]
    head += ["\t".join([label, *cells]) for label, cells in per_channel.items()]
    head += ["***End_of_Header***", "\t".join(["X_Value", *names, "Comment"])]
    _, recording, _ = imported(folder, "\n".join([*head, *lines_of(TIME_S, *columns), ""]), "run.lvm")
    check(recording)


@pytest.mark.parametrize("x0", [0.0, 0.125])
def test_labview_starts_without_columns_of_x(folder, x0):
    head = [
        "LabVIEW Measurement",
        "X_Columns\tNo",
        "***End_of_Header***",
        "",
        "Channels\t2",
        f"Samples\t{SAMPLES}\t{SAMPLES}",
        "Time\t14:05:06.500\t14:05:06.250",
        "Y_Unit_Label\tN\tm/s^2",
        f"X0\t0\t{x0}",
        "Delta_X\t0.001953125\t0.001953125",
        "***End_of_Header***",
        f"X_Value\tforce\t{A}\tComment",
    ]
    body = ["\t" + line for line in lines_of(FORCE, ACC)]
    _, recording, steps = imported(folder, "\n".join([*head, *body, ""]), "run.lvm")
    offset = round((0.25 - x0) * 512)
    assert recording.samples == SAMPLES - offset
    np.testing.assert_allclose(recording.force_n, FORCE[: SAMPLES - offset], atol=1e-9)
    np.testing.assert_allclose(recording.signals["acceleration"].values[0], ACC[offset:], atol=1e-9)
    assert any("cut to the time that all share" in step for step in steps)


def test_a_header_that_states_more_samples_than_follow_is_said(folder):
    head = [f"Samples,{SAMPLES + 50}", f"t [s],force [N],{A} [m/s^2]"]
    text, recording, steps = imported(folder, "\n".join([*head, *lines_of(TIME_S, FORCE, ACC, delimiter=","), ""]))
    check(recording)
    assert "the header states 350 samples, and only 300 lines follow" in text
    assert "the header states 350 samples, and only 300 lines follow" in steps


def test_exponents_as_fortran_writes_them_are_numbers(folder):
    body = ["  ".join(f"{v:.10E}".replace("E", "D") for v in row) for row in zip(TIME_S, FORCE, ACC, strict=True)]
    _, recording, _ = imported(folder, "\n".join([f"t[s]  force[N]  {A}[m/s^2]", *body, ""]))
    check(recording)


WORDS = ["OVL", "OVER", "+OL", "****", "1.#INF", "1.#QNAN", "inf", "-inf", "9.9E+37", "-9.91E+37", "1e38", "NaN"]


def with_word(word, columns, place, row=123):
    lines = lines_of(*columns, delimiter=",")
    cells = lines[row].split(",")
    cells[place] = word
    lines[row] = ",".join(cells)
    return lines


@pytest.mark.parametrize("word", WORDS)
def test_a_mark_of_overload_leaves_its_channel_out_or_stops_the_import(folder, word):
    """Line and word are quoted, by the look, and by the import if a map names the column."""
    names = f"t [s],force [N],{A} [m/s^2],tip [m/s^2]"
    text, recording, _ = imported(folder, "\n".join([names, *with_word(word, (TIME_S, FORCE, ACC, TIP), 3), ""]))
    check(recording)
    seen = "it has no number in line 125" if word == "NaN" else f"line 125 has '{word}'"
    assert f"left out: column 4 'tip [m/s^2]' ({seen}" in text
    tip = 'tip = { column = "tip [m/s^2]", quantity = "acceleration", body = "mass", position_m = 0.0 }'
    (folder / "map.toml").write_text((folder / "map.toml").read_text() + tip + "\n")
    with pytest.raises(RigError, match=r"line 125 has ") as caught:
        import_file(folder / "run.txt", folder / "map.toml", folder / "other.mcap")
    assert repr(word) in str(caught.value)
    assert not (folder / "other.mcap").exists()


@pytest.mark.parametrize("word", WORDS[:-1])
@pytest.mark.parametrize(("place", "kind"), [(0, "time"), (2, "only sensor")])
def test_a_needed_channel_with_a_mark_of_overload_is_refused(folder, word, place, kind):
    lines = with_word(word, (TIME_S, FORCE, ACC), place)
    (folder / "run.csv").write_text("\n".join([f"t [s],force [N],{A} [m/s^2]", *lines, ""]))
    with pytest.raises(RigError, match=f"the {kind}, column {place + 1} .* line 125 has ") as caught:
        proposed_import_map(folder / "run.csv", RIG)
    assert repr(word) in str(caught.value)


@pytest.mark.parametrize("word", WORDS[:-1])
def test_a_force_with_a_mark_of_overload_is_asked_for_with_the_reason(folder, word):
    lines = with_word(word, (TIME_S, FORCE, ACC), 1)
    (folder / "run.csv").write_text("\n".join([f"t [s],force [N],{A} [m/s^2]", *lines, ""]))
    text = proposed_import_map(folder / "run.csv", RIG).text
    assert f"force = \"?\"  # column 2 'force [N]' is left out: line 125 has '{word}'" in text


def test_a_sensor_of_the_rig_that_is_left_out_leaves_a_map_that_imports(folder):
    two = Sensor(name="second", station=RIG.sensors[0].station, quantity="acceleration")
    rig = replace(RIG, sensors=(*RIG.sensors, two))
    (folder / "rig.json").write_bytes(to_json(rig))
    lines = with_word("OVL", (TIME_S, FORCE, ACC, TIP), 3)
    (folder / "run.csv").write_text("\n".join([f"t [s],force [N],{A} [m/s^2],second [m/s^2]", *lines, ""]))
    (folder / "map.toml").write_text(proposed_import_map(folder / "run.csv", rig).text)
    import_file(folder / "run.csv", folder / "map.toml", folder / "r.mcap")
    recording = read(folder / "r.mcap")
    check(recording)
    assert recording.rig.sensors == RIG.sensors


def test_binary_numbers_that_nothing_measures_are_refused(folder):
    import h5py

    acceleration = ACC.copy()
    acceleration[50] = 9.9e37
    with h5py.File(folder / "run.h5", "w") as file:
        for name, unit, values in (("t", "s", TIME_S), ("force", "N", FORCE), ("a", "m/s^2", acceleration)):
            file[name] = values
            file[name].attrs["unit"] = unit
    map_text = f'time = {{ column = "t" }}\nforce = {{ column = "force" }}\n[sensors]\n{A} = {{ column = "a" }}\n'
    (folder / "map.toml").write_text(map_text)
    with pytest.raises(RigError, match=r"column 'a' is 9.9e\+37 at sample 50, which nothing measures"):
        import_file(folder / "run.h5", folder / "map.toml", folder / "r.mcap")
    assert not (folder / "r.mcap").exists()


def test_units_with_a_guess_do_not_take_horizontal_for_hours(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["time_s,F_N,acc_h,acc_d", *lines_of(TIME_S, FORCE, ACC, TIP, delimiter=","), ""]))
    text = proposed_import_map(path, None).text
    assert '"acc_h" = { column = "acc_h"' in text
    assert '"acc_d" = { column = "acc_d"' in text


def test_a_layout_says_units_and_names_of_its_columns(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Label;Time;F;a\nUnits;s;N;g\n" + "\n".join(lines_of(TIME_S, FORCE, ACC, delimiter=";")))
    layout = layout_of(path, TextForm(delimiter=";", lines_after_names=1))
    assert layout.names == ("Time", "F", "a")
    assert layout.units == ("s", "N", "g")
