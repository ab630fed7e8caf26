"""Contact laws on band-limited signals, without aliasing."""

import numpy as np
import pytest

from identify.signals.law_evaluation import evaluated_law, interpolated, oversampling, penetration
from identify.signals.law_evaluation import low_passed as low_passed_again
from rig.model.contact_laws import penetration_m
from rig.model.contact_laws.dead_zone import symmetric_dead_zone

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


def rate_of(periodic, rate_hz):
    omega = 2 * np.pi * np.fft.rfftfreq(periodic.size, 1 / rate_hz)
    return np.fft.irfft(1j * omega * np.fft.rfft(periodic), periodic.size)


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

    error = size(penetration(sampled(1), lower, upper, RATE_HZ) - true)
    plain = size(penetration_m(sampled(1), lower, upper) - true)
    assert plain / size(true) > 5e-3  # worth the effort
    assert plain / error > oversampling(RATE_HZ) ** 2 / 2


def test_no_penetration_within_the_gap():
    eta = noise(2000, 100.0, seed=2)(1)
    assert not penetration(eta, 1.05 * np.abs(eta).max(), 1.05 * np.abs(eta).max(), RATE_HZ).any()
    np.testing.assert_allclose(penetration(eta, 0.0, 0.0, RATE_HZ)[INSIDE], eta[INSIDE], atol=1e-3)  # a spring


@pytest.mark.parametrize("samples", [700, 5000])
def test_blocks_join_without_a_seam(samples):
    """The square of a signal below a quarter of the rate is below half of it: known exactly at every sample."""
    time_s = np.arange(samples) / RATE_HZ
    slow, fast = np.hanning(samples) * np.sin([2 * np.pi * f * time_s for f in (31.7, 190.3)])
    product = evaluated_law(lambda x, y: x * y, np.stack([slow, fast]), RATE_HZ)
    np.testing.assert_allclose(product, slow * fast, atol=1e-5)


def test_stiffness_and_clearance_are_not_biased():
    """A law laid against the exact force of a motion of 8 mm up to 50 Hz, sampled at 4096 Hz: both are off by less than
    a tenth of the smallest standard errors stated, 0.02 % of a clearance and 0.05 % of a stiffness.
    """
    rate_hz, fine, factor, gap_m, stiffness = 4.096 * RATE_HZ, 32, 5, 5e-3, 1e5
    sampled = noise(60000, 50.0 / 4.096, seed=4)

    def signals(times):
        eta = 8e-3 * sampled(times)
        return np.stack([eta, rate_of(eta, times * rate_hz)])

    def force(clearance_error, stiffness_error):
        law = symmetric_dead_zone(gap_m * (1 + clearance_error), stiffness * (1 + stiffness_error), 20.0)
        return evaluated_law(law.force_n, signals(1), rate_hz, factor)[INSIDE]

    step = 1e-4
    columns = np.stack([force(step, 0) - force(-step, 0), force(0, step) - force(0, -step)], axis=1) / (2 * step)
    exact = low_passed(symmetric_dead_zone(gap_m, stiffness, 20.0).force_n(*signals(fine)), fine * factor)[INSIDE]
    of_clearance, of_stiffness = np.linalg.lstsq(columns, exact - force(0, 0), rcond=None)[0]
    assert abs(of_clearance) < 0.1 * 2e-4
    assert abs(of_stiffness) < 0.1 * 5e-4


def test_a_record_goes_through_the_finer_rate_and_back():
    samples, factor = 3 * 4096, 4
    eta = 1 + 0.1 * np.sin(2 * np.pi * 20 * np.arange(samples) / RATE_HZ)
    fine = interpolated(eta, RATE_HZ)
    assert fine.size == oversampling(RATE_HZ) * samples
    np.testing.assert_allclose(low_passed_again(fine, RATE_HZ, factor)[50:-50], eta[::factor][50:-50], atol=1e-3)


@pytest.mark.parametrize(("rate_hz", "times"), [(512.0, 8), (2048.0, 8), (4096.0, 4), (5000.0, 3), (51200.0, 1)])
def test_the_finer_rate(rate_hz, times):
    assert oversampling(rate_hz) == times
