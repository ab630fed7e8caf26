"""Files that are not what their suffix says."""

import pytest

from rig.errors import RigError
from rig.lab.tables import TextForm, columns_of


@pytest.mark.parametrize("suffix", [".uff", ".mat", ".tdms", ".wav"])
def test_what_is_not_of_its_format_is_refused(tmp_path, suffix):
    path = tmp_path / f"lab{suffix}"
    path.write_text("t,F\n0.0,1.0\n0.1,2.0\n")
    with pytest.raises(RigError) as caught:
        columns_of(path, TextForm())
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("names", ["V1,V2,\n", ""])
def test_a_comma_behind_every_line_is_no_column(tmp_path, names):
    path = tmp_path / "lab.csv"
    path.write_text(f"{names}0.5,1.0,\n0.25,2.0,\n")
    assert [c.values.tolist() for c in columns_of(path, TextForm())] == [[0.5, 0.25], [1.0, 2.0]]
