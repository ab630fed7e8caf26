"""The dead zone's properties, whatever its parameters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.errors import RigError
from rig.model.contact_law import DAMPING_DEPTH_M, DeadZone

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
def test_elastic_force_is_continuous_and_never_falls(law, one, other):
    low, high = min(one, other), max(one, other)
    rise = force(law, high, 0.0) - force(law, low, 0.0)
    slack = 1e-12 * law.stiffness_n_per_m
    assert -slack <= rise <= law.stiffness_n_per_m * (high - low) + slack


@given(clearances, stiffnesses, dampings, displacements, rates)
def test_equal_sides_give_an_odd_law(clearance, stiffness, damping, eta, rate):
    law = DeadZone(
        lower_clearance_m=clearance,
        upper_clearance_m=clearance,
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=damping,
    )
    assert force(law, -eta, -rate) == -force(law, eta, rate)
    assert law.clearance_m == clearance


@given(laws)
def test_clearance_is_half_the_play(law):
    assert 2 * law.clearance_m == pytest.approx(law.lower_clearance_m + law.upper_clearance_m)


@pytest.mark.parametrize("field", ["lower_clearance_m", "upper_clearance_m", "stiffness_n_per_m", "damping_n_s_per_m"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_a_bad_value_is_named(field, value):
    good = {"lower_clearance_m": 1e-3, "upper_clearance_m": 1e-3, "stiffness_n_per_m": 1e4}
    with pytest.raises(RigError, match=rf"{field} is {value}; give"):
        DeadZone(**good | {field: value})


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.0])
def test_tangent_and_energy_belong_to_the_elastic_force(exponent):
    law = DeadZone(
        lower_clearance_m=1e-3,
        upper_clearance_m=2e-3,
        stiffness_n_per_m=1e4,
        cubic_n_per_m3=1e9,
        lower_stiffness_ratio=0.3,
        exponent=exponent,
        reference_depth_m=5e-4,
    )
    depth, step = np.array([-2e-3, -1e-4, 3e-4, 4e-3]), 1e-8
    slope = (law.elastic_n(depth + step) - law.elastic_n(depth - step)) / (2 * step)
    np.testing.assert_allclose(law.tangent_n_per_m(depth), slope, rtol=1e-6)
    work = (law.energy_j(depth + step) - law.energy_j(depth - step)) / (2 * step)
    np.testing.assert_allclose(work, law.elastic_n(depth), rtol=1e-6)
    np.testing.assert_array_equal(law.tangent_n_per_m(np.zeros(1)), 0)
    at_reference = law.spring_n(np.array([-5e-4, 5e-4]))
    np.testing.assert_allclose(at_reference, [-0.3 * 1e4 * 5e-4, 1e4 * 5e-4])
