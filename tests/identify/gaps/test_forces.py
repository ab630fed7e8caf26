"""Several measured forces at once, each with a gain of its own."""

from dataclasses import replace as with_fields

import numpy as np
import pytest
from msgspec.structs import replace

import identify
from identify.gaps.residual.linear import linear_model
from identify.gaps.residual.residual import linearized
from identify.gaps.residual.spectra import record_of
from identify.gaps.unmeasured_force.whitened_record import force_noise_variance, whitened_record_without_nuisance
from rig.effects import effect_named
from rig.model.description import Station
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.excitation import BandLimitedGaussian, force_history
from rig.simulation.reference import BarrelCradle
from rig.simulation.replay import modal
from tests.campaigns.topologies import RIGS

pytestmark = pytest.mark.long

BEAMS = BarrelCradle(sensors="acceleration").rig()
FRAME = RIGS["frame, free"].rig
FLOORS = [s.station for s in FRAME.sensors]
SHAKEN = replace(FRAME, force_at=(FLOORS[0], FLOORS[2]))
NOISE_N = 0.1


def noise(rig, seed=1):
    """12 s of noise in all channels, the forces' after a quiet second with little."""
    rng, samples = np.random.default_rng(seed), round(12 * rig.sample_rate_hz)
    signals = {
        name: Signals(channels, 0.0, rng.standard_normal((len(channels.names), samples)))
        for name, channels in channel_groups(rig).items()
    }
    for group in signals.values():
        group.values[:, : round(rig.sample_rate_hz)] *= 1e-3
    signals["force"].values[:, : round(rig.sample_rate_hz)] *= NOISE_N / 1e-3
    return Recording(rig, signals, {})


def test_forces_at_one_place_are_their_sum():
    at = BEAMS.force_at
    several = noise(replace(BEAMS, force_at=(at, at)))
    forces = Signals(channel_groups(BEAMS)["force"], 0.0, several.forces_n.sum(axis=0, keepdims=True))
    one = Recording(BEAMS, {**several.signals, "force": forces}, {})
    records = [
        with_fields(record, force_noise_variance=0 * record.force_noise_variance)
        for record in map(record_of, (several, one))
    ]
    models = [linear_model(record, record.rig, 5e-4) for record in records]
    lines = slice(models[0].residual.shape[1] // 2)  # where both bands reach
    for quantity in ("residual", "contact_force_n", "eta_m"):
        found, expected = (getattr(model, quantity)[:, lines] for model in models)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_the_noise_of_every_force_is_whitened():
    record = record_of(noise(replace(BEAMS, force_at=(BEAMS.force_at, Station("cradle", 0.6)))))
    bare = whitened_record_without_nuisance(record, record.rig)
    standard = bare.model.sensor_response / bare.model.error_deviation
    by_force = [bare.projected_rows((standard * bare.accelerance(at))[:, bare.line_slice]) for at in record.rig.forces]
    pushed = np.stack(by_force, axis=2) * np.sqrt(force_noise_variance(record))
    for line in (50, 500):
        modes, one = bare.force_noise_modes[line], np.eye(bare.row_count)
        whitening = one - (modes * bare.force_noise_shares[line]) @ modes.conj().T
        covariance = one + pushed[line] @ pushed[line].conj().T
        np.testing.assert_allclose(whitening @ covariance @ whitening, one, atol=1e-9)


@pytest.fixture(scope="module")
def records():
    """Of a stiffer bumper, the second load cell off by two tolerances."""
    rate, actual = SHAKEN.sample_rate_hz, effect_named("contact_stiffness:factor=1.3").applied_to(SHAKEN)
    found = []
    for level_n in (60.0, 90.0):
        drive = BandLimitedGaussian(rms_n=level_n, low_hz=0.5, high_hz=100.0, seed=round(level_n))
        forces_n = np.stack([force_history(replace(drive, seed=drive.seed + k), 14.0, 1 / rate) for k in (0, 1)])
        made = modal(SHAKEN, actual, forces_n, round(level_n))
        made.signals["force"].values[1] *= 1.006
        found.append(made)
    return found


def test_every_force_has_a_gain_of_its_own(records):
    parameters = linearized(record_of(records[0]), SHAKEN).columns.parameters
    assert [p.owner for p in parameters if p.kind == "force gain"] == ["force_1", "force_2"]


@pytest.mark.study
def test_the_effect_is_found_and_no_gain_taken_for_it(records):
    found = identify.gap(*records).report
    assert found.verdict == "explained"
    (best, *_) = found.causes
    assert best.effects == ("contact_stiffness",)
    (factor,) = best.parameters.values()
    assert abs(factor.value - 1.3) < 3 * factor.standard_error
    assert factor.standard_error < 0.05
