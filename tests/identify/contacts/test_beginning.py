"""Records that do not begin at rest, or whose start tells no noise."""

from dataclasses import replace

import numpy as np
import pytest

from identify.contacts import identify_contact
from rig.recording import read
from rig.simulation.reference import BarrelCradle, Sdof

FIRST_S = 5.0
RIGS = {
    "one mass, displacement": Sdof(duration_s=40.0, step_s=2.0**-12, sensors="displacement"),
    "one mass, accelerometer": Sdof(duration_s=40.0, step_s=2.0**-12, sensors="acceleration", noise_density=1e-3),
    "beams, displacements": BarrelCradle(duration_s=30.0, sensors="displacement"),
    "beams, accelerometers": BarrelCradle(duration_s=30.0, sensors="acceleration", noise_density=1e-3),
}


@pytest.mark.parametrize("name", RIGS)
def test_a_record_cut_from_a_longer_one_tells_the_contacts(name, simulate, tmp_path):
    whole = read(simulate(RIGS[name], tmp_path / "r.mcap"))
    first = round(FIRST_S * whole.rig.sample_rate_hz)
    signals = {k: replace(s, values=np.ascontiguousarray(s.values[:, first:])) for k, s in whole.signals.items()}
    report = identify_contact(replace(whole, signals=signals)).report
    assert report.findings == ()
    assert report.noise_from != "the quiet start of the record"
    for found, contact in zip(report.contacts, whole.rig.contacts, strict=True):
        for estimate, true in (
            (found.clearance_m, contact.law.lower_clearance_m),
            (found.stiffness_n_per_m, contact.law.stiffness_n_per_m),
        ):
            assert abs(estimate.value - true) < 3 * estimate.standard_error
            assert estimate.standard_error < 0.01 * true
