"""The EMPS carriage: measured data diagnosed where it is there; what is said where it is not."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from scipy.io import savemat
from typer.testing import CliRunner

from rig.errors import RigError
from rig.model.description import to_json
from scenarios.emps import FILE_NAMES, SAMPLE_RATE_HZ, CarriageDiagnosis, app, carriage, error_mm, import_benchmark
from scenarios.measured_data import simulated

DATA = Path(os.environ.get("EMPS", "emps"))


@pytest.fixture(scope="module")
def judged(tmp_path_factory) -> CarriageDiagnosis:
    if not (DATA / FILE_NAMES["fit"]).exists():
        pytest.skip(f"no {FILE_NAMES['fit']}: let the environment variable EMPS name its folder")
    out = tmp_path_factory.mktemp("emps")
    result = CliRunner().invoke(app, ["--data", str(DATA), "--out", str(out)])
    assert result.exit_code == 0, result.output
    return msgspec.json.decode((out / "emps.json").read_bytes(), type=CarriageDiagnosis)


def test_friction_and_offset_are_named(judged):
    """By regression on the true velocity: 20.4 N and 3.2 N (Janot, Gautier, Brunot, 2019)."""
    assert {"ground_friction", "preload"} <= set(judged.effects)
    friction = sum(damper.friction_n for damper in judged.corrected.dampers)
    (load,) = judged.corrected.loads
    assert friction == pytest.approx(20.4, rel=0.08)
    assert load.force_n == pytest.approx(3.2, abs=0.6)
    assert judged.corrected.bodies[0].mass_kg == pytest.approx(95.1, rel=0.03)


def test_the_corrected_carriage_runs_where_the_machine_does(judged):
    assert judged.believed_mm["pulses"] > 100
    assert judged.corrected_mm["pulses"] < 10  # with the regression's numbers 8.7 mm


def test_a_record_is_imported_with_the_gain_of_the_file_and_run_again(tmp_path):
    """A push of 1 s by 95.1 N; the carriage then coasts against its damper."""
    time_s = np.arange(round(4 * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    force_n = np.where((time_s > 0.5) & (time_s < 1.5), 95.1, 0.0)
    position_m = simulated(carriage(), carriage(), force_n, 1).signals["displacement"].values[0]
    path, gain_n_per_v = tmp_path / FILE_NAMES["fit"], 35.15
    savemat(path, {"t": time_s, "qm": position_m, "vir": force_n / gain_n_per_v, "gtau": gain_n_per_v})
    (tmp_path / "rig.json").write_bytes(to_json(carriage()))
    record = import_benchmark(path, tmp_path, "fit")
    np.testing.assert_allclose(record.force_n, force_n, atol=1e-9)
    assert error_mm(carriage(), record) < 1e-3
    heavier = replace(carriage(), bodies=(carriage().bodies[0].scale_mass(1.1),))
    assert error_mm(heavier, record) > 1


def test_a_folder_without_data_is_said(tmp_path):
    result = CliRunner().invoke(app, ["--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, RigError)
    assert "DATA_EMPS.mat: cannot be read" in str(result.exception)
