"""The F-16: measured data where it is there; and a simulated structure with a soft support that always is."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from identify.gaps.decision.answer import diagnose
from rig.effects import effect_named
from rig.errors import RigError
from rig.lab.modal.record import MeasuredResponse, fit_record
from rig.model.description import Rig, Sensor, Station
from rig.model.structure import structure_of
from rig.model.tolerances import Tolerances
from scenarios.f16 import FILE, PERIOD_SAMPLES, PLACES_M, RATE_HZ, LevelDiagnosis, accelerations, app, errors_percent
from scenarios.measured_data import SIMULATOR, simulated

DATA = Path(os.environ.get("F16", "f16"))
SHAPES = np.array([[0.09, 0.03, 0.04, 0.05], [0.02, 0.05, 0.08, -0.04], [0.02, 0.05, 0.07, -0.01]])


@pytest.fixture(scope="module")
def judged(tmp_path_factory) -> list[LevelDiagnosis]:
    if not (DATA / FILE.format("1")).exists():
        pytest.skip(f"no {FILE.format('1')}: let the environment variable F16 name its folder")
    out = tmp_path_factory.mktemp("f16")
    result = CliRunner().invoke(app, ["--data", str(DATA), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.glob("*.png")} == {"level3.png", "level5.png"}
    return msgspec.json.decode((out / "f16.json").read_bytes(), type=list[LevelDiagnosis])


def test_what_the_levels_add_is_explained_in_part_by_a_softer_and_more_damped_structure(judged):
    for one in judged:
        assert one.verdict == "partly_explained"
        assert set(one.effects) == {"linear_spring", "structural_damping"}
        (before_hz, before), (after_hz, after) = one.joint_mode, one.joint_mode_corrected
        assert after_hz < before_hz, "the joint's mode softens, "
        assert after > before, "and its damping rises"
    low, high = judged
    assert high.joint_mode_corrected[0] < low.joint_mode_corrected[0], "the more, the higher the level"


def test_the_corrected_rigs_leave_less_than_half_of_the_error_of_the_rig_of_level_1(judged):
    for one in judged:
        for run in one.runs:
            assert (np.array(run.corrected) < 0.5 * np.array(run.believed)).all()
    validation = judged[0].runs[1]  # level 2 is not the level that an equivalent linear model was fitted to
    assert (np.array(validation.corrected) < 0.6 * np.array(validation.equivalent_linear)).all()


@pytest.fixture(scope="module")
def soft():
    """A structure's rig fitted to a low level; and two records of more force with a support that lost stiffness."""
    places = np.array(PLACES_M)
    body = structure_of(
        "wing", 1.2, np.array([3.5, 5.2, 7.3, 9.2]), np.array([0.015, 0.008, 0.005, 0.007]), places, SHAPES
    )
    stations = [Station("wing", x) for x in PLACES_M]
    sensors = tuple(
        Sensor(name=f"acceleration {k}", station=s, quantity="acceleration", noise_density=1e-4)
        for k, s in enumerate(stations)
    )
    true = Rig(name="wing", bodies=(body,), contacts=(), force_at=stations[0], sensors=sensors, sample_rate_hz=RATE_HZ)
    low = simulated(true, true, multisine(10.0, 1), 1)
    found = fit_record(MeasuredResponse(low.force_n, accelerations(low), 2, RATE_HZ), PLACES_M, 0, 1.2, name="wing")
    told = Tolerances(unmodelled=0.01, highest_hz=15.0)
    believed = replace(true, bodies=(found.body,), tolerances=told)
    lost = effect_named("linear_spring:stiffness_n_per_m=-4000,relative_position=1").applied_to(true)
    high = [simulated(believed, lost, multisine(rms, seed), seed) for rms, seed in ((40.0, 2), (30.0, 3))]
    return found, believed, high


def multisine(rms_n, seed):
    """Three periods of odd lines from 2 to 15 Hz with random phases."""
    hz = np.fft.rfftfreq(PERIOD_SAMPLES, 1 / RATE_HZ)
    lines = (hz >= 2) & (hz <= 15) & (np.arange(hz.size) % 2 == 1)
    phases = np.exp(2j * np.pi * np.random.default_rng(seed).random(hz.size))
    one = np.fft.irfft(lines * phases, PERIOD_SAMPLES)
    return rms_n * np.tile(one / one.std(), 3)


def test_a_low_level_gives_the_rig(soft):
    found, _, _ = soft
    assert found.misfits.max() < 0.01
    assert found.period_s == pytest.approx(PERIOD_SAMPLES / RATE_HZ)


@pytest.mark.study
def test_a_support_that_lost_stiffness_is_found_under_a_multisine(soft):
    _, believed, high = soft
    gap, corrected = diagnose(*high, SIMULATOR)
    assert gap.verdict in ("explained", "partly_explained")
    assert "linear_spring" in gap.causes[0].effects
    assert "tone" not in gap.causes[0].effects
    for recording in high:
        before, after = (np.array(errors_percent(rig, recording)) for rig in (believed, corrected))
        assert (after < 0.1 * before).all()


def test_a_folder_without_data_is_said(tmp_path):
    result = CliRunner().invoke(app, ["--data", str(tmp_path), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, RigError)
    assert "F16Data_FullMSine_Level1.mat: cannot be opened" in str(result.exception)
