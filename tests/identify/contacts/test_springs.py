"""Springs between bodies: described as a contact's law, simulated, identified, planned, drawn and diagnosed."""

from functools import partial

import pytest
from msgspec.structs import replace

import identify
from identify.contacts.identification import identify_contact
from identify.contacts.report import write_results
from identify.pages.wording import COVERED, interval
from rig.model.contact_laws.spring import Spring
from rig.model.force_level import rattling_level
from rig.recording import read
from tests.campaigns.topologies import Topology, chain, one_mass, progressive_stop, recorded

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


def beside(rig, *springs):
    """The rig with springs between the places of its first contact, counted from the other side."""
    contact = rig.contacts[0]
    at, against = (contact.at, None) if contact.against is None else (contact.against, contact.at)
    struts = [replace(contact, name=f"strut {k}", at=at, against=against, law=s) for k, s in enumerate(springs, 1)]
    return replace(rig, contacts=(*struts, *rig.contacts))


def outcomes(rig, rms_n, folder, duration_s=12.0):
    return identify_contact(read(recorded(Topology(rig, rms_n, ""), folder / "r.mcap", duration_s=duration_s)))


@pytest.mark.parametrize("stiffness_n_per_m", [1e3, 4e4])
@pytest.mark.parametrize("quantity", ["acceleration", "displacement"])
def test_a_spring_between_the_places_of_a_stop_is_found_with_it(quantity, stiffness_n_per_m, tmp_path):
    """The spring may be softer than the stop or stiffer."""
    rig = beside(one_mass(4e-4, quantity=quantity), Spring(stiffness_n_per_m=stiffness_n_per_m, damping_n_s_per_m=5.0))
    strut, stop = outcomes(rig, 20.0, tmp_path, 24.0).report.contacts
    assert (strut.law, stop.law) == ("spring", "dead zone")
    for estimate, true in (
        (strut.stiffness_n_per_m, stiffness_n_per_m),
        (strut.damping_n_s_per_m, 5.0),
        (stop.clearance_m, 4e-4),
        (stop.stiffness_n_per_m, 2e4),
    ):
        assert abs(estimate.value - true) < 1.5 * COVERED * estimate.standard_error
    assert COVERED * strut.stiffness_n_per_m.standard_error < 200.0 + 0.01 * stiffness_n_per_m
    assert COVERED * stop.clearance_m.standard_error < 0.02 * 4e-4


def test_a_spring_between_two_bodies_is_found_with_the_stop_of_one_side_beside_it(tmp_path):
    rig = chain(2, "displacement", ground=False)
    stop = replace(rig.contacts[0], law=replace(rig.contacts[0].law, lower_clearance_m=float("inf")))
    report = outcomes(beside(replace(rig, contacts=(stop,)), STRUT), 12.0, tmp_path).report
    strut, stop = report.contacts
    assert abs(strut.stiffness_n_per_m.value - 2e4) < 1.5 * COVERED * strut.stiffness_n_per_m.standard_error
    assert abs(stop.clearance_m.value - 4e-4) < 1.5 * COVERED * stop.clearance_m.standard_error < 0.02 * 4e-4
    assert stop.lower_clearance_m is None


@pytest.mark.study
@pytest.mark.parametrize("quantity", ["acceleration", "displacement"])
def test_a_spring_is_found_with_two_stops_at_its_place(quantity, tmp_path):
    rig = beside(progressive_stop(quantity), Spring(stiffness_n_per_m=3e3, damping_n_s_per_m=5.0))
    strut, bumper, hard = outcomes(rig, 20.0, tmp_path, 20.0).report.contacts
    for estimate, true in (
        (strut.stiffness_n_per_m, 3e3),
        (bumper.clearance_m, 5e-4),
        (hard.clearance_m, 1e-3),
        (hard.stiffness_n_per_m, 1e5),
    ):
        assert abs(estimate.value - true) < 1.5 * COVERED * estimate.standard_error < 0.1 * true


def test_a_spring_is_found_without_the_stop_beside_it_that_is_not_reached(tmp_path):
    found = outcomes(beside(one_mass(4e-3), STRUT), 6.0, tmp_path)
    (strut,), (stop,) = found.report.contacts, found.report.unanswered
    assert abs(strut.stiffness_n_per_m.value - 2e4) < 1.5 * COVERED * strut.stiffness_n_per_m.standard_error
    assert stop.code == "not_reached"


def test_two_springs_between_the_same_places_are_refused(tmp_path):
    found = outcomes(beside(one_mass(4e-4), STRUT, STRUT), 6.0, tmp_path)
    assert {u.reason for u in found.report.unanswered} == {
        "2 springs stand between the same places, of which a record tells 1 at most; describe them as fewer"
    }


def test_a_spring_hands_the_force_on_to_a_stop_behind_it():
    """A strut that holds two masses together moves both; a strut of no stiffness moves the first alone."""
    rig = coupled("acceleration")
    rigid, loose = (
        replace(rig, contacts=(replace(rig.contacts[0], law=Spring(stiffness_n_per_m=k)), rig.contacts[1]))
        for k in (1e8, 0.0)
    )
    assert 1.0 < rattling_level(rigid, 0.5, 25.0).rms_n < 100.0
    assert "no contact has a clearance" in rattling_level(loose, 0.5, 25.0).reason


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
