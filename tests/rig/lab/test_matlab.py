"""The arrays of a MATLAB file."""

import sys

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from rig.errors import RigError
from rig.lab.csv_text import TextForm
from rig.lab.tables import read_table

RNG = np.random.default_rng(1)
FORCE, ACC, FIRST, SECOND = (RNG.standard_normal(shape) for shape in ((7, 1), (7, 3), (7, 1), (7, 2)))
NESTED = {
    "run.F": FORCE,
    "run.sensors.acc": ACC,
    "runs(1).x": FIRST,
    "runs(2).x": SECOND,
    "cells{1}": FIRST,
    "cells{3}": SECOND,
}


def write_5(path, compressed=False):
    """Write a file like MATLAB's save -v7."""
    runs, cells = np.empty((1, 2), dtype=[("x", object)]), np.empty((1, 3), dtype=object)
    runs["x"][0] = FIRST, SECOND
    cells[0] = FIRST, "by hand", SECOND
    run = {"F": FORCE, "note": "by hand", "sensors": {"acc": ACC, "phase": ACC * 1j}}
    savemat(path, {"fs": 512.0, "run": run, "runs": runs, "cells": cells}, do_compression=compressed)


def write_73(path):
    """Write a file like MATLAB's save -v7.3: transposed, in groups, with references for struct and cell arrays."""
    with h5py.File(path, "w", userblock_size=512) as file:

        def put_array(place, values, kind="double"):
            place = file.create_dataset(place, data=np.asarray(values).T)
            place.attrs["MATLAB_class"] = np.bytes_(kind)
            return place.ref

        def put_references(place, references, kind=None):
            dataset = file.create_dataset(place, (len(references), 1), dtype=h5py.ref_dtype)
            dataset[:, 0] = references
            if kind:
                dataset.attrs["MATLAB_class"] = np.bytes_(kind)

        put_array("fs", [[512.0]])
        put_array("run/F", FORCE)
        put_array("run/note", np.array([[98, 121]], dtype="u2"), "char")
        put_array("run/sensors/acc", ACC)
        put_array("run/sensors/phase", np.zeros((7, 3), dtype=[("real", "f8"), ("imag", "f8")]))
        put_array("run/sensors/none", np.zeros((2, 1), dtype="u8"))
        file["run/sensors/none"].attrs["MATLAB_empty"] = 1
        put_references("runs/x", [put_array("#refs#/a", FIRST), put_array("#refs#/b", SECOND)])
        text = put_array("#refs#/d", np.array([[98, 121]], dtype="u2"), "char")
        put_references("cells", [put_array("#refs#/c", FIRST), text, put_array("#refs#/e", SECOND)], "cell")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with path.open("rb+") as stream:
        stream.write(head)


def columns(path):
    return {c.name: c.values for c in read_table(path, TextForm()).columns.values()}


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_arrays_of_every_kind(tmp_path, compressed):
    kinds = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
    arrays = {f"as_{kind}": np.arange(12.0).reshape(3, 4).astype(kind) for kind in kinds}
    not_real = {"z": np.ones((2, 2)) * 1j, "text": "by hand", "empty": {}}
    savemat(tmp_path / "lab.mat", not_real | arrays, do_compression=compressed)
    rows = columns(tmp_path / "lab.mat")
    assert set(rows) == {f"{name}[{k}]" for name in arrays for k in (1, 2, 3)}
    for name, array in arrays.items():
        for k, row in enumerate(array, start=1):
            np.testing.assert_array_equal(rows[f"{name}[{k}]"], row)


@pytest.mark.parametrize("write", [write_5, lambda path: write_5(path, True), write_73], ids=["5", "7", "7.3"])
def test_arrays_in_structs_and_cells_have_matlabs_names(tmp_path, write):
    path = tmp_path / "lab.mat"
    write(path)
    rows = columns(path)
    expected = {
        name if array.shape[1] == 1 else f"{name}[{k}]": array[:, k - 1]
        for name, array in NESTED.items()
        for k in range(1, array.shape[1] + 1)
    }
    assert set(rows) == set(expected)
    for name, row in expected.items():
        np.testing.assert_array_equal(rows[name], row)


@pytest.mark.parametrize("write", [write_5, write_73])
def test_a_cut_file_is_refused(tmp_path, write):
    path = tmp_path / "lab.mat"
    write(path)
    content = path.read_bytes()
    for size in np.linspace(130, len(content) - 200, 12, dtype=int):
        path.write_bytes(content[:size])
        with pytest.raises(RigError, match=r"lab\.mat: "):
            read_table(path, TextForm())


def test_without_h5py_version_7_3_is_named(tmp_path, monkeypatch):
    path = tmp_path / "lab.mat"
    write_73(path)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RigError, match=r"lab\.mat: a MATLAB file of version 7\.3 .*'-v7'.*\[lab\]"):
        read_table(path, TextForm())
