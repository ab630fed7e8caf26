"""What a change of the program moves is marked; what rounding moves is not."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from rig.errors import RigError
from rig.files import write_json
from tests.campaigns import frozen
from tests.campaigns.blind_comparison import decoded
from tests.campaigns.frozen_table import Frozen, Number, Told, compared, shown

STORED = Path(__file__).parents[1] / "campaigns" / "frozen.json"
VALUE, ERROR = 5e-3, 1e-5


def told(value=VALUE, error=ERROR, word="consistent", **more):
    numbers = {"clearance_m": Number(value, error), "probability": Number(0.25), **more}
    return {"beams": Told({"verdict": word}, numbers)}


def marked(before, now):
    return [row.name for row in compared(before, now) if row.beyond_rounding]


@pytest.mark.parametrize(
    "now",
    [
        told(),
        told(value=VALUE + 0.9e-3 * ERROR),
        told(error=ERROR * (1 + 0.9e-3)),
        told(probability=Number(0.25 * (1 + 0.9e-6))),
    ],
)
def test_equal_numbers_and_rounding_are_not_marked(now):
    assert marked(told(), now) == []


@pytest.mark.parametrize(
    ("now", "name"),
    [
        (told(value=VALUE + 1.1e-3 * ERROR), "clearance_m"),
        (told(error=ERROR * (1 - 1.1e-3)), "clearance_m, standard error"),
        (told(probability=Number(0.25 * (1 - 1.1e-6))), "probability"),
        (told(probability=Number(np.nan)), "probability"),
        (told(word="unexplained"), "verdict"),
        (told(rms_n=Number(1.0)), "rms_n"),
    ],
)
def test_what_changed_is_marked(now, name):
    assert marked(told(), now) == [name]
    assert marked(now, told()) == [name]


def test_a_recording_that_is_missing_is_marked_whole():
    assert len(marked(told(), {})) == len(compared(told(), told()))


def test_the_table_tells_before_now_and_the_relative_difference(capsys):
    shown(compared(told(), told(value=6e-3)), "before.json")
    lines = capsys.readouterr().out.splitlines()
    (line,) = (line for line in lines if "beyond rounding" in line and "clearance_m" in line)
    assert [word.strip() for word in line.split("│")[3:7]] == ["0.005", "0.006", "+2.0e-01", "beyond rounding"]
    assert lines[-1] == "1 of 4 numbers and words beyond rounding"


def test_the_command_sets_its_numbers_beside_the_stored_ones(tmp_path):
    name = "mass_displacement"
    stored = {name: decoded(STORED, Frozen)[name]}
    write_json(stored, tmp_path / "stored.json")
    words = ["--only", name, "--out", tmp_path / "out", "--against", tmp_path / "stored.json"]
    done = CliRunner().invoke(frozen.app, [str(w) for w in words], catch_exceptions=False)
    assert done.exit_code == 0
    rows = compared(stored, decoded(tmp_path / "out" / "frozen.json", Frozen))
    assert f" of {len(rows)} numbers and words beyond rounding" in done.output
    errors = {row.name: row.before for row in rows if row.name.endswith(", standard error")}
    for row in rows:  # on another processor the motion differs, but not by more than this
        if f"{row.name}, standard error" in errors:
            assert abs(row.now - row.before) < 3 * errors[f"{row.name}, standard error"]


def test_the_stored_numbers_are_those_of_all_steps():
    assert list(decoded(STORED, Frozen)) == list(frozen.STEPS)


def test_a_file_that_is_missing_is_refused_before_anything_is_recorded(tmp_path):
    with pytest.raises(RigError, match=r"none\.json: cannot be read"):
        frozen.frozen(out=tmp_path / "out", against=tmp_path / "none.json")
    assert not (tmp_path / "out").exists()


def test_shaking_is_of_the_size_that_is_asked_for(tmp_path):
    (recording,) = frozen.recorded(frozen.MASS(sensors="displacement", duration_s=2.0), (), tmp_path)
    assert frozen.shaken(recording, 0.0) is recording
    other = frozen.shaken(recording, 1e-6)
    pushed = recording.force_n != 0
    assert np.std(other.force_n[pushed] / recording.force_n[pushed] - 1) == pytest.approx(1e-6, rel=0.1)
