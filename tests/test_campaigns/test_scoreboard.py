"""The scoreboard of a hand-made key and hand-made findings."""

from io import StringIO

import numpy as np
import pytest
from msgspec.structs import replace
from rich.console import Console
from scipy.stats import poisson

from identify.gaps.decision_table import Verdict
from rig.model.unmeasured_force import Value
from tests.campaigns.calibration import calibrated
from tests.campaigns.score_figures import drawn
from tests.campaigns.score_names import classes_of, named_classes
from tests.campaigns.score_places import description_right
from tests.campaigns.score_table import calibration_told, limits_told, shown
from tests.campaigns.scoreboard import ROWS, compared_cases, scored, wilson
from tests.campaigns.true_effect import Best, TrueEffect
from tests.test_campaigns.blind_cases import ABOVE, BELOW, case, cause, compared, effect, expected, force, found, gap

SENSOR = "barrel_0000mm_acceleration"
QUIET, UNEXPLAINED = gap("consistent", nothing=0.9), gap("unexplained", unknown=0.9)
GAIN = case("single", effect("sensor_gain", {"sensor": SENSOR}, strength=2.0, factor=1.1))
MASS = case("single", effect("added_mass", {"body": "barrel", "position_m": 0.5}, mass_kg=0.2, relative_position=0.5))
SHAKE = case("single", effect("base_motion", strength=0.3, low_hz=10.0, high_hz=14.0))
PAIR = case(
    "pair",
    effect("preload", {"body": "barrel", "position_m": 0.5}, force_n=2.0, relative_position=0.5),
    effect("force_gain", factor=1.05),
)
CABLE = effect("added_mass", {"body": "barrel", "position_m": 0.3}, uncounted=True, mass_kg=0.01, relative_position=0.3)
DRAG = case(
    "outside",
    effect("quadratic_drag", {"body": "barrel", "position_m": 0.9}, drag_n_s2_per_m2=4.0),
    expected=expected("force", "drag", body="barrel", position_m=0.9),
)
ON_THE_BARREL = force("force", "barrel", 0.92, law="4 N s^2/m^2 |v| v", against="velocity squared")


def a_mass(kg, at, label="added_mass", error=0.01):
    return {
        f"{label}__mass_kg": Value(kg, error, "kg"),
        f"{label}__relative_position": Value(at, 0.01, "1"),
        f"{label}__body": "barrel",
    }


def a_gain(factor, included=0.99):
    fields = {"sensor_gain__factor": Value(factor, 0.005, "1"), "sensor_gain__sensor": SENSOR}
    return cause("sensor_gain", included=included, **fields)


PRELOAD = {
    "preload__force_n": Value(2.1, 0.1, "N"),
    "preload__relative_position": Value(0.51, 0.02, "1"),
    "preload__body": "barrel",
}
COMPARED = [
    compared(case("null"), QUIET, before=0.5, cpu_s=5.0),
    compared(case("null"), gap("explained", cause("force_gain")), before=0.3),
    compared(GAIN, gap("explained", a_gain(1.12)), null_references_cpu_s={"a": 40.0, "b": 60.0}),
    compared(MASS, gap("partly_explained", cause("added_mass", **a_mass(0.21, 0.7)))),
    compared(SHAKE, gap("cannot_tell", cause("base_motion")), BELOW),
    compared(PAIR, gap("explained", cause("force_gain", "preload", **PRELOAD))),
    compared(PAIR, gap("partly_explained", cause("preload", **PRELOAD)), ABOVE, BELOW),
    compared(DRAG, gap("unexplained", unknown=0.9, force=ON_THE_BARREL), cpu_s=20.0, null_references_cpu_s={"a": 40.0}),
    compared(DRAG, gap("explained", cause("coulomb_friction"))),
    compared(DRAG, UNEXPLAINED, before=1.2),
    compared(PAIR, None),
    compared(GAIN, None, crashed=True),
    compared(MASS, gap("consistent"), refusal="too short"),
]


def counted(compared):
    return {rate.name: (rate.count, rate.of) for rate in scored(compared).rates}


def test_every_rate_counts_what_it_says():
    assert counted(COMPARED) == {
        "visible effects named": (4, 8),  # the gain, both of a pair, the preload; not the mass, nor what was refused
        "effects of all sizes named": (4, 11),
        "verdict right": (6, 13),
        "null: false alarm": (1, 2),
        "parameter in its 95 % interval": (4, 5),
        "outside: description right": (1, 3),
        "outside: that, above its limit": (1, 2),
        "refused": (1, 13),
        "crashed": (1, 13),
        "limits not known": (1, 13),
    }
    assert all(rate.interval_95 == wilson(rate.count, rate.of) for rate in scored(COMPARED).rates)


def test_false_names_are_counted_by_case():
    rate = scored(COMPARED).false_names
    assert (rate.count, rate.of) == (3, 13)  # of the null, of the mass elsewhere, of the friction
    low, high = (end * rate.of for end in rate.interval_95)
    assert poisson.sf(rate.count - 1, low) == pytest.approx(0.025)
    assert poisson.cdf(rate.count, high) == pytest.approx(0.025)
    assert scored(COMPARED[:1]).false_names.interval_95[0] == 0.0


def test_a_refused_case_is_a_wrong_verdict_and_misses_what_is_visible():
    refused = compared(PAIR, None, ABOVE, BELOW)
    assert (refused.score.visible, refused.score.recalled, refused.score.verdict_right) == (1, 0, False)
    unknown = compared(PAIR, None, refusal="too short")
    assert (unknown.score.visible, unknown.score.verdict_right) == (0, False)
    assert counted([compared(case("null"), None)])["null: false alarm"] == (0, 1)
    assert scored([refused]).cpu_s_median is None


@pytest.mark.parametrize("verdict", list(Verdict))
def test_a_null_is_alarmed_by_any_verdict_that_claims_a_difference(verdict):
    assert compared(case("null"), gap(verdict)).false_alarm == (verdict not in ("consistent", "cannot_tell"))


def test_cables_that_are_named_are_no_false_alarm():
    null = case("null", CABLE)
    right = gap("small", cause("added_mass", **a_mass(0.0101, 0.3, error=0.001)))
    beside = gap("small", cause("added_mass", "force_gain", **a_mass(0.0101, 0.3, error=0.001)))
    assert [compared(null, one, BELOW).false_alarm for one in (right, beside, gap("small"))] == [False, True, True]


def test_what_is_visible_says_what_a_case_is():
    rows = [c.row for c in COMPARED]
    assert rows[:4] == [ROWS[0], ROWS[0], ROWS[2], ROWS[2]]
    assert rows[4:7] == [ROWS[1], ROWS[3], ROWS[2]]
    assert rows[7:10] == [ROWS[4], ROWS[4], ROWS[1]]
    assert compared(case("null", CABLE), QUIET).row == ROWS[2]


def test_only_effects_that_are_sure_are_named():
    gain = gap("explained", a_gain(1.12, included=0.9))
    assert named_classes(gain) == ()
    assert len(classes_of(gain.causes[0], gain)) == 1
    assert named_classes(gap("unexplained", a_gain(1.12))) == ()
    (((named,),)) = named_classes(gap("small", a_gain(1.12)))
    assert (named.name, named.place, named.values["factor"].value) == ("sensor_gain", {"sensor": SENSOR}, 1.12)


def test_a_second_effect_of_one_kind_has_its_own_numbers():
    both = cause("added_mass", "added_mass", **a_mass(0.1, 0.2), **a_mass(0.3, 0.8, "added_mass_2"))
    (first,), (second,) = named_classes(gap("explained", both))
    assert [one.values["mass_kg"].value for one in (first, second)] == [0.1, 0.3]
    assert [one.values["relative_position"].value for one in (first, second)] == [0.2, 0.8]


def test_look_alikes_are_those_of_the_causes_that_hold_them():
    name = "added_mass:barrel"
    first = cause("force_gain", "added_mass", instead=(name, "tone:barrel"), **a_mass(0.1, 0.2))
    other = cause("added_mass", "added_mass", **a_mass(0.1, 0.2), **a_mass(0.3, 0.8, "added_mass_2"))
    (gain, instead), (mass,) = named_classes(gap("explained", first, other))
    assert (gain.name, instead.name, instead.values["mass_kg"].value) == ("force_gain", "added_mass", 0.3)
    assert mass.values["mass_kg"].value == 0.1


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


def test_the_limit_outside_the_library_is_above_what_nulls_leave():
    rows = [(case("null"), found(QUIET), Best(before)) for before in (0.2, 0.4, 3.0)]
    rows += [(case("null"), found(QUIET), Best(0.0, refusal="too short"))] * 3
    rows += [(DRAG, found(UNEXPLAINED), Best(before)) for before in (1.3, 1.5)]
    assert [c.truths[0].above for c in compared_cases(rows) if c.truth is DRAG] == [False, True]


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
        (("force", "moved", "barrel", None), ON_THE_BARREL, True),
        (("force", "moved", "cradle", None), ON_THE_BARREL, False),
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
        (("contact pair", "power", "contact_1", None), replace(SWINGING, frequency_hz=None), True),
        (("contact pair", "power", "contact_1", None), SWINGING, False),
        (("contact pair", "power", "contact_2", None), replace(SWINGING, frequency_hz=None), False),
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


def test_wilson_of_the_textbook():
    count, of, z = 8, 10, 1.959964
    share = count / of
    middle = (share + z**2 / (2 * of)) / (1 + z**2 / of)
    half = z / (1 + z**2 / of) * np.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    assert wilson(count, of) == pytest.approx((middle - half, middle + half), abs=1e-6)
    assert wilson(0, 0) == (0.0, 1.0)


def test_the_table_has_a_column_a_world():
    board = scored(COMPARED)
    console = Console(width=200, file=StringIO())
    console.print(shown({"own": board, "all": scored(COMPARED[:2])}, "blind"))
    text = console.file.getvalue()
    assert "own, 13 cases" in text
    assert "4 of 8, 50 % (22 to 78)" in text
    assert "3 in 13, 0.23" in text
    assert "base_motion 0.6" in limits_told(board)
    assert "p-values of nulls against uniform ones (Kolmogorov-Smirnov): D = " in calibration_told(calibrated(COMPARED))
    assert calibration_told(calibrated([])).count("none") == 3


def test_figures_are_drawn_also_of_nothing(tmp_path):
    for name, some in (("all", COMPARED), ("one", COMPARED[:1]), ("refused", COMPARED[10:12])):
        (tmp_path / name).mkdir()
        paths = drawn(some, tmp_path / name)
        names = ["verdicts.png", "power.png", "calibration.png", "parameters.png", "p_values.png"]
        assert [p.name for p in paths] == names
        assert all(p.stat().st_size > 5000 for p in paths)
