"""`rig init`, and what `rig record`, `rig export` and `rig import` make of its files at once."""

import json
from io import StringIO

import msgspec
import numpy as np
import pytest
import pyuff

from rig.lab.starting import KINDS
from rig.model.description import read_rig
from rig.recording import read
from tests.rig.lab.modal.test_uff import nodes, normal_modes
from tests.rig.lab.starting.test_starting import BEAMS, CONTACT, fin
from tests.running import exit_status

MASS = {"mass_kg": 1.0, "frequency_hz": 5.0} | CONTACT
TWO_MASSES = {"masses_kg": "1,2", "frequencies_hz": "6,9", "stops": "upper"} | CONTACT
CHAIN = {"masses_kg": "2,2,2", "springs_n_per_m": "5e4", "contacts": "3-2,1-0"} | CONTACT
CANTILEVER = {"length_m": 0.5, "width_m": 0.03, "thickness_m": 0.005} | CONTACT | {"sample_rate_hz": 4096.0}
FRAME = {"contacts_m": 0.1, "force_m": 0.5, "noise_density": 1e-3} | CONTACT | {"sample_rate_hz": 4096.0}


@pytest.fixture
def rig(in_folder, capsys):
    """Runs the command in this process, in an empty folder: exit status, standard output, standard error."""
    del in_folder

    def command(*words):
        return exit_status("rig", *words), *capsys.readouterr()

    return command


def options(values):
    return [word for name, value in values.items() for word in (f"--{name.replace('_', '-')}", value)]


@pytest.mark.parametrize(
    ("kind", "values", "plant"),
    [
        ("mass", MASS, None),
        ("two_masses", TWO_MASSES, "modal"),
        ("chain", CHAIN, None),
        ("cantilever", CANTILEVER, "modal"),
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
    used = plant or ("modal" if kind in ("structure", "chain") else "ancf")
    assert (before.provenance["plant"], before.provenance["seed"]) == (used, "5")
    assert f"by the plant {used}, force " in out
    assert "the force: " in out
    assert all(np.any(s.values) for s in before.signals.values())
    assert rig("export", "r.mcap", "--format", "csv", "--out", "lab/run.csv")[0] == 0
    status, _, err = rig("import", "lab/run.csv", "--map", "lab/map.toml", "--out", "back.mcap")
    assert (status, err) == (0, "")
    imported = read(tmp_path / "back.mcap")
    assert imported.rig == before.rig
    for name, signals in before.signals.items():
        np.testing.assert_array_equal(imported.signals[name].values, signals.values)


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
    assert out.startswith(
        "5 modes in direction z, 10 nodes along y, from node 30 at 0 m to node 9 at 0.9 m, from arm.uff\n"
    )
    (body,) = read_rig(tmp_path / "rig.json").bodies
    assert (body.name, body.max_modes) == ("arm", 5)
    status, out, err = rig("record", "rig.json", "--duration", 2, "--out", "r.mcap")
    assert (status, err) == (0, "")
    assert "by the plant modal" in out


MEASURED = {
    "from_record": "low.csv",
    "force_column": "force",
    "columns": "fin_0000mm_acceleration,fin_0250mm_acceleration,fin_0500mm_acceleration",
    "positions_m": "0,0.25,0.5",
    "unit": "m/s^2",
    "force_m": 0.5,
    "time_column": "time_s",
}


def test_a_recording_becomes_a_rig_that_imports_it(rig, tmp_path):
    """A structure is recorded without contact; the modes fitted to its accelerations are its modes."""
    body, place = fin(first=2), {"body": "fin"}
    stations = [place | {"position_m": x} for x in (0.0, 0.25, 0.5)]
    sensors = [
        {"name": f"fin_{round(1000 * s['position_m']):04d}mm_acceleration", "station": s, "quantity": "acceleration"}
        for s in stations
    ]
    description = {"name": "fin", "bodies": [body], "contacts": [], "force_at": stations[-1], "sensors": sensors}
    (tmp_path / "true.json").write_bytes(msgspec.json.encode(description | {"sample_rate_hz": 8192.0}))
    excitation = ("--set", "low_hz=60", "--set", "high_hz=1300", "--set", "rms_n=1")
    assert rig("record", "true.json", "--duration", 8, *excitation, "--out", "true.mcap")[0] == 0
    assert rig("export", "true.mcap", "--format", "csv", "--out", "low.csv")[0] == 0
    status, out, err = rig("init", "measured", *options(MEASURED), "--out", "lab")
    assert (status, err) == (0, "")
    assert "its force does not repeat" in out
    missed = [float(line.split("misses ")[1].split("%")[0]) for line in out.splitlines() if "a free run misses" in line]
    assert len(missed) == 3
    assert max(missed) < 1
    (fitted,) = read_rig(tmp_path / "lab" / "rig.json").bodies
    inside = [k for k, hz in enumerate(fitted.natural_hz) if 60 < hz < 1300]
    true_modes = [k for k, hz in enumerate(body.natural_hz) if 60 < hz < 1300]
    np.testing.assert_allclose(np.take(fitted.natural_hz, inside), np.take(body.natural_hz, true_modes), rtol=1e-3)
    places = np.array([0.0, 0.25, 0.5])
    of_found, of_own = (b.shapes(places, b.max_modes)[:, ks] for b, ks in ((fitted, inside), (body, true_modes)))
    np.testing.assert_allclose(of_found * np.sign(of_found[-1]), of_own * np.sign(of_own[-1]), atol=0.03)
    assert rig("import", "low.csv", "--map", "lab/map.toml", "--out", "back.mcap")[0] == 0
    np.testing.assert_array_equal(read(tmp_path / "back.mcap").force_n, read(tmp_path / "true.mcap").force_n)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"force_m": 0.4}, "force_m is 0.4, where no sensor is"),
        ({"positions_m": "0,0.5"}, "3 columns and 2 positions_m"),
        ({"positions_m": "0,0,0.5"}, "two positions_m are the same"),
        ({"contacts_m": 0.3, "clearance_m": 1e-3, "stiffness_n_per_m": 1e4}, "contacts_m has 0.3 m, where no sensor"),
        ({"quantity": "acceleration,velocity"}, "quantity names more than one"),
        ({"unit": "m"}, "'m' is no unit of acceleration"),
        ({"columns": "a,b,c"}, "low.csv: there is no column 'a'"),
        ({"band_hz": "1e4,2e4"}, "low.csv: the force excites no line in band_hz"),
        ({"from_record": "none.csv"}, "none.csv: cannot be opened"),
    ],
)
def test_a_recording_that_does_not_fit_is_said_and_leaves_nothing(rig, tmp_path, changes, said):
    names = ["time_s", "force", *MEASURED["columns"].split(",")]
    table = np.column_stack([np.arange(4000) / 8192, np.random.default_rng(1).standard_normal((4000, 4))])
    np.savetxt(tmp_path / "low.csv", table, delimiter=",", header=",".join(names), comments="")
    status, out, err = rig("init", "measured", *options(MEASURED | changes), "--out", "lab")
    assert (status, out) == (1, "")
    assert said in err
    assert "Traceback" not in err
    assert [p.name for p in tmp_path.iterdir()] == ["low.csv"]


def test_what_is_missing_is_asked_for_on_a_terminal_alone(rig, tmp_path, monkeypatch):
    values = {k: v for k, v in MASS.items() if k != "frequency_hz"}
    status, out, err = rig("init", "mass", *options(values))
    assert (status, out) == (2, "")
    assert "missing: --frequency-hz" in err
    assert not list(tmp_path.iterdir())
    terminal = StringIO("high\n7 Hz\n")
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    status, out, _ = rig("init", "mass", *options(values))
    assert status == 0
    assert "'high' does not fit" in out
    assert read_rig(tmp_path / "rig.json").bodies[0].frequency_hz == 7.0


def test_nothing_is_overwritten_unasked(rig, tmp_path):
    (tmp_path / "rig.json").write_text("precious")
    status, out, err = rig("init", "mass", *options(MASS))
    assert (status, out) == (1, "")
    assert "rig.json: exists already" in err
    assert [p.name for p in tmp_path.iterdir()] == ["rig.json"]
    status, out, _ = rig("init", "mass", *options(MASS), "--force", "--json")
    assert json.loads(out) == {"rig": "rig.json", "map": "map.toml", "notes": []}


def test_a_map_that_is_there_stays(rig, tmp_path):
    """As `rig import FILE --write-map map.toml` proposed it before there was a rig.json."""
    (tmp_path / "map.toml").write_text("proposed")
    status, out, _ = rig("init", "mass", *options(MASS))
    assert status == 0
    assert "map.toml: was there and stays as it is\nrig.json: written; next: " in out
    assert (tmp_path / "map.toml").read_text() == "proposed"
    assert rig("init", "mass", *options(MASS), "--force")[0] == 0
    assert (tmp_path / "map.toml").read_text() != "proposed"


@pytest.mark.parametrize("text", [None, "unknown", "?"])
@pytest.mark.parametrize("fields", [("clearance_m",), ("stiffness_n_per_m",), ("clearance_m", "stiffness_n_per_m")])
def test_what_is_unknown_of_a_contact_is_no_belief(rig, tmp_path, fields, text):
    values = {k: text if k in fields else v for k, v in MASS.items() if text or k not in fields}
    status, out, err = rig("init", "mass", *options(values))
    assert (status, err) == (0, "")
    machine = read_rig(tmp_path / "rig.json")
    law = machine.contacts[0].law
    for field, tolerance in (("clearance_m", "clearance"), ("stiffness_n_per_m", "stiffness")):
        assert (f"{tolerance} is unknown and starts from" in out) == (field in fields)
        assert getattr(machine.tolerances, tolerance) == (1.0 if field in fields else 0.01)
        if field not in fields:
            assert getattr(law, field) == MASS[field]
    assert not machine.tolerances.contacts_known
    _, out, _ = rig("info", "rig.json")
    assert "Contacts, unknown: where rig.json starts" in out


@pytest.mark.parametrize(
    ("option", "text", "value"),
    [
        ("clearance_m", "0.3 mm", 0.0003),
        ("clearance_m", "300um", 0.0003),
        ("clearance_m", "300 µm", 0.0003),
        ("clearance_m", "3e-4 m", 0.0003),
        ("stiffness_n_per_m", "100 N/mm", 1e5),
        ("stiffness_n_per_m", "1e4 N/m", 1e4),
        ("stiffness_n_per_m", "1e4", 1e4),
        ("stiffness_n_per_m", "+.5E+4N/m", 5e3),
        ("stiffness_n_per_m", "0.1kN/mm", 1e5),
        ("damping_n_s_per_m", "2 N·s/m", 2.0),
        ("sample_rate_hz", "5.12 kHz", 5120.0),
    ],
)
def test_values_carry_units(rig, tmp_path, option, text, value):
    assert rig("init", "mass", *options(MASS | {option: text}))[0] == 0
    machine = read_rig(tmp_path / "rig.json")
    holder = machine if option == "sample_rate_hz" else machine.contacts[0].law
    assert getattr(holder, option) == value


def test_each_number_of_a_list_carries_its_unit(rig, tmp_path):
    values = TWO_MASSES | {"masses_kg": "500 g,2", "frequencies_hz": "6,0.009kHz"}
    assert rig("init", "two_masses", *options(values))[0] == 0
    first, second = read_rig(tmp_path / "rig.json").bodies
    assert (first.mass_kg, second.mass_kg, first.frequency_hz, second.frequency_hz) == (0.5, 2.0, 6.0, 9.0)


def test_no_field_is_written_at_its_default(rig, tmp_path):
    assert rig("init", "two_masses", *options(TWO_MASSES))[0] == 0
    text = (tmp_path / "rig.json").read_text()
    assert text.count("null") == 1  # the stop that is not there
    for field in ("tones", "tolerances", "wear_m_per_s", "measuring_range", "force_sensor"):
        assert field not in text
    assert '"schema_version"' in text


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("init", "mass", *options(MASS | {"mass_kg": "heavy"})), 2, "'heavy' does not fit"),
        (("init", "mass", *options(MASS | {"mass_kg": -1.0})), 1, "mass_kg is -1.0"),
        (("init", "mass", *options(MASS | {"mass_kg": "unknown"})), 2, "'unknown' does not fit"),
        (("init", "mass", *options(MASS | {"clearance_m": "3 N"})), 2, "has the unit 'N'; give one of m, cm, mm, um"),
        (("init", "mass", *options(MASS | {"quantity": "temperature"})), 2, "'temperature'"),
        (("init", "structure", *options(FRAME)), 1, "give the body of the structure by one file"),
        (("init", "pendulum"), 2, "pendulum"),
        (("init", "mass", *options(MASS | {"stops": "left"})), 2, "give 'both' or 'lower' or 'upper'"),
        (("init", "two_masses", *options(TWO_MASSES | {"masses_kg": "1"})), 1, "masses_kg has 1 numbers; give two"),
        (("init", "chain", *options(CHAIN | {"contacts": "3-4"})), 1, "contacts names mass 4; there are masses 0 to 3"),
        (("init", "chain", *options(CHAIN | {"contacts": "3"})), 1, "contacts has '3'; give pairs of masses such as"),
        (("init", "chain", *options(CHAIN | {"springs_n_per_m": "1,2"})), 1, "springs_n_per_m has 2 numbers for 3"),
        (("record", "none.json", "--out", "r.mcap"), 1, "none.json: cannot be opened"),
    ],
)
def test_what_does_not_fit_is_said_and_leaves_nothing(rig, tmp_path, words, status, said):
    got, out, err = rig(*words)
    assert (got, out) == (status, "")
    assert said in err
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", KINDS)
def test_help_has_an_example_and_every_option(rig, kind):
    status, out, _ = rig("init", kind, "--help")
    assert status == 0
    assert f"Example: rig init {kind} " in out
    for name in KINDS[kind].__struct_fields__:
        assert f"--{name.replace('_', '-')} " in out


def test_help_says_which_options_take_a_choice(rig):
    """--contacts-m of two beams takes numbers, though its text has the word both."""
    _, out, _ = rig("init", "beams", "--help")
    (line,) = (line for line in out.splitlines() if "--contacts-m" in line)
    assert "NUMBER,..." in line
    (line,) = (line for line in out.splitlines() if "--stops" in line)
    assert "both|upper|lower" in line


def test_a_rig_and_a_recording_are_drawn(rig, tmp_path):
    rig("init", "mass", *options(MASS))
    assert rig("record", "rig.json", "--plant", "modal", "--duration", 2, "--out", "r.mcap")[0] == 0
    for file in ("rig.json", "r.mcap"):
        status, _, err = rig("draw", file)
        assert (status, err) == (0, "")
    assert (tmp_path / "rig.svg").read_bytes() == (tmp_path / "r.svg").read_bytes()
    status, _, err = rig("draw", "rig.json")
    assert (status, err) == (1, "rig: rig.svg: exists already; give another name, or --force to overwrite it\n")
    assert rig("draw", "rig.json", "--out", "rig.json", "--force")[0] == 1
    (tmp_path / "bad.json").write_text("{}")
    status, _, err = rig("draw", "bad.json")
    assert status == 1
    assert "bad.json: not a rig description" in err
