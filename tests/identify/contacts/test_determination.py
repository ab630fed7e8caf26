"""Stops of one mass, one behind the other: all told from the sum of their forces, or refused in one sentence."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.contacts import identify_contact
from identify.contacts.refusals import RefusalCode
from identify.contacts.results import identified_rig
from rig.model.description import Contact, Rig
from rig.recording import read
from tests.campaigns.topologies import Topology, chain, progressive_stop, recorded

STOPS = ((5e-4, 8e3), (1e-3, 1e5))


def report(tmp_path, believed: Rig, true: Rig, rms_n: float = 12.0):
    path = tmp_path / "r.mcap"
    recorded(Topology(believed, rms_n, ""), path, duration_s=12.0, actual=true)
    return identify_contact(read(path)).report


def codes(result):
    return {u.name: u.code for u in result.unanswered}


def is_within(estimate, value, share):
    return abs(estimate.value - value) < min(share * value, 3 * estimate.standard_error)


def assert_told(contacts, stops):
    """Clearance and stiffness of every stop within 1 and 5 %, and within three standard errors."""
    for contact, (clearance_m, stiffness) in zip(contacts, stops, strict=True):
        assert is_within(contact.clearance_m, clearance_m, 0.01)
        assert is_within(contact.stiffness_n_per_m, stiffness, 0.05)


@pytest.mark.parametrize("quantity", [pytest.param("displacement", marks=pytest.mark.study), "acceleration"])
def test_both_stops_are_told_where_rig_json_is_wrong_by_tens_of_per_cent(tmp_path, quantity):
    believed = progressive_stop(quantity, (6.5e-4, 2e4), (8e-4, 6e4))
    result = report(tmp_path, believed, progressive_stop(quantity, *STOPS))
    assert [c.name for c in result.contacts] == ["bumper", "hard stop"]
    assert_told(result.contacts, STOPS)
    assert not result.findings
    assert result.surface.histogram == ()


def test_one_stop_alone_is_told_of_a_mass_on_a_spring(tmp_path):
    rig = chain(1, "displacement", ground=True)
    (stop,) = rig.contacts
    rig = replace(rig, contacts=(replace(stop, law=replace(stop.law, lower_clearance_m=np.inf)),))
    result = report(tmp_path, rig, rig, 4.0)
    (contact,) = result.contacts
    assert contact.lower_clearance_m is None
    assert is_within(contact.clearance_m, stop.law.upper_clearance_m, 0.01)
    assert is_within(contact.stiffness_n_per_m, stop.law.stiffness_n_per_m, 0.02)
    assert identified_rig(rig, result).contacts[0].law.lower_clearance_m == np.inf


def test_a_free_body_by_accelerometers_has_no_play_of_which_half_could_be_told(tmp_path):
    """Two free masses at two stops, and a description that leaves one of them out."""
    rig = chain(2, "acceleration", ground=False)
    free = tuple(replace(b, frequency_hz=0.0, damping_ratio=0.0) for b in rig.bodies)
    rig = replace(rig, bodies=free)
    (stop,) = rig.contacts
    believed = replace(rig, contacts=(replace(stop, law=replace(stop.law, lower_clearance_m=np.inf)),))
    assert codes(report(tmp_path, rig, rig, 8.0)) == {}
    assert codes(report(tmp_path, believed, rig, 8.0)) == {stop.name: RefusalCode.ONE_STOP_TOUCHED}


@pytest.mark.parametrize("absent_m", [1.0, np.inf])
def test_stops_on_opposite_sides_and_counted_in_opposite_directions(tmp_path, absent_m):
    """Between two masses: one stop above, and one below that is counted the other way round."""
    rig = chain(2, "displacement", ground=False)
    (above,) = rig.contacts
    law = replace(above.law, lower_clearance_m=absent_m)
    law_below = replace(law, upper_clearance_m=7e-4, stiffness_n_per_m=5e4)
    below = Contact(name="below", at=above.against, against=above.at, law=law_below)
    rig = replace(rig, contacts=(replace(above, law=law), below))
    result = report(tmp_path, rig, rig, 8.0)
    for contact, true in zip(result.contacts, rig.contacts, strict=True):
        assert contact.lower_clearance_m is None
        assert is_within(contact.upper_clearance_m, true.law.upper_clearance_m, 0.01)
        assert is_within(contact.stiffness_n_per_m, true.law.stiffness_n_per_m, 0.02)


def test_knees_that_coincide_are_told_of_no_stop(tmp_path):
    coincident = progressive_stop("displacement", (7e-4, 8e3), (7e-4, 5e4))
    result = report(tmp_path, progressive_stop("displacement", *STOPS), coincident)
    assert not result.contacts
    assert list(codes(result).values()) == 2 * [RefusalCode.NOT_SEPARABLE]


@pytest.mark.study
def test_stops_that_are_believed_alike_are_told_apart_by_their_stiffness_alone(tmp_path):
    """Clearances are believed in the wrong order; the harder one is known to be that."""
    true = progressive_stop("displacement", *STOPS)
    alike = report(tmp_path, progressive_stop("displacement", (7e-4, 3e4), (6.5e-4, 3e4)), true)
    assert not alike.contacts
    assert list(codes(alike).values()) == 2 * [RefusalCode.INTERCHANGEABLE]
    result = report(tmp_path, progressive_stop("displacement", (7e-4, 1e4), (6.5e-4, 8e4)), true)
    assert_told(result.contacts, STOPS)


def test_a_stop_that_is_not_reached_is_refused_alone(tmp_path):
    rig = progressive_stop("acceleration", (2e-4, 8e3), (2e-3, 1e5))
    result = report(tmp_path, rig, rig, 2.0)
    (bumper,) = result.contacts
    assert bumper.name == "bumper"
    assert is_within(bumper.clearance_m, 2e-4, 0.02)
    (hard_stop,) = result.unanswered
    assert (hard_stop.name, hard_stop.code) == ("hard stop", RefusalCode.NOT_REACHED)
    assert hard_stop.evidence["stop_mm"] == pytest.approx(2.0)
    assert 0.2 < hard_stop.evidence["reach_mm"] < 2.0
    assert hard_stop.reason.startswith("its stops, by rig.json 2 mm away, are not reached")


def test_three_stops(tmp_path):
    stops = ((4e-4, 9e3), (7e-4, 4e4), (1e-3, 1.6e5))
    rig = progressive_stop("acceleration", *STOPS)
    contacts = [
        replace(rig.contacts[0], name=str(k), law=progressive_stop("acceleration", law).contacts[0].law)
        for k, law in enumerate(stops)
    ]
    rig = replace(rig, contacts=tuple(contacts))
    result = report(tmp_path, rig, rig, 25.0)
    assert_told(result.contacts, stops)


def test_no_number_is_told_of_the_first_where_the_second_has_no_knee(tmp_path):
    """The record of one stop twice as stiff, of which rig.json believes that there are two."""
    rng = np.random.default_rng(5)
    clearances = 5e-4 * (1 + rng.uniform(0.1, 0.6, 2).cumsum())
    rig = progressive_stop("displacement", *((float(c), 2e4) for c in clearances))
    result = report(tmp_path, rig, progressive_stop("displacement", (6e-4, 4e4)))
    assert not result.contacts
    assert len(codes(result)) == 2
