"""Noise of accelerations and channels in records without a quiet start."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec.structs import replace as changed

from identify.signals.kinematics import kinematics
from identify.signals.noise import (
    acceleration_noise_m_per_s2,
    displacement_noise,
    noise_density_and_certainty,
    noise_source,
    rounding_noise_density,
)
from rig.recording import read
from rig.simulation.reference import Sdof

DENSITY = 2e-3
RATE_HZ = 2048.0


def test_the_description_or_the_highest_frequencies_tell_the_noise(simulate, tmp_path):
    settings = Sdof(duration_s=30.0, step_s=2.0**-12, sensors="acceleration", noise_density=DENSITY)
    recording = read(simulate(settings, tmp_path / "r.mcap"))
    signals = {k: replace(s, values=np.ascontiguousarray(s.values[:, 2048:])) for k, s in recording.signals.items()}
    silent = changed(recording.rig, sensors=tuple(changed(s, noise_density=0.0) for s in recording.rig.sensors))
    true = DENSITY * np.sqrt(recording.rig.sample_rate_hz / 2)
    for rig, source, tolerance in (
        (recording.rig, "noise_density in rig.json", 1e-9),
        (silent, "the highest frequencies of the record", 0.4),
    ):
        motion = kinematics(replace(recording, rig=rig, signals=signals))
        assert noise_source(motion, rig) == source
        assert acceleration_noise_m_per_s2(motion, rig) == pytest.approx(true, rel=tolerance)


def test_the_noise_of_a_displacement_sensor_is_white_in_its_unit(simulate, tmp_path):
    settings = Sdof(duration_s=30.0, step_s=2.0**-12, sensors="displacement")
    recording, density = read(simulate(settings, tmp_path / "r.mcap")), 1e-7
    true_m = density * np.sqrt(recording.rig.sample_rate_hz / 2)
    motion_m = recording.signals["displacement"]
    noise_m = true_m * np.random.default_rng(0).standard_normal(motion_m.values.shape)
    noisy = {**recording.signals, "displacement": replace(motion_m, values=motion_m.values + noise_m)}
    later = {k: replace(s, values=np.ascontiguousarray(s.values[:, 2048:])) for k, s in noisy.items()}
    told = changed(recording.rig, sensors=tuple(changed(s, noise_density=density) for s in recording.rig.sensors))
    for rig, signals, source, tolerance in (
        (recording.rig, noisy, "the quiet start of the record", 0.1),
        (told, later, "noise_density in rig.json", 1e-9),
        (recording.rig, later, "the highest frequencies of the record", 0.5),
    ):
        motion = kinematics(replace(recording, rig=rig, signals=signals))
        assert noise_source(motion, rig) == source
        assert displacement_noise(motion, rig) == pytest.approx(true_m, rel=tolerance)


def ringing(duration_s):
    time_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    modes = ((1e-3, 0.6, 30.0), (2e-4, 3.0, 190.0))
    return sum(size * np.exp(-rate * time_s) * np.sin(2 * np.pi * hz * time_s) for size, rate, hz in modes)


@pytest.mark.parametrize("duration_s", [1.0, 4.0, 20.0])
@pytest.mark.parametrize("density", [5e-8, 1e-6])
def test_the_noise_beside_a_decay_is_heard(duration_s, density):
    signal = ringing(duration_s)
    rng = np.random.default_rng(402)
    noise = density * np.sqrt(RATE_HZ / 2) * rng.standard_normal(signal.size)
    density_shown, _ = noise_density_and_certainty(signal + noise, RATE_HZ)
    assert density_shown == pytest.approx(density, rel=0.15)  # three of its deviations in the shortest record


def test_motion_alone_is_not_surely_noise():
    assert not noise_density_and_certainty(ringing(4.0), RATE_HZ)[1]
    walk = np.cumsum(np.random.default_rng(403).standard_normal(20_000))
    assert not noise_density_and_certainty(walk, RATE_HZ)[1]


def test_no_channel_shows_less_than_24_bits():
    assert rounding_noise_density(np.array([2.0, -1.0]), 200.0) == pytest.approx(2e-7 / 10)
