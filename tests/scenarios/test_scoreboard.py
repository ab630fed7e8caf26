"""The scoreboard of a hand-made key and hand-made findings."""

from io import StringIO

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console

from rig.model.unmeasured_force import Value
from scenarios.score_figures import drawn
from scenarios.score_places import description_right, place_right
from scenarios.score_table import limits_told, shown
from scenarios.scoreboard import compared_cases, confusion, parameter_errors, scored, wilson
from scenarios.true_effect import Best, TrueEffect, named_now
from tests.scenarios.blind_cases import (
    BELOW,
    case,
    cause,
    compared,
    effect,
    expected,
    force,
    found,
    gap,
)

SENSOR = "barrel_0000mm_acceleration"
NO_GAP, UNKNOWN = gap("consistent", nothing=0.9), gap("unexplained", unknown=0.9)
GAIN = case("single", effect("sensor_gain", {"sensor": SENSOR}, strength=2.0, factor=1.1))
MASS = case("single", effect("added_mass", {"body": "barrel", "position_m": 0.5}, mass_kg=0.2, relative_position=0.5))
SHAKE = case("single", effect("base_motion", strength=0.3, low_hz=10.0, high_hz=14.0))
LATE = case("single", effect("actuator_lag", lag_s=5e-4))
PAIR = case(
    "pair",
    effect("preload", {"body": "barrel", "position_m": 0.5}, force_n=2.0, relative_position=0.5),
    effect("force_gain", factor=1.05),
)
DRAG = case(
    "outside",
    effect("quadratic_drag", {"body": "barrel", "position_m": 0.9}, drag_n_s2_per_m2=4.0),
    expected=expected("force", "drag", body="barrel", position_m=0.9),
)
ON_THE_BARREL = force("force", "barrel", 0.92, law="4 N s^2/m^2 |v| v", against="velocity squared")
COMPARED = [
    compared(case("null"), NO_GAP, before=0.5, cpu_s=5.0),
    compared(case("null"), gap("explained", cause("force_gain")), before=0.3),
    compared(
        GAIN,
        gap(
            "explained",
            cause("sensor_gain", sensor_gain__factor=Value(1.12, 0.005, "1"), sensor_gain__sensor=SENSOR),
        ),
        null_reference_cpu_s=40.0,
    ),
    compared(
        MASS,
        gap(
            "partly_explained",
            cause(
                "added_mass",
                explained=0.9,
                added_mass__mass_kg=Value(0.21, 0.01, "kg"),
                added_mass__relative_position=Value(0.7, 0.2, "1"),
                added_mass__body="barrel",
            ),
        ),
        null_reference_cpu_s=40.0,
    ),
    compared(SHAKE, gap("consistent", cause("base_motion")), BELOW),
    compared(LATE, gap("explained", cause("force_shift", explained=1.0, force_shift__shift_s=Value(5e-4, 1e-6, "s")))),
    compared(PAIR, gap("explained", cause("force_gain", "preload"))),
    compared(PAIR, gap("explained", cause("preload"))),
    compared(
        DRAG, gap("unexplained", unknown=0.9, force=ON_THE_BARREL), cpu_s=20.0, null_reference_cpu_s=60.0, key="another"
    ),
    compared(DRAG, gap("explained", cause("coulomb_friction")), before=1.2),
]


def test_every_rate_counts_what_it_says():
    board = scored(COMPARED)
    assert [(r.name, r.count, r.of) for r in board.rates] == [
        ("single effect right", 3, 4),
        ("single effect right, above its limit", 3, 3),
        ("single effect likeliest, by any verdict", 4, 4),
        ("single effect likeliest, above its limit", 3, 3),
        ("both of a pair", 1, 2),
        ("both of a pair, both above their limit", 1, 2),
        ("at least one of a pair", 2, 2),
        ("outside: unexplained or partly explained", 1, 2),
        ("outside: that, above its limit", 1, 1),
        ("outside: description right", 1, 2),
        ("outside: description right, above its limit", 1, 1),
        ("null: an effect named", 1, 2),
        ("null: a difference claimed", 1, 2),
        ("place right, of single effects right", 1, 2),
        ("parameter in its 95 % interval", 3, 4),
    ]
    assert all(r.interval_95 == wilson(r.count, r.of) for r in board.rates)


def test_closure_is_beside_that_of_the_truth():
    board = scored(COMPARED)
    assert board.closures == 4
    assert board.share_of_true_closure == pytest.approx((0.8 / 0.9 + 0.9 / 0.9) / 2)


def test_costs_count_a_shared_null_reference_once():
    board = scored(COMPARED)
    assert (board.cpu_s_median, board.cpu_s_largest) == (10.0, 20.0)
    assert (board.null_reference_cpu_s_median, board.null_reference_cpu_s_largest) == (50.0, 60.0)
    assert scored(COMPARED[:1]).null_reference_cpu_s_median is None


def test_a_limit_asks_for_what_matters_and_for_evidence():
    assert scored(COMPARED).limits["base_motion"] == pytest.approx(0.3 * 2)
    assert BELOW.limit(0.3) == pytest.approx(0.3 * max(np.sqrt(32 / 8), 1 / 0.5))
    assert TrueEffect(made=5.0, gain=50.0, needed=None).limit(1.0) == np.inf
    assert [
        e.above for e in (TrueEffect(5.0, 50.0, 32.0), TrueEffect(0.9, 50.0, 32.0), TrueEffect(5.0, 30.0, 32.0))
    ] == [1, 0, 0]
    assert not TrueEffect(5.0, 50.0, None).above
    assert not Best(10.0, 0.0, ()).above


def test_the_limit_outside_the_library_is_above_what_nulls_leave():
    rows = [(case("null"), found(NO_GAP), Best(before, 0.0, ())) for before in (0.2, 0.4, 3.0)]
    rows += [(DRAG, found(UNKNOWN), Best(before, 0.0, ())) for before in (1.3, 1.5)]
    assert [c.above for c in compared_cases(rows) if c.truth is DRAG] == [False, True]


def test_a_lag_is_a_shift():
    now = named_now(LATE.effects[0])
    assert (now.name, now.parameters, now.text) == ("force_shift", {"shift_s": 5e-4}, "force_shift:shift_s=0.0005")
    assert named_now(GAIN.effects[0]) is GAIN.effects[0]


def test_errors_are_in_standard_errors():
    assert dict(parameter_errors(COMPARED)) == pytest.approx(
        {
            "sensor_gain.factor": 4.0,
            "added_mass.mass_kg": 1.0,
            "added_mass.relative_position": 1.0,
            "force_shift.shift_s": 0.0,
        }
    )


@pytest.mark.parametrize(
    ("low", "high", "right"), [(10.0, 14.0, True), (9.0, 14.5, True), (12.0, 16.0, False), (20.0, 30.0, False)]
)
def test_a_band_is_right_where_it_overlaps(low, high, right):
    one = cause("base_motion", base_motion__low_hz=Value(low, 0.1, "Hz"), base_motion__high_hz=Value(high, 0.1, "Hz"))
    assert place_right(SHAKE.effects[0], one) == right


@pytest.mark.parametrize(("share", "right"), [(0.54, True), (0.56, False)])
def test_a_place_is_right_within_5_cm(share, right):
    one = cause("added_mass", added_mass__body="barrel", added_mass__relative_position=Value(share, 0.01, "1"))
    assert place_right(MASS.effects[0], one) == right


def test_a_place_that_is_not_given_is_wrong():
    assert not place_right(MASS.effects[0], cause("added_mass", added_mass__body="barrel"))


def of_law(name, **parameters):
    """The force on the barrel by another law; units do not count."""
    numbers = {key: Value(value, 0.0, "") for key, value in parameters.items()}
    return replace(ON_THE_BARREL, against="displacement", law_name=name, law_parameters=numbers)


SWINGING = force("contact", contact="contact_1", frequency_hz=2.1, law="0.1 mm at 2.1 Hz")


@pytest.mark.parametrize(
    ("true", "described", "right"),
    [
        (("force", "drag", "barrel", 0.9), ON_THE_BARREL, True),
        (("force", "drag", "barrel", 0.8), ON_THE_BARREL, False),
        (("force", "drag", "cradle", 0.9), ON_THE_BARREL, False),
        (("force", "stop", "barrel", 0.9), ON_THE_BARREL, False),
        (("force", "drag", "barrel", 0.9), of_law("power of the velocity", p=1.9), True),
        (("force", "drag", "barrel", 0.9), of_law("power of the velocity", p=0.9), False),
        (("force", "softening", "barrel", 0.9), of_law("softening spring", w0=1e-3), True),
        (("force", "softening", "barrel", 0.9), of_law("cubic spring", cubic=-3e6), True),
        (("force", "softening", "barrel", 0.9), of_law("cubic spring", cubic=3e6), False),
        (("force", "stop", "barrel", 0.9), replace(ON_THE_BARREL, against="clearance"), True),
        (("force", "rattle", "barrel", 0.9), force("force", "barrel", 0.9), True),
        (("force", "rattle", "barrel", 0.9), ON_THE_BARREL, False),
        (("sensor", "resonance", SENSOR, 130.0), force("sensor", sensor=SENSOR), True),
        (("sensor", "resonance", SENSOR, 130.0), force("sensor", sensor="another"), False),
        (("sensor", "resonance", SENSOR, 130.0), force("sensor", sensor=SENSOR, frequency_hz=130.1), True),
        (("sensor", "resonance", SENSOR, 130.0), force("sensor", sensor=SENSOR, frequency_hz=130.3), False),
        (("distributed", "drift", "cradle", None), force("distributed"), True),
        (("distributed", "drift", "cradle", None), SWINGING, False),
        (("contact pair", "modulated clearance", "contact_1", 2.0), SWINGING, True),
        (("contact pair", "modulated clearance", "contact_1", 3.0), SWINGING, False),
        (("contact pair", "modulated clearance", "contact_2", 2.0), SWINGING, False),
        (("contact pair", "modulated clearance", "contact_1", 2.0), replace(SWINGING, frequency_hz=None), False),
        (("distributed", "drift", "cradle", None), None, False),
    ],
)
def test_a_description_says_where_and_by_what_law(true, described, right):
    where, law, place, number = true
    fields = {
        "force": {"body": place, "position_m": number},
        "sensor": {"sensor": place, "frequency_hz": number},
        "distributed": {"body": place},
        "contact pair": {"contact": place, "frequency_hz": number},
    }[where]
    assert description_right(expected(where, law, **fields), described) == right


def test_a_null_is_never_right_nor_an_outside_effect():
    for answer in (case("null"), DRAG):
        for one in (NO_GAP, UNKNOWN, gap("explained", cause("force_gain")), gap("explained", cause("quadratic_drag"))):
            assert not compared(answer, one).right


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
    assert counts[rows.index("quadratic_drag"), columns.index("unexplained")] == 1
    assert counts[rows.index("null"), columns.index("consistent")] == 1
    assert counts[rows.index("force_shift"), columns.index("force_shift")] == 1
    assert counts[rows.index("base_motion"), columns.index("consistent")] == 1


def test_the_table_has_a_column_a_world():
    board = scored(COMPARED)
    console = Console(width=200, file=StringIO())
    console.print(shown({"own": board, "all": scored(COMPARED[:2])}, "blind"))
    text = console.file.getvalue()
    assert "own, 10 cases" in text
    assert "3 of 4, 75 % (30 to 95)" in text
    assert "base_motion 0.6" in limits_told(board)


def test_figures_are_drawn_also_of_nothing(tmp_path):
    for name, some in (("all", COMPARED), ("one", COMPARED[:1])):
        (tmp_path / name).mkdir()
        paths = drawn(some, tmp_path / name)
        assert [p.name for p in paths] == ["confusion.png", "power.png", "calibration.png", "parameters.png"]
        assert all(p.stat().st_size > 5000 for p in paths)
