"""`rig demo`: commands that a user would type, in processes of their own, and their answers beside the truth."""

import json
import re
import shlex

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
    words = r"explained: An added mass of ([0-9.]+) ± ([0-9.]+) g on the\s+barrel at ([0-9.]+) ± ([0-9.]+)\s+m"
    mass_g, mass_width_g, position_m, position_width_m = map(float, re.search(words, printed).groups())
    assert abs(mass_g - 500) < 1.5 * mass_width_g
    assert abs(position_m - 0.8) < 1.5 * position_width_m


def test_commands_and_answers_go_to_a_file_while_progress_is_shown(tmp_path, capsys, monkeypatch):
    estimate = {"value": 5.25e-3, "standard_error": 1e-5}
    contacts = [{"name": name, "clearance_m": estimate, "stiffness_n_per_m": estimate} for name in ("one", "two")]
    answers = {
        "contact": {"contacts": contacts},
        "gap": {"verdict": "explained", "sentence": "A mass explains the difference."},
    }

    def write_answers(commands, *_):
        name = commands[-1][1]  # of the two chains that run at once each writes its own
        (tmp_path / "a b" / name).mkdir(parents=True)
        (tmp_path / "a b" / name / f"{name}.json").write_text(json.dumps(answers[name]))

    monkeypatch.setattr("rig.commands.demo._run_all", write_answers)
    words = ("rig", "demo", "--out", tmp_path / "a b", "--no-open")
    assert exit_status(*words, columns=80, FORCE_COLOR="1") == 0
    printed = capsys.readouterr().out
    assert "clearance of one: 5.250 " in printed
    assert "explained: A mass explains the difference." in printed
    commands = [shlex.split(command) for command in re.findall(r"^\$ ((?:.*\\\n)*.*)$", printed, re.MULTILINE)]
    assert [command[:2] for command in commands] == [
        ["rig", "record"],
        ["identify", "contact"],
        ["rig", "record"],
        ["identify", "gap"],
    ]
    assert str(tmp_path / "a b" / "gap") in commands[-1]


def test_a_page_that_is_there_is_not_written_over(tmp_path, capsys):
    page = tmp_path / "gap" / "gap.html"
    page.parent.mkdir()
    page.write_text("mine")
    assert exit_status("rig", "demo", "--out", tmp_path) == 1
    assert "gap.html: exists already; give another name, or --force" in capsys.readouterr().err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [page]
