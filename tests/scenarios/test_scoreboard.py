"""The scoreboard of a hand-made key and hand-made findings."""

import numpy as np
import pytest
from msgspec.structs import replace

from scenarios.score_figures import drawn
from scenarios.scoreboard import (
    Best,
    Cause,
    Closure,
    Compared,
    Diagnosis,
    Value,
    Where,
    confusion,
    parameter_errors,
    place_right,
    scored,
    wilson,
)
from scenarios.worlds.believed import believed_rig, nominal_machine
from scenarios.worlds.truth import Case, EffectTruth

NOWHERE = Where()
SENSOR = "barrel_0000mm_acceleration"


MACHINE = nominal_machine(believed_rig("own", np.random.default_rng(1)))


def effect(name, place=None, **parameters):
    return EffectTruth(name=name, parameters=parameters, place=place or {}, strength=1.0)


def case(kind, *effects):
    name = " and ".join((kind, *(e.name for e in effects)))
    machines = dict.fromkeys(("nominal", "drawn", "true"), MACHINE)
    return Case(
        case=name,
        world="own",
        kind=kind,
        effects=effects,
        expected=None,
        hung=False,
        records=(),
        draw=0,
        refused=(),
        sha256={},
        **machines,
    )


def named(*effects, probability=0.9, equivalent=(), closed=None, where=NOWHERE, **fields):
    parameters = {k.replace("__", "."): v for k, v in fields.items() if isinstance(v, Value)}
    places = {k.replace("__", "."): v for k, v in fields.items() if isinstance(v, str)}
    closure = None if closed is None else Closure(10.0, 1.0, 1.5, closed)
    return Diagnosis("effect", (Cause(effects, probability, parameters, places),), equivalent, where, closure, 10.0)


NO_GAP, NONE = Diagnosis("no_gap", cpu_s=5.0), Diagnosis("none_of_these", cpu_s=20.0)
GAIN = case("single", replace(effect("sensor_gain", {"sensor": SENSOR}, factor=1.1), strength=2.0))
MASS = case("single", effect("added_mass", {"body": "barrel"}, mass_kg=0.2, relative_position=0.5))
SHAKE = case("single", replace(effect("base_motion", low_hz=10.0, high_hz=14.0), strength=0.3))
E_WRONG = case("single", effect("youngs_modulus", {"beam": "cradle"}, factor=0.95))
PAIR = case(
    "pair",
    effect("preload", {"body": "barrel", "position_m": 0.5}, force_n=2.0, relative_position=0.5),
    effect("force_gain", factor=1.05),
)
DRAG = case("outside", effect("quadratic_drag", {"body": "barrel", "position_m": 0.9}, drag_n_s2_per_m2=4.0))
COMPARED = [
    Compared(case("null"), NO_GAP),
    Compared(case("null"), named("force_gain", probability=0.4)),
    Compared(
        GAIN,
        named(
            "sensor_gain",
            closed=0.9,
            where=Where(channels={"another": 0.1, SENSOR: 0.8}),
            sensor_gain__factor=Value(1.12, 0.005),
            sensor_gain__sensor=SENSOR,
        ),
    ),
    Compared(
        MASS,
        named(
            "added_mass",
            closed=0.8,
            added_mass__mass_kg=Value(0.21, 0.01, "kg"),
            added_mass__relative_position=Value(0.7, 0.2),
            added_mass__body="barrel",
        ),
    ),
    Compared(SHAKE, NO_GAP),
    Compared(E_WRONG, named("clamp_compliance", closed=1.0, equivalent=(("clamp_compliance", "youngs_modulus"),))),
    Compared(PAIR, named("force_gain", "preload")),
    Compared(PAIR, named("preload")),
    Compared(DRAG, NONE),
    Compared(DRAG, named("coulomb_friction")),
]
BEST = {c.truth.case: Best(10.0, 1.0, gain=5.0, needed=4.0) for c in COMPARED} | {
    SHAKE.case: Best(1.0, 1.0, gain=1.0, needed=4.0)
}


def test_every_rate_counts_what_it_says():
    board = scored(COMPARED, BEST)
    assert {r.name: (r.count, r.of) for r in board.rates} == {
        "single effect right": (3, 4),
        "single effect right, above its limit": (3, 3),
        "single effect named itself": (2, 4),
        "false alarm without effect": (1, 2),
        "outside the library rejected": (1, 2),
        "outside the library mislabelled": (1, 2),
        "both effects of a pair": (1, 2),
        "at least one effect of a pair": (2, 2),
        "place right, of those named": (1, 2),
        "faulty sensor first among channels": (1, 1),
        "parameter within its 95 % interval": (2, 3),
    }
    assert board.median_closed_fraction == pytest.approx(0.9)
    assert board.closed_cases == 3
    assert board.share_of_true_closure == pytest.approx(8.5 / 9)
    assert (board.cpu_s_median, board.cpu_s_largest) == (10.0, 20.0)
    assert board.limits["added_mass"] == pytest.approx((4 / 5) ** 0.5)
    assert board.limits["base_motion"] == pytest.approx(0.6)


def test_the_limit_is_where_the_gain_is_what_a_null_may_have():
    below = Best(1.0, 1.0, gain=1.0, needed=4.0)
    assert (below.detectable, below.limit(0.3)) == (False, pytest.approx(0.6))
    assert Best(1.0, 1.0, gain=-1.0, needed=4.0).limit(0.3) == np.inf


def test_errors_are_in_standard_errors():
    assert dict(parameter_errors(COMPARED)) == pytest.approx(
        {"sensor_gain.factor": 4.0, "added_mass.mass_kg": 1.0, "added_mass.relative_position": 1.0}
    )


@pytest.mark.parametrize(
    ("low", "high", "right"), [(10.0, 14.0, True), (9.0, 14.5, True), (12.0, 16.0, False), (20.0, 30.0, False)]
)
def test_a_band_is_right_where_it_overlaps(low, high, right):
    found = named("base_motion", base_motion__low_hz=Value(low, 0.1), base_motion__high_hz=Value(high, 0.1))
    assert place_right(Compared(SHAKE, found)) == right


def test_a_place_that_is_not_given_is_wrong():
    assert not place_right(Compared(MASS, named("added_mass", added_mass__body="barrel")))


def test_a_null_is_never_right_nor_an_outside_effect():
    for answer in (case("null"), DRAG):
        for found in (NO_GAP, NONE, named("force_gain")):
            assert not Compared(answer, found).right


def test_wilson_of_the_textbook():
    count, of, z = 8, 10, 1.959964
    share = count / of
    middle = (share + z**2 / (2 * of)) / (1 + z**2 / of)
    half = z / (1 + z**2 / of) * np.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    assert wilson(count, of) == pytest.approx((middle - half, middle + half), abs=1e-6)
    assert wilson(0, 0) == (0.0, 1.0)


def test_confusion_counts_every_case_but_pairs():
    rows, columns, counts = confusion(COMPARED)
    assert counts.sum() == 8
    assert counts[rows.index("youngs_modulus"), columns.index("clamp_compliance")] == 1
    assert counts[rows.index("quadratic_drag"), columns.index("none_of_these")] == 1
    assert counts[rows.index("null"), columns.index("no_gap")] == 1


def test_figures_are_drawn_also_of_nothing(tmp_path):
    for name, compared in (("all", COMPARED), ("one", COMPARED[:1])):
        (tmp_path / name).mkdir()
        paths = drawn(compared, BEST, tmp_path / name)
        assert [p.name for p in paths] == ["confusion.png", "power.png", "calibration.png", "parameters.png"]
        assert all(p.stat().st_size > 5000 for p in paths)
