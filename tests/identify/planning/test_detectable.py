"""The smallest effects that a planned record would name: their scaling, what looks alike, and what is named in fact."""

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.planning import page, ranking
from identify.planning.detectable import DetectableEffect, detectable_effects, look_alike_mask
from identify.planning.planned_test import planned_test, random_forces_n, simulated_recording
from rig.effects import effect_named
from rig.model.tolerances import LABORATORY
from rig.simulation.reference import Sdof
from rig.simulation.replay import modal
from tests.identify.small_rigs import MASS_ON_TABLE

pytestmark = pytest.mark.long

RIG = Sdof(sensors="acceleration", noise_density=1e-3).rig()


def planned(tolerances=LABORATORY, duration_s=20.0):
    test = planned_test(RIG, duration_s, 0.5, None, tolerances)
    return {effect.effect: effect for effect in detectable_effects(test, modal, 1, 20.0)}


@pytest.fixture(scope="module")
def usual():
    return planned()


def test_sizes_are_ordered_and_follow_the_tolerances(usual):
    assert {"added_mass", "contact_clearance", "contact_stiffness", "force_gain"} <= set(usual)
    for effect in usual.values():
        if effect.least is not None:
            assert effect.least > 0
        if effect.greatest is not None:
            assert effect.least <= effect.size <= effect.greatest
    loose = planned(replace(LABORATORY, clearance=3 * LABORATORY.clearance))
    growth = loose["contact_clearance"].size / usual["contact_clearance"].size
    assert 2.3 < growth < 3.2  # the tolerance hides it, not the noise
    # the machine that is drawn has another clearance, and is closed for another share of the time
    assert loose["added_mass"].size == pytest.approx(usual["added_mass"].size, rel=0.1)


def test_a_longer_record_shows_less_of_what_noise_hides(usual):
    test = planned_test(RIG, 80.0, 0.5, None, LABORATORY)
    longer = {effect.effect: effect for effect in detectable_effects(test, modal, 1, 20.0)}
    for name in ("added_mass", "force_gain", "ground_damper", "linear_spring"):
        assert longer[name].size == pytest.approx(usual[name].size / 2)
    assert longer["contact_clearance"].size == pytest.approx(usual["contact_clearance"].size, rel=0.2)  # tolerances


def test_what_acts_on_one_mass_alike_is_told_to_look_alike(usual):
    """One mass feels a damper to the ground as its own damping, and friction at its stop as friction to the ground."""
    for pair in (("ground_damper", "structural_damping"), ("coulomb_friction", "ground_friction")):
        for name, other in (pair, pair[::-1]):
            assert any(alike.startswith(other) for alike in usual[name].alike)
    assert usual["contact_clearance"].alike == ()


def test_a_large_effect_does_not_look_like_what_a_small_one_looks_like():
    """r = 0.975: 1 - r^2 = 0.049 of the 36 of a small step, and of the 400 of a large one, against 2 ln 19 = 5.9; no
    effect looks like one that is never named."""
    information = np.array([[4.0, 3.9, 0.0], [3.9, 4.0, 0.0], [0.0, 0.0, 0.0]])
    mask = look_alike_mask(information, np.array([3.0, 10.0, np.inf]))
    assert mask.tolist() == [[True, True, False], [False, True, False], [False, False, False]]


def test_what_is_hidden_at_some_places_is_said_so():
    effects = (
        DetectableEffect(effect="added_mass", place="beam", unit="kg", size=0.02, least=0.01, greatest=None),
        DetectableEffect(effect="preload", place="beam", unit="N", size=None, least=None, greatest=None),
        DetectableEffect(
            effect="one_stop", place="a", unit="1", size=0.2, least=0.2, greatest=0.2, alike=("added_mass:beam",)
        ),
        DetectableEffect(effect="one_stop", place="b", unit="1", size=0.5, least=0.5, greatest=0.5, alike=("a",)),
    )
    assert list(page.effect_kind_rows(effects)) == [
        ("added mass", "10 g, at some places none"),
        ("preload", "none of its range"),
        ("one stop", "20 to 50 %"),
    ]
    assert list(page.effect_rows(effects))[2] == ("one stop", "a", "20 %", "added mass (beam)")


def test_a_plan_outlives_this_side_analysis(monkeypatch):
    def fails(*_):
        raise ZeroDivisionError("no such thing")

    monkeypatch.setattr(ranking, "detectable_effects", fails)
    report = identify.plan(RIG, duration_s=10.0, force_rms_n=0.5, most_changes=0, workers=1).report
    assert report.contacts
    assert report.effects == ()
    assert "which effects would be named could not be computed: no such thing" in report.notes


@pytest.mark.study
@pytest.mark.parametrize(("times", "named"), [(1.2, True), (0.3, False)])
def test_on_a_shaken_base_what_is_large_enough_is_named(times, named):
    test = planned_test(MASS_ON_TABLE, 20.0, None, (4.0, 40.0), LABORATORY, 2.0)
    (added,) = (effect for effect in detectable_effects(test, modal, 1, 20.0) if effect.effect == "added_mass")
    actual = effect_named(f"added_mass:mass_kg={times * added.size}").applied_to(MASS_ON_TABLE)
    gap = identify.gap(*(simulated_recording(test, actual, modal, seed) for seed in (5, 6))).report
    assert (gap.verdict == "explained") == named
    assert not named or gap.causes[0].effects == ("added_mass",)


@pytest.mark.study
@pytest.mark.parametrize(("times", "named"), [(1.2, True), (0.3, False)])
@pytest.mark.parametrize("name", ["contact_clearance", "added_mass"])
def test_what_is_large_enough_is_named(usual, name, times, named):
    strength = {"contact_clearance": "factor", "added_mass": "mass_kg"}[name]
    value = (1.0 if strength == "factor" else 0.0) + times * usual[name].size
    test = planned_test(RIG, 20.0, 0.5, None, LABORATORY)
    actual = effect_named(f"{name}:{strength}={value}").applied_to(RIG)
    gap = identify.gap(*(modal(RIG, actual, random_forces_n(test, seed), seed) for seed in (5, 6))).report
    assert (gap.causes[0].effects == (name,) and gap.causes[0].probability > 0.95 if gap.causes else False) == named
