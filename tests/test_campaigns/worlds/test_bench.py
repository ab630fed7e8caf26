"""The world "bench": machines that a rig.json describes, moved as far as asked, and effects that suit them."""

from collections import Counter

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from rig.effects import effect_named, effects
from rig.model.beam import Beam
from rig.model.description import check_shapes_known, from_json, to_json
from rig.model.modes import modes_of as believed_modes
from rig.model.oscillator import Oscillator
from rig.recording import read
from tests.campaigns.worlds.bench import BENCHES, response_of
from tests.campaigns.worlds.describing import described
from tests.campaigns.worlds.drawing import bench_name, drawn_case, kind_and_names
from tests.campaigns.worlds.forces import Blows, Gaussian, Release
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.making import made, planned, write
from tests.campaigns.worlds.simulator import model_of

RNG_SEEDS = (3, 4)


def bench(name):
    return BENCHES[name].drawn(*(np.random.default_rng(s) for s in RNG_SEEDS))


@pytest.mark.parametrize("name", BENCHES)
def test_a_rig_json_describes_the_machine(name):
    """It survives its file, has every place, and its own modes are those of the machine."""
    one = bench(name)
    rig = described(one.nominal, one.name, one.sample_rate_hz)
    assert from_json(to_json(rig), "test") == rig
    check_shapes_known(rig, "test")
    believed = [believed_modes(rig, body).frequencies_hz(min(body.max_modes, 5)) for body in rig.bodies]
    model = model_of(one.nominal)
    own = np.sort(model.omega)[: sum(len(f) for f in believed)] / (2 * np.pi)
    if len(believed) == 1 or len(own) == len(model.omega):
        np.testing.assert_allclose(np.sort(np.concatenate(believed)), own, rtol=2e-4)
    for body in rig.bodies:
        assert isinstance(body, (Beam, Oscillator)) or body.max_modes in (3, 4)


@pytest.mark.parametrize("name", BENCHES)
def test_every_effect_that_it_may_have_changes_it_and_is_one_of_the_library(name):
    one, rng = bench(name), np.random.default_rng(5)
    rig = described(one.nominal, one.name, one.sample_rate_hz)
    for known in (*BENCHES[name].effects, *BENCHES[name].outside):
        kind = one.kinds[known]
        truth = kind.drawn(one.nominal, one.excitations[0].level_n, rng)
        assert kind.change(one.nominal, truth) != one.nominal
        assert (known in effects()) == kind.library
        if kind.library:
            assert effect_named(truth.text).applied_to(rig) != rig
        else:
            assert kind.stand_ins or known in ("quadratic_drag", "softening_support")


@pytest.mark.parametrize("name", BENCHES)
def test_sizes_and_noise_are_those_of_the_force(name):
    """By the level of the record: noise far below it, friction from a little of it to about as much."""
    for seed in range(5):
        one = BENCHES[name].drawn(np.random.default_rng(seed), np.random.default_rng(seed + 100))
        level_n, density = one.excitations[0].level_n, one.nominal.cell.noise_density
        assert density * np.sqrt(one.sample_rate_hz / 2) < 1e-3 * level_n
        assert (density > 0) == one.excitations[0].measured
        size = one.kinds["ground_friction"].size
        assert 1e-5 * level_n < size.low < size.high < level_n


def test_a_gaussian_force_moves_the_linear_machine_as_far_as_computed():
    one = bench("chain")
    free = replace(one.nominal, contacts=())
    response = response_of(free, (0.5, 40.0))
    force = Gaussian(rms_n=2.0, begins_s=0.0, band_hz=(0.5, 40.0))
    quiet = replace(free, sensors=tuple(replace(s, quantity="displacement", noise_density=0.0) for s in free.sensors))
    moved = measured(quiet, force, 60 * 512, 512.0, 3).delivered[0, 5 * 512 :]
    assert np.std(moved) == pytest.approx(2.0 * response.rms_m, rel=0.15)


def test_decays_are_not_measured_and_hits_are():
    for name, known in BENCHES.items():
        first, second = bench(name).excitations
        assert isinstance(first, {"gaussian": Gaussian, "hits": Blows, "decay": (Blows, Release)}[known.excited])
        assert first.measured == second.measured == (known.excited != "decay")
        if isinstance(first, type(second)) and known.excited != "hits":
            assert 1.2 < second.level_n / first.level_n < 6


def test_a_case_is_a_function_of_world_seed_and_number():
    for number in (0, 5, 11):
        assert drawn_case("bench", 4, number) == drawn_case("bench", 4, number)
        assert drawn_case("bench", 4, number).machine == bench_name(4, number)
    assert drawn_case("bench", 5, 0).drawn != drawn_case("bench", 4, 0).drawn
    again = drawn_case("bench", 4, 5, draw=1)
    assert (again.kind, again.machine) == (drawn_case("bench", 4, 5).kind, bench_name(4, 5))
    assert again.drawn != drawn_case("bench", 4, 5).drawn


def test_kinds_and_machines_are_spread_evenly():
    cases = [kind_and_names("bench", 1, k) for k in range(12 * 16)]
    assert Counter(kind for kind, _ in cases) == {"null": 48, "single": 64, "pair": 48, "outside": 32}
    assert set(Counter(bench_name(1, k) for k in range(12 * 16)).values()) == {12}
    for number, (kind, names) in enumerate(cases):
        known = BENCHES[bench_name(1, number)]
        assert {*names} <= {*(known.outside if kind == "outside" else known.effects)}
        assert len({*names}) == {"null": 0, "single": 1, "pair": 2, "outside": 1}[kind]


def test_tolerances_keep_the_shapes_of_masses_in_a_row():
    for number in range(40):
        case = drawn_case("bench", 4, number, nulls_only=True)
        assert case.true == case.drawn
        for body, was in zip(case.drawn.lumped, case.nominal.lumped, strict=True):
            ratios = np.array(body.masses_kg) / was.masses_kg
            assert np.ptp(ratios) < 1e-12
            assert 0 < abs(ratios[0] - 1) <= 2e-3
            assert all(0.8 <= f <= 1.25 for f in body.damping_factors)
        for contact, was in zip(case.drawn.contacts, case.nominal.contacts, strict=True):
            assert 0 < abs(contact.law.upper_m / was.law.upper_m - 1) <= 7e-3
            assert contact.law.offset_m == 0.0


def sound(name, tmp_path, seconds=30.0):
    """What the check says of a null record of this machine."""
    number = next(k for k in range(16) if bench_name(4, k) == name)
    case = drawn_case("bench", 4, number, nulls_only=True)
    rate_hz = case.rig.sample_rate_hz
    record = measured(case.true, case.excitations[0], round(seconds * rate_hz), rate_hz, case.seeds[0])
    write(tmp_path / "null.mcap", case.rig, record)
    back = read(tmp_path / "null.mcap")
    assert back.rig == case.rig
    np.testing.assert_allclose(back.force_n, record.force_n, atol=1e-6 * np.abs(record.force_n).max() + 1e-12)
    return identify.check(tmp_path / "null.mcap").findings


@pytest.mark.parametrize("name", ["carriage", "two_masses", "frame", "frame_hit", "shaken_mass"])
def test_a_null_record_is_sound(name, tmp_path):
    assert sound(name, tmp_path) == ()


def test_two_recordings_of_a_case_are_read_back(tmp_path):
    for name in ("recordings", "sealed/work"):
        (tmp_path / name).mkdir(parents=True)
    plan = planned(tmp_path, "bench", 1, 10, 2.0)[9]
    case = made(plan)
    assert case.machine == bench_name(1, 9)
    for told in case.records:
        recording = read(tmp_path / "recordings" / told.file)
        assert recording.samples == round(2.0 * recording.rig.sample_rate_hz)
        assert {*recording.signals} == {"force", *(s.quantity for s in recording.rig.sensors)}
        assert told.excitation.measured == bool(recording.force_n.any())
