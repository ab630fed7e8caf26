"""Strain gauges in a recording change neither the kinematics of the stations nor the diagnosis."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gaps.residual.spectra import record_of
from identify.signals.kinematics import kinematics
from rig.errors import RigError
from rig.recording import Recording, Signals, channel_groups
from rig.simulation.reference import BarrelCradle

BOTH = BarrelCradle(sensors="acceleration+strain", stations=4, sample_rate_hz=512.0).rig()
SAMPLES = 512 * 12


def recorded(rig):
    """Any signals, the same in every recording for channels of the same name."""
    signals = {}
    for group, channels in channel_groups(rig).items():
        seeds = [sum(map(ord, name)) for name in channels.names]
        rows = np.stack([np.random.default_rng(seed).standard_normal(SAMPLES) for seed in seeds])
        signals[group] = Signals(channels, 0.0, rows)
    return Recording(rig, signals, {})


def only(quantity):
    return replace(BOTH, sensors=tuple(s for s in BOTH.sensors if s.quantity == quantity))


def test_the_motion_is_that_of_the_accelerometers():
    mixed, plain = (kinematics(recorded(rig)) for rig in (BOTH, only("acceleration")))
    assert mixed.channels == plain.channels
    np.testing.assert_array_equal(mixed.displacement_m, plain.displacement_m)


def test_the_diagnosis_reads_gauges_behind_the_accelerometers():
    mixed, plain = (record_of(recorded(rig)) for rig in (BOTH, only("acceleration")))
    assert mixed.motion_sensors == plain.sensors
    np.testing.assert_array_equal(mixed.acceleration_signals[: len(plain.sensors)], plain.acceleration_signals)
    np.testing.assert_array_equal(mixed.eta_above_band, plain.eta_above_band)


@pytest.mark.parametrize("read", [kinematics, record_of])
def test_gauges_alone_are_refused(read):
    with pytest.raises(RigError, match="the recording has no sensors of motion"):
        read(recorded(only("strain")))
