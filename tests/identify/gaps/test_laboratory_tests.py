"""The diagnosis of tests that laboratories do: which part of a record counts, and that the effect is found."""

import numpy as np
import pytest

from identify.gaps.decision.null_simulations import is_impulsive
from identify.gaps.decision.prepare import search_record
from identify.gaps.residual.likelihood import nominal_variances_of
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from rig.simulation.excitation import excitation_of, force_history
from tests.campaigns.laboratory_tests import TESTS, recorded


@pytest.mark.parametrize(
    ("name", "parameter", "value"),
    [("one mass, high-pass of 0.5 Hz", "mass_kg", 0.1), ("one mass, no quiet start, displacement", "mass_kg", 0.1)],
)
def test_the_effect_is_the_likeliest(name, parameter, value, tmp_path):
    test = TESTS[name]
    record = record_of(recorded(test, tmp_path / "r.mcap", duration_s=20.0, effect=test.effect))
    best = search_record(record, nominal_variances_of(linearized(record, record.rig))).hypotheses[0]
    assert best.effects == (test.effect.partition(":")[0],)
    index = best.parameters.names.index(parameter)
    assert abs(best.values[index] - value) < 3 * np.sqrt(best.covariance[index, index])
    assert np.sqrt(best.covariance[index, index]) < 0.1 * value


@pytest.mark.parametrize(
    ("kind", "low_hz", "blows", "highest_hz"),
    [("gaussian", 0.5, False, 160), ("burst", 0.5, False, 160), ("sweep", 0.5, False, 161), ("hammer", 0.5, True, 341)],
)
def test_a_hammers_force_is_known_and_its_band_ends(kind, low_hz, blows, highest_hz, tmp_path):
    force = excitation_of(kind, rms_n=14.0, low_hz=low_hz, high_hz=100.0)
    assert is_impulsive(force_history(force, 20.0, 1 / 4096)) == blows
    sensed = recorded(TESTS["two beams, Gaussian force"], tmp_path / "r.mcap", duration_s=12.0)
    sensed.signals["force"].values[:] = force_history(force, 12.0, 1 / 4096)
    assert record_of(sensed).highest_hz == pytest.approx(highest_hz, rel=0.1)


def test_a_record_counts_until_it_has_decayed(tmp_path):
    record = record_of(recorded(TESTS["one mass, one measured blow"], tmp_path / "r.mcap", duration_s=30.0))
    end_s = record.counted_slice.stop / record.residual_rate_hz
    power = (record.in_time(record.acceleration_signals)[0] ** 2).mean()
    assert 5.0 < end_s < 25.5
    assert power > 0
