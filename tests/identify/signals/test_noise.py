"""The noise of accelerations where no quiet start tells it."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec.structs import replace as changed

from identify.signals.kinematics import kinematics
from identify.signals.noise import acceleration_noise, noise_source
from rig.recording import read
from rig.simulation.reference import Sdof

DENSITY = 2e-3


def test_the_description_or_the_highest_frequencies_tell_the_noise(simulate, tmp_path):
    settings = Sdof(duration_s=30.0, step_s=2.0**-12, sensors="acceleration", noise_density=DENSITY)
    whole = read(simulate(settings, tmp_path / "r.mcap"))
    signals = {k: replace(s, values=np.ascontiguousarray(s.values[:, 2048:])) for k, s in whole.signals.items()}
    silent = changed(whole.rig, sensors=tuple(changed(s, noise_density=0.0) for s in whole.rig.sensors))
    true = DENSITY * np.sqrt(whole.rig.sample_rate_hz / 2)
    for rig, source, within in (
        (whole.rig, "noise_density in rig.json", 1e-9),
        (silent, "the highest frequencies of the record", 0.4),
    ):
        motion = kinematics(replace(whole, rig=rig, signals=signals))
        assert noise_source(motion, rig) == source
        assert acceleration_noise(motion, rig) == pytest.approx(true, rel=within)
