"""Absurd sizes and numbers are refused in a sentence, at once; nothing of numpy is on the screen."""

import json

import pytest

from rig.model.description import to_json
from rig.simulation.reference import Sdof

MANY = 20_000
LIMITS = {
    *(("rms_n", value) for value in ("1e-300", "0")),
    *(("damping_ratio", value) for value in ("1e-300", "0")),
    *(("frequency_hz", value) for value in ("1e-300", "0")),
    ("mass_kg", "1e300"),
    *((each, "1e300") for each in ("added_mass:mass_kg", "clearance_wear:growth_per_minute")),
    ("contact_clearance:factor", "1e300"),
    ("clamp_compliance:compliance", "1e300"),
}
"""What has a meaning: no force, no damping, no spring, a mass that does not move, a contact that never closes, a clamp
that lets the beam turn."""


def refused(command, *words, statuses=(1,)):
    status, out, err = command(*words)
    assert status in statuses, (out, err)
    assert out == ""
    assert "Traceback" not in err
    assert "Warning" not in err
    assert len(err) < 3000
    return err


@pytest.mark.parametrize("kind", ["sensors", "bodies", "contacts"])
def test_too_many_of_a_kind_are_refused_at_once(command, tmp_path, at_most, kind):
    told = json.loads(to_json(Sdof().rig()))
    told[kind] = [told[kind][0] | {"name": f"one_{k}"} for k in range(MANY)]
    if kind == "bodies":
        told["bodies"][0]["name"] = told["force_at"]["body"]
    (tmp_path / "rig.json").write_text(json.dumps(told))
    with at_most(20):
        said = refused(command, "rig", "record", tmp_path / "rig.json", "--out", tmp_path / "r.mcap")
    assert f"has {MANY} times a" in said
    assert [path.name for path in tmp_path.iterdir()] == ["rig.json"]


@pytest.mark.parametrize("value", ["1e300", "-1e300", "1e-300", "0"])
@pytest.mark.parametrize("field", ["frequency_hz", "mass_kg", "sample_rate_hz", "high_hz", "rms_n", "damping_ratio"])
def test_a_setting_without_reason_is_refused(command, tmp_path, at_most, field, value):
    words = ("record", "sdof", "--plant", "modal", "--duration", 2, "--set", f"{field}={value}")
    with at_most(30):
        status, _, err = command("rig", *words, "--out", tmp_path / "r.mcap")
    assert "Warning" not in err
    assert "Traceback" not in err
    if (field, value) in LIMITS:
        assert (status, err) == (0, "")
    else:
        assert status == 1
        assert err.count("\n") == 1
        assert not list(tmp_path.iterdir())


def effects_with_numbers():
    from rig.effects import effects
    from rig.effects.base import parameters_of

    return [(name, parameter) for name, kind in effects().items() for parameter in parameters_of(kind).names]


@pytest.mark.parametrize("value", ["1e300", "-1e300"])
@pytest.mark.parametrize(("name", "parameter"), effects_with_numbers())
def test_an_effect_without_reason_is_refused(command, tmp_path, at_most, name, parameter, value):
    words = (
        "record",
        "barrel_cradle",
        "--plant",
        "modal",
        "--duration",
        "1.2",
        "--effect",
        f"{name}:{parameter}={value}",
    )
    with at_most(60):
        if (f"{name}:{parameter}", value) in LIMITS:
            assert command("rig", *words, "--out", tmp_path / "r.mcap")[::2] == (0, "")
        else:
            refused(command, "rig", *words, "--out", tmp_path / "r.mcap", statuses=(1, 2))
            assert not list(tmp_path.iterdir())
