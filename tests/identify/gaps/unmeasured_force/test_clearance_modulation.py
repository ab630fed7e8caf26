"""The periodogram of samples with gaps is that of Lomb and Scargle."""

import numpy as np
from scipy.signal import lombscargle

from identify.gaps.unmeasured_force.clearance_modulation import _periodogram


def test_periodogram_of_samples_with_gaps_is_lombs():
    rng, rate_hz = np.random.default_rng(0), 200.0
    time_s = np.arange(3000) / rate_hz
    is_sampled = rng.uniform(size=time_s.size) < 0.4 * (1 + np.sin(9.0 * time_s))
    history = (rng.standard_normal(time_s.size) + np.sin(2 * np.pi * 1.234 * time_s))[is_sampled]
    hz, shares = _periodogram(history, is_sampled, rate_hz)
    expected = lombscargle(time_s[is_sampled], history - history.mean(), 2 * np.pi * hz, normalize=True)
    np.testing.assert_allclose(shares, expected, rtol=1e-9, atol=1e-12)
