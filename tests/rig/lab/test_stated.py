"""What exports state beside their arrays, as structs of MATLAB and as attributes and groups of HDF5."""

import time

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from rig.errors import RigError
from rig.lab.csv_text import TextForm
from rig.lab.looking import proposed_import_map
from rig.lab.tables import read_table

RNG = np.random.default_rng(8)
FORCE, ACC = RNG.standard_normal((2, 200))


def put(file, place, value):
    """Store a value as MATLAB's save -v7.3 does: transposed, texts as numbers of characters."""
    if isinstance(value, dict):
        for name, member in value.items():
            put(file, f"{place}/{name}", member)
        return
    if isinstance(value, list):
        cell = file.create_dataset(place, (len(value), 1), dtype=h5py.ref_dtype)
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
        for k, text in enumerate(value):
            put(file, f"#refs#/{place.replace('/', '_')}{k}", text)
            cell[k, 0] = file[f"#refs#/{place.replace('/', '_')}{k}"].ref
        return
    array = np.asarray(value)
    if array.dtype.kind == "U":
        rows = np.array([[*map(ord, text)] for text in np.atleast_1d(array).tolist()], dtype="u2")
        file.create_dataset(place, data=rows.T).attrs["MATLAB_class"] = np.bytes_("char")
    else:
        file.create_dataset(place, data=np.atleast_2d(array).T)


def write_73(path, data):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in data.items():
            put(file, name, value)
    with path.open("rb+") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_5(path, data, compressed=False):
    def cells(value):
        if isinstance(value, dict):
            return {name: cells(member) for name, member in value.items()}
        return np.array(value, dtype=object)[:, None] if isinstance(value, list) else value

    savemat(path, cells(data), do_compression=compressed)


WRITERS = {"5": write_5, "7": lambda path, data: write_5(path, data, compressed=True), "7.3": write_73}


@pytest.fixture(params=WRITERS)
def columns(request, tmp_path):
    """Columns of a MATLAB file of these variables, of each version."""

    def read(data):
        WRITERS[request.param](tmp_path / "lab.mat", data)
        return {column.name: column for column in read_table(tmp_path / "lab.mat", TextForm()).columns.values()}

    return read


def said(column):
    return column.label, column.unit, column.sample_rate_hz, column.start_s


def simcenter_struct(name, unit, values, start_s=0.0, time_unit="s", interval=1 / 512):
    return {
        "x_values": {"start_value": start_s, "increment": interval, "quantity": {"label": time_unit}},
        "y_values": {"values": values[:, None], "quantity": {"label": unit}},
        "function_record": {"name": name},
    }


def test_a_struct_for_each_signal(columns):
    by_name = columns(
        {"Signal_0": simcenter_struct("F 1", "kN", FORCE), "Signal_1": simcenter_struct("a 1", "g", ACC, start_s=0.25)}
    )
    assert said(by_name["Signal_0.y_values.values"]) == ("F 1", "kN", 512.0, 0.0)
    assert said(by_name["Signal_1.y_values.values"]) == ("a 1", "g", 512.0, 0.25)
    np.testing.assert_array_equal(by_name["Signal_1.y_values.values"].values, ACC)


def test_the_interval_of_a_struct_in_milliseconds(columns):
    by_name = columns({"s": simcenter_struct("F", "N", FORCE, 250.0, "ms", 1e3 / 512)})
    assert said(by_name["s.y_values.values"]) == ("F", "N", 512.0, 0.25)


@pytest.mark.parametrize("cells", [False, True], ids=["characters", "cells"])
def test_lists_of_labels_and_units_beside_a_matrix(columns, cells):
    labels, units = ["Force   ", "Acc. tip"], ["N", "g"]
    by_name = columns({
        "data": np.stack([FORCE, ACC], axis=1),
        "labels": labels if cells else np.array(labels),
        "units": units if cells else np.array(units),
        "isi": 1e3 / 512, "isi_units": "ms", "start_sample": 128.0,
    })  # fmt: skip
    assert said(by_name["data[1]"]) == ("Force", "N", 512.0, 0.25)
    assert said(by_name["data[2]"]) == ("Acc. tip", "g", 512.0, 0.25)


def test_scalars_and_texts_beside_the_array_in_its_struct(columns):
    def channel(name, unit, values):
        return {"Name": name, "SampleFrequency": 512.0, "PreSampleCount": 64.0, "Unit": unit, "Data": values[:, None]}

    by_name = columns({"Ch1": channel("Hammer", "N", FORCE), "Ch2": channel("Tip", "m/s2", ACC)})
    assert said(by_name["Ch1.Data"]) == ("Hammer", "N", 512.0, -0.125)
    assert said(by_name["Ch2.Data"]) == ("Tip", "m/s2", 512.0, -0.125)


def test_fields_that_bear_the_name_of_an_array(columns):
    by_name = columns({
        "force": FORCE[:, None], "force_unit": "kN", "acc": ACC[:, None], "acc_units": "g", "dt": 1 / 512,
        "Channel_1_Data": FORCE[:, None], "Channel_1_Header": {"SignalName": "Kraft", "Unit": "N"},
        "Channel_10_Data": ACC[:, None], "Channel_10_Header": {"SignalName": "Tip", "Unit": "g"},
    })  # fmt: skip
    assert said(by_name["force"])[:3] == ("", "kN", 512.0)
    assert said(by_name["acc"])[:3] == ("", "g", 512.0)
    assert said(by_name["Channel_1_Data"])[:2] == ("Kraft", "N")
    assert said(by_name["Channel_10_Data"])[:2] == ("Tip", "g")


def test_what_one_text_says_is_not_taken_for_several_arrays(columns):
    by_name = columns({"run": {"F": FORCE[:, None], "a": ACC[:, None], "unit": "N", "name": "run 7", "fs": 512.0}})
    assert said(by_name["run.F"]) == said(by_name["run.a"]) == ("", None, 512.0, None)


def test_what_is_stated_of_one_struct_is_not_taken_for_another(columns):
    by_name = columns({"one": {"x": FORCE[:, None], "fs": 512.0, "unit": "N"}, "two": {"x": ACC[:, None]}})
    assert said(by_name["one.x"]) == ("", "N", 512.0, None)
    assert said(by_name["two.x"]) == ("", None, None, None)


def test_a_column_of_time_does_not_take_the_unit_of_the_signal_beside_it(columns):
    by_name = columns({"run": {"time": np.arange(200.0)[:, None] / 512, "F": FORCE[:, None], "unit": "N"}})
    assert (by_name["run.time"].unit, by_name["run.F"].unit) == (None, "N")


def labchart(**changes):
    """Two channels in two blocks; the second channel is recorded in the first block alone, at half the rate."""
    return {
        "data": np.concatenate([FORCE, ACC[:100], FORCE[:50]])[None],
        "datastart": np.array([[1.0, 301.0], [201.0, -1.0]]),
        "dataend": np.array([[200.0, 350.0], [300.0, -1.0]]),
        "titles": np.array(["Force   ", "Tip acc."]),
        "unittext": np.array(["g ", "kN"]),
        "unittextmap": np.array([[2.0, 2.0], [1.0, -1.0]]),
        "samplerate": np.array([[512.0, 512.0], [256.0, 256.0]]),
        "tickrate": np.array([[512.0, 512.0]]),
        "firstsampleoffset": np.array([[0.0, 0.0], [1.0, 0.0]]),
        "blocktimes": np.array([[738000.5, 738000.5 + 100 / 86400]]),
        **changes,
    }


def test_channels_one_behind_the_other_are_taken_apart(columns):
    by_name = columns(labchart())
    assert list(by_name) == ["data(1:200)", "data(301:350)", "data(201:300)"]
    assert said(by_name["data(1:200)"]) == ("Force", "kN", 512.0, 0.0)
    assert said(by_name["data(201:300)"]) == ("Tip acc.", "g", 256.0, 1 / 512)
    assert said(by_name["data(301:350)"])[:3] == ("Force", "kN", 512.0)
    assert by_name["data(301:350)"].start_s == pytest.approx(100.0, abs=1e-4)
    np.testing.assert_array_equal(by_name["data(201:300)"].values, ACC[:100])


def test_integers_of_labchart_are_scaled(columns):
    raw = np.arange(300, dtype="i2")[None]
    scales = {"scaleunits": np.full((2, 2), 0.5), "scaleoffset": np.full((2, 2), 10.0)}
    by_name = columns(labchart(data=raw, **scales))
    np.testing.assert_array_equal(by_name["data(1:200)"].values, 0.5 * (raw[0, :200] + 10.0))


def test_the_map_calls_sensors_by_their_labels_and_columns_by_their_names(tmp_path):
    write_5(
        tmp_path / "lab.mat", {"s0": simcenter_struct("drive", "N", FORCE), "s1": simcenter_struct("tip", "g", ACC)}
    )
    text = proposed_import_map(tmp_path / "lab.mat", None).text
    assert 'force = { column = "s0.y_values.values", unit = "N"' in text
    assert '"tip" = { column = "s1.y_values.values", unit = "g", quantity = "acceleration"' in text
    assert "512 Hz by the file itself" in text


@pytest.mark.parametrize(
    ("attributes", "rate_hz", "start_s"),
    [
        ({"sample_rate": 512.0}, 512.0, None),
        ({"samplerate": 512}, 512.0, None),
        ({"fs": np.array([512.0])}, 512.0, None),
        ({"sampling_frequency": "512 Hz"}, 512.0, None),
        ({"rate": 0.512, "unit_of_rate": "kHz"}, 0.512, None),
        ({"dt": 1 / 512, "t0": 0.25}, 512.0, 0.25),
        ({"delta_t_ms": 1e3 / 512}, 512.0, None),
        ({"sample_rate": 512.0, "start_time": "1970-01-01T00:01:00.25Z"}, 512.0, 60.25),
        ({"gain": 512.0}, None, None),
    ],
)
@pytest.mark.parametrize("place", ["run/acc", "run", "/"])
def test_attributes_of_a_dataset_its_groups_and_the_file(tmp_path, attributes, rate_hz, start_s, place):
    with h5py.File(tmp_path / "lab.h5", "w") as file:
        file["run/acc"] = ACC
        file["run/F"] = FORCE
        file[place].attrs.update(attributes)
    by_name = {column.name: column for column in read_table(tmp_path / "lab.h5", TextForm()).columns.values()}
    assert (by_name["run/acc"].sample_rate_hz, by_name["run/acc"].start_s) == (rate_hz, start_s)
    others = (None, None) if place == "run/acc" else (rate_hz, start_s)
    assert (by_name["run/F"].sample_rate_hz, by_name["run/F"].start_s) == others


def test_the_nearest_attribute_and_single_values_beside_a_dataset_count(tmp_path):
    with h5py.File(tmp_path / "lab.h5", "w") as file:
        file.attrs["fs"] = 100.0
        file["slow/fs"] = 256.0
        file["slow/acc"] = ACC
        file["fast/F"] = FORCE
        file["fast/F"].attrs.update({"sample_rate_hz": 512.0, "Units": "kN", "label": "drive"})
        file["other/F"] = FORCE
    by_name = {column.name: column for column in read_table(tmp_path / "lab.h5", TextForm()).columns.values()}
    assert {name: column.sample_rate_hz for name, column in by_name.items()} == {
        "slow/acc": 256.0, "fast/F": 512.0, "other/F": 100.0,
    }  # fmt: skip
    assert said(by_name["fast/F"]) == ("drive", "kN", 512.0, None)


def test_the_suffix_hdf_is_hdf5_and_hdf4_is_named(tmp_path):
    with h5py.File(tmp_path / "lab.hdf", "w") as file:
        file["F"] = FORCE
    assert read_table(tmp_path / "lab.hdf", TextForm()).names == ("F",)
    (tmp_path / "old.hdf").write_bytes(b"\x0e\x03\x13\x01" + bytes(500))
    with pytest.raises(RigError, match=r"old\.hdf: is HDF4, an older format than HDF5, which is not read; convert it"):
        read_table(tmp_path / "old.hdf", TextForm())


def test_many_arrays_and_fields_at_one_level_take_no_time(tmp_path):
    data = {f"a{k}": np.zeros((1, 2)) for k in range(3000)} | {f"t{k}": "N" for k in range(3000)}
    savemat(tmp_path / "lab.mat", data)
    began = time.process_time()
    assert len(read_table(tmp_path / "lab.mat", TextForm()).names) == 3000
    assert time.process_time() - began < 5.0
