"""A beam's own modes given as data: every identification gives the answers that it gives with the beam itself."""

from functools import cache

import msgspec
import numpy as np
import pytest

from identify.contacts import identify_contact
from identify.contacts.acceptance import contacts_after_recording_check
from identify.contacts.report import write_results
from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.nuisance import nuisance_columns_of
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates
from rig.effects.base import Scale
from rig.model.description import Rig
from rig.model.structure import structure_of
from rig.model.tolerances import EXACT, LABORATORY
from rig.recording import Recording, read
from scenarios.jitter import jittered

pytestmark = pytest.mark.long

FINELY = np.linspace(0, 1, 401)


def as_data(rig: Rig, n: int = 40) -> Rig:
    """With all modes that a beam has, or the first n, finely enough for slopes; exact at the stations in any case."""
    bodies = tuple(
        structure_of(b.name, b.length_m, b.frequencies_hz(n), b.damping_ratios(n), FINELY, b.shapes(FINELY, n))
        for b in rig.bodies
    )
    return msgspec.structs.replace(rig, bodies=bodies)


@pytest.fixture(scope="module")
def recordings(barrel_cradle) -> tuple[Recording, Recording]:
    """The same signals, believed to come from beams and from structures."""
    beams = read(barrel_cradle)
    return beams, Recording(as_data(beams.rig), beams.signals, beams.provenance)


@pytest.fixture(scope="module")
def identified(recordings):
    """Function that identifies the contacts of both by sensors of one kind, once."""
    return cache(lambda use: [identify_contact(r, use=use, tolerances=EXACT) for r in recordings])


def numbers(report) -> np.ndarray:
    return np.array(
        [v for c in report.contacts for x in (c.clearance_m, c.stiffness_n_per_m) for v in (x.value, x.standard_error)]
    )


@pytest.mark.parametrize("use", [pytest.param("displacement", marks=pytest.mark.study), "acceleration"])
def test_contacts_come_out_the_same_to_rounding(identified, use):
    beams, data = (identification.report for identification in identified(use))
    np.testing.assert_allclose(numbers(data), numbers(beams), rtol=1e-6)
    assert len(numbers(beams)) == 8
    for one, other in zip(data.nifo, beams.nifo, strict=True):
        assert one.equation == other.equation
        for a, b in zip(one.stiffness, other.stiffness, strict=True):
            assert a.mean_n_per_m.value == pytest.approx(b.mean_n_per_m.value, rel=1e-6)
    assert [m.frequency_hz for m in data.modes] == pytest.approx([m.frequency_hz for m in beams.modes], rel=1e-6)


def test_modes_left_out_are_in_the_intervals(recordings):
    beams, _ = recordings
    seven_modes = Recording(as_data(beams.rig, 7), beams.signals, beams.provenance)
    pulls = []
    for tolerances in (LABORATORY, msgspec.structs.replace(LABORATORY, truncation=0.0)):
        estimates = contacts_after_recording_check(seven_modes, "acceleration", tolerances).outcomes.estimates
        assert len(estimates) == 2
        pulls.append([(e.stiffness_n_per_m - 1e5) / e.errors[2] for e in estimates.values()])
    assert np.abs(pulls[0]).max() < 1.96
    assert np.abs(pulls[1]).min() > 1.96


@pytest.mark.study
def test_the_page_is_accessible(inaccessible, identified, tmp_path):
    _, data = identified("acceleration")
    write_results(data, tmp_path, "a structure", {c.name: c.law for c in data.rig.contacts}, "true")
    path = tmp_path / "contact.html"
    assert path.stat().st_size < 3e6
    assert inaccessible(path, 375) == []


@pytest.mark.study
def test_slopes_by_the_spline_leave_the_tolerances_what_they_are(recordings):
    beams, data = (identify_contact(r, use="acceleration", tolerances=LABORATORY).report for r in recordings)
    np.testing.assert_allclose(numbers(data), numbers(beams), rtol=1e-3)


def test_the_diagnosis_sees_the_same_residual_and_the_same_nuisance_columns(recordings):
    both = []
    for recording in recordings:
        record = record_of(recording)
        model = linear_model(record, recording.rig, LABORATORY.unmodelled)
        both.append((model, nuisance_columns_of(record, model)))
    (beam, of_beam), (data, of_data) = both
    for one, other in (
        (data.residual, beam.residual),
        (data.contact_force_n, beam.contact_force_n),
        (data.eta_m, beam.eta_m),
    ):
        np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(other).max())
    assert of_data.parameters == of_beam.parameters
    np.testing.assert_allclose(of_data.residual, of_beam.residual, atol=1e-3 * np.abs(of_beam.residual).max())


def test_what_makes_no_sense_for_a_basis_is_no_candidate(recordings):
    beams, data = ({c.kind.name for c in candidates(Scale(r.rig, 14.0, r.duration_s), ["a"], True)} for r in recordings)
    # how the base carries what is clamped, a basis does not say
    assert beams - data == {"youngs_modulus", "clamp_compliance", "contact_position", "base_motion"}
    assert data <= beams


def test_jitter_draws_the_same_laboratory(recordings):
    beams, data = (jittered(r.rig, np.random.default_rng(1)) for r in recordings)
    assert data.sensors == beams.sensors
    for one, other in zip(data.bodies, beams.bodies, strict=True):
        np.testing.assert_allclose(one.frequencies_hz(8), other.frequencies_hz(8))
        np.testing.assert_allclose(one.damping_ratios(8), other.damping_ratios(8))
