"""Densities in their unit, and what is drawn of them."""

import numpy as np
import pytest

from rig.viewer.spectra import amplitude_densities

RATE = 1000.0


def test_white_noise_has_its_density_and_the_square_sums_to_the_variance():
    noise = np.random.default_rng(3).normal(0.0, 2.0, (2, 200_000))
    frequency_hz, density = amplitude_densities(noise, RATE)
    assert density.mean(axis=1) == pytest.approx([2.0 / np.sqrt(RATE / 2)] * 2, rel=0.02)
    between_hz = frequency_hz[1] - frequency_hz[0]
    assert between_hz == pytest.approx(0.25)
    assert np.sum(density**2, axis=1) * between_hz == pytest.approx(noise.var(axis=1), rel=0.02)


def test_a_sine_stands_at_its_frequency():
    time_s = np.arange(20_000) / RATE
    frequency_hz, density = amplitude_densities(np.sin(2 * np.pi * 50 * time_s)[None], RATE)
    assert frequency_hz[density[0].argmax()] == 50.0


@pytest.mark.parametrize("samples", [4, 9, 100])
def test_a_short_record_has_a_spectrum_too(samples):
    frequency_hz, density = amplitude_densities(np.ones((1, samples)), RATE)
    assert frequency_hz[0] > 0
    assert np.isfinite(density).all()
