"""The force that makes the contacts of a rig rattle."""

import numpy as np
import pytest
from msgspec.structs import replace

from rig.model.contact_laws.dead_zone import symmetric_dead_zone
from rig.model.force_level import RMS_TO_CLEARANCE, rattling_level
from rig.simulation.reference import BarrelCradle, Sdof


def test_white_noise_moves_a_mass_as_theory_says():
    """A flat force over a band that holds the resonance: eta_rms^2 = S pi f0 / (4 zeta k^2), S = F_rms^2 / band."""
    start = Sdof(damping_ratio=0.02)
    (mass,) = start.rig().bodies
    force_n = rattling_level(start.rig(), 0.0, 100.0).rms_n
    eta_m = force_n * np.sqrt(np.pi * mass.frequency_hz / (4 * mass.damping_ratio * 100.0)) / mass.stiffness_n_per_m
    assert eta_m == pytest.approx(RMS_TO_CLEARANCE * start.clearance_m, rel=0.2)  # to one significant digit


@pytest.mark.parametrize("start", [Sdof(), BarrelCradle()])
def test_the_papers_forces_are_near(start):
    assert 0.5 < rattling_level(start.rig(), start.low_hz, start.high_hz).rms_n / start.rms_n < 2


def test_two_equal_forces_at_one_place_may_be_weaker_by_root_two():
    rig = Sdof().rig()
    rig = replace(rig, contacts=tuple(replace(c, law=symmetric_dead_zone(1e-3, 1e4)) for c in rig.contacts))
    single_n, each_of_two_n = (
        rattling_level(replace(rig, force_at=stations), 0.5, 15.0).rms_n
        for stations in (rig.force_at, (rig.force_at,) * 2)
    )
    assert each_of_two_n == pytest.approx(single_n / np.sqrt(2), rel=0.15)  # to one significant digit


def with_law(**changes):
    rig = Sdof().rig()
    (contact,) = rig.contacts
    return replace(rig, contacts=(replace(contact, law=replace(contact.law, **changes)),))


def test_a_force_where_no_contact_has_a_clearance():
    none = {"lower_clearance_m": 0.0, "upper_clearance_m": 0.0}
    for rig in (with_law(**none), replace(Sdof().rig(), contacts=())):
        assert rattling_level(rig, 0.5, 15.0).rms_n == 1.0


def test_a_stop_that_nothing_reaches_does_not_choose_the_force():
    usual_n = rattling_level(Sdof().rig(), 0.5, 15.0).rms_n
    for far_m in (1.0, np.inf):
        assert rattling_level(with_law(lower_clearance_m=far_m), 0.5, 15.0).rms_n == usual_n
    unreached = rattling_level(with_law(lower_clearance_m=1.0, upper_clearance_m=1.0), 0.5, 15.0)
    assert unreached.rms_n == 1.0
    assert "no contact has a clearance of at most 0.1 m" in unreached.reason
    assert rattling_level(with_law(lower_clearance_m=1e-3, upper_clearance_m=3e-3), 0.5, 15.0).rms_n > usual_n


def test_the_contact_that_chose_the_force_is_named():
    why = rattling_level(BarrelCradle().rig(), 4.0, 100.0).reason
    assert "'contact_2'" in why or "'contact_1'" in why
    assert "which moves least" in why
    assert "4 clearances of 5 mm rms" in why
