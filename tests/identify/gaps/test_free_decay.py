"""Free decays, whose force channel is zero: null simulations that are released, and the diagnosis of one mass."""

import numpy as np
import pytest

import identify
from identify.gaps.decision.null_simulations import REPRODUCED_MOTION_S, null_simulator
from identify.gaps.decision.recordings import check_free_decay
from identify.gaps.decision.sentence import UNSCALED
from identify.gaps.residual.extent import OMITTED_EDGE_S
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, effect_range_scale
from rig.errors import RigError
from rig.simulation.replay import modal
from tests.campaigns.laboratory_tests import STIFFER, TESTS, VALIDATES, recorded

pytestmark = pytest.mark.long

ACCELEROMETER, DISPLACEMENT = "one mass, free decay, no force measured", "one mass, free decay, displacement"


def decay(name, folder, effect="", level=1.0):
    return recorded(TESTS[name], folder / f"{level}.mcap", duration_s=20.0, effect=effect, level=level)


def row(recording):
    return recording.signals[recording.rig.sensors[-1].quantity].values[-1]


@pytest.mark.study
@pytest.mark.parametrize(("effect", "verdict"), [("", "cannot_tell"), (STIFFER, "explained")])
def test_a_free_decay_is_diagnosed(effect, verdict, tmp_path):
    records = (decay(ACCELEROMETER, tmp_path, effect, level) for level in (1.0, VALIDATES))
    result = identify.gap(*records)
    assert result.report.verdict == verdict
    assert UNSCALED in result.report.sentence
    assert "dead" not in {f.cause for f in result.findings}
    if effect:
        best = result.report.causes[0]
        assert best.effects == ("contact_stiffness",)
        factor = best.parameters["contact_stiffness.factor"]
        assert abs(factor.value - 1.3) < 1.96 * factor.standard_error < 0.1


@pytest.mark.parametrize("name", [ACCELEROMETER, DISPLACEMENT])
def test_a_null_simulation_begins_in_motion_as_the_record_does(name, tmp_path):
    measured = decay(name, tmp_path)
    simulate = null_simulator(measured, record_of(measured), modal)
    simulations = [simulate(measured.rig, measured.rig, measured.forces_n, seed) for seed in (1, 2)]
    scaled = slice(round(REPRODUCED_MOTION_S * measured.rig.sample_rate_hz))
    start_s = OMITTED_EDGE_S if name == ACCELEROMETER else 0.0
    for simulation in simulations:
        assert simulation.samples == measured.samples
        assert not np.any(simulation.forces_n)
        assert np.std(row(simulation)[scaled]) == pytest.approx(np.std(row(measured)[scaled]), rel=0.1)
        check_free_decay(simulation)
        assert record_of(simulation).residual_times_s[0] == pytest.approx(start_s, abs=0.1)
    first, second = (row(simulation)[scaled] for simulation in simulations)
    assert np.std(first - second) > 0.1 * np.std(first)


def test_null_simulations_of_beams_move_as_far_as_the_record(tmp_path):
    measured = decay("two beams, free decay, displacements", tmp_path)
    record = record_of(measured)
    simulation = null_simulator(measured, record, modal)(measured.rig, measured.rig, measured.forces_n, 1)
    counted = slice(round(record.residual_times_s[0] * measured.rig.sample_rate_hz), None)
    rms_m = [np.std(row(recording)[counted]) for recording in (measured, simulation)]
    assert rms_m[1] == pytest.approx(rms_m[0], rel=0.25)  # 13 % less on one processor: which stop is struck is chance
    check_free_decay(measured)


def test_effects_of_the_force_and_its_channel_need_a_force(tmp_path):
    record = record_of(decay(ACCELEROMETER, tmp_path))
    arguments = effect_range_scale(record, record.rig), [s.name for s in record.sensors], record.zero_known
    names, unforced = ({c.kind.name for c in candidates(*arguments, has_force=forced)} for forced in (True, False))
    assert not record.has_force
    channels = {"force_gain", "force_shift", "sensor_gain", "sensor_delay"}
    assert channels <= names
    assert not channels & unforced
    assert {"contact_clearance", "contact_stiffness", "added_mass"} <= unforced


def test_a_motion_that_is_kept_up_is_no_free_decay(tmp_path):
    recording = decay(DISPLACEMENT, tmp_path)
    row(recording)[-recording.samples // 4 :] *= 5.0
    with pytest.raises(RigError, match="no free decay"):
        check_free_decay(recording)
