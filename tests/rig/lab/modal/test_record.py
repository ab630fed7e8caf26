"""Modes fitted to time records: against scipy's state-space simulation of random structures."""

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from rig.errors import RigError
from rig.lab.modal.record import MeasuredResponse, fit_record

RATE_HZ, PERIOD = 200.0, 2048
BAND_HZ = (2.0, 30.0)
NATURAL_HZ = np.array([4.1, 9.3, 11.7, 21.0])
RATIOS = np.array([0.02, 0.008, 0.012, 0.006])
SHAPES = np.array([[0.4, 0.3, 0.5, 0.6], [-0.6, 0.7, 0.2, -0.5], [0.8, -0.4, 0.6, 0.3]])
PLACES_M = (0.0, 0.5, 0.8)
OUTSIDE = {"natural_hz": 55.0, "ratio": 0.01, "shape": (1.1, 0.4, -0.8)}


def band_limited(samples, rng):
    """Random phases, equal amplitudes in the band, 10 N rms."""
    hz = np.fft.rfftfreq(samples, 1 / RATE_HZ)
    inside = (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1])
    force = np.fft.irfft(inside * np.exp(2j * np.pi * rng.random(hz.size)), samples)
    return 10 * force / force.std()


def force_of(kind, rng):
    return np.tile(band_limited(PERIOD, rng), 6) if kind == "repeats" else band_limited(6 * PERIOD, rng)


def response(force_n, order, natural_hz, ratios, shapes):
    """Simulate at eight times the rate, with the force band-limited between the samples."""
    count, fine = natural_hz.size, 8
    omega, zero, identity = 2 * np.pi * natural_hz, np.zeros((count, count)), np.eye(count)
    a = np.block([[zero, identity], [-np.diag(omega**2), -np.diag(2 * ratios * omega)]])
    b = np.concatenate([np.zeros(count), shapes[0]])[:, None]
    outputs = (np.concatenate([shapes, 0 * shapes], axis=1), np.concatenate([0 * shapes, shapes], axis=1), None)
    c = shapes @ a[count:] if order == 2 else outputs[order]
    d = shapes @ b[count:] if order == 2 else np.zeros((len(shapes), 1))
    spectrum = np.fft.rfft(force_n)
    smooth = np.fft.irfft(spectrum, fine * force_n.size) * fine
    times = np.arange(smooth.size) / (fine * RATE_HZ)
    return lsim(StateSpace(a, b, c, d), smooth, times)[1].T[:, ::fine]


@pytest.mark.parametrize("order", [0, 2])
@pytest.mark.parametrize("kind", ["repeats", "random"])
def test_the_modes_of_a_record_are_found(kind, order):
    rng = np.random.default_rng(order)
    force_n = force_of(kind, rng)
    clean = response(force_n, order, NATURAL_HZ, RATIOS, SHAPES)
    noise = 0.01 * clean.std(axis=1, keepdims=True) * rng.standard_normal(clean.shape)
    measured = MeasuredResponse(force_n, clean + noise, order, RATE_HZ)
    fit = fit_record(measured, PLACES_M, 0, 1.0, BAND_HZ)
    inside = [k for k, hz in enumerate(fit.body.natural_hz) if BAND_HZ[0] <= hz <= BAND_HZ[1]]
    np.testing.assert_allclose(fit.body.frequencies_hz(fit.body.max_modes)[inside], NATURAL_HZ, rtol=3e-4)
    np.testing.assert_allclose(fit.body.damping_ratios(fit.body.max_modes)[inside], RATIOS, rtol=0.03)
    shapes = fit.body.shapes(np.array(PLACES_M), fit.body.max_modes)[:, inside]
    np.testing.assert_allclose(shapes * np.sign(shapes[0]), SHAPES, atol=0.02)
    assert (fit.misfits < 0.012).all(), "little beside the noise"
    assert fit.unmodelled_share < 0.004
    assert fit.period_s == (PERIOD / RATE_HZ if kind == "repeats" else None)
    np.testing.assert_allclose(fit.noise_density, np.sqrt(2 / RATE_HZ) * noise.std(axis=1), rtol=0.1)


def test_a_mode_stands_for_those_above_the_band():
    """The free run is right where the modes in the band alone miss much."""
    rng = np.random.default_rng(3)
    force_n = force_of("repeats", rng)
    natural_hz, ratios = np.append(NATURAL_HZ, OUTSIDE["natural_hz"]), np.append(RATIOS, OUTSIDE["ratio"])
    shapes = np.column_stack([SHAPES, OUTSIDE["shape"]])
    measured = MeasuredResponse(force_n, response(force_n, 2, natural_hz, ratios, shapes), 2, RATE_HZ)
    fit = fit_record(measured, PLACES_M, 0, 1.0)
    assert fit.misfits.max() < 2e-3
    np.testing.assert_allclose(fit.unmodelled_share, np.sqrt(np.mean(fit.misfits**2)), rtol=0.1)
    assert fit.frf_fit_misfits.max() > 0.05


def test_what_cannot_be_fitted_is_said():
    rng = np.random.default_rng(6)
    force_n = force_of("random", rng)
    noise = MeasuredResponse(force_n, rng.standard_normal((3, force_n.size)), 2, RATE_HZ)
    with pytest.raises(RigError, match="no mode"):
        fit_record(noise, PLACES_M, 0, 1.0)
    with pytest.raises(RigError, match="excites no line in band_hz"):
        fit_record(noise, PLACES_M, 0, 1.0, (60.0, 80.0))
    with pytest.raises(RigError, match="band_hz has 1 numbers"):
        fit_record(noise, PLACES_M, 0, 1.0, (60.0,))
