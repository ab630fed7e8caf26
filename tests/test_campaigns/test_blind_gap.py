"""The blind check from beginning to end, with a diagnosis that always says no."""

import shutil
from dataclasses import replace as fields
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from identify.gaps.residual.record import CountedBandAndEnd
from rig.errors import RigError
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import read as read_recording
from rig.simulation import prediction
from tests.campaigns import blind_diagnosis, blind_gap
from tests.campaigns.blind_comparison import limits_of, opened, pairs_of, refused_in
from tests.campaigns.blind_diagnosis import (
    Found,
    NullReferenceMade,
    NullReferenceToMake,
    null_reference_made,
    without_curves,
)
from tests.campaigns.blind_gap import app
from tests.campaigns.scoreboard import Score
from tests.campaigns.tolerance_sensitivity import settings
from tests.campaigns.true_effect import Best
from tests.test_campaigns.blind_cases import ABOVE, gap

pytestmark = pytest.mark.fakes

CASES = ["case_000", "case_001", "case_002"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Of every case its effects are above their limits, which are not computed."""
    folder = tmp_path_factory.mktemp("blind")

    def best(answers, *_):
        return [Best(0.0 if a.kind == "null" else 2.0, (ABOVE,) * len(a.effects)) for a in answers]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(blind_gap, "best_of", best)
        ran("make", "--out", folder, "--world", "wide", "--cases", 3, "--duration", 1.5, "--seed", 2)
    return folder


def ran(*words):
    done = CliRunner().invoke(app, [str(w) for w in words], catch_exceptions=False)
    assert done.exit_code == 0
    return done.output


@pytest.fixture
def cases(made, tmp_path):
    shutil.copytree(made, tmp_path / "cases")
    return tmp_path / "cases"


def run_here(function, parameters, _result_type, folder, _dask=None):
    """One after another in this process: what is put in place of the diagnosis holds here alone."""
    folder.mkdir(parents=True, exist_ok=True)
    return [function(p) for p in parameters]


def forced_record(*_, **__):
    """What the tool asks of a record; the recordings here are too short for a true one."""
    return SimpleNamespace(counted_part=CountedBandAndEnd(1, 1.5), has_force=True, base=None)


@pytest.fixture
def tool(monkeypatch):
    """Puts other functions in the place of those of the tool under test."""

    def changed(**functions):
        monkeypatch.setattr(blind_diagnosis, "TOOL", fields(blind_diagnosis.TOOL, **functions))

    return changed


@pytest.fixture
def quick(tool):
    """Diagnoses at once; the calls."""
    calls = []

    def diagnosed(fit, _validate, null_reference, tolerances):
        calls.append((fit.samples, null_reference, tolerances))
        return gap("consistent", nothing=0.9)

    tool(
        run_tasks=run_here,
        gap_of=diagnosed,
        record_of=forced_record,
        null_reference_made=lambda task: NullReferenceMade(task.key, 30.0, 400.0),
    )
    return calls


def diagnosed(cases):
    ran("diagnose", "--cases", cases, "--out", cases.parent / "found")
    return cases.parent / "found"


def read(folder):
    return msgspec.json.decode((folder / "found.json").read_bytes(), type=list[Found])


@pytest.mark.usefixtures("quick")
def test_what_is_made_is_sealed_and_scored(cases, tmp_path):
    key = opened(cases)
    assert sorted(c.case for c in key.cases) == CASES
    assert len(list((cases / "recordings").iterdir())) == 6
    folder = diagnosed(cases)
    text = ran("score", "--cases", cases, "--found", folder, "--out", tmp_path / "score")
    assert "wide, 3 cases" in text
    told = msgspec.json.decode((tmp_path / "score" / "score.json").read_bytes())
    board = msgspec.convert(told["worlds"]["wide"], Score)
    rates = {r.name: (r.count, r.of) for r in board.rates}
    below = sum(c.kind == "null" for c in key.cases)
    assert rates["null: false alarm"] == (0, below)
    assert rates["verdict right"] == (below, 3)
    assert told["calibration"]["wide"]["sets"]["brier"] == pytest.approx((below * 0.1**2 + (3 - below) * 0.9**2) / 3)
    assert "temperature" in ran("calibrate", "--cases", cases, "--found", folder)


@pytest.mark.usefixtures("quick")
def test_folders_of_one_world_are_scored_together(cases, tmp_path):
    folder = diagnosed(cases)
    text = ran("score", "--cases", cases, "--found", folder, "--out", tmp_path / "s", "--also", f"{cases}:{folder}")
    assert "wide, 6 cases" in text
    with pytest.raises(RigError, match="is not CASES:FOUND"):
        pairs_of(cases, folder, ["somewhere"])


@pytest.mark.usefixtures("quick")
def test_diagnosing_needs_no_answers(cases):
    shutil.rmtree(cases / "sealed")
    assert [f.case for f in read(diagnosed(cases))] == CASES


def test_cases_of_one_level_share_a_null_reference(cases, quick):
    some = read(diagnosed(cases))
    assert {cpu_s for f in some for cpu_s in f.null_references_cpu_s.values()} == {30.0}
    assert all(len(f.null_references_cpu_s) == 2 for f in some)  # the records' levels differ
    assert len({key for f in some for key in f.null_references_cpu_s}) < 6
    assert {(null_reference, tolerances) for _, null_reference, tolerances in quick} == {
        (cases.parent / "found" / "null_references", None)
    }


def test_tolerances_and_null_references_of_others(cases, quick, tmp_path):
    ran(
        "diagnose",
        "--cases",
        cases,
        "--out",
        tmp_path / "a",
        "--tolerances",
        "exact",
        "--null-references-of",
        tmp_path / "kept",
    )
    assert all((null_reference, tolerances) == (tmp_path / "kept", EXACT) for _, null_reference, tolerances in quick)
    ran("diagnose", "--cases", cases, "--out", tmp_path / "b")
    keys = [{key for f in read(tmp_path / name) for key in f.null_references_cpu_s} for name in "ab"]
    assert keys[0].isdisjoint(keys[1])


def to_make(cases, folder, which=1):
    fit, other = (str(cases / "recordings" / f"case_000{end}.mcap") for end in ("", "_validate"))
    return NullReferenceToMake(
        key="0123456789abcdefgh", fit=fit, validate=other, which=which, null_reference=str(folder), tolerances=None
    )


def test_a_null_reference_that_is_there_costs_nothing(cases, tool, tmp_path):
    asked = []
    tool(null_reference_of=lambda *_, path, predict: asked.append((path, predict)), record_of=forced_record)
    assert null_reference_made(to_make(cases, tmp_path)).cpu_s > 0
    (tmp_path / "0123456789abcdef.json").touch()
    assert null_reference_made(to_make(cases, tmp_path)).cpu_s == 0
    assert asked == [(Path(tmp_path), prediction.modal)] * 2


@pytest.mark.parametrize("which", [0, 1])
def test_each_record_has_a_null_reference_of_its_own(cases, tool, tmp_path, which):
    asked = []
    tool(null_reference_of=lambda record, *_, **__: asked.append(record.forces_n), record_of=forced_record)
    null_reference_made(to_make(cases, tmp_path, which))
    name = ("case_000", "case_000_validate")[which]
    np.testing.assert_array_equal(asked[0], read_recording(cases / "recordings" / f"{name}.mcap").forces_n)


@pytest.mark.parametrize(("error", "crashed"), [(RigError("too stiff"), False), (ValueError("too stiff"), True)])
def test_a_null_reference_that_fails_loses_its_cases_alone(cases, quick, tmp_path, tool, error, crashed):
    def fails(*_, **__):
        raise error

    tool(null_reference_of=fails)
    failed = null_reference_made(to_make(cases, tmp_path))
    assert (failed.refusal.endswith("too stiff"), failed.crashed) == (True, crashed)
    tool(null_reference_made=lambda task: replace(failed, key=task.key))
    ran("diagnose", "--cases", cases, "--out", tmp_path / "found")
    assert not quick
    assert [(r.case, r.crashed) for r in refused_in(tmp_path / "found")] == [(case, crashed) for case in CASES]


def test_what_is_large_is_not_stored():
    one = gap("consistent")
    full = msgspec.structs.replace(
        one,
        attribution=msgspec.structs.replace(one.attribution, positions_m={"barrel": {0.1: 1.0}}, channels={"a": 1.0}),
    )
    kept = without_curves(full).attribution
    assert (kept.positions_m, kept.channels) == ({}, {"a": 1.0})


def test_each_tolerance_is_doubled_and_halved(cases, quick, tmp_path):
    every = dict(settings())
    assert every["default"] == LABORATORY
    assert every["damping_halved"].damping == LABORATORY.damping / 2
    assert every["gain_doubled"].gain == 2 * LABORATORY.gain
    assert not any(name.startswith("force_noise_density") for name in every)
    text = ran("sensitivity", "--cases", cases, "--out", tmp_path / "s", "--only", "damping")
    assert "damping halved" in text
    boards = msgspec.json.decode((tmp_path / "s" / "sensitivity.json").read_bytes(), type=dict[str, Score])
    assert list(boards) == ["default", "damping_doubled", "damping_halved"]
    assert {tolerances.damping for _, _, tolerances in quick} == {0.15, 0.3, 0.6}


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("changed", ["sealed/key.json", "sealed/limits.json", "recordings/case_001_validate.mcap"])
def test_a_changed_byte_is_refused(cases, tmp_path, changed):
    folder = diagnosed(cases)
    path = cases / changed
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(RigError, match=r"is not (what|the recording that) was sealed"):
        ran("score", "--cases", cases, "--found", folder, "--out", tmp_path / "score")


@pytest.mark.usefixtures("quick")
def test_unsealed_answers_are_refused(cases, tmp_path):
    folder = diagnosed(cases)
    (cases / "key.sha256").unlink()
    with pytest.raises(RigError, match=r"key\.sha256: is missing"):
        ran("score", "--cases", cases, "--found", folder, "--out", tmp_path / "score")


@pytest.mark.usefixtures("quick")
def test_a_diagnosis_of_other_recordings_is_refused(cases, tmp_path):
    path = diagnosed(cases) / "found.json"
    one, *others = msgspec.json.decode(path.read_bytes())
    path.write_bytes(msgspec.json.encode([{**one, "sha256": {}}, *others]))
    with pytest.raises(RigError, match="case_000: another recording was diagnosed"):
        ran("score", "--cases", cases, "--found", path.parent, "--out", tmp_path / "score")
    path.write_bytes(msgspec.json.encode(others))
    with pytest.raises(RigError, match="case_000: was not diagnosed"):
        ran("score", "--cases", cases, "--found", path.parent, "--out", tmp_path / "score")


def test_sealed_cases_are_not_overwritten(cases):
    with pytest.raises(RigError, match=r"key\.sha256: exists already"):
        ran("make", "--out", cases)


def test_a_refused_diagnosis_is_counted_and_told(cases, quick, tmp_path, tool):
    """One of three is refused: it stands beside what was found, and its verdict is wrong."""
    del quick
    of_one = read_recording(cases / "recordings" / "case_001.mcap").force_n

    def some_refused(fit, *_):
        if np.array_equal(fit.force_n, of_one):
            raise RigError("velocity sensors are not read")
        return gap("consistent", nothing=0.9)

    tool(gap_of=some_refused)
    folder = tmp_path / "found"
    said = ran("diagnose", "--cases", cases, "--out", folder)
    assert "2 diagnoses" in said
    assert "case_001 was refused: velocity sensors are not read" in said
    assert [f.case for f in read(folder)] == ["case_000", "case_002"]
    assert [r.case for r in refused_in(folder)] == ["case_001"]
    text = ran("score", "--cases", cases, "--found", folder, "--out", tmp_path / "score")
    assert "wide, 3 cases" in text
    assert [line.split()[2:5] for line in text.splitlines() if "│ refused" in line] == [["│", "1", "of"]]
    assert "case_001 was refused: velocity sensors are not read" in text


def test_a_recording_that_no_diagnosis_can_read_is_refused_before_it_begins(cases, quick, tmp_path, tool):
    def unreadable(*_):
        raise RigError("the force is zero throughout")

    tool(without_faulty_channels=unreadable)
    ran("diagnose", "--cases", cases, "--out", tmp_path / "found")
    assert not quick
    assert read(tmp_path / "found") == []
    assert {r.sentence for r in refused_in(tmp_path / "found")} == {"the force is zero throughout"}
    assert [r.case for r in refused_in(tmp_path / "found")] == CASES


def test_a_crash_is_counted_and_does_not_lose_the_others(cases, quick, tmp_path, tool):
    del quick

    def crash(*_):
        raise ValueError("shapes differ")

    tool(gap_of=crash)
    assert "case_002 crashed: ValueError: shapes differ" in ran("diagnose", "--cases", cases, "--out", tmp_path / "f")
    assert all(r.crashed for r in refused_in(tmp_path / "f"))


def test_limits_are_sealed_once_before_anything_is_scored(cases, quick, tmp_path, monkeypatch):
    del quick
    sealed = (cases / "limits.sha256").read_text().strip()
    folder = diagnosed(cases)
    words = ("score", "--cases", cases, "--found", folder, "--out", tmp_path / "score")
    assert f"sha256 of the detection limits: {sealed}" in ran(*words)
    with pytest.raises(RigError, match=r"limits\.sha256: exists already"):
        ran("limits", "--cases", cases)
    (cases / "limits.sha256").unlink()
    with pytest.raises(RigError, match=r"limits\.sha256: is missing; lay the limits first"):
        ran(*words)
    monkeypatch.setattr(blind_gap, "best_of", lambda answers, *_: [Best(7.0)] * len(answers))
    assert sealed not in ran("limits", "--cases", cases)
    assert limits_of(cases, opened(cases).cases) == [Best(7.0)] * 3


@pytest.mark.parametrize("world", ["counted", "bench"])
def test_every_world_is_sealed_by_its_hash(world, tmp_path):
    """Of records of 1.5 s, which are too short for machines with contacts."""
    ran("make", "--out", tmp_path / world, "--world", world, "--cases", 2, "--duration", 1.5, "--seed", 3)
    key = opened(tmp_path / world)
    assert (key.world, len(key.cases)) == (world, 2)
    rigs = [read_recording(tmp_path / world / "recordings" / f"{one.case}.mcap").rig for one in key.cases]
    refused = [bool(best.refusal) for best in limits_of(tmp_path / world, key.cases)]
    assert refused == [bool(rig.contacts) for rig in rigs]
    sealed = tmp_path / world / "sealed" / "key.json"
    sealed.write_bytes(sealed.read_bytes().replace(b'"whole"', b'"whule"', 1))
    with pytest.raises(RigError, match="is not what was sealed"):
        opened(tmp_path / world)
