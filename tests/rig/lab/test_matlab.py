"""The arrays of a MATLAB file."""

import numpy as np
import pytest
from scipy.io import savemat

from rig.lab.matlab import arrays_of


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_arrays_of_every_kind(tmp_path, compressed):
    kinds = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
    arrays = {f"as_{kind}": np.arange(12.0).reshape(3, 4).astype(kind) for kind in kinds}
    others = {"z": np.ones((2, 2)) * 1j, "text": "by hand", "cell": np.array([1, "a"], dtype=object)}
    savemat(tmp_path / "lab.mat", others | arrays, do_compression=compressed)
    found = dict(arrays_of(tmp_path / "lab.mat"))
    assert set(found) == set(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
