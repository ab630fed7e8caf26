"""Contacts of rigs other than the reference rigs, simulated by the plant `modal`, are found within their intervals."""

import pytest

from identify.contacts.identification import identify_contact
from rig.errors import RigError
from rig.recording import read
from scenarios.topologies import RIGS, recorded

TOLD = [name for name, case in RIGS.items() if case.told]


@pytest.mark.parametrize("name", TOLD)
def test_every_contact_is_found(name, tmp_path):
    case = RIGS[name]
    found = identify_contact(read(recorded(case, tmp_path / "r.mcap", duration_s=24.0))).report
    assert [c.name for c in found.contacts] == [c.name for c in case.rig.contacts]
    for contact, true in zip(found.contacts, case.rig.contacts, strict=True):
        clearance_m = min(true.law.lower_clearance_m, true.law.upper_clearance_m)
        for estimate, value in (
            (contact.clearance_m, clearance_m),
            (contact.stiffness_n_per_m, true.law.stiffness_n_per_m),
        ):
            assert abs(estimate.value - value) < 3 * estimate.standard_error
            assert estimate.standard_error < 0.05 * value


def test_contacts_that_move_by_one_mode_are_refused(tmp_path):
    path = recorded(RIGS["two stops on one mass"], tmp_path / "r.mcap", duration_s=5.0)
    with pytest.raises(RigError, match="the 2 contacts of rig 'mass' move by fewer independent modes"):
        identify_contact(read(path))
