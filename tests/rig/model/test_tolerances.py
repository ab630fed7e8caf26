"""Tolerances of a rig's description."""

import msgspec
import pytest

from rig.errors import RigError
from rig.model.description import from_json, to_json
from rig.model.tolerances import EXACT, LABORATORY, ModeTolerance, SensorTolerance, Tolerances, tolerances_named
from rig.simulation.reference import Sdof


def test_a_file_states_what_differs_from_a_laboratory(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('damping = 0.1\n[modes."barrel 3"]\nfrequency = 1e-4\n[sensors.tip]\ngain = 0.01\n')
    tolerances = tolerances_named(str(path))
    assert tolerances.damping == 0.1
    assert tolerances.position_m == LABORATORY.position_m
    assert tolerances.of_mode("barrel", 3).frequency == 1e-4
    assert tolerances.of_mode("barrel", 3).damping == 0.1
    assert tolerances.of_mode("barrel", 4) == tolerances
    assert tolerances.of_sensor("tip").gain == 0.01
    assert tolerances.of_sensor("another") == tolerances


def test_names_stand_for_tolerances():
    assert tolerances_named("laboratory") == LABORATORY
    assert tolerances_named("exact") == EXACT
    assert EXACT.of_sensor("any").gain == 0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("gain = -0.1", "gain is -0.1; give a finite standard deviation"),
        ("gain = nan", "gain is nan; give a finite standard deviation"),
        ("gian = 0.1", "has no field 'gian' .did you mean 'gain'"),
        ('[modes."barrel 3"]\ndamping = -1.0', "damping is -1.0"),
        ("gain = ", "is no file of tolerances"),
        pytest.param("gain = " + 20_000 * "[", "is no file of tolerances", id="nested"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(text, reason, tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(RigError, match=reason):
        tolerances_named(str(path))


def test_a_file_that_is_not_there_is_refused_with_what_there_is():
    with pytest.raises(RigError, match="give laboratory, exact or a TOML file"):
        tolerances_named("nowhere.toml")


def test_a_rig_carries_its_tolerances():
    tolerances = Tolerances(
        gain=0.05, modes={"mass 1": ModeTolerance(damping=0.5)}, sensors={"a": SensorTolerance(gain=0.1)}
    )
    rig = msgspec.structs.replace(Sdof().rig(), tolerances=tolerances)
    assert from_json(to_json(rig), "rig.json") == rig
    assert from_json(to_json(Sdof().rig()), "rig.json").tolerances is None
