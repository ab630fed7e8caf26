"""`rig demo`: commands that a user would type, in processes of their own, and their answers beside the truth."""

import json
import re

import pytest

from tests.running import exit_status


@pytest.mark.study
def test_every_answer_stands_beside_the_truth(tmp_path, capsys):
    assert exit_status("rig", "demo", "--out", tmp_path / "demo", "--no-open") == 0
    printed = capsys.readouterr().out
    rows = re.findall(r"([0-9.]+) ± ([0-9.]+) \S+ +\(true: ([0-9.]+) ", printed)
    assert len(rows) == 4
    for value, half_width, true in (map(float, row) for row in rows):
        assert abs(value - true) < 1.5 * half_width
    gap = json.loads((tmp_path / "demo" / "gap" / "gap.json").read_text())
    assert gap["verdict"] == "explained"
    assert gap["causes"][0]["effects"] == ["added_mass"]
    assert "explained: An added mass of 0.15" in printed


def test_a_page_that_is_there_is_not_written_over(tmp_path, capsys):
    page = tmp_path / "gap" / "gap.html"
    page.parent.mkdir()
    page.write_text("mine")
    assert exit_status("rig", "demo", "--out", tmp_path) == 1
    assert "gap.html: exists already; give another name, or --force" in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [page]
