"""`rig init`, and what `rig record`, `rig export` and `rig import` make of its files at once."""

import json
import sys
from io import StringIO

import msgspec
import numpy as np
import pytest
import pyuff

from rig.commands.cli import main
from rig.model.description import read_rig
from rig.recording import read
from tests.rig.lab.modal.test_uff import nodes, normal_modes
from tests.rig.lab.starting.test_starting import BEAMS, CONTACT, fin

MASS = {"mass_kg": 1.0, "frequency_hz": 5.0} | CONTACT
FRAME = {"contacts_m": 0.1, "force_m": 0.5, "noise_density": 1e-3} | CONTACT | {"sample_rate_hz": 4096.0}


@pytest.fixture
def rig(monkeypatch, capsys, tmp_path):
    """Runs the command in this process, in an empty folder: exit status, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def command(*words):
        monkeypatch.setattr(sys, "argv", ["rig", *map(str, words)])
        with pytest.raises(SystemExit) as stopped:
            main()
        return stopped.value.code, *capsys.readouterr()

    return command


def options(values):
    return [word for name, value in values.items() for word in (f"--{name.replace('_', '-')}", value)]


@pytest.mark.parametrize(
    ("kind", "values", "plant"),
    [
        ("mass", MASS, None),
        ("beams", BEAMS, "modal"),
        ("structure", FRAME | {"body": "fin.json"}, None),
    ],
)
def test_what_is_written_is_recorded_exported_and_imported_at_once(rig, tmp_path, kind, values, plant):
    (tmp_path / "fin.json").write_bytes(msgspec.json.encode(fin()))
    status, out, err = rig("init", kind, *options(values), "--out", "lab")
    assert (status, err) == (0, "")
    assert "lab/rig.json, lab/map.toml: written" in out
    words = [] if plant is None else ["--plant", plant]
    status, out, err = rig("record", "lab/rig.json", *words, "--duration", 2, "--seed", 5, "--out", "r.mcap")
    assert (status, err) == (0, "")
    before = read(tmp_path / "r.mcap")
    assert before.rig == read_rig(tmp_path / "lab" / "rig.json")
    used = plant or ("modal" if kind == "structure" else "ancf")
    assert (before.provenance["plant"], before.provenance["seed"]) == (used, "5")
    assert f"by the plant {used}, force " in out
    assert all(np.any(s.values) for s in before.signals.values())
    assert rig("export", "r.mcap", "--format", "csv", "--out", "lab/run.csv")[0] == 0
    status, _, err = rig("import", "lab/run.csv", "--map", "lab/map.toml", "--out", "back.mcap")
    assert (status, err) == (0, "")
    back = read(tmp_path / "back.mcap")
    assert back.rig == before.rig
    for name, signals in before.signals.items():
        np.testing.assert_array_equal(back.signals[name].values, signals.values)


def test_a_structure_is_refused_by_ancf_in_one_sentence(rig, tmp_path):
    (tmp_path / "fin.json").write_bytes(msgspec.json.encode(fin()))
    rig("init", "structure", *options(FRAME | {"body": "fin.json"}))
    status, out, err = rig("record", "rig.json", "--plant", "ancf", "--duration", 2, "--out", "r.mcap")
    assert (status, out) == (1, "")
    assert err == "rig: the ancf plant meshes beams, and 'fin' is a modal basis; simulate it with modal\n"


def test_a_modal_analysis_becomes_a_rig_that_records(rig, tmp_path):
    pyuff.UFF("arm.uff").write_sets([nodes(), *normal_modes()], mode="add")
    status, out, err = rig("init", "structure", "--from-uff", "arm.uff", *options(FRAME | {"force_m": 0.9}))
    assert (status, err) == (0, "")
    assert out.startswith("5 modes in direction z, 10 nodes along y, 0.9 m, from arm.uff\n")
    (body,) = read_rig(tmp_path / "rig.json").bodies
    assert (body.name, body.max_modes) == ("arm", 5)
    status, out, err = rig("record", "rig.json", "--duration", 2, "--out", "r.mcap")
    assert (status, err) == (0, "")
    assert "by the plant modal" in out


def test_what_is_missing_is_asked_for_on_a_terminal_alone(rig, tmp_path, monkeypatch):
    given = {k: v for k, v in MASS.items() if k != "clearance_m"}
    status, out, err = rig("init", "mass", *options(given))
    assert (status, out) == (2, "")
    assert "missing: --clearance-m" in err
    assert not list(tmp_path.iterdir())
    terminal = StringIO("wide\n2e-3\n")
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    status, out, _ = rig("init", "mass", *options(given))
    assert status == 0
    assert "'wide' does not fit" in out
    assert read_rig(tmp_path / "rig.json").contacts[0].law.upper_clearance_m == 2e-3


def test_nothing_is_overwritten_unasked(rig, tmp_path):
    (tmp_path / "map.toml").write_text("precious")
    status, out, err = rig("init", "mass", *options(MASS))
    assert (status, out) == (1, "")
    assert "map.toml: exists already" in err
    assert [p.name for p in tmp_path.iterdir()] == ["map.toml"]
    status, out, _ = rig("init", "mass", *options(MASS), "--force", "--json")
    assert json.loads(out) == {"rig": "rig.json", "map": "map.toml", "notes": []}


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("init", "mass", *options(MASS | {"mass_kg": "heavy"})), 2, "'heavy' does not fit"),
        (("init", "mass", *options(MASS | {"mass_kg": -1.0})), 1, "mass_kg is -1.0"),
        (("init", "mass", *options(MASS | {"quantity": "temperature"})), 2, "'temperature'"),
        (("init", "structure", *options(FRAME)), 1, "give the body of the structure by one file"),
        (("init", "pendulum"), 2, "pendulum"),
        (("record", "none.json", "--out", "r.mcap"), 1, "none.json: cannot be opened"),
    ],
)
def test_what_does_not_fit_is_said_and_leaves_nothing(rig, tmp_path, words, status, said):
    got, out, err = rig(*words)
    assert (got, out) == (status, "")
    assert said in err
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["mass", "beams", "structure"])
def test_help_has_an_example_and_every_option(rig, kind):
    from rig.lab.starting import KINDS

    status, out, _ = rig("init", kind, "--help")
    assert status == 0
    assert f"Example: rig init {kind} " in out
    for name in KINDS[kind].__struct_fields__:
        assert f"--{name.replace('_', '-')} " in out


def test_a_rig_and_a_recording_are_drawn(rig, tmp_path):
    rig("init", "mass", *options(MASS))
    assert rig("record", "rig.json", "--plant", "modal", "--duration", 2, "--out", "r.mcap")[0] == 0
    for file in ("rig.json", "r.mcap"):
        status, _, err = rig("draw", file)
        assert (status, err) == (0, "")
    assert (tmp_path / "rig.svg").read_bytes() == (tmp_path / "r.svg").read_bytes()
    status, _, err = rig("draw", "rig.json")
    assert (status, err) == (1, "rig: rig.svg: exists already; give another name, or --force to overwrite it\n")
    assert rig("draw", "rig.json", "--out", "rig.json", "--force")[0] == 2
    (tmp_path / "bad.json").write_text("{}")
    status, _, err = rig("draw", "bad.json")
    assert status == 1
    assert "bad.json: not a rig description" in err
