"""Contacts are found from the tests that laboratories do, or a sentence says what is missing."""

import pytest

from identify.contacts import identify_contact
from rig.errors import RigError
from scenarios.laboratory_tests import REFUSED, TESTS, recorded

SHORT = [name for name in TESTS if name.startswith("one mass")] + [
    "two beams, a hammer's hit every two seconds",
    "two beams, stepped sine",
    "two beams, high-pass of 2 Hz",
    "two beams, two stations each",
    "two beams, no quiet start",
    "two beams, no quiet start, displacements",
    "two beams, free decay, no force measured",
    "two beams, free decay, displacements",
]
NOT_FREE = r"the exciting force is zero throughout, and this is no free decay: \d+.* % of \w+'s force follow from no "
SENTENCES = {
    "two beams, force not recorded": NOT_FREE,
    "two beams, a blow that is not recorded": NOT_FREE,
    "two beams, base excitation": NOT_FREE,
    "two beams, base excitation in rig.json": "has base_motion, which the identification does not know; of one mass "
    "give its motion against the base, and minus its mass times the base's acceleration as the force; of other bodies "
    "hold the base still",
    "two beams, displacements, no sensor at contact 2": "contact 'contact_2' has no sensor at 0.55 m of 'barrel', and "
    r"the body has more modes than stations \(5\): its displacement there cannot be told; put a sensor there",
    "two beams, accelerometers, no sensor at contact 2": "contact 'contact_2' has no sensor at 0.55 m of 'barrel'; "
    "its drift cannot be told: put an accelerometer there",
    "one mass, force not recorded": NOT_FREE,
}


@pytest.mark.parametrize("name", SHORT)
def test_every_contact_is_found(name, tmp_path):
    test = TESTS[name]
    report = identify_contact(recorded(test, tmp_path / "r.mcap", duration_s=24.0)).report
    assert [c.name for c in report.contacts] == [c.name for c in test.rig.contacts]
    assert report.findings == ()
    for found, contact in zip(report.contacts, test.rig.contacts, strict=True):
        for estimate, true in (
            (found.clearance_m, contact.law.lower_clearance_m),
            (found.stiffness_n_per_m, contact.law.stiffness_n_per_m),
        ):
            assert abs(estimate.value - true) < 3 * estimate.standard_error
            assert estimate.standard_error < 0.02 * true


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_record_does_not_tell_is_refused(name, tmp_path):
    with pytest.raises(RigError, match=SENTENCES[name]):
        identify_contact(recorded(REFUSED[name], tmp_path / "r.mcap", duration_s=14.0))
