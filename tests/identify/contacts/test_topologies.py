"""Contacts of rigs other than the reference rigs, simulated by the plant `modal`, are found within their intervals."""

from dataclasses import replace as replace_case

import pytest
from msgspec.structs import replace

from identify.contacts.identification import identify_contact
from rig.errors import RigError
from rig.recording import read
from tests.campaigns.topologies import RIGS, chain, recorded

pytestmark = pytest.mark.long


STUDIES = (
    "three masses in a chain",
    "three masses, displacements",
    "frame on soft supports",
    "bumper and hard stop, accelerometer",
    "overdamped mass",
    "two beams, two stops at one place",
)


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.study if n in STUDIES else ()) for n in RIGS])
def test_every_contact_is_found(name, tmp_path):
    case = RIGS[name]
    report = identify_contact(read(recorded(case, tmp_path / "r.mcap", duration_s=24.0))).report
    assert [c.name for c in report.contacts] == [c.name for c in case.rig.contacts]
    for contact, true in zip(report.contacts, case.rig.contacts, strict=True):
        clearance_m = min(true.law.lower_clearance_m, true.law.upper_clearance_m)
        for estimate, value in (
            (contact.clearance_m, clearance_m),
            (contact.stiffness_n_per_m, true.law.stiffness_n_per_m),
        ):
            assert abs(estimate.value - value) < 3 * estimate.standard_error
            assert estimate.standard_error < 0.05 * value


def test_contacts_that_move_by_fewer_modes_are_refused(tmp_path):
    rig = chain(2, "displacement", ground=True)
    wall = replace(rig.contacts[1], name="other wall", at=rig.contacts[0].at)
    case = replace_case(RIGS["two masses"], rig=replace(rig, contacts=(*rig.contacts, wall)))
    with pytest.raises(RigError, match="the 3 contacts of rig 'chain' move by fewer independent modes"):
        identify_contact(read(recorded(case, tmp_path / "r.mcap", duration_s=5.0)))
