"""The law of a link: its slopes and its energy are those of its force, and its terms those of its formula."""

import numpy as np
import pytest

from tests.campaigns.worlds.laws import StopLaw, depth_m, energy_j, force_of

STOP = StopLaw(lower_m=1e-3, upper_m=2e-3, stiffness_below_n_per_m=1e5, stiffness_above_n_per_m=2e5)
LAWS = {
    "stop": STOP,
    "off centre": StopLaw(**{f: getattr(STOP, f) for f in STOP.__struct_fields__} | {"offset_m": 4e-4}),
    "hertz": StopLaw(
        **{f: getattr(STOP, f) for f in STOP.__struct_fields__} | {"exponent": 1.5, "reference_depth_m": 5e-4}
    ),
    "cubic stop": StopLaw(lower_m=1e-3, upper_m=1e-3, cubic_stop_n_per_m3=3e10),
    "spring": StopLaw(spring_n_per_m=300.0, cubic_spring_n_per_m3=-1e6),
    "yielding": StopLaw(yield_n=3.0, yield_m=2e-3),
    "damped": StopLaw(
        lower_m=1e-3,
        upper_m=1e-3,
        damping_n_s_per_m=50.0,
        friction_n=2.0,
        dashpot_n_s_per_m=3.0,
        drag_n_s2_per_m2=7.0,
    ),
}


def test_damping_sets_in_over_its_own_penetration():
    for onset_m, share in ((1e-7, 1.0), (1e-5, 0.5), (4e-5, 0.125)):
        law = StopLaw(lower_m=1e-3, upper_m=1e-3, damping_n_s_per_m=50.0, onset_m=onset_m)
        force_n, _, viscous = force_of(law.row(), 1e-3 + 5e-6, 0.2, 0.0)
        assert force_n == pytest.approx(50.0 * 0.2 * share)
        assert viscous == pytest.approx(50.0 * share)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("eta_m", [-5e-3, -1.4e-3, 3e-4, 2.7e-3, 4e-3])
@pytest.mark.parametrize("rate", [-0.3, 0.013, 0.5])
def test_slopes_are_the_derivatives(law, eta_m, rate):
    row, d = law.row(), 1e-8

    def force(x, v):
        return force_of(row, x, v, 0.0)[0]

    _, slope, viscous = force_of(row, eta_m, rate, 0.0)
    assert slope == pytest.approx((force(eta_m + d, rate) - force(eta_m - d, rate)) / (2 * d), rel=1e-4, abs=1e-3)
    assert viscous == pytest.approx((force(eta_m, rate + d) - force(eta_m, rate - d)) / (2 * d), rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_the_energy_is_the_work_of_the_force_at_rest(law):
    etas = np.linspace(0, 4e-3, 40001)
    force = [force_of(law.row(), eta, 0.0, 0.0)[0] for eta in etas]
    work = np.trapezoid(force, etas)
    assert energy_j(law, 4e-3) - energy_j(law, 0.0) == pytest.approx(work, rel=1e-4, abs=1e-9)


def test_stops_stand_where_they_should_and_move():
    worn = StopLaw(lower_m=1e-3, upper_m=2e-3, wear_m_per_s=1e-5, offset_m=5e-4)
    assert depth_m(worn.row(), 2.5e-3 + 1e-6, 0.0) == pytest.approx(1e-6)
    assert depth_m(worn.row(), -0.5e-3 - 1e-6, 0.0) == pytest.approx(-1e-6)
    assert depth_m(worn.row(), 2.6e-3 + 1e-6, 10.0) == pytest.approx(1e-6)
    breathing = StopLaw(lower_m=1e-3, upper_m=1e-3, breath_m=1e-4, breath_hz=5.0)
    assert depth_m(breathing.row(), 1.2e-3, 0.05) == pytest.approx(1e-4)
    assert depth_m(breathing.row(), 1.2e-3, 0.15) == pytest.approx(3e-4)


def test_a_hertzian_stop_has_the_believed_stiffness_at_its_reference_depth():
    law = LAWS["hertz"].row()
    assert force_of(law, 2e-3 + 5e-4, 0.0, 0.0)[0] == pytest.approx(2e5 * 5e-4)
    assert force_of(law, 2e-3 + 1e-3, 0.0, 0.0)[0] == pytest.approx(2e5 * 5e-4 * 2**1.5)
    assert force_of(law, -1e-3 - 1e-3, 0.0, 0.0)[0] == pytest.approx(-1e5 * 5e-4 * 2**1.5)


def test_damping_sets_in_over_ten_micrometres():
    law = StopLaw(lower_m=1e-3, upper_m=1e-3, damping_n_s_per_m=100.0).row()
    assert force_of(law, 1e-3 + 5e-6, 0.1, 0.0)[0] == pytest.approx(5.0)
    assert force_of(law, 1e-3 + 5e-5, 0.1, 0.0)[0] == pytest.approx(10.0)
    assert force_of(law, 0.9e-3, 0.1, 0.0)[0] == 0.0
