"""Contacts are found from the tests that laboratories do; tests/test_refused.py has those that are refused."""

import pytest

from identify.contacts import identify_contact
from scenarios.laboratory_tests import TESTS, recorded

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
