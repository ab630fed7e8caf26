"""A stop that moves a mode beyond the recorded band says so; at a higher rate it does not."""

import numpy as np
import pytest

from identify.contacts.acceptance import estimated_contacts
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Rig, Sensor, Station
from rig.model.structure import structure_of
from rig.model.tolerances import LABORATORY
from tests.identify.contacts.remedies import made

PLACES_M = np.array([0.0, 0.5, 1.0])
SHAPES = np.array([[1.0, 0.9], [1.0, -0.3], [1.0, 1.2]])
"""Of 1 kg: a spring at 6 Hz, and a lightly damped mode at 330 Hz."""
STOP = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=5e4, damping_n_s_per_m=5.0)


@pytest.mark.parametrize(("rate_hz", "is_found"), [(512.0, True), (2048.0, False)])
def test_a_mode_that_rings_beyond_the_band_is_a_finding(rate_hz, is_found, tmp_path):
    body = structure_of("body", 1.0, np.array([6.0, 330.0]), np.array([0.02, 0.002]), PLACES_M, SHAPES)
    sensors = tuple(
        Sensor(name=f"s{k}_{quantity}", station=Station("body", x), quantity=quantity)
        for quantity in ("displacement", "acceleration")
        for k, x in enumerate(PLACES_M.tolist())
    )
    contact = Contact(name="stop", at=Station("body", 1.0), law=STOP)
    described = Rig(
        name="r",
        bodies=(body,),
        contacts=(contact,),
        force_at=Station("body", 0.0),
        sensors=sensors,
        sample_rate_hz=rate_hz,
    )
    findings = estimated_contacts(made(described)(tmp_path), "auto", LABORATORY).findings
    assert any("beyond the recorded band" in finding.evidence for finding in findings) == is_found
