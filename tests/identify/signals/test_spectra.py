"""Blocks, windows and bands."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from identify.signals.spectra import (
    WINDOW_EXPONENTS,
    Averaging,
    at_force_rate,
    blocks,
    force_band_hz,
    window_derivatives,
)
from rig.errors import RigError

RATE_HZ = 1000.0


@pytest.mark.parametrize("name", WINDOW_EXPONENTS)
@pytest.mark.parametrize("order", [1, 2])
def test_the_windows_derivatives_are_derivatives(name, order):
    errors = []
    for length in (500, 1000):  # the window has the period of the block, so differences wrap round
        rate_hz = float(length)
        before, derivative = window_derivatives(name, length, rate_hz)[[order - 1, order]]
        numerical = (np.roll(before, -1) - np.roll(before, 1)) * rate_hz / 2
        errors.append(np.abs(numerical - derivative).max() / np.abs(derivative).max())
    assert errors[0] < 1e-2
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.02)  # central differences are of second order


@pytest.mark.parametrize("name", WINDOW_EXPONENTS)
def test_the_window_and_its_slope_vanish_where_a_block_begins(name):
    shape = window_derivatives(name, 64, RATE_HZ)
    assert shape[0, 0] == shape[1, 0] == 0
    assert shape[0].max() == shape[0, 32] == pytest.approx(1)


@pytest.mark.parametrize("name", ["sin4", "sin6"])
def test_derivatives_can_be_moved_from_the_signal_to_the_window(name):
    """Integration by parts: W[x''] = W''[x] - 2 i omega W'[x] - omega^2 W[x] for a motion that is not periodic."""
    time_s = np.arange(3000) / RATE_HZ
    pole = -0.4 + 2j * np.pi * 7.3
    x = np.exp(pole * time_s)
    cut = blocks(x.size, RATE_HZ, Averaging(block_s=1.0, window=name), (1.0, 50.0))
    omega = 2 * np.pi * cut.frequency_hz
    by_window = cut.spectra(x.real, 2) - 2j * omega * cut.spectra(x.real, 1) - omega**2 * cut.spectra(x.real)
    direct = cut.spectra((pole**2 * x).real)
    np.testing.assert_allclose(by_window, direct, atol=1e-6 * np.abs(direct).max())


def test_a_tone_stands_at_its_line_with_the_windows_mean():
    length, line = 200, 7
    x = np.cos(2 * np.pi * line * np.arange(1000) / length)
    cut = blocks(x.size, RATE_HZ, Averaging(block_s=length / RATE_HZ), (5.0, 100.0))
    spectra = cut.spectra(x)
    line_index = int(np.argmin(np.abs(cut.frequency_hz - line * RATE_HZ / length)))
    assert cut.frequency_hz[line_index] == line * RATE_HZ / length
    # the Hann window's mean is 1/2, the cosine's half 1/2
    np.testing.assert_allclose(np.abs(spectra[:, line_index]), length / 4)
    np.testing.assert_allclose(spectra[:, line_index + 3 :], 0, atol=1e-9 * length)


@given(
    samples=st.integers(2000, 50_000), averages=st.integers(2, 60), overlap=st.sampled_from([0.0, 0.25, 0.5, 0.75, 0.9])
)
def test_blocks_cover_the_record(samples, averages, overlap):
    assume(samples / (1 + (averages - 1) * (1 - overlap)) > 100)
    cut = blocks(samples, RATE_HZ, Averaging(averages=averages, overlap=overlap), (20.0, 300.0))
    hops = set(np.diff(cut.starts))
    assert cut.starts[0] == 0
    assert len(cut.starts) >= averages
    assert len(hops) == 1
    assert abs(hops.pop() - (1 - overlap) * cut.block_samples) <= 1
    left_over = samples - (cut.starts[-1] + cut.block_samples)
    assert 0 <= left_over < cut.starts[1]


@given(half=st.integers(25, 1000), low=st.integers(0, 200), width=st.integers(40, 250), extra=st.integers(0, 5000))
def test_lines_are_those_in_the_band(half, low, width, extra):
    samples = 2 * half + extra
    cut = blocks(samples, RATE_HZ, Averaging(block_s=2 * half / RATE_HZ), (float(low), float(low + width)))
    assert cut.block_samples == 2 * half
    assert cut.resolution_hz == pytest.approx(RATE_HZ / cut.block_samples)
    numbers = [n for n in range(half) if low * cut.block_samples <= n * RATE_HZ <= (low + width) * cut.block_samples]
    np.testing.assert_allclose(cut.frequency_hz, np.array(numbers) * RATE_HZ / cut.block_samples)
    assert cut.spectra(np.ones(samples)).shape == (len(cut.starts), len(numbers))


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"averages": 1}, "averages is 1; give 2 or more"),
        ({"block_s": 0.0}, "the block is 0.0 s; give a value above zero"),
        ({"block_s": np.nan}, "the block is nan s"),
        ({"overlap": 1.0}, "overlap is 1.0; give a value from 0 to below 1"),
        ({"overlap": -0.1}, "overlap is -0.1"),
        ({"window": "box"}, "no window 'box'; there are hann, sin4, sin6"),
        ({"band_hz": (5.0, 5.0)}, "the band 5.0 to 5.0 Hz is empty"),
        ({"band_hz": (-1.0, 5.0)}, "the band -1.0 to 5.0 Hz is empty"),
        ({"band_hz": (0.0, np.inf)}, "the band 0.0 to inf Hz"),
    ],
)
def test_a_bad_averaging_is_refused(settings, sentence):
    with pytest.raises(RigError, match=sentence):
        Averaging(**settings)


@pytest.mark.parametrize(
    ("averaging", "band_hz", "sentence"),
    [
        (Averaging(block_s=3.0), (1.0, 10.0), "a block of 3 s does not fit a record with 2 usable seconds"),
        (Averaging(averages=1000), (1.0, 10.0), "does not fit a record with 2 usable seconds; choose another block"),
        (Averaging(block_s=0.5), (10.5, 11.5), "the band 10.5 to 11.5 Hz holds no lines at a resolution of 2 Hz"),
        (Averaging(block_s=0.5), (256.0, 204.8), "begins at 256 Hz, and 1000 samples a second show the motion up to"),
        (Averaging(block_s=0.5), (10.0, 600.0), "and 1000 samples a second; choose another band"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(averaging, band_hz, sentence):
    with pytest.raises(RigError, match=sentence):
        blocks(2000, RATE_HZ, averaging, band_hz)


INSIDE = slice(400, -400)
"""Away from the ends, where the record is led to zero."""


@pytest.mark.parametrize("factor", [1, 2, 5])
def test_decimation_keeps_what_the_new_rate_can_show_and_no_more(factor):
    samples = 6001
    time_s = np.arange(samples) / RATE_HZ
    passed = np.sin(2 * np.pi * 0.35 * RATE_HZ / factor * time_s)
    stopped_share = 0.61 if factor > 1 else 0.45  # sensors' filters act above 0.4 of the recorded rate
    stopped = np.sin(2 * np.pi * stopped_share * RATE_HZ / factor * time_s)
    decimated_rows = at_force_rate(np.stack([passed, passed + stopped]), factor)
    assert decimated_rows.shape == (2, -(-samples // factor))
    for row in decimated_rows:
        np.testing.assert_allclose(row[INSIDE], passed[::factor][INSIDE], atol=2e-3)


@pytest.mark.parametrize("factor", [1, 6])
def test_the_end_of_a_record_rings_in_its_last_samples_alone(factor):
    """What comes behind the end is not known; an ideal low-pass carries that through the whole record."""
    whole = np.random.default_rng(1).standard_normal(12000)
    difference = at_force_rate(whole[:9000], factor) - at_force_rate(whole, factor)[: 9000 // factor]
    assert np.std(difference[-8:]) > 0.03
    assert np.std(difference[:-64]) < 1e-3  # 5e-3 and more by an ideal one


def test_the_band_of_a_force_holds_all_but_the_share_at_either_end():
    duration_s, low, high, share = 20.0, 20.0, 80.0, 0.01
    samples = int(duration_s * RATE_HZ)
    lines = np.arange(int(low * duration_s), int(high * duration_s) + 1)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * np.random.default_rng(1).uniform(size=lines.size))  # equal power
    band_hz = force_band_hz(np.fft.irfft(spectrum, samples), RATE_HZ, share)
    lines_out = share * lines.size
    assert band_hz[0] == pytest.approx(low + lines_out / duration_s, abs=1 / duration_s)
    assert band_hz[1] == pytest.approx(high - lines_out / duration_s, abs=1 / duration_s)


def test_the_band_of_several_forces_holds_that_of_each_that_acts():
    tones = [np.sin(2 * np.pi * hz * np.arange(2000) / RATE_HZ) for hz in (40.0, 5.0)]
    assert force_band_hz(np.stack([tones[0], 1e-3 * tones[1], 0 * tones[0]]), RATE_HZ) == pytest.approx((5.0, 40.0))


@pytest.mark.parametrize(("value", "said"), [(0.0, "zero throughout"), (2.0, "constant")])
def test_no_force_has_no_band(value, said):
    with pytest.raises(RigError, match=f"the exciting force is {said}"):
        force_band_hz(np.full(100, value), RATE_HZ)
