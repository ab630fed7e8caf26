"""The blind check from beginning to end, with a diagnosis that always says no."""

import shutil

import msgspec
import pytest
from typer.testing import CliRunner

from rig.errors import RigError
from scenarios import blind_gap
from scenarios.blind_gap import app, opened
from scenarios.scoreboard import Best, Diagnosis, Score


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind")
    ran("make", "--out", folder, "--world", "wide", "--cases", 3, "--duration", 1.5, "--seed", 2)
    return folder


def ran(*words):
    done = CliRunner().invoke(app, [str(w) for w in words], catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


@pytest.fixture
def copied(made, tmp_path):
    shutil.copytree(made, tmp_path / "cases")
    return tmp_path / "cases"


def diagnosed(cases, monkeypatch):
    monkeypatch.setattr(blind_gap, "diagnosis_of", lambda *_: Diagnosis("no_gap"))
    monkeypatch.setattr(blind_gap, "floors_of", lambda *_: None)
    best = {f"case_{i:03d}": Best(1.0, 1.0, gain=1.0, needed=2.0) for i in range(3)}
    monkeypatch.setattr(blind_gap, "best_of", lambda *_: best)
    ran("diagnose", "--cases", cases, "--out", cases.parent / "found")
    return cases.parent / "found"


def test_what_is_made_is_sealed_and_scored(copied, monkeypatch, tmp_path):
    key = opened(copied)
    assert sorted(c.case for c in key.cases) == ["case_000", "case_001", "case_002"]
    assert len(list((copied / "recordings").iterdir())) == 6
    found = diagnosed(copied, monkeypatch)
    text = ran("score", "--cases", copied, "--found", found, "--out", tmp_path / "score")
    assert "false alarm without effect" in text
    board = msgspec.json.decode((tmp_path / "score" / "score.json").read_bytes(), type=Score)
    nulls = sum(c.kind == "null" for c in key.cases)
    assert (board.rates[3].count, board.rates[3].of) == (0, nulls)


def test_diagnosing_needs_no_answers(copied, monkeypatch):
    shutil.rmtree(copied / "sealed")
    found = msgspec.json.decode((diagnosed(copied, monkeypatch) / "found.json").read_bytes())
    assert [f["case"] for f in found] == ["case_000", "case_001", "case_002"]


@pytest.mark.parametrize("changed", ["sealed/key.json", "recordings/case_001_validate.mcap"])
def test_a_changed_byte_is_refused(copied, monkeypatch, tmp_path, changed):
    found = diagnosed(copied, monkeypatch)
    path = copied / changed
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(RigError, match=r"is not (what|the recording that) was sealed"):
        ran("score", "--cases", copied, "--found", found, "--out", tmp_path / "score")


def test_a_diagnosis_of_other_recordings_is_refused(copied, monkeypatch, tmp_path):
    found = diagnosed(copied, monkeypatch) / "found.json"
    one, *others = msgspec.json.decode(found.read_bytes())
    found.write_bytes(msgspec.json.encode([{**one, "sha256": {}}, *others]))
    with pytest.raises(RigError, match="case_000: another recording was diagnosed"):
        ran("score", "--cases", copied, "--found", found.parent, "--out", tmp_path / "score")
    found.write_bytes(msgspec.json.encode(others))
    with pytest.raises(RigError, match="case_000: was not diagnosed"):
        ran("score", "--cases", copied, "--found", found.parent, "--out", tmp_path / "score")


def test_sealed_cases_are_not_overwritten(copied):
    with pytest.raises(RigError, match=r"key\.sha256: exists already"):
        ran("make", "--out", copied)
