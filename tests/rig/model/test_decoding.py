"""What is said of a description that does not fit its type: the place, what is allowed, the nearest name."""

import msgspec
import pytest

from rig.effects import effect_named
from rig.errors import RigError
from rig.model.description import from_json, to_json
from rig.simulation.reference import BarrelCradle


def refusal_of(place, changes):
    """What is said of the barrel-cradle's rig.json with values of the object at a place changed, or taken out."""
    rig = msgspec.json.decode(to_json(BarrelCradle().rig()))
    target = rig
    for key in place:
        target = target[key]
    for key, value in changes.items():
        if value is ...:
            del target[key]
        else:
            target[key] = value
    with pytest.raises(RigError) as caught:
        from_json(msgspec.json.encode(rig), "rig.json")
    return str(caught.value).removeprefix("rig.json: not a rig description: ")


@pytest.mark.parametrize(
    ("place", "changes", "said"),
    [
        (["bodies", 0], {"ends": "cantilever"}, "bodies[0].ends is 'cantilever' (did you mean 'clamped-free'?); give "),
        (["bodies", 0], {"ends": "clamped"}, "(did you mean 'clamped-free'?); give 'clamped-free' or 'free-free'"),
        (["bodies", 0], {"ends": "free-fre"}, "(did you mean 'free-free'?)"),
        (["bodies", 1], {"type": "bean"}, "bodies[1].type is 'bean' (did you mean 'beam'?); give 'beam' or "),
        (["bodies", 1], {"type": ...}, "bodies[1] lacks 'type'; give 'beam' or 'oscillator' or 'structure'"),
        (["bodies", 1], {"lenght_m": 1.0}, "the beam bodies[1] has no field 'lenght_m' (did you mean 'length_m'?); it"),
        (
            ["contacts", 0, "law"],
            {"stiffnes": 1.0},
            "(did you mean 'stiffness_n_per_m'?); it has type, lower_clearance",
        ),
        (["contacts", 0, "law"], {"stiffness_n_per_m": ...}, "law lacks 'stiffness_n_per_m'; it needs lower_clearance"),
        (["sensors", 2], {"quantity": "Accelerometer"}, "sensors[2].quantity is 'Accelerometer' (did you mean 'accel"),
        (["sensors", 2, "station"], {"body": 3}, "sensors[2].station.body is a whole number; give text"),
        ([], {"force_at": [{"body": "barrel", "position": 1.0}] * 2}, "force_at[0] has no field 'position' (did you"),
        ([], {"tolerances": {"sensors": {"a": {"gains": 1.0}}}}, "tolerances.sensors has no field 'gains' (did you"),
        ([], {"samplerate_hz": 1.0}, "it has no field 'samplerate_hz' (did you mean 'sample_rate_hz'?); it has name, "),
        (["sensors", 2], {"gain": 0.0}, "gain is 0.0; give a finite value other than zero (at sensors[2])"),
    ],
)
def test_the_place_what_is_allowed_and_the_nearest_name_are_said(place, changes, said):
    sentence = refusal_of(place, changes)
    assert said in sentence
    assert "README" not in sentence


def test_an_effects_wrong_word_is_met_by_those_that_it_knows():
    with pytest.raises(RigError, match=r"side is 'uper' \(did you mean 'upper'\?\); give 'lower' or 'upper'"):
        effect_named("one_stop:side=uper")
