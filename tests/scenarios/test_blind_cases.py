"""Blind cases: balanced, repeatable, and each as its answer says."""

from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rig.description import to_json
from rig.effect import parameters_of
from rig.effects import effect_named, effects
from rig.errors import RigError
from rig.recording import read, truth_path
from scenarios import blind_cases
from scenarios.blind_cases import BELIEVED, Planned, drawn_of, effect_drawn, made, planned, reality, usable_effects
from scenarios.outside import OUTSIDE, described


def plans(folder="somewhere", cases=100, seed=1):
    return planned(cases, seed, Path(folder), 30.0, 2.0**-13, 16)


def short(folder, kind="null", names=()):
    for name in ("recordings", "sealed/work"):
        (folder / name).mkdir(parents=True)
    return Planned(str(folder), "case_000", (5, 0), kind, names, 1.2, 2.0**-13, 8)


def test_plans_are_balanced_and_shuffled():
    cases = plans()
    assert Counter(c.kind for c in cases) == {"null": 22, "outside": 22, "pair": 22, "single": 34}
    for kind, names in (("single", usable_effects()), ("outside", tuple(OUTSIDE)), ("pair", usable_effects())):
        counts = Counter(name for c in cases if c.kind == kind for name in c.names)
        assert set(counts) == set(names)
        assert max(counts.values()) - min(counts.values()) <= 1
    assert all(c.names[0] != c.names[1] for c in cases if c.kind == "pair")
    kinds = [c.kind for c in cases]
    changes = sum(a != b for a, b in pairwise(kinds))
    assert changes > 50  # sorted kinds would change three times


def test_a_seed_draws_the_same_and_another_does_not():
    assert plans() == plans()
    assert [c.kind for c in plans()] != [c.kind for c in plans(seed=2)]
    for plan in plans()[:10]:
        assert drawn_of(plan, 0) == drawn_of(plan, 0)
        assert drawn_of(plan, 0).jitter_seed != drawn_of(plan, 1).jitter_seed
        assert to_json(reality(drawn_of(plan, 0))) == to_json(reality(drawn_of(plan, 0)))


def test_levels_of_the_force_differ_as_asked():
    for plan in plans():
        drawn = drawn_of(plan, 0)
        fit_n, validate_n = drawn.rms_n
        assert 12 <= fit_n <= 18
        assert 1.3 <= validate_n / fit_n <= 1.7
        assert len(set(drawn.force_seeds)) == 2


@pytest.mark.parametrize("name", usable_effects())
def test_magnitudes_follow_from_the_strength(name):
    kind, rig = effects()[name], BELIEVED.rig()
    rng = np.random.default_rng(4)
    for _ in range(40):
        effect, strength = effect_drawn(name, rig, (0.25, 2.5), rng)
        assert 0.25 <= strength <= 2.5 + 1e-12
        for field, parameter in parameters_of(kind).items():
            value = getattr(effect, field)
            assert parameter.low <= value <= parameter.high
            if parameter.neutral is not None:
                span = getattr(kind(), field) - parameter.neutral
                assert abs(value - parameter.neutral) == pytest.approx(strength * abs(span))
        assert effect_named(described(effect, name)) == effect
        effect.applied_to(rig)


def test_signs_and_places_vary():
    rng = np.random.default_rng(4)
    gains = [effect_drawn("sensor_gain", BELIEVED.rig(), (0.25, 2.5), rng)[0] for _ in range(60)]
    assert {g.factor > 1 for g in gains} == {True, False}
    assert len({g.sensor for g in gains}) == len(BELIEVED.rig().sensors)


def test_a_case_leaves_two_recordings_and_no_truth(tmp_path):
    case = made(short(tmp_path, "single", ("preload",)))
    assert effect_named(case.effects[0]).name == "preload"
    assert sorted(p.name for p in tmp_path.rglob("*.*")) == ["case_000.mcap", "case_000_validate.mcap"]
    fit, validate = (read(tmp_path / "recordings" / name) for name in sorted(case.sha256))
    assert fit.rig == validate.rig == BELIEVED.rig()
    assert fit.provenance["plant"] == "ancf"
    assert np.std(validate.force_n) > 1.2 * np.std(fit.force_n)
    assert not truth_path(tmp_path / "recordings" / "case_000.mcap").exists()
    assert made(short(tmp_path / "again", "single", ("preload",))).sha256 == case.sha256


def test_a_draw_that_cannot_be_simulated_is_drawn_again(tmp_path, monkeypatch):
    calls = []

    def failing(*_, **__):
        calls.append(1)
        if len(calls) < 3:
            raise RigError("diverged")

    monkeypatch.setattr(blind_cases, "record", failing)
    monkeypatch.setattr(blind_cases, "sha256_of", lambda path: path.name)
    monkeypatch.setattr(Path, "replace", lambda *_: None)
    case = made(short(tmp_path, "single", ("force_gain",)))
    assert case.draw == 2
    assert [r.rpartition(": ")[2] for r in case.refused] == ["diverged", "diverged"]
    assert case.effects == tuple(
        described(e, e.name) for e in drawn_of(short(tmp_path / "x", "single", ("force_gain",)), 2).effects
    )


def test_a_case_that_never_runs_is_one_clear_sentence(tmp_path, monkeypatch):
    def failing(*_, **__):
        raise RigError("diverged")

    monkeypatch.setattr(blind_cases, "record", failing)
    with pytest.raises(RigError, match=r"case_000: none of 20 draws could be simulated, the last: .*diverged"):
        made(short(tmp_path))
