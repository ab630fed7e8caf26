"""What a column is taken for: unknown units are asked for, and a force is never dropped."""

import numpy as np
import pytest
from msgspec import toml
from msgspec.structs import replace

from rig.lab.importing import import_file
from rig.lab.looking import proposed_import_map
from rig.model.description import ON_GROUND, Sensor, to_json
from rig.recording import read
from rig.simulation.reference import Sdof
from tests.rig.lab.looking.loggers import ACCELERATION, FORCE_N, TIME_S, rows

RIG = Sdof(sensors="acceleration").rig()
TABLE_SENSOR = Sensor(name="table", station=ON_GROUND, quantity="acceleration")
SHAKEN_RIG = replace(RIG, force_at=ON_GROUND, sensors=(TABLE_SENSOR, *RIG.sensors))
TEMPERATURE = np.resize([20.0, 20.1, 20.2], len(TIME_S))
(SENSOR,) = (sensor.name for sensor in RIG.sensors)


def proposal_of(folder, *columns, rig=RIG):
    """Map proposed for a CSV file of time and these columns, (header, values)."""
    (folder / "rig.json").write_bytes(to_json(rig))
    names, values = zip(("time [s]", TIME_S), *columns, strict=True)
    (folder / "run.csv").write_text(",".join(names) + "\n" + rows(np.column_stack(values), digits="%.12g"))
    return proposed_import_map(folder / "run.csv", rig).text


@pytest.mark.parametrize(
    ("unit", "newtons", "map_unit"),
    [
        ("lb", 4.4482216152605, "lbf"),
        ("lbs", 4.4482216152605, "lbf"),
        ("kg", 9.80665, "kgf"),
        ("kgf", 9.80665, "kgf"),
        ("daN", 10.0, "daN"),
        ("Newtons", 1.0, "N"),
        ("dyn", 1e-5, "dyn"),
    ],
)
def test_a_force_of_any_workshop_is_imported_in_newtons(tmp_path, unit, newtons, map_unit):
    text = proposal_of(tmp_path, (f"force [{unit}]", FORCE_N / newtons), (f"{SENSOR} [g's]", ACCELERATION / 9.80665))
    assert toml.decode(text.encode())["force"] == {"column": f"force [{unit}]", "unit": map_unit}
    assert ("is taken as" in text) == (unit in ("lb", "lbs", "kg"))
    (tmp_path / "map.toml").write_text(text)
    import_file(tmp_path / "run.csv", tmp_path / "map.toml", tmp_path / "r.mcap")
    recording = read(tmp_path / "r.mcap")
    np.testing.assert_allclose(recording.force_n, FORCE_N, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(recording.signals["acceleration"].values[0], ACCELERATION, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("unit", ["stone", "bar", "furlong", "V", "EU"])
def test_a_force_in_an_unknown_unit_is_asked_for(tmp_path, unit):
    text = proposal_of(tmp_path, (f"Kraft [{unit}]", FORCE_N), (f"{SENSOR} [m/s^2]", ACCELERATION))
    assert toml.decode(text.encode())["force"] == {"column": f"Kraft [{unit}]", "unit": "?", "scale": "?"}
    assert f"one {unit} is" in text
    assert "none" not in text


@pytest.mark.parametrize("unit", ["furlong", "kg", "ticks"])
def test_a_channel_in_an_unknown_unit_is_asked_for(tmp_path, unit):
    text = proposal_of(tmp_path, ("F [N]", FORCE_N), (f"channel 7 [{unit}]", ACCELERATION))
    (entry,) = toml.decode(text.encode())["sensors"].values()
    assert entry["column"] == f"channel 7 [{unit}]"
    assert (entry["unit"], entry["scale"], entry["quantity"]) == ("?", "?", "?")


@pytest.mark.parametrize("unit", ["degC", "Hz", "MPa"])
def test_what_is_another_quantity_is_left_out(tmp_path, unit):
    text = proposal_of(tmp_path, ("F [N]", FORCE_N), (f"T [{unit}]", TEMPERATURE), (f"{SENSOR} [m/s^2]", ACCELERATION))
    assert f"'T [{unit}]' (it is in {unit}, which no sensor of a rig measures)" in text


@pytest.mark.parametrize("rig", [RIG, SHAKEN_RIG], ids=["driven", "shaken"])
def test_beside_a_force_that_cannot_be_used_none_is_not_offered(tmp_path, rig):
    values = FORCE_N.copy()
    values[40] = np.nan
    text = proposal_of(tmp_path, ("F [N]", values), (f"{SENSOR} [m/s^2]", ACCELERATION), rig=rig)
    (force_line,) = (line for line in text.splitlines() if line.startswith("force ="))
    assert force_line.startswith("force = \"?\"  # column 2 'F [N]' is left out: it has no")
    assert "none" not in force_line


def test_a_force_named_so_in_the_unit_of_an_acceleration_is_asked_about(tmp_path):
    text = proposal_of(tmp_path, ("force [g]", FORCE_N), (f"{SENSOR} [m/s^2]", ACCELERATION))
    (force_line,) = (line for line in text.splitlines() if line.startswith("force ="))
    assert "column 2 'force [g]' is in g; name the column of the force" in force_line
    assert "none" not in force_line


def test_a_force_of_zero_is_a_measured_one_and_an_idle_input_beside_another_is_not(tmp_path):
    zeros = ("F [N]", np.zeros_like(TIME_S))
    assert toml.decode(proposal_of(tmp_path, zeros, (f"{SENSOR} [m/s^2]", ACCELERATION)).encode())["force"] == {
        "column": "F [N]",
        "unit": "N",
    }
    text = proposal_of(tmp_path, zeros, ("hammer [N]", FORCE_N), (f"{SENSOR} [m/s^2]", ACCELERATION))
    assert toml.decode(text.encode())["force"]["column"] == "hammer [N]"
    assert "left out: column 2 'F [N]' (it is 0 throughout)" in text


def test_the_last_part_of_a_name_says_what_a_channel_is(tmp_path):
    text = proposal_of(tmp_path, ("load test/F [V]", FORCE_N), ("load test/acc tip [V]", ACCELERATION))
    decoded = toml.decode(text.encode())
    assert decoded["force"]["column"] == "load test/F [V]"
    (entry,) = decoded["sensors"].values()
    assert (entry["column"], entry["quantity"]) == ("load test/acc tip [V]", "acceleration")
