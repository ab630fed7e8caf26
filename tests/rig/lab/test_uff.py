"""What time histories of UFF files state in their headers, and the ways in which programs write their numbers."""

import numpy as np
import pytest
import pyuff

from rig.errors import RigError
from rig.lab.csv_text import TextForm
from rig.lab.looking import proposed_import_map
from rig.lab.tables import read_table
from tests.uff_histories import time_history

TIME_S = np.arange(50) / 512
VALUES = np.random.default_rng(3).standard_normal(50)


def write(folder, *datasets):
    path = folder / "lab.uff"
    pyuff.UFF(str(path)).write_sets(list(datasets), "add")
    return path


def columns(path):
    return {column.name: column for column in read_table(path, TextForm()).columns.values()}


@pytest.mark.parametrize("binary", [0, 1])
def test_each_history_has_its_own_start(tmp_path, binary):
    early = time_history("early", TIME_S, VALUES, binary=binary, abscissa_min=0.0, abscissa_inc=1 / 512)
    late = time_history("late", TIME_S + 0.25, VALUES, binary=binary, abscissa_min=0.25, abscissa_inc=1 / 512)
    by_name = columns(write(tmp_path, early, late))
    assert [(column.start_s, column.sample_rate_hz) for column in by_name.values()] == [(0.0, 512.0), (0.25, 512.0)]


@pytest.mark.parametrize(
    ("label", "axis", "factor"),
    [("ms", "Time", 1e3), ("us", "", 1e6), ("min", "Time", 1 / 60), ("NONE", "Time [ms]", 1e3), ("NONE", "Time", 1.0)],
)
def test_the_abscissa_has_a_unit(tmp_path, label, axis, factor):
    dataset = time_history(
        "a", factor * (TIME_S + 0.5), VALUES, abscissa_axis_units_lab=label, abscissa_axis_lab=axis,
        abscissa_min=factor * 0.5, abscissa_inc=factor / 512,
    )  # fmt: skip
    column = columns(write(tmp_path, dataset))["a"]
    assert column.sample_rate_hz == 512.0
    assert column.start_s == pytest.approx(0.5, rel=1e-5)


def test_of_an_unknown_unit_of_the_abscissa_no_rate_is_stated(tmp_path):
    path = write(tmp_path, time_history("a", TIME_S, VALUES, abscissa_axis_units_lab="rev", abscissa_inc=1 / 512))
    column = columns(path)["a"]
    assert (column.sample_rate_hz, column.start_s) == (None, None)
    text = proposed_import_map(path, None).text
    assert "the abscissa of 'a' is in 'rev', which is no known unit of time" in text
    assert 'sample_rate_hz = "?"' in text


@pytest.mark.parametrize(
    ("factors", "code", "unit"),
    [
        ((1.0, 1.0), 13, "N"),
        ((1.0, 1.0), 12, "m/s^2"),
        ((1e3, 1.0), 8, "mm"),
        ((39.3701, 0.224809), 13, "lbf"),
        ((39.3701, 0.224809), 12, "in/s^2"),
        ((3.28084, 0.224809), 11, "ft/s"),
        ((7.0, 7.0), 13, None),
        ((1.0, 1.0), 0, None),
    ],
)
def test_units_are_those_of_dataset_164_where_the_history_states_none(tmp_path, factors, code, unit):
    units = {"type": 164, "units_code": 9, "temp_mode": 1, "length": factors[0], "force": factors[1]}
    units |= {"temp": 1.0, "temp_offset": 0.0}
    stated = time_history("kN", TIME_S, VALUES, ordinate_spec_data_type=13, ordinate_axis_units_lab="kN")
    path = write(tmp_path, units, time_history("a", TIME_S, VALUES, ordinate_spec_data_type=code), stated)
    assert {name: column.unit for name, column in columns(path).items()} == {"a": unit, "kN": "kN"}


def text_of(folder, change):
    """File of a history whose lines of numbers are changed."""
    path = write(folder, time_history("a", TIME_S, VALUES, abscissa_inc=1 / 512))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:13], *change(lines[13:-1]), lines[-1], ""]))
    return path


def rows_of(count, form):
    return [" ".join(form % value for value in VALUES[k : k + count]) for k in range(0, VALUES.size, count)]


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: [line.replace("e", "D").replace("E", "D") for line in lines],
        lambda lines: [line.replace("e", "d").replace("E", "d") for line in lines],
        lambda _: rows_of(3, "%25.16E"),
        lambda _: rows_of(1, "%.12e"),
        lambda _: rows_of(7, "%16.9E"),
        lambda _: [" " + row.replace(" ", "\t") for row in rows_of(5, "%.12g")],
    ],
    ids=["D", "d", "25", "single", "16", "tabs"],
)
def test_numbers_of_other_widths_and_exponents_are_read(tmp_path, change):
    np.testing.assert_allclose(columns(text_of(tmp_path, change))["a"].values, VALUES, rtol=1e-8)


def test_numbers_that_touch_are_read_by_their_columns(tmp_path):
    def touching(_):
        rows = VALUES.astype(np.float32)
        return ["".join(f"{value:13.6E}" for value in rows[k : k + 6]) for k in range(0, 50, 6)]

    path = text_of(tmp_path, touching)
    path.write_text(path.read_text().replace(f"{4:10d}{50:10d}", f"{2:10d}{50:10d}"))
    assert "E-01-" in path.read_text() or "E+00-" in path.read_text()
    np.testing.assert_allclose(columns(path)["a"].values, VALUES, rtol=1e-6)


def test_numbers_of_other_columns_that_touch_are_refused_with_the_widths(tmp_path):
    def touching(_):
        return ["".join(f"{value:15.8E}" for value in VALUES[k : k + 5]) for k in range(0, 50, 5)]

    with pytest.raises(
        RigError, match=r"its dataset 'a' has the line .*neither apart by spaces nor in columns of 20 ch"
    ):
        columns(text_of(tmp_path, touching))


def declared(path, count):
    path.write_text(path.read_text().replace(f"{4:10d}{50:10d}", f"{4:10d}{count:10d}"))
    return path


def test_zeros_that_fill_the_last_line_are_left_out_and_said(tmp_path):
    path = text_of(tmp_path, lambda lines: [*lines[:-1], lines[-1] + 2 * f"{0.0:20.11e}"])
    table = read_table(path, TextForm())
    np.testing.assert_allclose(table.columns[0].values, VALUES, rtol=1e-11)
    assert table.notes == ("2 numbers that only fill the last line of 'a' are left out",)
    assert table.notes[0] in proposed_import_map(path, None).text


@pytest.mark.parametrize("zeros", [4, 5])
def test_a_whole_line_of_zeros_and_numbers_beyond_the_count_are_refused(tmp_path, zeros):
    path = text_of(tmp_path, lambda lines: [*lines, zeros * f"{0.0:20.11e}"])
    with pytest.raises(RigError, match="of 50 samples"):
        columns(path)
    with pytest.raises(RigError, match="of 49 samples"):
        columns(declared(text_of(tmp_path, lambda lines: lines), 49))


def test_a_history_that_is_whole_says_nothing(tmp_path):
    assert read_table(write(tmp_path, time_history("a", TIME_S, VALUES)), TextForm()).notes == ()
