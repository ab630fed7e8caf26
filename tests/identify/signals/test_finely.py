"""Laws without memory of band-limited signals, without aliasing."""

import numpy as np
import pytest

from identify.signals.finely import OVERSAMPLING, finely, penetration
from rig.model.contact_laws import penetration_m

RATE_HZ = 1000.0


def noise(samples, high_hz, seed):
    """Periodic Gaussian noise up to high_hz, variance about 1, as a function that samples it ever finer."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, int(high_hz * samples / RATE_HZ))
    amplitudes = (rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size)) / np.sqrt(2 * lines.size)

    def sampled(factor):
        spectrum = np.zeros(samples * factor // 2 + 1, dtype=complex)
        spectrum[lines] = amplitudes * samples * factor
        return np.sqrt(0.5) * np.fft.irfft(spectrum, samples * factor)

    return sampled


def low_passed(fine, factor):
    """Every factor-th sample of what lies below half the low rate; exact, as the signal is periodic."""
    samples = fine.size // factor
    return np.fft.irfft(np.fft.rfft(fine)[: samples // 2 + 1], samples) / factor


INSIDE = slice(200, -200)
"""Away from the ends of the record."""


def test_the_penetration_does_not_alias():
    """The spectrum of a kinked function falls as 1/f^2, so oversampled n times it aliases n^2 times less."""
    sampled = noise(8000, 100.0, seed=1)
    lower, upper = 0.5, 0.8
    true = low_passed(penetration_m(sampled(256), lower, upper), 256)
    passband = np.fft.rfftfreq(true[INSIDE].size, 1 / RATE_HZ) < 0.4 * RATE_HZ

    def size(signal):
        return np.linalg.norm(np.fft.rfft(np.hanning(signal[INSIDE].size) * signal[INSIDE])[passband])

    error = size(penetration(sampled(1), lower, upper) - true)
    plain = size(penetration_m(sampled(1), lower, upper) - true)
    assert plain / size(true) > 5e-3  # worth the effort
    assert plain / error > max(30, OVERSAMPLING**2 / 2)


def test_no_penetration_within_the_gap():
    eta = noise(2000, 100.0, seed=2)(1)
    assert not penetration(eta, 1.05 * np.abs(eta).max(), 1.05 * np.abs(eta).max()).any()
    np.testing.assert_allclose(penetration(eta, 0.0, 0.0)[INSIDE], eta[INSIDE], atol=1e-3)  # no gap: a spring


@pytest.mark.parametrize("samples", [700, 5000])
def test_blocks_join_without_a_seam(samples):
    """The square of a signal below a quarter of the rate is below half of it: known exactly at every sample."""
    time_s = np.arange(samples) / RATE_HZ
    slow, fast = np.hanning(samples) * np.sin([2 * np.pi * f * time_s for f in (31.7, 190.3)])
    found = finely(lambda x, y: x * y, np.stack([slow, fast]), 4)
    np.testing.assert_allclose(found, slow * fast, atol=1e-5)
