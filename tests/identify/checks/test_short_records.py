"""Records of few samples are checked, or refused, like any other."""

import numpy as np
import pytest

from identify.checks.waveforms import drift_finding
from identify.checks.windows import window_finding

RATE_HZ = 512.0


@pytest.mark.parametrize("sample_count", [1, 2, 15, 100])
def test_a_short_record_shows_no_window_of_an_analyser(sample_count):
    samples = np.random.default_rng(0).standard_normal(sample_count)
    assert window_finding("tip", RATE_HZ, samples, np.zeros((1, sample_count))) is None


@pytest.mark.parametrize("sample_count", [1, 2, 3])
def test_few_samples_are_no_drift(sample_count):
    assert drift_finding("tip", RATE_HZ, np.arange(1.0, sample_count + 1)) is None
