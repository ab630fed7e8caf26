"""Contacts of bodies that supports, springs and masses are attached to: they are part of the linear bodies."""

import pytest
from msgspec.structs import replace

from identify.contacts.identification import identify_contact
from identify.pages.wording import COVERED
from rig.model.description import PointMass, PointSpring, Station, Support
from rig.recording import read
from tests.campaigns.topologies import Topology, cantilever, frame, recorded

pytestmark = pytest.mark.long


def assert_found(rig, rms_n, folder):
    path = recorded(Topology(rig, rms_n, ""), folder / "r.mcap", duration_s=15.0)
    (contact,) = identify_contact(read(path)).report.contacts
    law = rig.contacts[0].law
    for estimate, true in (
        (contact.clearance_m, law.upper_clearance_m),
        (contact.stiffness_n_per_m, law.stiffness_n_per_m),
    ):
        assert abs(estimate.value - true) < 1.5 * COVERED * estimate.standard_error < 0.05 * true


def test_a_free_frame_that_is_held_at_its_foot(tmp_path):
    rig = frame(0.0)
    foot = Support(station=Station("frame", 0.0))
    assert_found(replace(rig, supports=(foot,), force_at=Station("frame", 0.3)), 60.0, tmp_path)


@pytest.mark.study
def test_a_cantilever_on_a_support(tmp_path):
    support = Support(station=Station("beam", 0.3))
    assert_found(replace(cantilever("acceleration"), supports=(support,)), 20.0, tmp_path)


@pytest.mark.study
def test_a_cantilever_with_a_mass_and_a_spring(tmp_path):
    mass = PointMass(station=Station("beam", 0.8), mass_kg=2.0)
    spring = PointSpring(station=Station("beam", 0.5), stiffness_n_per_m=5e4)
    assert_found(replace(cantilever("acceleration"), masses=(mass,), springs=(spring,)), 15.0, tmp_path)
