"""Every remedy is done as its sentence says, and then the record is taken, within its intervals."""

import pytest

import identify
from identify.contacts.refusals import ContactRefusedError, RemedyCode
from identify.pages.wording import COVERED
from tests.identify.contacts.remedies import CASES, WITHOUT_CASE

pytestmark = pytest.mark.long
STUDIES = (
    "a stop behind another that is not reached",
    "stops whose knees coincide",
    "stops that are believed alike",
    "no accelerometer at a contact",
    "no displacement sensor at a contact",
    "accelerometers noisier than rig.json says",
)
"""Cases of a quarter of a minute or more."""
SUMS = {"one, their sum": 2}
"""True stiffness over that of rig.json, where it differs."""


def marked(names):
    """Names and parameters of cases, the long ones marked."""
    return [pytest.param(*name, marks=pytest.mark.study if name[0] in STUDIES else ()) for name in names]


def test_every_remedy_has_a_case_or_a_reason_for_none():
    assert {case.remedy for case in CASES.values()} | set(WITHOUT_CASE) == set(RemedyCode)
    assert all(WITHOUT_CASE.values())


@pytest.mark.parametrize("name", marked((name,) for name in CASES))
def test_the_record_is_refused_with_the_remedy(name, tmp_path):
    case = CASES[name]
    try:
        refusals = list(identify.contact(case.refused(tmp_path)).identification.outcomes.refusals.values())
    except ContactRefusedError as error:
        refusals = [error.refusal]
    assert (case.code, case.remedy) in {(refusal.code, refusal.remedy) for refusal in refusals}


@pytest.mark.parametrize(("name", "way"), marked((name, way) for name, case in CASES.items() for way in case.mended))
def test_the_mended_record_is_taken(name, way, tmp_path):
    recording = CASES[name].mended[way](tmp_path)
    report = identify.contact(recording).report
    assert [contact.name for contact in report.contacts] == [contact.name for contact in recording.rig.contacts]
    for contact, described in zip(report.contacts, recording.rig.contacts, strict=True):
        stiffness, true = contact.stiffness_n_per_m, SUMS.get(way, 1) * described.law.stiffness_n_per_m
        assert abs(stiffness.value - true) < 1.5 * COVERED * stiffness.standard_error < 0.3 * true
