"""The Silverbox: measured data diagnosed and corrected, where the data is there; and a simulated one that always is."""

import os
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from identify.gaps.decision.answer import diagnose
from rig.errors import RigError
from rig.model.description import PointSpring
from rig.simulation.excitation import BandLimitedGaussian, force_history
from scenarios.measured_data import SIMULATOR, free_run, simulated
from scenarios.silverbox import FILE, SAMPLE_COUNT, SilverboxDiagnosis, app, fit_free_run, one_mass, read_volts, rms

DATA = Path(os.environ.get("SILVERBOX", "silverbox"))
CUBIC_N_PER_M3, NOISE_DENSITY = 4e7, 1e-7


@pytest.fixture(scope="module")
def judged(tmp_path_factory) -> SilverboxDiagnosis:
    if not (DATA / FILE).exists():
        pytest.skip(f"no {FILE}: let the environment variable SILVERBOX name its folder")
    out = tmp_path_factory.mktemp("silverbox")
    result = CliRunner().invoke(app, ["--data", str(DATA), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.glob("*.png")} == {"where.png", "arrow.png"}
    return msgspec.json.decode((out / "silverbox.json").read_bytes(), type=SilverboxDiagnosis)


def test_measured_data_is_diagnosed_as_a_hardening_spring(judged):
    assert judged.verdict == "partly_explained"  # one band keeps more than tolerances explain, and more than matters
    assert judged.effects[0] == "hardening_spring"


def test_the_corrected_rig_runs_free_where_the_linear_one_fails(judged):
    assert 10 < judged.linear_mv < 20  # the best linear models that were published leave 14.2 mV
    assert judged.diagnosed_mv < 0.5  # output error over eight parameters leaves 0.51 mV
    assert judged.corrected_mv < judged.diagnosed_mv


@pytest.fixture(scope="module")
def duffing():
    """A linear rig, and two noisy records of it with a cubic spring and 0.5 % of mass that its owner does not know."""
    linear = one_mass(0.54, 68.3, 0.05, NOISE_DENSITY)
    cubic = PointSpring(station=linear.force_at, cubic_n_per_m3=CUBIC_N_PER_M3)
    actual = replace(linear, bodies=(linear.bodies[0].scale_mass(1.005),), springs=(cubic,))
    rate = linear.sample_rate_hz
    forces = [
        force_history(BandLimitedGaussian(rms_n=220.0, low_hz=1.0, high_hz=150.0, seed=seed), 40.0, 1 / rate)
        for seed in (1, 2)
    ]
    return linear, actual, [simulated(linear, actual, force, seed) for seed, force in enumerate(forces)]


@pytest.mark.study
def test_a_simulated_cubic_spring_is_named_and_measured(duffing):
    _, actual, (fit, validation) = duffing
    gap, corrected = diagnose(fit, validation, SIMULATOR)
    assert gap.verdict == "explained"
    assert gap.causes[0].effects == ("hardening_spring",)
    found = gap.causes[0].parameters["hardening_spring.cubic_n_per_m3"]
    assert abs(found.value - CUBIC_N_PER_M3) < max(3 * found.standard_error, 0.02 * CUBIC_N_PER_M3)
    (body,), (known,), (sensor,) = corrected.bodies, actual.bodies, corrected.sensors
    assert corrected.force_sensor.gain * body.mass_kg / sensor.gain == pytest.approx(known.mass_kg, rel=1e-3)
    assert body.frequency_hz == pytest.approx(known.frequency_hz, rel=1e-3)
    assert body.damping_ratio == pytest.approx(known.damping_ratio, rel=1e-2)


def test_identification_recovers_the_rig_from_a_wrong_start(duffing):
    _, actual, (fit, _) = duffing
    (body,), (spring,) = actual.bodies, actual.springs
    wrong = replace(
        actual,
        bodies=(replace(body, mass_kg=1.03 * body.mass_kg, frequency_hz=1.01 * body.frequency_hz),),
        springs=(replace(spring, cubic_n_per_m3=0.9 * spring.cubic_n_per_m3),),
    )
    found = fit_free_run(wrong, fit)
    assert found.springs[0].cubic_n_per_m3 == pytest.approx(CUBIC_N_PER_M3, rel=2e-3)
    assert found.bodies[0].mass_kg == pytest.approx(body.mass_kg, rel=2e-3)


def test_a_free_run_has_no_noise(duffing):
    _, actual, (fit, _) = duffing
    noisy = fit.signals["displacement"].values[0]
    left = noisy - free_run(actual, fit.force_n).signals["displacement"].values[0]
    assert rms(left) == pytest.approx(NOISE_DENSITY * np.sqrt(fit.rig.sample_rate_hz / 2), rel=0.05)


def test_data_that_is_not_there_is_one_sentence(tmp_path):
    with pytest.raises(RigError, match=f"{FILE}: cannot be opened"):
        read_volts(tmp_path)
    (tmp_path / FILE).write_text('"V1","V2",\n0.1,0.2,\n0.1,0.2,\n')
    with pytest.raises(RigError, match="has 2 samples instead of"):
        read_volts(tmp_path)


def test_the_package_that_fetches_the_data(monkeypatch):
    record = SimpleNamespace(u=np.arange(SAMPLE_COUNT) * 1.0, y=np.ones(SAMPLE_COUNT))
    loads = SimpleNamespace(Silverbox=lambda train_test_split: None if train_test_split else record)
    monkeypatch.setitem(sys.modules, "nonlinear_benchmarks", loads)
    np.testing.assert_array_equal(read_volts(None), [record.u, record.y])

    loads.Silverbox = Mock(side_effect=OSError("no network"))
    with pytest.raises(RigError, match="could not fetch the data"):
        read_volts(None)
    monkeypatch.setitem(sys.modules, "nonlinear_benchmarks", None)
    with pytest.raises(RigError, match="no data: give --data FOLDER"):
        read_volts(None)
