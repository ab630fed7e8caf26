"""Springs between bodies: described as a contact's law, simulated, identified, planned, drawn and diagnosed."""

from functools import partial

import pytest
from msgspec.structs import replace

import identify
from identify.contacts.identification import identify_contact
from identify.contacts.report import write_results
from identify.pages.wording import COVERED, interval
from rig.model.contact_laws.spring import Spring
from rig.model.force_level import rattling
from rig.recording import read
from tests.campaigns.topologies import Topology, chain, recorded

pytestmark = pytest.mark.long

STRUT = Spring(stiffness_n_per_m=2e4, damping_n_s_per_m=15.0)


def coupled(quantity):
    """Two masses with a strut between them; the second, which no force shakes, meets a stop on the ground."""
    rig = chain(2, quantity, ground=True)
    return replace(rig, contacts=(replace(rig.contacts[0], name="strut", law=STRUT), rig.contacts[1]))


@pytest.fixture(scope="module", params=["acceleration", "displacement"])
def identified(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    case = Topology(coupled(request.param), 12.0, "")
    return identify_contact(read(recorded(case, folder / "r.mcap", duration_s=20.0)))


def test_a_spring_and_the_stop_beside_it_are_found(identified):
    strut, ground = identified.report.contacts
    assert (strut.law, ground.law) == ("spring", "dead zone")
    assert (strut.clearance_m.value, strut.clearance_m.standard_error, strut.closed_share) == (0.0, 0.0, None)
    for estimate, true, share in (
        (strut.stiffness_n_per_m, 2e4, 0.01),
        (strut.damping_n_s_per_m, 15.0, 0.1),
        (ground.clearance_m, 4e-4, 0.01),
        (ground.stiffness_n_per_m, 2e4, 0.02),
    ):
        assert abs(estimate.value - true) < 1.5 * COVERED * estimate.standard_error
        assert COVERED * estimate.standard_error < share * true
    assert not identified.report.findings


def test_a_spring_hands_the_force_on_to_a_stop_behind_it():
    """A strut that holds two masses together moves both; a strut of no stiffness moves the first alone."""
    rig = coupled("acceleration")
    rigid, loose = (
        replace(rig, contacts=(replace(rig.contacts[0], law=Spring(stiffness_n_per_m=k)), rig.contacts[1]))
        for k in (1e8, 0.0)
    )
    assert 1.0 < rattling(rigid, 0.5, 25.0).rms_n < 100.0
    assert "no contact has a clearance" in rattling(loose, 0.5, 25.0).why


@pytest.mark.study
def test_a_softer_spring_is_named(tmp_path):
    case = Topology(coupled("acceleration"), 12.0, "")
    effect = "contact_stiffness:factor=0.9,contact=strut"
    record = partial(recorded, case, duration_s=20.0, effect=effect)
    paths = [record(tmp_path / f"{seed}.mcap", seed=seed) for seed in (1, 2)]
    gap = identify.gap(*map(read, paths)).report
    assert gap.verdict == "explained"
    (factor,) = gap.causes[0].parameters.values()
    assert gap.causes[0].effects == ("contact_stiffness",)
    assert abs(factor.value - 0.9) < 1.5 * COVERED * factor.standard_error < 0.03


def test_the_page_tells_a_spring_without_a_clearance(identified, tmp_path):
    laws = {contact.name: contact.law for contact in identified.rig.contacts}
    write_results(identified, tmp_path, "struts", laws, "rig.json")
    text = (tmp_path / "contact.html").read_text(encoding="utf-8")
    estimate = identified.report.contacts[0].stiffness_n_per_m
    stiffness = interval(estimate.value, estimate.standard_error, "N/m")
    assert f"strut: stiffness {stiffness} (spring)" in text.replace("\N{NO-BREAK SPACE}", " ")
    assert "strut: clearance" not in text
