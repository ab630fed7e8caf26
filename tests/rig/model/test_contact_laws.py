"""The dead zone's properties, whatever its parameters; what every law must be."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.contact_laws import PLANE_LAWS, DeadZone, stop_positions_m_and_sides
from rig.model.contact_laws.base import CLEARANCES
from rig.model.contact_laws.dead_zone import DAMPING_DEPTH_M
from rig.model.contact_laws.hunt_crossley import HuntCrossley
from rig.model.contact_laws.spring import Spring
from rig.simulation.plants.compiled_laws import force_n, law_records

clearances = st.floats(0, 0.1)
stiffnesses = st.floats(1, 1e7)
dampings = st.floats(0, 1e3)
displacements = st.floats(-1, 1)
rates = st.floats(-10, 10)
laws = st.builds(
    DeadZone,
    lower_clearance_m=clearances,
    upper_clearance_m=clearances,
    stiffness_n_per_m=stiffnesses,
    damping_n_s_per_m=dampings,
)


def force(law, eta, rate):
    return float(law.force_n(np.array([eta]), np.array([rate]))[0])


@given(laws, st.floats(0, 1), rates)
def test_nothing_passes_inside_the_gap(law, fraction, rate):
    eta = -law.lower_clearance_m + fraction * (law.lower_clearance_m + law.upper_clearance_m)
    assert force(law, np.clip(eta, -law.lower_clearance_m, law.upper_clearance_m), rate) == 0


@given(laws, st.floats(1e-6, 1), rates)
def test_outside_spring_and_damper_act(law, depth, rate):
    above, below = law.upper_clearance_m + depth, -law.lower_clearance_m - depth
    for eta, signed in ((above, depth), (below, -depth)):
        damped = law.damping_n_s_per_m * rate * min(1, depth / DAMPING_DEPTH_M)
        rounding = 1e-15 * (law.stiffness_n_per_m + law.damping_n_s_per_m * abs(rate) / DAMPING_DEPTH_M)
        expected = law.stiffness_n_per_m * signed + damped
        assert force(law, eta, rate) == pytest.approx(expected, rel=1e-9, abs=1e-8 * law.stiffness_n_per_m + rounding)


@given(laws, displacements, displacements)
def test_elastic_force_is_continuous_and_never_falls(law, eta_a, eta_b):
    low, high = min(eta_a, eta_b), max(eta_a, eta_b)
    rise = force(law, high, 0.0) - force(law, low, 0.0)
    slack = 1e-12 * law.stiffness_n_per_m
    assert -slack <= rise <= law.stiffness_n_per_m * (high - low) + slack


@given(clearances, stiffnesses, dampings, displacements, rates)
def test_equal_sides_give_an_odd_law(clearance, stiffness, damping, eta, rate):
    law = DeadZone(
        lower_clearance_m=clearance, upper_clearance_m=clearance, stiffness_n_per_m=stiffness, damping_n_s_per_m=damping
    )
    assert force(law, -eta, -rate) == -force(law, eta, rate)
    assert law.clearance_m == clearance


@given(laws)
def test_clearance_is_half_the_play(law):
    assert 2 * law.clearance_m == pytest.approx(law.lower_clearance_m + law.upper_clearance_m)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *product(CLEARANCES, [-1.0, float("nan"), -np.inf]),
        *product(["stiffness_n_per_m", "damping_n_s_per_m"], [-1.0, float("nan"), np.inf]),
    ],
)
def test_a_bad_value_is_named(field, value):
    good = {"lower_clearance_m": 1e-3, "upper_clearance_m": 1e-3, "stiffness_n_per_m": 1e4}
    with pytest.raises(RigError, match=rf"{field} is {value}; give"):
        DeadZone(**good | {field: value})


@pytest.mark.parametrize("kind", [kind for kind in PLANE_LAWS if kind.has_stops])
@given(displacements, rates, clearances, st.booleans())
def test_a_stop_that_is_not_there_gives_no_force_and_the_other_one_its_own(kind, eta, rate, clearance, is_lower):
    near, lacking = ("lower_clearance_m", "upper_clearance_m")[:: 1 if is_lower else -1]
    both = kind(**{near: clearance, lacking: clearance}, stiffness_n_per_m=1e4, damping_n_s_per_m=5.0)
    law = replace(both, **{lacking: np.inf})
    is_beyond_the_stop = eta < -clearance if is_lower else eta > clearance
    expected = float(both.force_n(eta, rate)) if is_beyond_the_stop else 0.0
    assert float(law.force_n(eta, rate)) == expected
    assert force_n(law_records([law])[0], eta, rate, 0.0) == pytest.approx(expected, rel=1e-9)
    assert law.clearance_m == clearance
    assert [side for _, side in stop_positions_m_and_sides(law)] == [-1 if is_lower else 1]


def test_a_law_without_any_stop_is_refused_unless_it_rubs():
    none = {"lower_clearance_m": np.inf, "upper_clearance_m": np.inf, "stiffness_n_per_m": 0.0}
    with pytest.raises(RigError, match="both clearances are null"):
        DeadZone(**none)
    assert float(DeadZone(**none, friction_n=3.0).force_n(0.0, 1.0)) == pytest.approx(3.0)


STOPS = {"lower_clearance_m": 1e-3, "upper_clearance_m": 2e-3, "stiffness_n_per_m": 1e4, "damping_n_s_per_m": 5.0}
EXAMPLES = (
    DeadZone(
        **STOPS,
        cubic_n_per_m3=1e9,
        lower_stiffness_ratio=0.3,
        friction_n=0.2,
        open_damping_n_s_per_m=0.4,
        wear_m_per_s=1e-5,
        exponent=1.5,
        reference_depth_m=5e-4,
    ),
    HuntCrossley(**STOPS, wear_m_per_s=1e-5, reference_depth_m=5e-4),
    *(kind(**STOPS) for kind in PLANE_LAWS if kind.has_stops),  # a law's own numbers have defaults
    Spring(stiffness_n_per_m=1e4, damping_n_s_per_m=5.0),
)


@pytest.mark.parametrize("law", EXAMPLES, ids=lambda law: type(law).__name__)
def test_derivatives_and_energy_belong_to_the_force(law):
    eta, rate, time_s = np.array([-3e-3, -1.2e-3, 0.0, 2.3e-3, 6e-3]), np.array([0.1, -0.01, 0.0, 0.02, -0.3]), 4.0
    step = 1e-8
    by_eta = (law.force_n(eta + step, 0.0, time_s) - law.force_n(eta - step, 0.0, time_s)) / (2 * step)
    np.testing.assert_allclose(law.by_eta_n_per_m(eta, time_s), by_eta, rtol=1e-6)
    by_rate = (law.force_n(eta, rate + 1e-7, time_s) - law.force_n(eta, rate - 1e-7, time_s)) / 2e-7
    np.testing.assert_allclose(law.by_rate_n_s_per_m(eta, rate, time_s), by_rate, rtol=1e-6)
    work = (law.energy_j(eta + step, time_s) - law.energy_j(eta - step, time_s)) / (2 * step)
    np.testing.assert_allclose(work, law.force_n(eta, 0.0, time_s), rtol=1e-6)


@pytest.mark.parametrize("law", EXAMPLES, ids=lambda law: type(law).__name__)
def test_the_compiled_formula_is_the_same(law):
    (row,) = law_records([law])
    rng = np.random.default_rng(5)
    for eta, rate, time_s in zip(rng.normal(0, 3e-3, 50), rng.normal(0, 0.1, 50), rng.uniform(0, 9, 50), strict=True):
        assert force_n(row, eta, rate, time_s) == pytest.approx(float(law.force_n(eta, rate, time_s)), rel=1e-12)


@pytest.mark.parametrize("law", EXAMPLES, ids=lambda law: type(law).__name__)
def test_nothing_is_steeper_at_a_stop_than_a_law_says(law):
    powerless = {"exponent": 1.0, "cubic_n_per_m3": 0.0}
    linear = replace(law, **{field: powerless[field] for field in powerless if field in law.__struct_fields__})
    depth_m = getattr(law, "reference_depth_m", 5e-4)
    eta = np.array([-1e-3 - depth_m, 2e-3 + depth_m])
    stiffness, damping = linear.largest_slopes
    assert max(linear.by_eta_n_per_m(eta)) == pytest.approx(stiffness)
    assert max(linear.by_rate_n_s_per_m(eta, np.zeros(2))) == pytest.approx(damping)


def test_the_reference_depth_is_where_stiffness_and_damping_are_those_given():
    for law in (DeadZone(**STOPS, exponent=2.0, reference_depth_m=5e-4), HuntCrossley(**STOPS, reference_depth_m=5e-4)):
        np.testing.assert_allclose(law.force_n(np.array([-1.5e-3, 2.5e-3])), [-1e4 * 5e-4, 1e4 * 5e-4])
    assert HuntCrossley(**STOPS, reference_depth_m=5e-4).force_n(2.5e-3, 0.1) == pytest.approx(1e4 * 5e-4 + 5.0 * 0.1)


def test_a_spring_has_no_clearance_and_does_not_wear():
    for field, value in (("lower_clearance_m", 1e-3), ("upper_clearance_m", np.inf), ("wear_m_per_s", 1e-6)):
        with pytest.raises(RigError, match=f"{field} of a spring is {value}; leave it out, or give the type dead_zone"):
            Spring(stiffness_n_per_m=1e4, **{field: value})
