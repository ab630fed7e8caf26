"""Contacts are found from the tests that laboratories do; tests/test_refused.py has those that are refused."""

import pytest

from identify.contacts import identify_contact
from tests.campaigns.laboratory_tests import TESTS, beams, recorded

pytestmark = pytest.mark.long

SHORT = [name for name in TESTS if name.startswith("one mass")] + [
    "two beams, high-pass of 2 Hz",
]
STUDIES = [
    "two beams, no quiet start",
    "two beams, a shaker on each",
    "two beams, free decay, no force measured",
    "two beams, free decay, displacements",
    "two beams, a hammer's hit every two seconds",
    "two beams, stepped sine",
    "two beams, two stations each",
    "two beams, no quiet start, displacements",
]


@pytest.mark.parametrize("name", [*SHORT, *(pytest.param(name, marks=pytest.mark.study) for name in STUDIES)])
def test_every_contact_is_found(name, tmp_path):
    test = TESTS[name]
    duration_s = 24.0 if name.startswith("one mass") else 12.0 + test.without_s
    report = identify_contact(recorded(test, tmp_path / "r.mcap", duration_s=duration_s)).report
    assert [c.name for c in report.contacts] == [c.name for c in test.rig.contacts]
    assert report.findings == ()
    for found, contact in zip(report.contacts, test.rig.contacts, strict=True):
        for estimate, true in (
            (found.clearance_m, contact.law.lower_clearance_m),
            (found.stiffness_n_per_m, contact.law.stiffness_n_per_m),
        ):
            assert abs(estimate.value - true) < 3 * estimate.standard_error
            assert estimate.standard_error < 0.02 * true


@pytest.mark.study
def test_nifo_looks_at_each_body_where_the_forces_on_it_act(tmp_path):
    """A shaker up to 100 Hz on the barrel, a hammer on the cradle."""
    test = TESTS["two beams, a shaker and a hammer"]
    report = identify_contact(recorded(test, tmp_path / "r.mcap", duration_s=12.0)).report
    found = {one.equation: one for one in report.nifo}
    assert found["barrel 1"].band_hz[1] == pytest.approx(100.0, rel=0.02)
    assert found["cradle 1"].band_hz[1] > 200.0
    for stiffness in found["barrel 1"].stiffness:
        assert stiffness.mean_n_per_m.value == pytest.approx(1e5, rel=0.02)


@pytest.mark.parametrize(
    ("rms_n", "reason"),
    [(0.5, "only one of its stops is clearly touched"), (0.7, "closes too rarely for accelerometers")],
)
def test_what_closes_rarely_is_not_told_by_accelerometers(rms_n, reason, tmp_path):
    report = identify_contact(recorded(beams(rms_n=rms_n), tmp_path / "r.mcap", duration_s=12.0)).report
    assert report.contacts == ()
    reasons = [one.reason for one in report.unanswered]
    assert all(reason in one and "excite the rig more strongly" in one for one in reasons)
