"""What is drawn of a case: kinds, tolerances, believed rigs, levels; all of it by world, seed and number alone."""

from collections import Counter
from dataclasses import asdict

import numpy as np
import pytest

from rig.model.description import from_json, to_json
from rig.model.tolerances import LABORATORY
from tests.campaigns.worlds.believed import NOISE_DENSITY
from tests.campaigns.worlds.drawing import DECK, DRAWABLE, drawn_case, kind_and_names
from tests.campaigns.worlds.outside import OUTSIDE
from tests.campaigns.worlds.stated import STATED
from tests.campaigns.worlds.truth import WORLDS

MANY = 36


@pytest.fixture(scope="module", params=("own", "wide", "other"))
def drawn(request):
    return request.param, [drawn_case(request.param, 5, k) for k in range(MANY)]


def test_a_case_is_a_function_of_world_seed_and_number(drawn):
    world, cases = drawn
    for k in (0, 7, 35):
        assert drawn_case(world, 5, k) == cases[k]
    assert drawn_case(world, 6, 0).drawn != cases[0].drawn
    assert drawn_case(world, 5, 0, draw=1).drawn != cases[0].drawn
    assert drawn_case(world, 5, 0, draw=1).kind == cases[0].kind
    assert len({c.seeds for c in cases}) == MANY


def test_dampers_of_the_bench_set_in_at_other_moments():
    cases = [drawn_case("bench", 5, k) for k in range(MANY)]
    onsets_m = np.array([c.law.onset_m for case in cases for c in case.drawn.contacts])
    assert onsets_m.min() < 3e-7
    assert onsets_m.max() > 2e-5
    assert len(np.unique(onsets_m)) == len(onsets_m)


def test_worlds_differ():
    assert len({drawn_case(world, 5, 0).seeds for world in WORLDS}) == len(WORLDS)


def test_kinds_and_names_are_spread_evenly():
    of_all = [kind_and_names("wide", 3, k) for k in range(9 * len(DRAWABLE))]
    assert Counter(kind for kind, _ in of_all) == {k: DECK.count(k) * len(DRAWABLE) for k in DECK}
    for kind, names in (("single", DRAWABLE), ("outside", tuple(OUTSIDE))):
        counts = Counter(n[0] for k, n in of_all if k == kind)
        assert set(counts) == set(names)
        assert max(counts.values()) - min(counts.values()) <= 1
    pairs = [n for k, n in of_all if k == "pair"]
    assert all(a != b for a, b in pairs)
    assert {a for a, _ in pairs} == set(DRAWABLE)


def test_nulls_only_has_no_effects_and_the_same_tolerances():
    for k in range(12):
        null = drawn_case("wide", 5, k, nulls_only=True)
        assert (null.kind, null.effects, null.expected) == ("null", (), None)
        assert null.true == null.drawn == drawn_case("wide", 5, k).drawn


def test_tolerances_lie_within_what_the_world_allows(drawn):
    world, cases = drawn
    wide = world != "own"
    for case in cases:
        for beam, was in zip(case.drawn.beams, case.nominal.beams, strict=True):
            assert abs(beam.youngs_modulus_pa / was.youngs_modulus_pa - 1) <= 3e-3
            assert (len({*beam.damping_factors}) > 20) == wide
            assert all(0.75 <= f <= 1.3 for f in beam.damping_factors)
            assert all(abs(f - 1) <= 3e-3 for f in beam.frequency_factors)
            assert (beam.damping_ratio == was.damping_ratio) == wide
            assert abs(beam.damping_ratio / was.damping_ratio - 1) <= 0.2
        for sensor, was in zip(case.drawn.sensors, case.nominal.sensors, strict=True):
            assert abs(sensor.at.position_m - was.at.position_m) <= 1e-3
            assert abs(sensor.gain - 1) <= 2e-3
            assert abs(sensor.lateral_share) <= 5e-3
            assert sensor.highpass_hz == 0 if not wide else 0.05 <= sensor.highpass_hz <= 0.3
            assert 0.8 * NOISE_DENSITY <= sensor.noise_density <= 1.25 * NOISE_DENSITY
        for contact, was in zip(case.drawn.contacts, case.nominal.contacts, strict=True):
            assert abs(contact.law.lower_m / was.law.lower_m - 1) <= 0.01
            assert abs(contact.law.stiffness_above_n_per_m / was.law.stiffness_above_n_per_m - 1) <= 0.01
            assert abs(contact.law.offset_m) <= 0.0506 * was.law.lower_m
            assert (contact == was) != wide
            assert 1e-7 <= contact.law.onset_m <= 4e-5
        assert abs(case.drawn.cell.gain - 1) <= 3e-3
        assert case.drawn.cell.noise_density == 0 if not wide else 2e-4 < case.drawn.cell.noise_density < 1.1e-3
    hung = np.mean([c.hung for c in cases])
    assert hung == 0 if not wide else 0.1 < hung < 0.6


def test_a_hung_mass_is_light_and_damped():
    cases = [c for c in (drawn_case("wide", 5, k) for k in range(MANY)) if c.hung]
    for case in cases:
        mass, law = case.drawn.masses[0].mass_kg, case.drawn.links[0].law
        hertz = np.sqrt(law.spring_n_per_m / mass) / (2 * np.pi)
        assert 0.5e-3 <= mass <= 2e-3
        assert 80 <= hertz <= 400
        assert 0.05 <= law.dashpot_n_s_per_m / (2 * mass * 2 * np.pi * hertz) <= 0.3


def test_believed_rigs_are_what_the_world_says(drawn):
    world, cases = drawn
    for case in cases:
        rig = case.rig
        assert from_json(to_json(rig), "test") == rig
        counts = {*Counter(s.station.body for s in rig.sensors).values()}
        places = {s.station for s in rig.sensors}
        assert all({c.at, c.against} <= places for c in rig.contacts)
        assert rig.force_at.position_m == rig.body("barrel").length_m
        first, second = rig.contacts
        assert second.at.position_m == pytest.approx(second.against.position_m - first.against.position_m)
        if world == "other":
            assert len(counts) == 1
            assert counts <= {4, 5, 6, 7, 8}
            assert all(
                2e-3 <= c.law.clearance_m <= 7e-3 and 3e4 <= c.law.stiffness_n_per_m <= 4e5 for c in rig.contacts
            )
        else:
            assert rig == cases[0].rig
            assert counts == {6}
    assert (len({c.rig.body("cradle").thickness_m for c in cases}) == MANY) == (world == "other")
    assert (len({len(c.rig.sensors) for c in cases}) == 5) == (world == "other")


def test_levels_and_quiet_starts(drawn):
    world, cases = drawn
    for case in cases:
        fit_n, validate_n = (e.rms_n for e in case.excitations)
        assert 1.3 <= validate_n / fit_n <= 1.7
        low, high = (8, 40) if world == "other" else (12, 18 * 1.7)
        assert low <= fit_n < validate_n <= high
    quiet = {e.begins_s for c in cases for e in c.excitations}
    assert quiet == ({0.0, 1.0} if world == "other" else {1.0})


def test_machines_of_the_stated_world_are_off_by_what_the_tolerances_state():
    assert all(value == getattr(LABORATORY, name) for name, value in asdict(STATED).items())
    drawn = [drawn_case("stated", 5, k, nulls_only=True) for k in range(60)]
    gains = [sensor.gain - 1 for case in drawn for sensor in case.true.sensors]
    wider = [
        true.law.upper_m / known.law.upper_m - 1
        for case in drawn
        for true, known in zip(case.true.contacts, case.nominal.contacts, strict=True)
    ]
    assert np.std(gains) == pytest.approx(LABORATORY.gain, rel=0.15)
    assert np.std(wider) == pytest.approx(LABORATORY.clearance, rel=0.25)
    assert {case.kind for case in drawn} == {"null"}
