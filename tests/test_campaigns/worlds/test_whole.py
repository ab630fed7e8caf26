"""The whole deviation: what is true over what is believed, effect and tolerance together, by hand."""

import numpy as np
import pytest
from msgspec.structs import replace

from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.bench import BENCHES
from tests.campaigns.worlds.drawing import drawn_case, kind_and_names
from tests.campaigns.worlds.library import EFFECTS
from tests.campaigns.worlds.machine import with_bodies, with_laws, with_sensors
from tests.campaigns.worlds.truth import EffectTruth
from tests.campaigns.worlds.whole import WHOLES, reached_m, secant_n_per_m, with_wholes

NOMINAL = nominal_machine(believed_rig("own", np.random.default_rng(1)))


def truth(name, place=None, **parameters):
    return EffectTruth(name=name, parameters=parameters, place=place or {}, strength=1.0)


def whole(built, *effects, nominal=NOMINAL):
    """Of every effect put into a machine that differs by tolerances already."""
    true = built
    for effect in effects:
        true = EFFECTS[effect.name].change(true, effect)
    return [e.whole for e in with_wholes(effects, nominal, true)]


def test_a_clearance_is_that_of_tolerance_times_effect():
    built = with_laws(
        NOMINAL, "contact_1", lambda law: replace(law, lower_m=law.lower_m * 1.01, upper_m=law.upper_m * 1.01)
    )
    wider = truth("contact_clearance", {"contact": "contact_1"}, factor=1.05)
    assert whole(built, wider) == [{"factor": pytest.approx(1.01 * 1.05)}]
    assert wider.parameters == {"factor": 1.05}


def test_at_all_contacts_it_is_their_mean():
    built = with_laws(
        NOMINAL, "contact_1", lambda law: replace(law, lower_m=law.lower_m * 1.02, upper_m=law.upper_m * 1.02)
    )
    found = whole(built, truth("contact_clearance", {"contact": "all"}, factor=1.1))
    assert found == [{"factor": pytest.approx(1.1 * np.sqrt(1.02))}]


def test_of_a_single_stop_its_zero_counts():
    one_sided = with_laws(NOMINAL, "all", lambda law: replace(law, lower_m=1.0))
    law = replace(one_sided.contacts[0].law, offset_m=1e-4)
    assert reached_m(law) == pytest.approx(5.1e-3)
    assert reached_m(replace(law, lower_m=5e-3)) == pytest.approx(5e-3)


def test_a_stiffness_beside_a_power_law_is_the_secant_where_the_law_is_named():
    """f = k d (depth / d)^n: at the reference force R = k d the secant is k."""
    law = NOMINAL.contacts[0].law
    bent = replace(law, exponent=1.5, reference_depth_m=2e-4)
    reference_n = law.stiffness_above_n_per_m * 2e-4
    assert secant_n_per_m(bent, True, reference_n) == pytest.approx(law.stiffness_above_n_per_m)
    depth_m = 2e-4 * 4 ** (1 / 1.5)
    assert secant_n_per_m(bent, True, 4 * reference_n) == pytest.approx(4 * reference_n / depth_m)
    hertz = truth("hertz_stop", {"contact": "contact_1"}, exponent=1.5, reference_force_n=20.0)
    stiffer = truth("contact_stiffness", {"contact": "contact_1"}, factor=1.3)
    exponents, factors = whole(NOMINAL, stiffer, hertz)[::-1]
    assert exponents["exponent"] == 1.5
    assert factors["factor"] == pytest.approx(1.3)


def test_one_stop_beside_a_stiffness_is_against_the_other():
    stiffer = truth("contact_stiffness", {"contact": "contact_1"}, factor=1.2)
    upper = truth("one_stop", {"contact": "contact_1", "side": "upper"}, factor=1.5)
    assert [w["factor"] for w in whole(NOMINAL, stiffer, upper)] == pytest.approx([1.2, 1.5])
    assert whole(NOMINAL, upper)[0]["factor"] == pytest.approx(1.5)


def test_gains_and_delays_are_those_of_the_channel():
    name = NOMINAL.sensors[3].name
    built = with_sensors(NOMINAL, name, lambda s: replace(s, gain=1.002, delay_s=1e-5))
    built = replace(built, cell=replace(built.cell, gain=0.998))
    effects = [
        truth("sensor_gain", {"sensor": name}, factor=1.05),
        truth("sensor_delay", {"sensor": name}, delay_s=2e-4),
        truth("force_gain", factor=1.1),
        truth("force_shift", shift_s=3e-4),
    ]
    gain, delay, force, shift = whole(built, *effects)
    assert (gain["factor"], delay["delay_s"]) == pytest.approx((1.002 * 1.05, 2.1e-4))
    assert (force["factor"], shift["shift_s"]) == pytest.approx((0.998 * 1.1, 3e-4))


def test_a_modulus_and_damping_are_those_of_the_beam():
    built = with_bodies(NOMINAL, "cradle", lambda b: replace(b, youngs_modulus_pa=b.youngs_modulus_pa * 0.998))
    built = with_bodies(built, "cradle", lambda b: replace(b, damping_factors=(1.2, *b.damping_factors[1:])))
    softer = truth("youngs_modulus", {"beam": "cradle"}, factor=0.95)
    damped = truth("structural_damping", {"body": "cradle"}, factor=2.0)
    modulus, damping = whole(built, softer, damped)
    assert modulus["factor"] == pytest.approx(0.998 * 0.95)
    assert damping["factor"] == pytest.approx(2.0 * 1.2 ** (1 / 3))  # of the modes at 8, 52 and 147 Hz


def test_of_a_single_mass_the_spring_and_mass_are_what_it_has_more_than_believed():
    nominal = BENCHES["mass_decay"].drawn(np.random.default_rng(1), np.random.default_rng(2)).nominal
    (body,) = nominal.lumped
    built = with_bodies(nominal, "mass", lambda b: replace(b, masses_kg=(1.002 * b.masses_kg[0],)))
    heavier = truth("added_mass", {"body": "mass", "position_m": 0.0}, mass_kg=0.1)
    held = truth("linear_spring", {"body": "mass", "position_m": 0.0}, stiffness_n_per_m=100.0)
    mass, spring = whole(built, heavier, held, nominal=nominal)
    assert mass["mass_kg"] == pytest.approx(0.1 + 0.002 * body.masses_kg[0])
    assert spring["stiffness_n_per_m"] == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("world", ["own", "wide", "other", "counted", "bench"])
def test_every_effect_of_every_world_has_its_whole_deviation(world):
    for number in range(12):
        case = drawn_case(world, 6, number)
        for effect in case.effects:
            assert {*effect.whole} == {*effect.parameters}
            if effect.name not in WHOLES:
                assert effect.whole == effect.parameters
            elif "factor" in effect.whole and effect.name not in ("structural_damping", "one_stop"):
                assert (
                    effect.whole["factor"] == pytest.approx(effect.parameters["factor"], rel=0.03)
                    or len(case.effects) > 1
                )


def test_counted_cases_have_cables_and_several_effects():
    cases = [drawn_case("counted", 6, k) for k in range(16)]
    assert sum(c.kind == "null" for c in cases) == 4
    for case in cases:
        cables = [e for e in case.effects if e.uncounted]
        assert sorted(e.place["body"] for e in cables) == ["barrel"] * 2 + ["cradle"] * 2
        assert all(3e-3 <= e.parameters["mass_kg"] <= 12e-3 for e in cables)
        for cable in cables:
            there = case.true.beam(str(cable.place["body"])).masses
            assert (cable.place["position_m"], cable.parameters["mass_kg"]) in there
        assert not any(b.masses for b in case.nominal.beams)
        assert len(case.effects) - 4 == len(kind_and_names("counted", 6, cases.index(case))[1])
        assert all(max(map(abs, s.crosstalk)) <= 5e-3 and any(s.crosstalk) for s in case.drawn.sensors)
    assert {len(c.effects) - 4 for c in cases} == {0, 2, 3, 4}
    repeated = [drawn_case("counted", 6, k).effects for k in range(60)]
    twice = [e for e in repeated if len({x.name for x in e if not x.uncounted}) < sum(not x.uncounted for x in e)]
    assert len(twice) > 5
