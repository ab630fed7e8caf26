"""Every effect of the library as the worlds put it in: drawn within its range, and doing what its name says."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.effects import effect_named, effects
from tests.campaigns.worlds.believed import believed_rig, nominal_machine
from tests.campaigns.worlds.bench import BENCHES
from tests.campaigns.worlds.drawing import DRAWABLE
from tests.campaigns.worlds.forces import Gaussian
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.library import EFFECTS, UNSEEN
from tests.campaigns.worlds.machine import with_sensors
from tests.campaigns.worlds.truth import EffectTruth

RIG = believed_rig("own", np.random.default_rng(1))
MACHINE = with_sensors(nominal_machine(RIG), "all", lambda s: replace(s, noise_density=0.0))
RMS_N = 20.0


def put_in(name, place=None, **parameters):
    truth = EffectTruth(name=name, parameters=parameters, place=place or {}, strength=1.0)
    return EFFECTS[name].change(MACHINE, truth)


def record(machine, seconds=1.6, rms_n=RMS_N):
    return measured(machine, Gaussian(rms_n=rms_n, begins_s=0.1), round(seconds * 4096), 4096.0, 3)


@pytest.fixture(scope="module")
def plain():
    return record(MACHINE)


def test_the_worlds_know_every_effect_of_the_library():
    assert set(effects()) <= {*EFFECTS, *(name for bench in BENCHES.values() for name in bench.effects)}
    assert set(DRAWABLE) == set(EFFECTS) - set(UNSEEN)


@pytest.mark.parametrize("name", EFFECTS)
def test_sizes_signs_and_places_are_drawn_within_their_ranges(name):
    kind, rng = EFFECTS[name], np.random.default_rng(4)
    drawn = [kind.drawn(MACHINE, RMS_N, rng) for _ in range(60)]
    size = kind.size
    if kind.told:
        values = np.array([d.parameters[size.field] for d in drawn])
        neutral = 1.0 if size.factor else size.neutral
        away = np.exp(np.abs(np.log(values))) - 1 if size.factor else np.abs(values - neutral)
        assert size.low * size.below * (1 - 1e-9) <= away.min() < away.max() <= size.high * (1 + 1e-9)
        assert {*np.sign(values - neutral)} == {*map(float, size.signs)}
    strengths = np.array([d.strength for d in drawn])
    assert np.ptp(np.log(strengths)) > 0.5 * np.log(size.high / size.low) * (0.5 if size.factor else 1)
    if kind.at == "contact":
        everywhere = np.mean([d.place["contact"] == "all" for d in drawn])
        assert 0.15 < everywhere < 0.55
        assert {d.place["contact"] for d in drawn} == {"all", "contact_1", "contact_2"}
    if kind.at in ("body", "moving"):
        assert {d.place["body"] for d in drawn} == {"cradle", "barrel"}
    assert len({d.text for d in drawn}) == 60
    assert kind.drawn(MACHINE, RMS_N, np.random.default_rng(9)) == kind.drawn(MACHINE, RMS_N, np.random.default_rng(9))


@pytest.mark.parametrize("name", sorted(set(effects()) & set(DRAWABLE)))
def test_its_text_is_that_of_the_library(name):
    rng = np.random.default_rng(2)
    for _ in range(5):
        effect = effect_named(EFFECTS[name].drawn(MACHINE, RMS_N, rng).text)
        assert effect.name == name


@pytest.mark.parametrize("name", DRAWABLE)
def test_every_effect_changes_what_is_measured(name, plain):
    kind, rng = EFFECTS[name], np.random.default_rng(7)
    changed = record(kind.change(MACHINE, kind.drawn(MACHINE, RMS_N, rng, least=0.9)))
    assert np.isfinite(changed.delivered).all()
    rows = [np.vstack([r.force_n, r.delivered])[:, 600:] for r in (plain, changed)]
    assert np.linalg.norm(rows[1] - rows[0]) > 1e-3 * np.linalg.norm(rows[0])


def test_a_shift_of_the_contacts_that_sensors_cannot_see_moves_the_gap():
    moved = put_in("asymmetric_clearance", {"contact": "contact_1"}, shift_m=1e-3)
    assert [c.law.offset_m for c in moved.contacts] == [1e-3, 0.0]


def test_contact_effects_act_at_one_contact_or_at_all():
    one = put_in("contact_damping", {"contact": "contact_2"}, damping_n_s_per_m=7.0)
    both = put_in("contact_damping", {"contact": "all"}, damping_n_s_per_m=7.0)
    assert [c.law.damping_n_s_per_m for c in one.contacts] == [0.0, 7.0]
    assert [c.law.damping_n_s_per_m for c in both.contacts] == [7.0, 7.0]


def test_one_stop_softens_on_its_side_alone():
    law = put_in("one_stop", {"contact": "contact_1", "side": "upper"}, factor=0.5).contacts[0].law
    assert (law.stiffness_below_n_per_m, law.stiffness_above_n_per_m) == (1e5, 5e4)


def test_a_shift_shows_the_force_before_it_acts(plain):
    """The measured force of one sample ago is the true one; the motion is as it was."""
    late = record(put_in("force_shift", shift_s=1 / 4096))
    np.testing.assert_allclose(late.delivered, plain.delivered, atol=1e-9)
    np.testing.assert_allclose(late.force_n[500:-1], plain.force_n[501:], atol=1e-9)


def test_wear_grows_by_its_share_a_minute():
    law = put_in("clearance_wear", {"contact": "contact_1"}, growth_per_minute=0.2).contacts[0].law
    assert law.wear_m_per_s * 60 == pytest.approx(0.2 * 5e-3)


def test_the_overlap_moves_both_contacts_along():
    moved = put_in("contact_position", shift_m=0.02)
    assert [c.at.position_m for c in moved.contacts] == pytest.approx([0.0, 0.53])
    assert [c.against.position_m for c in moved.contacts] == pytest.approx([0.47, 1.0])


def test_a_compliant_clamp_has_the_stiffness_of_its_share():
    beam = put_in("clamp_compliance", {"beam": "cradle"}, compliance=0.05).beam("cradle")
    assert beam.clamp_n_m_per_rad == pytest.approx(20 * beam.bending_stiffness_n_m2 / beam.length_m)


def test_gains_multiply(plain):
    both = record(put_in("common_gain", factor=1.1)), record(put_in("force_gain", factor=0.8))
    np.testing.assert_allclose(both[0].delivered, 1.1 * plain.delivered, atol=1e-9)
    np.testing.assert_allclose(both[1].force_n, 0.8 * plain.force_n, atol=1e-9)
