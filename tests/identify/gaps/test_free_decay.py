"""Free decays, whose force channel is zero: null simulations that are released, and the diagnosis of one mass."""

import numpy as np
import pytest

import identify
from identify.gaps.decision.release import FIRST_S, released
from identify.gaps.decision.sentence import UNSCALED
from identify.gaps.faults import check_decay
from identify.gaps.residual.extent import LEFT_OUT_S
from identify.gaps.residual.spectra import record_of
from identify.gaps.search.candidates import candidates, scale_of
from rig.errors import RigError
from rig.simulation.replay import modal
from tests.campaigns.laboratory_tests import STIFFER, TESTS, VALIDATES, recorded

ACCELEROMETER, DISPLACEMENT = "one mass, free decay, no force measured", "one mass, free decay, displacement"


def decay(name, folder, effect="", level=1.0):
    return recorded(TESTS[name], folder / f"{level}.mcap", duration_s=20.0, effect=effect, level=level)


def row(recording):
    return recording.signals[recording.rig.sensors[-1].quantity].values[-1]


@pytest.mark.parametrize(("effect", "verdict"), [("", "cannot_tell"), (STIFFER, "explained")])
def test_a_free_decay_is_diagnosed(effect, verdict, tmp_path):
    records = (decay(ACCELEROMETER, tmp_path, effect, level) for level in (1.0, VALIDATES))
    found = identify.gap(*records)
    assert found.report.verdict == verdict
    assert UNSCALED in found.report.sentence
    assert "dead" not in {f.cause for f in found.findings}
    if effect:
        best = found.report.causes[0]
        assert best.effects == ("contact_stiffness",)
        factor = best.parameters["contact_stiffness.factor"]
        assert abs(factor.value - 1.3) < 1.96 * factor.standard_error < 0.1


@pytest.mark.parametrize("name", [ACCELEROMETER, DISPLACEMENT])
def test_a_null_simulation_begins_in_motion_as_the_record_does(name, tmp_path):
    measured = decay(name, tmp_path)
    simulate = released(measured, modal)
    one, other = (simulate(measured.rig, measured.rig, measured.forces_n, seed) for seed in (1, 2))
    first = round(FIRST_S * measured.rig.sample_rate_hz)
    for made in (one, other):
        assert made.samples == measured.samples
        assert not np.any(made.forces_n)
        assert np.std(row(made)[:first]) == pytest.approx(np.std(row(measured)[:first]), rel=0.1)
        check_decay(made)
        assert record_of(made).time_s[0] == pytest.approx(LEFT_OUT_S, abs=0.1)
    assert np.std(row(one)[:first] - row(other)[:first]) > 0.1 * np.std(row(one)[:first])


def test_null_simulations_of_beams_move_as_much_as_the_record(tmp_path):
    measured = decay("two beams, free decay, displacements", tmp_path)
    made = released(measured, modal)(measured.rig, measured.rig, measured.forces_n, 1)
    second = round(measured.rig.sample_rate_hz)
    levels = [row(one)[: FIRST_S * second].reshape(FIRST_S, second).std(axis=1) for one in (measured, made)]
    assert np.log(levels[1] / levels[0]).mean() == pytest.approx(0.0, abs=0.2)
    check_decay(measured)


def test_effects_of_the_force_and_its_channel_need_a_force(tmp_path):
    record = record_of(decay(ACCELEROMETER, tmp_path))
    given = scale_of(record, record.rig), [s.name for s in record.sensors], record.zero_known
    names, unforced = ({c.kind.name for c in candidates(*given, forced=forced)} for forced in (True, False))
    assert not record.forced
    channels = {"force_gain", "force_shift", "sensor_gain", "sensor_delay"}
    assert channels <= names
    assert not channels & unforced
    assert {"contact_clearance", "contact_stiffness", "added_mass"} <= unforced


def test_a_motion_that_is_kept_up_is_no_free_decay(tmp_path):
    recording = decay(DISPLACEMENT, tmp_path)
    row(recording)[-recording.samples // 4 :] *= 5.0
    with pytest.raises(RigError, match="no free decay"):
        check_decay(recording)
