"""The channels of a record against the true motion and force."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import welch

from tests.campaigns.worlds.forces import Gaussian
from tests.campaigns.worlds.instruments import measured
from tests.campaigns.worlds.machine import ForceCell, MachineTone, Place, Shaking, with_sensors
from tests.campaigns.worlds.simulator import model_of
from tests.test_campaigns.worlds.examples import alone, beam

RATE_HZ = 4096.0
BAR = alone(beam(damping_ratio=0.03), 0.8)


def record(machine, seconds=4.0, rms_n=2.0, quiet_s=1.0, seed=5):
    excitation = Gaussian(rms_n=rms_n, begins_s=quiet_s)
    return measured(machine, excitation, round(seconds * RATE_HZ), RATE_HZ, seed)


def test_the_force_has_its_level_its_band_and_a_quiet_start():
    force = record(BAR).force_n
    quiet, excited = force[:4000], force[4096:]
    assert np.abs(quiet).max() < 1e-3 * np.abs(excited).max()
    assert np.sqrt(np.mean(excited**2)) == pytest.approx(2.0, rel=1e-3)
    hertz, power = welch(excited, RATE_HZ, nperseg=4096)
    assert power[(hertz > 110) & (hertz < 2000)].sum() < 1e-4 * power.sum()


def test_a_cantilever_answers_as_its_receptance_says():
    """Acceleration over force at the same place is -w^2 sum phi^2 / (w_i^2 - w^2 + 2 i zeta w_i w)."""
    found = record(BAR, 16.0, quiet_s=0.0)
    model = model_of(BAR)
    omega = 2 * np.pi * 20.0
    lines = np.sum(model.sensed[0] ** 2 / (model.omega**2 - omega**2 + 2j * model.zeta * model.omega * omega))
    window = np.hanning(found.force_n.size)
    ratios = []
    for hertz in (19.9375, 20.0, 20.0625):
        line = round(hertz * found.force_n.size / RATE_HZ)
        a, f = (np.fft.rfft(window * x)[line] for x in (found.delivered[0], found.force_n))
        ratios.append((a * np.conj(f), abs(f) ** 2))
    cross, power = np.sum(ratios, axis=0)
    assert cross / power == pytest.approx(-(omega**2) * lines, rel=0.02)


def test_gain_and_delay_of_a_sensor_and_of_the_force():
    plain = record(BAR)
    changed = with_sensors(BAR, "all", lambda s: replace(s, gain=1.2, delay_s=2 / RATE_HZ))
    changed = replace(changed, cell=ForceCell(gain=0.7, delay_s=-3 / RATE_HZ))
    other = record(changed)
    here, late, early = slice(100, -100), slice(98, -102), slice(103, -97)
    np.testing.assert_allclose(other.delivered[0, here], 1.2 * plain.delivered[0, late], atol=1e-9)
    np.testing.assert_allclose(other.force_n[here], 0.7 * plain.force_n[early], atol=1e-9)


def test_an_amplifier_turns_the_phase_as_a_first_order_high_pass():
    """s / (s + w_c)."""
    corner_hz = 0.3
    shaken = replace(BAR, shaking=Shaking(acceleration_rms_m_per_s2=1.0, low_hz=0.4, high_hz=3.0))
    quiet = {"rms_n": 1e-9, "seconds": 32.0}
    plain = record(shaken, **quiet).delivered[0]
    passed = record(with_sensors(shaken, "all", lambda s: replace(s, highpass_hz=corner_hz)), **quiet)
    window = np.hanning(plain.size)
    spectra = [np.fft.rfft(window * x) for x in (passed.delivered[0], plain)]
    hertz = np.fft.rfftfreq(plain.size, 1 / RATE_HZ)
    for low, high in ((0.5, 0.7), (1.9, 2.1)):
        some = (hertz > low) & (hertz < high)
        found = np.sum(spectra[0][some] * np.conj(spectra[1][some])) / np.sum(np.abs(spectra[1][some]) ** 2)
        middle = (low + high) / 2
        assert found == pytest.approx(1j * middle / (1j * middle + corner_hz), abs=0.03)


def test_noise_has_its_density():
    noisy = with_sensors(BAR, "all", lambda s: replace(s, noise_density=1e-3))
    noisy = replace(noisy, cell=ForceCell(noise_density=5e-4))
    plain, other = record(BAR), record(noisy)
    for difference, density in (
        (other.delivered[0] - plain.delivered[0], 1e-3),
        (other.force_n - plain.force_n, 5e-4),
    ):
        assert np.sqrt(np.mean(welch(difference, RATE_HZ)[1])) == pytest.approx(density, rel=0.03)


def test_a_lateral_motion_adds_its_share_and_is_not_the_motion():
    plain = record(BAR, 8.0).delivered[0]
    sideways = with_sensors(BAR, "all", lambda s: replace(s, lateral_share=0.1))
    added = record(sideways, 8.0).delivered[0] - plain
    assert np.std(added) == pytest.approx(0.1 * np.std(plain), rel=0.15)
    assert abs(np.corrcoef(added, plain)[0, 1]) < 0.3
    assert np.abs(added[:3000]).max() < 1e-3 * np.abs(added).max()


def test_a_tone_is_there_from_the_start():
    tone = MachineTone(at=Place("bar", 0.8), cosine_n=0.3, sine_n=-0.4, frequency_hz=50.0)
    found = record(replace(BAR, tones=(tone,)), 1.5).delivered[0, : int(0.9 * RATE_HZ)]
    spectrum = np.abs(np.fft.rfft(found * np.hanning(found.size)))
    assert np.argmax(spectrum) * RATE_HZ / found.size == pytest.approx(50.0, abs=1.2)
    assert np.std(found[:800]) == pytest.approx(np.std(found[-800:]), rel=0.1)
