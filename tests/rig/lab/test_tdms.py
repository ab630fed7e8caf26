"""What TDMS files state beside their numbers, and those that are damaged in part."""

import struct

import numpy as np
import pytest
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
from nptdms.timestamp import TdmsTimestamp

from rig.errors import RigError
from rig.lab.csv_text import TextForm
from rig.lab.looking import proposed_import_map
from rig.lab.tables import read_table

START = np.datetime64("2024-03-01T14:05:06")
VALUES = np.random.default_rng(5).standard_normal(60)


def write(path, *channels):
    """Write a segment of channels, (name, properties)."""
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("g", name, VALUES, properties) for name, properties in channels])
    return path


def columns(path, keys=None):
    return {column.name: column for column in read_table(path, TextForm(), keys).columns.values()}


def waveform(**properties):
    return {"wf_increment": 1e-3, "wf_start_time": START} | properties


def test_starts_are_on_one_clock(tmp_path):
    path = write(
        tmp_path / "lab.tdms",
        ("early", waveform(wf_start_offset=0.0)),
        ("later", waveform(wf_start_time=START + np.timedelta64(250_000, "us"))),
        ("offset", waveform(wf_start_offset=0.125)),
        ("none", {"wf_increment": 1e-3}),
        ("unset", waveform(wf_start_time=np.datetime64("1904-01-01T00:00:00"))),
    )
    starts_s = {name: column.start_s for name, column in columns(path).items()}
    assert starts_s == {"g/early": 0.0, "g/later": 0.25, "g/offset": 0.125, "g/none": None, "g/unset": None}


def test_starts_keep_more_digits_than_a_date(tmp_path):
    """Of a time in seconds since 1904, a double keeps half a microsecond."""
    stamps = [TdmsTimestamp(3_792_000_000, int(fraction * 2**64)) for fraction in (0.75, 0.75 + 3e-9)]
    path = write(tmp_path / "lab.tdms", *((f"c{k}", {"wf_start_time": stamp}) for k, stamp in enumerate(stamps)))
    assert columns(path)["g/c1"].start_s == pytest.approx(3e-9, rel=1e-6)


@pytest.mark.parametrize(
    ("properties", "rate_hz"),
    [
        ({"wf_increment": 2.0, "wf_xunit_string": "ms"}, 500.0),
        ({"wf_increment": 2.0, "wf_xunit_string": "Hz"}, None),
        ({"wf_increment": 0.0}, None),
        ({"SampleRate": 500.0}, 500.0),
        ({"dt_ms": 2.0}, 500.0),
    ],
)
def test_the_rate_of_a_channel(tmp_path, properties, rate_hz):
    assert columns(write(tmp_path / "lab.tdms", ("a", properties)))["g/a"].sample_rate_hz == rate_hz


@pytest.mark.parametrize(
    ("properties", "unit"),
    [
        ({"unit_string": "N", "NI_UnitDescription": "Volts"}, "N"),
        ({"NI_UnitDescription": "g"}, "g"),
        ({"unit_string": "", "NI_UnitDescription": "kgf"}, "kgf"),
        ({"Unit": "mm"}, "mm"),
        ({"NI_UnitDescription": "(null)"}, None),
        ({}, None),
    ],
)
def test_the_unit_of_a_channel(tmp_path, properties, unit):
    assert columns(write(tmp_path / "lab.tdms", ("a", properties)))["g/a"].unit == unit


@pytest.mark.parametrize("scale", ["Strain", "Reciprocal", "Table"])
def test_a_scale_that_cannot_be_applied_spoils_its_channel_alone(tmp_path, scale):
    """Of an unknown type npTDMS would give the numbers before the scale, in the unit of those behind it."""
    bad = {"NI_Number_Of_Scales": 1, "NI_Scaling_Status": "unscaled", "NI_Scale[0]_Scale_Type": scale}
    path = write(tmp_path / "lab.tdms", ("F", waveform(unit_string="N")), ("bad", waveform(**bad)))
    np.testing.assert_array_equal(columns(path, ["g/F"])["g/F"].values, VALUES)
    sentence = f"'g/bad' has a scale of the type {scale}, which cannot be applied"
    assert f"left out: {sentence}" in proposed_import_map(path, None).text
    with pytest.raises(RigError, match=f"lab.tdms: {sentence}"):
        columns(path, ["g/bad"])


def test_a_scale_that_is_applied_already_spoils_nothing(tmp_path):
    done = {"NI_Number_Of_Scales": 1, "NI_Scaling_Status": "scaled", "NI_Scale[0]_Scale_Type": "Reciprocal"}
    np.testing.assert_array_equal(columns(write(tmp_path / "lab.tdms", ("a", done)))["g/a"].values, VALUES)


def unclosed(path, cut_bytes):
    """Write three segments of two channels, of which the last was never closed and lacks its last bytes."""
    with TdmsWriter(str(path)) as writer:
        for k in range(3):
            writer.write_segment([ChannelObject("g", name, VALUES + k, waveform()) for name in ("F", "a")])
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, content.rindex(b"TDSm") + 12, 2**64 - 1)
    path.write_bytes(content[: len(content) - cut_bytes])
    return path


@pytest.mark.parametrize(
    ("cut_bytes", "kept", "lost"),
    [
        (0, 180, 0),
        (8, 179, 1),
        (13, 178, 1),
        (300, 142, 37),
        (8 * 60, 120, 60),
        (8 * 100, 120, 20),
        (8 * 120 + 3, 120, 0),
    ],
)
def test_a_file_that_was_not_closed_is_read_as_far_as_it_is_whole(tmp_path, cut_bytes, kept, lost, capfd):
    path = unclosed(tmp_path / "lab.tdms", cut_bytes)
    table = read_table(path, TextForm())
    expected = np.concatenate([VALUES, VALUES + 1, VALUES + 2])[:kept]
    for column in table.columns.values():
        np.testing.assert_array_equal(column.values, expected)
    (note,) = table.notes
    assert note.startswith("the file was not closed, as after a crash; it is read to its last whole sample")
    if lost and cut_bytes < 8 * 60:
        assert f", {60 - (kept - 120)} samples" in note
    assert note in proposed_import_map(path, None).text
    assert capfd.readouterr() == ("", "")


def test_a_file_that_was_not_closed_and_holds_nothing_is_refused(tmp_path):
    path = unclosed(tmp_path / "lab.tdms", 0)
    content = bytearray(path.read_bytes())
    struct.pack_into("<Q", content, 12, 2**64 - 1)
    path.write_bytes(content[:60])
    with pytest.raises(RigError, match="it was not closed, and ends before its first samples"):
        read_table(path, TextForm())


def test_a_channel_of_time_stamps_is_a_column_of_seconds(tmp_path):
    stamps = START + np.arange(60) * np.timedelta64(1_953, "us")
    with TdmsWriter(str(tmp_path / "lab.tdms")) as writer:
        writer.write_segment([RootObject(), GroupObject("g"), ChannelObject("g", "t", stamps)])
    column = columns(tmp_path / "lab.tdms")["g/t"]
    assert column.unit == "s"
    np.testing.assert_allclose(column.values, np.arange(60) * 1.953e-3, atol=1e-9)
