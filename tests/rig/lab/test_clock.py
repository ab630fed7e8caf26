"""Time stamps that are even already."""

import numpy as np

from rig.lab.clock import SampleTimes, even_samples_and_steps


def test_even_stamps_are_left_alone():
    rate_hz = 512.0
    rows = np.random.default_rng(1).standard_normal((3, 2000))
    rounded_s = np.round(np.arange(2000) / rate_hz, 6)  # as most programs print them
    values, steps = even_samples_and_steps(rows, SampleTimes.of_stamps(rounded_s), rate_hz, resample=True)
    assert values is rows
    assert steps == ()
