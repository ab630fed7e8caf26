"""Laws of a contact other than a dead zone are named where the record asks for them; what a law leaves is in the
intervals; stops that are not there, and noise, do not spoil them."""

from dataclasses import replace as replace_case

import numpy as np
import pytest
from msgspec.structs import replace

from identify.contacts import identify_contact
from identify.contacts.acceptance import estimated_contacts
from identify.contacts.law_form import STIFFNESS_GRADIENT
from identify.contacts.results import identified_rig
from rig.model.contact_laws import DeadZone
from rig.model.tolerances import LABORATORY
from rig.recording import read
from tests.campaigns.topologies import Topology, cantilever, one_mass, recorded
from tests.campaigns.worlds.bench import BENCHES
from tests.campaigns.worlds.describing import described
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.making import write
from tests.campaigns.worlds.tolerances import built

CLEARANCE_M = 5e-4
MASS = Topology(one_mass(CLEARANCE_M), 12.0, "")
LAWS = {
    "dead zone": {},
    "power law": {"exponent": 1.15, "reference_depth_m": 1e-4},
    "cannot pull": {"damping_n_s_per_m": 59.0, "pulls": False},
}


@pytest.fixture(scope="module", params=LAWS)
def case(request, tmp_path_factory):
    """A law that rig.json believes to be a dead zone, its name and what was recorded of it."""
    (contact,) = MASS.rig.contacts
    law = replace(contact.law, **LAWS[request.param])
    actual = replace(MASS.rig, contacts=(replace(contact, law=law),))
    path = tmp_path_factory.mktemp("law") / "r.mcap"
    return request.param, law, read(recorded(MASS, path, duration_s=16.0, actual=actual))


def test_the_law_that_the_record_asks_for_is_named(case):
    name, law, recording = case
    identification = identify_contact(recording)
    (contact,) = identification.report.contacts
    stiffness = law.stiffness_n_per_m
    if contact.reference_depth_m:
        stiffness *= (contact.reference_depth_m / law.reference_depth_m) ** (law.exponent - 1)
    pairs = [(contact.clearance_m, CLEARANCE_M), (contact.stiffness_n_per_m, stiffness)]
    pairs += [(contact.damping_n_s_per_m, law.damping_n_s_per_m)]
    pairs += [(contact.exponent, law.exponent)] if contact.exponent else []
    assert contact.law == name
    assert (contact.exponent is not None) == (name == "power law")
    assert (name in contact.law_sentence.replace("follows a power law", "power law")) == (name != "dead zone")
    assert all(abs(estimate.value - value) < 3 * estimate.standard_error for estimate, value in pairs)
    closed = np.mean(np.abs(recording["mass_0000"]) > CLEARANCE_M)
    assert contact.closed_share == pytest.approx(closed, abs=0.01)
    law = identified_rig(identification.rig, identification.report).contacts[0].law
    assert (law.pulls, law.exponent > 1) == (name != "cannot pull", name == "power law")


def test_what_the_law_leaves_enters_the_intervals(case):
    """Where the record's own law is not among those that are tried; those of a dead zone stay as they are."""
    name, law, recording = case
    by_others = {"power law": ("cannot pull",)}.get(name, ("power law",))
    estimate = estimated_contacts(recording, "auto", LABORATORY, by_others).outcomes.estimates["stop_1"]
    assert estimate.form.name == "dead zone"
    without_misfit = replace_case(estimate, covariances={**estimate.covariances, "law": np.zeros((4, 4))})
    widened = estimate.error(STIFFNESS_GRADIENT) / without_misfit.error(STIFFNESS_GRADIENT)
    assert widened < 1.05 if name == "dead zone" else widened > 1.5
    if name == "cannot pull":
        assert abs(estimate.stiffness_n_per_m - law.stiffness_n_per_m) < 3 * estimate.error(STIFFNESS_GRADIENT)


def test_a_stop_that_is_described_far_away_is_not_there(tmp_path):
    rig = cantilever("acceleration")
    (tip,) = rig.contacts
    law = replace(tip.law, lower_clearance_m=1.0)
    rig = replace(rig, contacts=(replace(tip, law=law),), sensors=rig.sensors[1:])
    identification = identify_contact(read(recorded(Topology(rig, 10.0, ""), tmp_path / "r.mcap", duration_s=14.0)))
    (contact,) = identification.report.contacts
    assert contact.lower_clearance_m is None
    for estimate, value in ((contact.clearance_m, 1e-3), (contact.stiffness_n_per_m, law.stiffness_n_per_m)):
        assert abs(estimate.value - value) < 3 * estimate.standard_error
    (stops,) = identification.stops
    assert (stops.clearance_m, stops.clearance_error_m) == (stops.upper_m, stops.upper_error_m)


def test_noise_does_not_refuse_a_free_decay(tmp_path):
    """Of a mass whose displacement is measured with 50 nm/sqrt(Hz), which is stated."""
    machine, records, tolerances = np.random.default_rng([35, 2]).spawn(3)
    bench = BENCHES["mass_decay"].drawn(machine, records)
    rig, true = described(bench.nominal, bench.name, bench.sample_rate_hz), built(bench.nominal, tolerances)
    samples = round(20 * rig.sample_rate_hz)
    write(tmp_path / "r.mcap", rig, measured(true, bench.excitations[0], samples, rig.sample_rate_hz, 2))
    (contact,) = identify_contact(read(tmp_path / "r.mcap")).report.contacts
    law = true.contacts[0].law
    for estimate, value in (
        (contact.upper_clearance_m, law.upper_m),
        (contact.stiffness_n_per_m, law.stiffness_above_n_per_m),
    ):
        assert abs(estimate.value - value) < 3 * estimate.standard_error < 0.3 * value


def test_a_stop_that_cannot_pull_only_presses():
    law = DeadZone(
        lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4, damping_n_s_per_m=50.0, pulls=False
    )
    eta, rate = np.array([2e-3, 2e-3, -2e-3, -2e-3, 0.0]), np.array([0.1, -0.4, -0.1, 0.4, 0.4])
    np.testing.assert_allclose(law.force_n(eta, rate), [15.0, 0.0, -15.0, 0.0, 0.0], rtol=1e-12)


def test_friction_that_rig_json_lacks_is_told_and_no_damping_of_the_stop(tmp_path):
    (contact,) = MASS.rig.contacts
    law = replace(contact.law, friction_n=1.0, damping_n_s_per_m=6.0)
    actual = replace(MASS.rig, contacts=(replace(contact, law=law),))
    recording = read(recorded(MASS, tmp_path / "r.mcap", duration_s=16.0, actual=actual))
    report = identify_contact(recording).report
    (found,) = report.contacts
    for estimate, value in (
        (found.clearance_m, CLEARANCE_M),
        (found.stiffness_n_per_m, law.stiffness_n_per_m),
        (found.damping_n_s_per_m, law.damping_n_s_per_m),
    ):
        assert abs(estimate.value - value) < 3 * estimate.standard_error
        assert estimate.standard_error < 0.1 * value
    (told,) = [finding.evidence for finding in report.findings if finding.cause == "fit"]
    assert float(told.removeprefix("while stop_1 is open, ").split(" N act")[0]) == pytest.approx(1.0, abs=0.02)


def test_a_mass_whose_stops_are_closed_most_of_the_time_is_not_called_stiffer(tmp_path):
    (contact,) = MASS.rig.contacts
    law = replace(contact.law, damping_n_s_per_m=6.0)
    actual = replace(MASS.rig, contacts=(replace(contact, law=law),))
    recording = read(recorded(MASS, tmp_path / "r.mcap", duration_s=16.0, actual=actual))
    assert not identify_contact(recording).report.findings
