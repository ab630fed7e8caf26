"""The periodogram of samples with gaps is that of Lomb and Scargle; amplitude and frequency of a swing lie within their
intervals."""

import numpy as np
import pytest
from scipy.signal import lombscargle

from identify.gaps.unmeasured_force.clearance_modulation import _fitted_modulation, _periodogram


def test_periodogram_of_samples_with_gaps_is_lombs():
    rng, rate_hz = np.random.default_rng(0), 200.0
    time_s = np.arange(3000) / rate_hz
    is_sampled = rng.uniform(size=time_s.size) < 0.4 * (1 + np.sin(9.0 * time_s))
    history = (rng.standard_normal(time_s.size) + np.sin(2 * np.pi * 1.234 * time_s))[is_sampled]
    hz, shares = _periodogram(history, is_sampled, rate_hz)
    expected = lombscargle(time_s[is_sampled], history - history.mean(), 2 * np.pi * hz, normalize=True)
    np.testing.assert_allclose(shares, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_amplitude_and_frequency_of_a_swing_are_within_their_intervals(seed):
    rng = np.random.default_rng([seed, 59])
    time_s = np.sort(rng.uniform(0, 30, 6000))
    noise_m = np.repeat(rng.standard_normal(1500), 4)  # coloured: one value for four samples
    history_m = 1e-3 * (0.2 + 0.3 * np.cos(2 * np.pi * 1.234 * time_s + 1.0) + 0.2 * noise_m)
    swing = _fitted_modulation("stop", time_s, history_m, 1.2343, 0.5)  # as near as the trials are
    assert abs(swing.amplitude_m - 3e-4) < 3 * swing.amplitude_error_m
    assert abs(swing.frequency_hz - 1.234) < 3 * swing.frequency_error_hz
    assert swing.amplitude_error_m == pytest.approx(2e-4 * np.sqrt(2 * 4 / 6000), rel=0.6)
