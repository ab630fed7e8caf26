"""The friction damper: measured data where it is there; and a simulated damper that always is."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from typer.testing import CliRunner

import identify
from identify.laws import SLIDING
from identify.laws.fitted_laws import BacklashFriction
from scenarios.friction_damper import SAMPLE_RATE_HZ, DamperLaw, app, damper_recording

DATA = Path(os.environ.get("FRICTION_DAMPER", "friction_damper"))


def test_a_simulated_damper_is_identified():
    time_s = np.arange(round(16 * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    displacement = 0.025 * np.minimum(time_s / 4, 1) * np.sin(np.pi * time_s)
    law = BacklashFriction(upper_n=9e3, lower_n=6e3, backlash_m=4e-3, stiffness_n_per_m=5e6)
    noise = 200 * np.random.default_rng(1).standard_normal(time_s.size)
    recording = damper_recording(displacement, law(displacement) + noise, "simulated")
    found = identify.law(recording, seconds=3.0).report.laws[0]
    assert found.best == SLIDING
    for name in ("upper_n", "lower_n", "backlash_m", "stiffness_n_per_m"):
        estimate, true = getattr(found.sliding, name), getattr(law, name)
        assert abs(estimate.value - true) < max(4 * estimate.standard_error, 2e-3 * true)


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
    for hz in {one.frequency_hz for one in laws}:
        ordered = sorted((one for one in laws if one.frequency_hz == hz), key=lambda one: one.tension_n)
        sums = [one.law.sliding.upper_n.value + one.law.sliding.lower_n.value for one in ordered]
        assert sums == sorted(sums)
        assert sums[-1] > 2 * sums[0]


def test_a_folder_without_data_is_said(tmp_path):
    from rig.errors import RigError

    result = CliRunner().invoke(app, ["--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, RigError)
    assert "holds no file like 0.5Hz20lbtension.json" in str(result.exception)
