"""An FMU, run by another program, moves as the plant does."""

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from msgspec.structs import replace

from rig.errors import RigError
from rig.model.description import BaseMotion, to_json
from rig.simulation.excitation import force_history
from rig.simulation.fmu import export_fmu
from rig.simulation.motion import concatenated
from rig.simulation.plants import modal
from rig.simulation.reference import Sdof
from tests.running import exit_status

STEP_S = 2.0**-12


@pytest.fixture
def written(tmp_path):
    rig = Sdof(sensors="displacement+acceleration").rig()
    (tmp_path / "rig.json").write_bytes(to_json(rig))
    words = ["rig", "fmu", str(tmp_path / "rig.json"), "--step", str(STEP_S), "--out", str(tmp_path / "rig.fmu")]
    assert exit_status(*words) == 0
    return rig, str(tmp_path / "rig.fmu")


def test_its_variables_are_the_force_the_sensors_and_the_contacts(written):
    rig, path = written
    description = read_model_description(path)
    assert description.fmiVersion == "3.0"
    assert [v.name for v in description.modelVariables if v.causality == "input"] == ["force"]
    outputs = {v.name: v.description for v in description.modelVariables if v.causality == "output"}
    assert outputs == {
        "sensors.mass_0000mm_displacement": "displacement, m",
        "sensors.mass_0000mm_acceleration": "acceleration, m/s^2",
        "contacts.stop.eta": "relative displacement, m",
        "contacts.stop.force": "contact force, N",
    }
    assert len(rig.sensors) == 2


def test_it_moves_as_the_plant_over_a_fifth_of_a_second_of_contact(written):
    rig, path = written
    force_n = force_history(Sdof(rms_n=2.0).force(), 8.0, STEP_S)
    force_n[0] = 0.0
    motion = concatenated(modal.simulate(rig, force_n, STEP_S, lambda _: None))
    closed = np.cumsum(np.abs(motion.contact_force_n[0]) > 0) * STEP_S
    until = int(np.argmax(closed > 0.2))
    assert until
    force_table = np.array(
        [*zip(np.arange(until) * STEP_S, force_n, strict=False)], [("time", float), ("force", float)]
    )
    clock = {"stop_time": until * STEP_S, "step_size": STEP_S, "output_interval": STEP_S}
    ran = simulate_fmu(path, input=force_table, output=["contacts.stop.eta"], **clock)
    eta_m, expected_m = ran["contacts.stop.eta"][1 : until + 1], motion.eta_m[0, :until]
    assert np.abs(eta_m - expected_m).max() < 1e-4 * np.abs(expected_m).max()


def test_a_rig_on_a_shaking_base_is_refused(tmp_path):
    rig = replace(Sdof().rig(), base_motion=BaseMotion(acceleration_rms_m_per_s2=1.0, low_hz=5.0, high_hz=9.0))
    with pytest.raises(RigError, match="its base shakes"):
        export_fmu(rig, tmp_path / "rig.fmu")
    assert list(tmp_path.iterdir()) == []
