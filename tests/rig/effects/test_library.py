"""The library as a whole: every effect is found, described, read from text, and applied without touching the rest."""

import msgspec
import numpy as np
import pytest

import rig.effects
from rig.effects import effect_named, effects
from rig.effects.base import Scale, parameters_of
from rig.errors import RigError
from rig.model.description import from_json, to_json
from rig.simulation.reference import BarrelCradle, Sdof

NAMES = sorted(effects())
REFUSED = {
    "barrel_cradle": {"support_position"},
    "sdof": {"clamp_compliance", "contact_position", "support_position", "youngs_modulus"},
}
RIGS = {"barrel_cradle": BarrelCradle().rig(), "sdof": Sdof().rig()}
WANTED = {
    "contact": "contact_clearance contact_stiffness contact_damping coulomb_friction nonlinear_contact "
    "asymmetric_clearance clearance_wear contact_position hertz_stop one_stop",
    "structure": "clamp_compliance added_mass youngs_modulus structural_damping hardening_spring linear_spring "
    "ground_damper ground_friction support_position",
    "loads": "preload base_motion tone",
    "instruments": "sensor_gain sensor_delay common_gain force_gain force_shift",
}


def test_the_library_holds_what_the_design_asks_for():
    assert set(" ".join(WANTED.values()).split()) <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_effect_says_what_it_is(name):
    kind = effects()[name]
    assert kind.__module__ == f"rig.effects.{name}"
    sentence = kind.__doc__
    assert sentence.endswith(".")
    assert "\n" not in sentence
    parameters = parameters_of(kind)
    assert parameters
    default = kind()
    for parameter in parameters:
        assert parameter.low <= getattr(default, parameter.name) <= parameter.high, parameter.name
        assert parameter.unit


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rig_name", RIGS)
def test_every_effect_changes_the_rig_or_says_why_not(name, rig_name):
    machine, effect = RIGS[rig_name], effects()[name]()
    if name in REFUSED[rig_name]:
        missing = "(beam|spring along a body); choose another place"
        with pytest.raises(RigError, match=f"effect {name}: rig '{rig_name}' has no .*{missing}"):
            effect.applied_to(machine)
        return
    changed = effect.applied_to(machine)
    assert changed != machine
    assert from_json(to_json(changed), "text") == changed
    assert [s.name for s in changed.sensors] == [s.name for s in machine.sensors]
    assert [c.name for c in changed.contacts] == [c.name for c in machine.contacts]


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_is_read_from_its_text(name):
    kind = effects()[name]
    assert effect_named(name) == kind()
    middles = {p.name: (p.low + p.high) / 2 for p in parameters_of(kind)}
    text = ",".join(f"{field}={value}" for field, value in middles.items())
    assert effect_named(f"{name}:{text}") == kind(**middles)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("wind", "no effect 'wind'; there are added_mass, asymmetric"),
        ("added_maas", "no effect 'added_maas' (did you mean 'added_mass'?); there are"),
        ("preload:weight=1", "effect preload has no parameter 'weight'; it has force_n, relative_position, body"),
        ("preload:force_n", "effect preload: 'force_n' is not PARAMETER=VALUE"),
        ("preload:force_n=much", "effect preload: force_n is text; give a number"),
        ("preload:force_n=inf", "force_n is inf; give a finite value"),
    ],
)
def test_a_text_that_asks_for_nothing_known_is_refused(text, sentence):
    with pytest.raises(RigError) as caught:
        effect_named(text)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("contact_stiffness:contact=nose", "rig 'barrel_cradle' has no contact 'nose'"),
        ("added_mass:body=nose", "has no body 'nose'"),
        ("added_mass:relative_position=1.5", "relative_position is 1.5; give 0 to 1"),
        ("youngs_modulus:beam=nose", "has no beam 'nose'"),
        ("clamp_compliance:beam=barrel", "has no clamped-free beam 'barrel'"),
        ("clamp_compliance:compliance=0", "compliance is 0.0; give a value above zero"),
        ("sensor_gain:sensor=nose", "has no sensor 'nose'"),
        ("asymmetric_clearance:shift_m=0.006", "lower_clearance_m is -0.001; give"),
        ("contact_position:shift_m=0.6", "stands at 1.05 m, off 'cradle'; give 0 to 1.0 m"),
        ("base_motion:low_hz=20", "the band 20.0 to 12.0 Hz is empty"),
        ("force_gain:factor=0", "force sensor: gain is 0.0"),
        ("hertz_stop:exponent=0.9", "exponent is 0.9; give 1 to 3"),
        ("hertz_stop:reference_force_n=0", "reference_force_n is 0.0; give a value above zero"),
        ("one_stop:side=left", "one_stop: side is 'left'; give 'lower' or 'upper'"),
        ("linear_spring:stiffness_n_per_m=-1,body=barrel", "on 'barrel' are more than what holds it"),
        ("linear_spring:stiffness_n_per_m=-3000,body=cradle", "on 'cradle' are more than what holds it"),
        ("tone:frequency_hz=0", "tone: frequency_hz is 0.0"),
    ],
)
def test_an_effect_that_the_rig_cannot_have_is_refused(text, sentence):
    with pytest.raises(RigError) as caught:
        effect_named(text).applied_to(RIGS["barrel_cradle"])
    assert sentence in str(caught.value)


def test_an_effect_acts_on_the_place_that_it_names():
    machine = RIGS["barrel_cradle"]
    stiffened = effect_named("contact_stiffness:factor=2,contact=contact_2").applied_to(machine)
    assert stiffened.contact("contact_1") == machine.contact("contact_1")
    assert (
        stiffened.contact("contact_2").law.stiffness_n_per_m == 2 * machine.contact("contact_2").law.stiffness_n_per_m
    )
    cradle = effect_named("youngs_modulus:beam=cradle").applied_to(machine)
    assert cradle.body("barrel") == machine.body("barrel")
    assert cradle.body("cradle") != machine.body("cradle")


SCALES = {"barrel_cradle": Scale(RIGS["barrel_cradle"], 14.0, 60.0), "sdof": Scale(RIGS["sdof"], 0.5, 60.0)}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rig_name", RIGS)
def test_ranges_are_stated_for_the_rig_and_hold_what_is_typical(name, rig_name):
    machine, kind = RIGS[rig_name], effects()[name]
    places = kind.placements(machine, ["cradle_1", "cradle_2"])
    if name in REFUSED[rig_name]:
        return
    assert places
    for place in places:
        scale = SCALES[rig_name].with_place(place)
        parameters, typical = kind.parameters(scale), kind.typical(scale)
        assert next(iter(parameters)).neutral is not None
        assert {field: getattr(typical, field) for field in place} == place
        for parameter in parameters:
            assert parameter.low < parameter.high
            assert parameter.low <= getattr(typical, parameter.name) <= parameter.high
            if parameter.neutral is not None and name != "clamp_compliance":  # a clamp cannot be quite stiff
                assert parameter.low <= parameter.neutral <= parameter.high
        if name == "clamp_compliance" and place["beam"] == "barrel":
            continue
        if "sensor" not in name:
            assert typical.applied_to(machine) != machine
            for sign in (0, 1):  # the ends of a range can be had
                limits = {p.name: (p.low, p.high)[sign] for p in parameters if p.neutral is not None}
                if name == "linear_spring":  # the least is that of the middle, beyond which a body may be softer
                    limits["relative_position"] = 0.5
                if name != "clamp_compliance":
                    msgspec.structs.replace(typical, **limits).applied_to(machine)


def test_a_larger_machine_has_larger_ranges():
    heavy = BarrelCradle(length_m=2.0).rig()
    for name, field in (("added_mass", "mass_kg"), ("contact_position", "shift_m")):
        kind = effects()[name]
        small, large = (kind.parameters(Scale(m, 14.0, 60.0))[field].high for m in (RIGS["barrel_cradle"], heavy))
        assert large == pytest.approx(2 * small)
    for name in ("preload", "coulomb_friction", "ground_friction"):
        low, high = (effects()[name].parameters(Scale(heavy, f, 60.0))["force_n"].high for f in (5.0, 10.0))
        assert high == pytest.approx(2 * low)


def test_contacts_are_tried_one_by_one_and_tied():
    placements = effects()["contact_stiffness"].placements
    assert [p["contact"] for p in placements(RIGS["barrel_cradle"], [])] == ["contact_1", "contact_2", None]
    assert [p["contact"] for p in placements(RIGS["sdof"], [])] == ["stop"]
    sides = effects()["one_stop"].placements(RIGS["sdof"], [])
    assert sides == [{"contact": "stop", "side": "upper"}, {"contact": "stop", "side": "lower"}]


def test_effects_add_up():
    machine = RIGS["barrel_cradle"]
    for name in ("added_mass", "preload", "hardening_spring", "coulomb_friction", "force_shift"):
        effect = effects()[name]()
        once, twice = effect.applied_to(machine), effect.applied_to(effect.applied_to(machine))
        assert twice not in (once, machine), name
    with pytest.raises(RigError, match="the base of rig 'barrel_cradle' moves already"):
        effect_named("base_motion").applied_to(effect_named("base_motion").applied_to(machine))


NEW = '''
"""A rig in which everything is painted."""

from typing import Annotated, ClassVar

from msgspec.structs import replace

from rig.effects.base import Effect
from rig.model.parameters import Parameter


class Paint(Effect, frozen=True):
    """Every body is `factor` times as dense."""

    name: ClassVar[str] = "paint"
    factor: Annotated[float, Parameter("1", 0.9, 1.2)] = 1.01

    def applied_to(self, rig):
        bodies = tuple(replace(b, density_kg_per_m3=b.density_kg_per_m3 * self.factor) for b in rig.bodies)
        return replace(rig, bodies=bodies)
'''


def test_a_new_file_is_a_new_effect(tmp_path, monkeypatch):
    (tmp_path / "paint.py").write_text(NEW)
    monkeypatch.setattr(rig.effects, "__path__", [*rig.effects.__path__, str(tmp_path)])
    assert set(effects()) == {*NAMES, "paint"}
    machine = RIGS["barrel_cradle"]
    painted = effect_named("paint:factor=1.1").applied_to(machine)
    for body, heavier in zip(machine.bodies, painted.bodies, strict=True):
        assert heavier.mass_kg == pytest.approx(1.1 * body.mass_kg)


def test_a_rig_without_effects_reads_as_before():
    text = msgspec.json.decode(to_json(RIGS["barrel_cradle"]))
    for field in ("masses", "springs", "clamps", "loads", "base_motion", "force_sensor", "dampers", "tones"):
        del text[field]
    for contact in text["contacts"]:
        for field in ("cubic_n_per_m3", "friction_n", "wear_m_per_s", "open_damping_n_s_per_m"):
            assert contact["law"].pop(field) == 0
        for field in ("lower_stiffness_ratio", "exponent"):
            assert contact["law"].pop(field) == 1
        del contact["law"]["reference_depth_m"]
    assert from_json(msgspec.json.encode(text), "text") == RIGS["barrel_cradle"]
    assert np.all([parameter.low < parameter.high for kind in effects().values() for parameter in parameters_of(kind)])
