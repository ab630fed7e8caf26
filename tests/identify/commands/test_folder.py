"""Folders of recordings: one table, each recording by itself, resumed, refusals beside answers."""

import csv
import json

import msgspec
import pytest
from pyarrow import parquet

from identify.commands.contact_folder import COLUMN_NAMES
from identify.contacts.results import ContactReport
from rig.recording import truth_path
from rig.simulation.reference import Sdof
from tests.running import exit_status

CLEARANCE_M = 1.3e-3
USE = ("--use", "displacement")


@pytest.fixture(scope="module")
def folder(simulate, tmp_path_factory):
    """A recording of the one-mass rig, one that is too weak to close the contact, and a file that is none."""
    path = tmp_path_factory.mktemp("many") / "runs"
    path.mkdir()
    short = {"duration_s": 20.0, "step_s": 2.0**-12, "sensors": "displacement"}
    simulate(Sdof(clearance_m=CLEARANCE_M, **short), path / "run2.mcap")
    simulate(Sdof(rms_n=0.01, **short), path / "run10.mcap")
    assert truth_path(path / "run2.mcap").exists()
    (path / "broken.mcap").write_text("nothing")
    return path


@pytest.fixture(scope="module")
def results(folder):
    """Folder of the results, of a command that was run once."""
    out = folder.parent / "results"
    assert exit_status("identify", "contact", folder, "--out", out, *USE) == 1
    return out


@pytest.fixture
def identify(capfd):
    """Runs the command and gives its exit status, standard output and standard error."""

    def run(*words):
        return exit_status("identify", *words), *capfd.readouterr()

    return run


def rows_of(out, name="contacts"):
    with (out / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        return {row["recording"]: row for row in csv.DictReader(stream)}


def test_a_row_for_each_recording_and_contact_holds_what_its_files_hold(results):
    rows = rows_of(results)
    assert list(rows) == ["broken.mcap", "run2.mcap", "run10.mcap"]
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "broken.mcap": "refused",
        "run2.mcap": "identified",
        "run10.mcap": "not_told",
    }
    told, weak = rows["run2.mcap"], rows["run10.mcap"]
    assert float(told["clearance_m"]) == pytest.approx(CLEARANCE_M, rel=1e-2)
    report = msgspec.json.decode((results / "run2" / "contact.json").read_bytes(), type=ContactReport)
    estimate = report.contacts[0].stiffness_n_per_m
    assert float(told["stiffness_n_per_m"]) == estimate.value
    assert float(told["stiffness_standard_error_n_per_m"]) == estimate.standard_error
    assert (weak["contact"], weak["code"], weak["clearance_m"]) == ("stop", "hardly_closes", "")
    assert "is no MCAP file" in rows["broken.mcap"]["reason"]
    assert (results / "run2" / "contact.html").exists()
    assert (results / "run10" / "contact.json").exists()
    assert not (results / "broken").exists()


def test_the_parquet_file_is_the_same_table(results):
    table = parquet.read_table(results / "contacts.parquet")
    assert tuple(table.column_names) == COLUMN_NAMES
    rows = rows_of(results)
    for row in table.to_pylist():
        written = rows[row["recording"]]
        assert {k: "" if v is None else str(v) for k, v in row.items() if k != "clearance_m"} == {
            k: v for k, v in written.items() if k != "clearance_m"
        }
    assert table["clearance_m"].to_pylist() == [None, float(rows["run2.mcap"]["clearance_m"]), None]


def test_the_same_command_computes_only_what_is_missing(identify, folder, results):
    """run10's result is lost: it is made again, run2's is not."""
    kept, lost = results / "run2" / "contact.json", results / "run10" / "contact.json"
    made_ns = kept.stat().st_mtime_ns
    table = (results / "contacts.csv").read_bytes()
    lost.unlink()
    (results / "contacts.csv").unlink()
    status, out, err = identify("contact", folder, "--out", results, *USE)
    assert status == 1
    assert err == f"identify: 1 of 3 recordings were refused; {results / 'contacts.csv'} says why\n"
    assert "run10.mcap, stop: not told: it hardly ever closes" in out
    assert lost.exists()
    assert kept.stat().st_mtime_ns == made_ns
    assert (results / "contacts.csv").read_bytes() == table


def test_json_has_the_rows(identify, folder, results):
    status, out, _ = identify("contact", folder, "--out", results, *USE, "--json")
    assert status == 1
    assert [row["verdict"] for row in json.loads(out)] == ["refused", "identified", "not_told"]


def test_results_by_other_settings_are_not_mixed(identify, folder, results):
    before = (results / "contacts.csv").read_bytes()
    status, out, err = identify("contact", folder, "--out", results, *USE, "--tolerances", "exact")
    assert (status, out) == (1, "")
    assert "holds results by other settings; give another folder, or --force to begin anew" in err
    assert (results / "contacts.csv").read_bytes() == before


def test_results_of_a_recording_by_itself_are_not_overwritten(identify, folder, tmp_path):
    mine = tmp_path / "run2" / "contact.json"
    mine.parent.mkdir()
    mine.write_text("mine")
    status, out, err = identify("contact", folder, "--out", tmp_path, *USE)
    assert (status, out) == (1, "")
    assert f"{mine}: exists already" in err
    assert mine.read_text() == "mine"


def test_exit_status_is_0_where_all_answered(identify, simulate, tmp_path):
    runs = tmp_path / "runs"
    runs.mkdir()
    simulate(Sdof(duration_s=20.0, step_s=2.0**-12, rms_n=0.01), runs / "weak.mcap")
    status, out, err = identify("contact", runs, "--out", tmp_path / "results", *USE)
    assert (status, err) == (0, "")
    assert "1 rows of 1 recordings" in out


@pytest.mark.parametrize("command", ["contact", "gap"])
def test_what_a_folder_needs_is_said_in_one_line(identify, folder, tmp_path, command):
    (tmp_path / "empty").mkdir()
    for words, sentence in (
        ((folder,), "is a folder of recordings; give --out DIR"),
        ((tmp_path / "empty", "--out", tmp_path / "results"), "holds no recordings"),
        ((folder, "--out", tmp_path / "results", "--dask", "tcp://127.0.0.1:9"), "no scheduler answers there"),
    ):
        status, out, err = identify(command, *words)
        assert (status, out, err.count("\n")) == (1, "", 1)
        assert sentence in err


@pytest.mark.study
def test_recordings_are_diagnosed_one_by_one_with_one_null_reference(identify, simulate, tmp_path):
    """Two recordings of a rig that is as believed, beside a file that is none. The fitted and the judged part each have
    a null reference, which both recordings share."""
    runs, out = tmp_path / "runs", tmp_path / "results"
    runs.mkdir()
    for seed in (1, 2):
        simulate(Sdof(duration_s=30.0, step_s=2.0**-12, seed=seed), runs / f"run{seed}.mcap")
    (runs / "broken.mcap").write_text("nothing")
    status, _, err = identify("gap", runs, "--out", out)
    assert status == 1
    assert "1 of 3 recordings were refused" in err
    rows = rows_of(out, "gaps")
    assert list(rows) == ["broken.mcap", "run1.mcap", "run2.mcap"]
    for name in ("run1", "run2"):
        gap = json.loads((out / name / "gap.json").read_bytes())
        assert rows[f"{name}.mcap"]["verdict"] == gap["verdict"]
        assert rows[f"{name}.mcap"]["sentence"] == gap["sentence"]
        assert gap["verdict"] in {"consistent", "cannot_tell"}
    (reference,) = (out / "null_references").iterdir()
    assert len(json.loads(reference.read_bytes())["null_references"]) == 2
