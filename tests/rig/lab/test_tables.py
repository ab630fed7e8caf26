"""Files that are not what their suffix says."""

import pytest

from rig.errors import RigError
from rig.lab.csv_text import TextForm
from rig.lab.tables import read_table


@pytest.mark.parametrize("suffix", [".uff", ".mat", ".tdms", ".wav"])
def test_what_is_not_of_its_format_is_refused(tmp_path, suffix):
    path = tmp_path / f"lab{suffix}"
    path.write_text("t,F\n0.0,1.0\n0.1,2.0\n")
    with pytest.raises(RigError) as caught:
        read_table(path, TextForm())
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def columns(tmp_path, content, **form):
    path = tmp_path / "lab.csv"
    path.write_text(content)
    return {c.name: c.values.tolist() for c in read_table(path, TextForm(**form)).columns.values()}


@pytest.mark.parametrize(
    ("names", "line_end"),
    [
        ("", ","),
        ("V1,V2,", ","),
        ("V1,V2", ","),
        ("V1,V2,,", ",,"),
        ("V1,V2,", ""),
        ("V1,V2,note", ","),
        ("V1,V2,note,", ", ,"),
        ("V1,V2,", ",9"),
        ("V1,V2, ,", ",9,8"),
        ("V1,V2,", ",by hand"),
    ],
)
def test_last_columns_without_a_name_or_without_values_are_left_out(tmp_path, names, line_end):
    content = "\n".join([*([names] if names else []), f"0.5,1.0{line_end}", f"0.25,2.0{line_end}", ""])
    by_name = columns(tmp_path, content)
    assert list(by_name) == (["V1", "V2"] if names else ["column 1", "column 2"])
    assert list(by_name.values()) == [[0.5, 0.25], [1.0, 2.0]]
    with_commas = content.replace(",", ";").replace(".", ",")
    assert list(columns(tmp_path, with_commas, delimiter=";", decimal=",").values()) == [[0.5, 0.25], [1.0, 2.0]]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("V1,V2\n1,2,3\n", "2 names for 3 columns"),
        ("V1,V2,V3\n1,2\n", "3 names for 2 columns"),
        ("V1,,V3\n1,,3\n", "line 2 has '' in column '', which is no number"),
        ("V1,V2,V3\n1,2,\n1,2,3\n", "line 2 has '' in column 'V3', which is no number"),
        ("V1,V2\n,\n,\n", "2 names for 0 columns"),
    ],
)
def test_other_columns_need_names_and_values(tmp_path, content, said):
    with pytest.raises(RigError, match=said):
        columns(tmp_path, content)
