"""Changes of modes: stated in place of strengths that shapes leave open, and between records of several levels."""

import re
from functools import reduce

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.decision.differences import _trend_of
from identify.gaps.decision.modal_changes import has_several_force_levels, identifiable_change_words, level_dependence
from identify.gaps.results import LevelDependence, ParameterByRecord
from identify.gaps.search.candidates import Candidate
from identify.gaps.wording import interval, level_dependence_sentence, parameter_trend_words
from rig.effects import effect_named, effects
from rig.effects.base import Scale
from rig.model.description import Rig, Sensor, Station
from rig.model.structure import structure_of
from rig.model.unmeasured_force import Value
from rig.simulation.reference import Sdof

HZ, RATIO = np.array([5.0, 9.0]), 0.01
SHAPES = np.array([[0.04, 0.01], [0.08, 0.01]])
"""At either end: of the first mode twice as large at the right one, where it dominates everywhere."""


def rig(second=1.0, places=(0.0, 1.0)):
    shapes = np.array([np.interp(places, (0.0, 1.0), column) for column in SHAPES.T]).T * (1.0, second)
    body = structure_of("wing", 1.0, HZ, np.full(2, RATIO), np.array(places), shapes)
    sensors = tuple(
        Sensor(name=f"s{x}", station=Station("wing", x), quantity="acceleration", noise_density=1e-3) for x in places
    )
    return Rig(
        name="wing", bodies=(body,), contacts=(), force_at=Station("wing"), sensors=sensors, sample_rate_hz=400.0
    )


def change_words(of, name, strength, place=0.5, error=0.1):
    kind = effects()[name]
    place_of_effect = next(iter(kind.placements(of, [])))
    scale = Scale(of, 1.0, 60.0).with_place(place_of_effect)
    candidate = Candidate(kind, place_of_effect, kind.parameters(scale), kind.typical(scale))
    covariance = np.diag([(error * strength) ** 2, 0.0])
    return identifiable_change_words(of, candidate, np.array([strength, place]), covariance, 15.0)


@pytest.mark.parametrize(
    ("name", "strength", "shift", "unit", "quantity"),
    [  # of phi(0.5) = 0.06: k phi^2 / (8 pi^2 f), -f m phi^2 / 2, c phi^2 / (4 pi f)
        ("linear_spring", -1000.0, -1000 * 0.06**2 / (8 * np.pi**2 * 5), "Hz", "frequency"),
        ("added_mass", 1.0, -5 * 0.06**2 / 2, "Hz", "frequency"),
        ("ground_damper", 10.0, 100 * 10 * 0.06**2 / (4 * np.pi * 5), "%", "damping ratio"),
    ],
)
def test_the_change_of_the_mode_stands_in_place_of_the_number(name, strength, shift, unit, quantity):
    words = change_words(rig(), name, strength)
    head, _, number = words.partition(" changes by ")
    assert head.endswith(f"told: the {quantity} of the mode at 5.000 Hz")
    value, _, half_width_and_unit = number.partition(" ± ")
    half_width, _, ending = half_width_and_unit.partition(" ")
    assert float(value) == pytest.approx(shift, rel=0.03)
    assert float(half_width) == pytest.approx(0.196 * abs(shift), rel=0.05)
    assert ending == unit
    assert interval(Value(strength, 0.1 * abs(strength), "N/m", instead=words)) == words


def test_friction_has_no_such_change():
    assert change_words(rig(), "ground_friction", 1.0).endswith("one mode dominates: the mode at 5.000 Hz")


@pytest.mark.parametrize(
    ("of", "place"),
    [
        (rig(), 1.0),  # a sensor stands there
        (rig(second=20.0), 0.5),  # another mode tells as much
        (rig(places=(0.0, 0.45, 0.55, 1.0)), 0.5),  # its neighbours hardly differ
        (replace(rig(), bodies=(replace(rig().bodies[0], natural_hz=(0.0, 9.0)),)), 0.5),  # it is free
    ],
)
def test_what_shapes_or_several_modes_tell_is_told(of, place):
    assert change_words(of, "linear_spring", 1000.0, place) == ""


LEVELS_N = (30.0, 12.0, 61.0)


def compared(by_level):
    name, values = "linear_spring.stiffness_n_per_m", tuple(Value(x, 0.1, "N/m") for x in (-20.0, -10.0, -40.0))
    return ParameterByRecord(
        parameter=name, place="mass", values=values, p_value=1e-6, trend="differs", by_level=by_level
    )


STRENGTHS = np.array([-20.0, 1.3, -10.0, 1.0, -40.0, 1.9])
"""Spring and factor of the damping of each record: stiffness falls and damping grows with the level."""


def rigs_of(strengths):
    texts = [
        (f"linear_spring:stiffness_n_per_m={k},body=mass", f"structural_damping:factor={c},body=mass")
        for k, c in strengths.reshape(-1, 2)
    ]
    return [reduce(lambda rig, t: effect_named(t).applied_to(rig), effects, Sdof().rig()) for effects in texts]


EXACT = np.zeros(6)


def dependence_of(*differing, errors=EXACT):
    return level_dependence(rigs_of, STRENGTHS, np.diag(errors**2), LEVELS_N, differing, (0.1, 100.0))


def test_a_mode_that_follows_the_level_is_told_from_the_lowest_to_the_highest():
    dependence = dependence_of(compared("falls"))
    lowest, highest = (rigs_of(STRENGTHS)[k].bodies[0] for k in (1, 2))
    stiffness = [lowest.stiffness_n_per_m + k for k in (-10, -40)]
    assert (dependence.lowest_n, dependence.highest_n) == (12.0, 61.0)
    assert dependence.frequency_change == pytest.approx(np.sqrt(stiffness[1] / stiffness[0]) - 1, rel=1e-6)
    ratio = np.sqrt(stiffness[0] / stiffness[1]) if highest.damping_n_s_per_m != lowest.damping_n_s_per_m else 1.0
    assert dependence.damping_change == pytest.approx(1.9 * ratio - 1, rel=0.05)
    words = level_dependence_sentence(dependence)
    assert words.startswith("The machine softens with the motion")
    assert "from 12 to 61 N rms" in words


def test_the_changes_are_as_certain_as_the_springs_and_dampers_of_both_levels():
    """f ~ sqrt(k), damping ratio ~ c / sqrt(k); the middle level matters to neither."""
    errors = np.array([99.0, 9.0, 2.0, 0.05, 3.0, 0.07])
    dependence = dependence_of(compared("falls"), errors=errors)
    stiffness = Sdof().rig().bodies[0].stiffness_n_per_m + STRENGTHS[[2, 4]]
    of_frequency = np.hypot(*(errors[[2, 4]] / stiffness / 2))
    assert dependence.frequency_change_standard_error == pytest.approx(
        (1 + dependence.frequency_change) * of_frequency, rel=1e-2
    )
    of_damping = np.linalg.norm([of_frequency, *(errors[[3, 5]] / STRENGTHS[[3, 5]])])
    assert dependence.damping_change_standard_error == pytest.approx(
        (1 + dependence.damping_change) * of_damping, rel=0.05
    )
    words = level_dependence_sentence(dependence)
    assert re.search(r"changes by -\d+\.\d+ ± \d+\.\d+ % and its damping by \+\d+ ± \d+ %", words)


@pytest.mark.parametrize("trend", ["differs", "none"])
def test_what_does_not_follow_the_level_is_not_told_as_its(trend):
    assert dependence_of(compared("falls"), compared(trend)) is None
    assert dependence_of() is None


def test_what_follows_the_level_is_told_so():
    values = "(-20.00 ± 0.20 N/m, -10.00 ± 0.20 N/m, -40.00 ± 0.20 N/m)"
    name = "linear_spring.stiffness_n_per_m (mass)"
    assert parameter_trend_words(compared("falls")) == f"{name} falls with the level {values}"
    assert parameter_trend_words(compared("differs")) == f"{name} differs {values}"


def test_forces_within_a_quarter_are_one_level():
    assert has_several_force_levels(LEVELS_N)
    assert not has_several_force_levels((12.0, 13.0, 14.0))
    assert not has_several_force_levels((0.0, 13.0))


def test_a_trend_is_one_of_the_levels_in_their_order():
    values, covariance = np.array([-20.0, -10.0, -40.0]), 0.01 * np.eye(3)
    order = np.argsort(LEVELS_N)
    assert _trend_of(values, covariance) == "differs"
    assert _trend_of(values[order], covariance) == "falls"


@pytest.mark.parametrize(
    ("shift", "damping", "kind", "cause"),
    [
        (-0.013, 0.9, "softens", "friction or clearance"),
        (0.02, 0.1, "stiffens", "a hardening spring"),
        (0.0, 0.9, "is damped more", "friction or clearance"),
        (0.0, -0.3, "is damped less", "friction or clearance"),
    ],
)
def test_the_words_are_those_of_the_changes(shift, damping, kind, cause):
    dependence = LevelDependence(
        lowest_n=12.0, highest_n=61.0, body="wing", frequency_hz=7.3, frequency_change=shift, damping_change=damping
    )
    words = level_dependence_sentence(dependence)
    assert words.startswith(f"The machine {kind} with the motion: from 12 to 61 N rms")
    assert cause in words
