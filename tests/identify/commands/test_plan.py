"""The command `identify plan`: what it prints, what it writes, and how it fails."""

import msgspec
import pytest

from identify.planning.results import PlanReport
from rig.model.description import to_json
from rig.simulation.reference import Sdof
from tests.identify.small_rigs import MASS_ON_TABLE
from tests.running import exit_status

WORDS = ("--duration", 20, "--force-rms", 0.7, "--workers", 1)


@pytest.fixture
def rig_json(tmp_path):
    path = tmp_path / "rig.json"
    path.write_bytes(to_json(Sdof(sensors="acceleration", noise_density=1e-3).rig()))
    return path


def test_json_on_standard_output_is_the_plan_and_the_file(rig_json, tmp_path, capfd):
    out = tmp_path / "out"
    words = ("--band", 0.5, 15, "--tolerances", "exact", "--changes", 0, "--json", "--out", out)
    assert exit_status("identify", "plan", rig_json, *WORDS, *words) == 0
    printed, errors = capfd.readouterr()
    assert errors == ""
    plan = msgspec.json.decode(printed, type=PlanReport)
    assert msgspec.json.decode((out / "plan.json").read_bytes(), type=PlanReport) == plan
    assert (plan.duration_s, plan.force.rms_n, plan.force.band_hz) == (20.0, (0.7,), (0.5, 15.0))
    assert [contact.name for contact in plan.contacts] == ["stop"]
    assert not plan.changes
    assert (out / "plan.html").read_text(encoding="utf-8").endswith("</html>\n")
    assert exit_status("identify", "plan", rig_json, *WORDS, "--changes", 0, "--out", out) == 1
    assert "--force" in capfd.readouterr().err


def test_the_terminal_shows_intervals_and_ranked_changes(rig_json, capfd):
    assert exit_status("identify", "plan", rig_json, *WORDS, "--changes", 2, columns=100) == 0
    printed, _ = capfd.readouterr()
    for text in ("Planned: 20 s of a Gaussian force of 0.700 N rms", "stop", "1.000", "10000", "note: "):
        assert text in printed
    assert ("What would help, ranked" in printed) != ("No change that was tried would help." in printed)


def test_a_base_is_planned_with_its_own_level(tmp_path, capfd):
    path, out = tmp_path / "rig.json", tmp_path / "out"
    path.write_bytes(to_json(MASS_ON_TABLE))
    words = ("--duration", 12, "--base-rms", 1.5, "--band", 4, 40, "--changes", 1, "--workers", 1, "--out", out)
    assert exit_status("identify", "plan", path, *words, columns=100) == 0
    assert "Planned: 12 s of a base that shakes with 1.50 m/s² rms from 4 to 40 Hz." in capfd.readouterr().out
    plan = msgspec.json.decode((out / "plan.json").read_bytes(), type=PlanReport)
    assert (plan.base.acceleration_rms_m_per_s2, plan.force) == (1.5, None)
    assert "a base that shakes with 1.50 m/s" in (out / "plan.html").read_text(encoding="utf-8")
    assert exit_status("identify", "plan", path, "--force-rms", 1) == 1
    assert "--base-rms" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "text"),
    [(("--duration", 1), "give 4 to"), (("--force-rms", -1), "above zero"), (("--simulator", "none"), "no simulator")],
)
def test_what_makes_no_test_is_one_line(rig_json, words, text, capfd):
    assert exit_status("identify", "plan", rig_json, *words) == 1
    errors = capfd.readouterr().err
    assert errors.count("\n") == 1
    assert text in errors
