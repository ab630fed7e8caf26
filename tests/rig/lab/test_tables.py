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
        ("V1,,V3\n1,,3\n", "line 2 has '' in column '', which is no number"),
        ("V1,V2,V3\n1,2,\n1,2,3\n", "line 2 has '' in column 'V3', which is no number"),
        ("V1,V2\n,\n,\n", "2 names for 0 columns"),
    ],
)
def test_other_columns_need_names_and_values(tmp_path, content, said):
    with pytest.raises(RigError, match=said):
        columns(tmp_path, content)


def test_white_space_of_any_length_is_one_delimiter(tmp_path):
    content = "# t  F\n 0.5   1.0\n 0.25  -2.0\n"
    assert columns(tmp_path, content, delimiter=" ") == {"t": [0.5, 0.25], "F": [1.0, -2.0]}


def test_a_file_without_names_may_have_other_text_in_its_lines(tmp_path):
    path = tmp_path / "lab.csv"
    path.write_text("2024-03-01 14:05:06,1.0\n2024-03-01 14:05:07,2.0\n")
    (column,) = read_table(path, TextForm(names=False), [2]).columns.values()
    assert column.values.tolist() == [1.0, 2.0]


def test_an_incomplete_end_is_left_out(tmp_path):
    path = tmp_path / "lab.csv"
    path.write_text("t,F [kN],x\n0,1.0,2\n1,2.0,3\n2,,4\n3,nan\nend of data\n")
    table = read_table(path, TextForm(cut_incomplete_end=True), ["t", "F [kN]"])
    assert [c.values.tolist() for c in table.columns.values()] == [[0, 1, 2, 3], [1, 2]]
    assert [c.unit for c in table.columns.values()] == [None, "kN"]
    path.write_text("t,F\n0,1.0\n1,\n2,3.0\n")
    with pytest.raises(RigError, match="line 3 lacks a number, and line 4 has them all"):
        read_table(path, TextForm(cut_incomplete_end=True))
    with pytest.raises(RigError, match="line 3 has '' in column 'F', which is no number"):
        read_table(path, TextForm())
