"""What a laboratory never knows exactly, put into the rig of one mass."""

import numpy as np
import pytest
from msgspec.structs import replace

from identify.gap.doubts import moved
from identify.gap.residual import base_of
from identify.gap.spectra import record_of
from identify.tolerances import LABORATORY
from rig.excitation import force_history
from rig.reference import Sdof
from rig.replay import modal

SETTINGS = Sdof(sensors="displacement", duration_s=12.0)
RIG = SETTINGS.rig()


@pytest.fixture(scope="module")
def base():
    force_n = force_history(SETTINGS.force(), SETTINGS.duration_s, 1 / RIG.sample_rate_hz)
    return base_of(record_of(modal(RIG, RIG, force_n, 1)), RIG)


def test_every_doubt_about_a_single_mass_and_its_sensor_moves_the_rig(base):
    doubts = np.arange(1.0, 1.0 + len(base.doubts.names))
    found, put = moved(RIG, base.doubts.names, doubts, LABORATORY)
    np.testing.assert_array_equal(put, doubts)
    by_name = dict(zip(base.doubts.names, doubts, strict=True))
    (body,), (sensor,) = RIG.bodies, RIG.sensors
    assert found.bodies == (
        replace(
            body,
            frequency_hz=body.frequency_hz * (1 + LABORATORY.frequency * by_name[f"frequency of {body.name}"]),
            damping_ratio=body.damping_ratio * (1 + LABORATORY.damping * by_name[f"damping of {body.name}"]),
        ),
    )
    assert found.sensors == (
        replace(sensor, gain=sensor.gain * (1 + LABORATORY.gain * by_name[f"gain of {sensor.name}"])),
    )
