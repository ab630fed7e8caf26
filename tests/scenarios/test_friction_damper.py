"""The friction damper: measured data where it is there; and a simulated damper that always is."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

import identify
from identify.laws import SLIDING
from identify.laws.fitted_laws import Friction, monotonic_runs
from scenarios.friction_damper import SAMPLE_RATE_HZ, DamperLaw, app, damper_recording, read_mr_damper_file

DATA = Path(os.environ.get("FRICTION_DAMPER", "friction_damper"))
MR_DATA = Path(os.environ.get("MR_DAMPER", "mr_damper"))


def test_a_simulated_damper_is_identified():
    time_s = np.arange(round(16 * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    displacement = 0.025 * np.minimum(time_s / 4, 1) * np.sin(np.pi * time_s)
    law = Friction(upper_n=9e3, lower_n=6e3, backlash_m=4e-3, stiffness_n_per_m=5e6)
    noise = 200 * np.random.default_rng(1).standard_normal(time_s.size)
    recording = damper_recording(
        displacement, law.slider_n(monotonic_runs(displacement), displacement) + noise, "simulated"
    )
    found = identify.law(recording, seconds=3.0).report.laws[0]
    assert found.best == SLIDING
    for name in ("upper_n", "lower_n", "backlash_m", "stiffness_n_per_m"):
        estimate, true = getattr(found.sliding, name), getattr(law, name)
        assert abs(estimate.value - true) < max(4 * estimate.standard_error, 2e-3 * true)


def test_the_mr_damper_is_friction_with_a_damper_about_a_constant_force():
    """The authors' fit of Dahl's law: 57.4 N and 0.768 N s/mm; others up to 67 N and 0.91 N s/mm."""
    path = MR_DATA / "data_simulation_4.1_MRdamper.mat"
    if not path.exists():
        pytest.skip("no data_simulation_4.1_MRdamper.mat: let the environment variable MR_DAMPER name its folder")
    (law,) = identify.law(read_mr_damper_file(path), seconds=1.0).report.laws
    assert law.fits
    assert law.candidate(SLIDING).left_share < 0.15
    assert law.sliding.upper_n == law.sliding.lower_n
    for estimate, low, high in (
        (law.sliding.upper_n, 57.0, 67.0),
        (law.sliding.viscous_n_s_per_m, 700.0, 910.0),
        (law.sliding.constant_n, 110.0, 140.0),
    ):
        assert low - 1.96 * estimate.standard_error < estimate.value < high + 1.96 * estimate.standard_error
    assert law.sliding.backlash_m is None


@pytest.fixture(scope="module")
def laws(tmp_path_factory) -> list[DamperLaw]:
    if not list(DATA.glob("*lbtension.json")):
        pytest.skip("no *lbtension.json: let the environment variable FRICTION_DAMPER name its folder")
    out = tmp_path_factory.mktemp("friction_damper")
    result = CliRunner().invoke(app, ["--data", str(DATA), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert (out / "friction_damper.png").stat().st_size > 10_000
    return msgspec.json.decode((out / "friction_damper.json").read_bytes(), type=list[DamperLaw])


def test_the_measured_damper_slides_behind_a_backlash(laws):
    assert {one.law.best for one in laws} == {SLIDING}
    assert all(0.002 < one.law.sliding.backlash_m.value < 0.005 for one in laws)


def test_the_sliding_force_rises_with_the_tension_of_the_band(laws):
    sliding_n = {one.file: one.law.sliding.upper_n.value + one.law.sliding.lower_n.value for one in laws}
    for hz in ("0.5", "1"):
        sums = [sliding_n[f"{hz}Hz{tension_lb}lbtension.json"] for tension_lb in (20, 25, 70)]
        assert sums == sorted(sums)
        assert sums[-1] > 2 * sums[0]


def test_a_folder_without_data_is_said(tmp_path):
    from rig.errors import RigError

    result = CliRunner().invoke(app, ["--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, RigError)
    assert "holds no file like *lbtension.json or *_MRdamper.mat or SNLS80mV.csv" in str(result.exception)
