"""Contacts of bodies that springs hold, by accelerometers alone: what the noise of all stations adds slowly to a
separated force is no drift of the contact. Machines of the blind check, simulated by another program."""

import pytest

from identify.contacts.acceptance import estimated_contacts
from identify.pages.wording import COVERED
from rig.model.tolerances import LABORATORY
from rig.recording import read
from tests.campaigns.worlds.making import Planned, made


def identified_and_true(folder, number):
    """Estimate of the one contact of a machine of the world `bench`, and its true law."""
    for name in ("recordings", "sealed/work"):
        (folder / name).mkdir(parents=True)
    plan = Planned(folder=str(folder), world="bench", seed=99422, number=number, nulls_only=True, duration_s=30.0)
    case = made(plan)
    recording = read(folder / "recordings" / case.records[0].file)
    (estimate,) = estimated_contacts(recording, "acceleration", LABORATORY).outcomes.estimates.values()
    return estimate, case.true.contacts[0].law


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(7, id="frame with a bumper"),
        pytest.param(13, id="cantilever with a stop on one side", marks=pytest.mark.study),
    ],
)
def test_the_noise_of_other_stations_is_no_drift_of_a_contact(number, tmp_path):
    estimate, true_law = identified_and_true(tmp_path, number)
    stiffness_error = estimate.errors[2] / estimate.stiffness_n_per_m
    assert stiffness_error < 0.01
    assert abs(estimate.stiffness_n_per_m / true_law.stiffness_above_n_per_m - 1) < COVERED * stiffness_error
    assert estimate.values[1] == pytest.approx(true_law.upper_m, abs=COVERED * estimate.errors[1])
    assert estimate.errors[1] < 0.02 * true_law.upper_m
