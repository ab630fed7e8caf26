"""The instruments: what a channel delivers of a known motion, and the decimating filter against a convolution."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import upfirdn, welch

from rig.errors import RigError
from rig.model.contact_laws import DeadZone
from rig.model.description import Contact, Rig, Sensor, Station
from rig.model.oscillator import Oscillator
from rig.model.sensing import PASSBAND
from rig.simulation.motion import Motion
from rig.simulation.sensors import decimate, decimator, digitise, plant_run_duration_s

RATE_HZ = 1000.0
FACTOR = 4
STEP_S = 1 / (RATE_HZ * FACTOR)
MASS = Station("mass")
PERFECT = Sensor(name="perfect", station=MASS, quantity="displacement")


def rig_with(*sensors):
    law = DeadZone(lower_clearance_m=1e-3, upper_clearance_m=1e-3, stiffness_n_per_m=1e4)
    return Rig(
        name="r",
        bodies=(Oscillator(name="mass", mass_kg=1.0, frequency_hz=5.0, damping_ratio=0.01),),
        contacts=(Contact(name="stop", at=MASS, against=None, law=law),),
        force_at=MASS,
        sensors=sensors,
        sample_rate_hz=RATE_HZ,
    )


def motion_of(signal, rows, step_s=STEP_S):
    """A motion whose every row, force and truth included, is the same signal."""
    row = signal[None, :]
    return Motion(0.0, step_s, row, np.repeat(row, rows, axis=0), row, row, row)


def deliver(signal, *sensors, seed=1):
    rig = rig_with(*sensors)
    blocks = list(digitise(rig, iter([motion_of(signal, len(sensors))]), np.random.default_rng(seed)))
    return np.concatenate([b.sensed["displacement"] for b in blocks], axis=1)


def tone(frequency_hz, duration_s=2.0, late_s=0.0):
    time_s = np.arange(round(duration_s / STEP_S)) * STEP_S - late_s
    return np.sin(2 * np.pi * frequency_hz * time_s)


def middle(values):
    """Away from the ends, where the filter sees the rest before and after the record."""
    return values[..., 100:-100]


def at_samples(frequency_hz, samples, late_s=0.0):
    return np.sin(2 * np.pi * frequency_hz * (np.arange(samples) / RATE_HZ - late_s))


@pytest.mark.parametrize("fraction", [0.01, 0.1, 0.25, 0.35, PASSBAND])
def test_the_passband_is_flat_and_in_phase(fraction):
    frequency_hz = fraction * RATE_HZ
    (delivered,) = deliver(tone(frequency_hz), PERFECT)
    np.testing.assert_allclose(middle(delivered), middle(at_samples(frequency_hz, delivered.size)), atol=1e-4)


@pytest.mark.parametrize("fraction", [0.6, 0.7, 1.0, 1.37, 1.99])
def test_what_would_alias_is_gone(fraction):
    (delivered,) = deliver(tone(fraction * RATE_HZ + 0.3), PERFECT)
    assert np.abs(middle(delivered)).max() < 1e-4


def test_force_passes_the_same_filter_and_the_truth_none():
    frequency_hz = 0.1 * RATE_HZ
    signal = tone(frequency_hz) + tone(0.8 * RATE_HZ)
    (samples,) = digitise(rig_with(PERFECT), iter([motion_of(signal, 1)]), np.random.default_rng(1))
    np.testing.assert_array_equal(samples.force_n, samples.sensed["displacement"][0])
    for truth in samples.truth.values():
        np.testing.assert_array_equal(truth[0], signal[::FACTOR][: truth.shape[1]])


@pytest.mark.parametrize("delay_s", [1e-3, 0.37e-3, 5.21e-3, -0.8e-3])
def test_a_delay_shows_the_motion_of_that_long_ago(delay_s):
    frequency_hz = 0.2 * RATE_HZ
    late = msgspec.structs.replace(PERFECT, delay_s=delay_s)
    (delivered,) = deliver(tone(frequency_hz), late)
    np.testing.assert_allclose(middle(delivered), middle(at_samples(frequency_hz, delivered.size, delay_s)), atol=1e-4)


def test_a_gain_multiplies():
    plain, scaled = deliver(tone(50.0), PERFECT, msgspec.structs.replace(PERFECT, name="scaled", gain=-1.03))
    np.testing.assert_allclose(scaled, -1.03 * plain, rtol=1e-12)


def test_noise_has_its_density_at_every_frequency():
    density = 3e-4
    noisy = msgspec.structs.replace(PERFECT, noise_density=density)
    (noise,) = deliver(np.zeros(round(100 / STEP_S)), noisy)
    frequency_hz, power = welch(noise, RATE_HZ, nperseg=500, detrend=False)
    averages = 2 * noise.size / 500
    inside = (frequency_hz > 0) & (frequency_hz < RATE_HZ / 2)
    np.testing.assert_allclose(np.sqrt(power[inside]), density, rtol=6 / np.sqrt(averages))
    assert np.std(noise) == pytest.approx(density * np.sqrt(RATE_HZ / 2), rel=4 / np.sqrt(2 * noise.size))


def test_sensors_are_noisy_independently_and_by_the_seed():
    noisy = [msgspec.structs.replace(PERFECT, name=name, noise_density=1e-3) for name in "ab"]
    silence = np.zeros(round(20 / STEP_S))
    first, repeated, other_seed = (deliver(silence, *noisy, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, repeated)
    for a, b in ((first[0], first[1]), (first[0], other_seed[0])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(a.size)


def test_a_range_clips():
    clipped = msgspec.structs.replace(PERFECT, measuring_range=0.5)
    plain, delivered = deliver(tone(20.0), PERFECT, msgspec.structs.replace(clipped, name="clipped"))
    np.testing.assert_array_equal(delivered, np.clip(plain, -0.5, 0.5))
    assert (np.abs(delivered) == 0.5).any()


@pytest.mark.parametrize("bits", [4, 8])
def test_quantisation_rounds_to_the_nearest_step(bits):
    coarse = msgspec.structs.replace(PERFECT, name="coarse", measuring_range=2.0, bits=bits)
    ramp = np.linspace(-1, 1, round(4 / STEP_S))
    plain, delivered = middle(deliver(ramp, PERFECT, coarse))
    step = 4.0 / 2**bits
    assert np.abs(delivered - plain).max() <= step / 2 * (1 + 1e-9)
    levels = np.unique(delivered)
    np.testing.assert_allclose(levels / step, np.round(levels / step), atol=1e-12)
    np.testing.assert_allclose(np.diff(levels), step)  # the ramp passes every level between


@given(st.lists(st.integers(1, 4000), min_size=1, max_size=8), st.sampled_from([1, 2, 4]))
def test_blocks_do_not_show(sizes, factor):
    late = msgspec.structs.replace(PERFECT, name="late", delay_s=2.3e-3, gain=2.0, noise_density=0.1)
    sensors = (msgspec.structs.replace(PERFECT, noise_density=0.1), late)
    rig = rig_with(*sensors)
    signal = np.random.default_rng(sum(sizes)).standard_normal(sum(sizes))
    single_block = motion_of(signal, 2, step_s=1 / (RATE_HZ * factor))
    stops = np.cumsum(sizes)
    pieces = [
        replace(
            motion_of(signal[stop - size : stop], 2, step_s=single_block.step_s),
            start_s=float((stop - size) * single_block.step_s),
        )
        for size, stop in zip(sizes, stops, strict=True)
    ]
    results = []
    for blocks in ([single_block], pieces):
        segments = list(digitise(rig, iter(blocks), np.random.default_rng(1)))
        results.append([np.concatenate([p.sensed["displacement"] for p in segments], axis=1)] if segments else [])
        results[-1] += [np.concatenate([p.truth["displacement"] for p in segments], axis=1)] if segments else []
    for expected, delivered in zip(*results, strict=True):
        np.testing.assert_allclose(expected, delivered, atol=1e-12)


@pytest.mark.parametrize("delay_s", [0.0, 0.01, -0.003])
@pytest.mark.parametrize("duration_s", [0.5, 1.234])
def test_the_needed_duration_is_enough_for_the_record(duration_s, delay_s):
    late = msgspec.structs.replace(PERFECT, delay_s=delay_s)
    signal = np.zeros(round(plant_run_duration_s(rig_with(late), duration_s) / STEP_S))
    assert deliver(signal, late).shape[1] >= round(duration_s * RATE_HZ)


@pytest.mark.parametrize("step_s", [1 / 1500, 1 / 500, 2.0**-12])
def test_a_step_that_does_not_divide_the_sampling_interval_is_refused(step_s):
    blocks = iter([motion_of(np.zeros(1000), 1, step_s=step_s)])
    with pytest.raises(RigError, match=r"sample_rate_hz is 1000\.0 .* must be a whole multiple"):
        list(digitise(rig_with(PERFECT), blocks, np.random.default_rng(1)))


def by_convolution(taps, signals, factor, samples):
    """Convolved at the full rate where all taps meet a sample, then every factor-th."""
    return np.array([upfirdn(taps, row)[taps.size - 1 :: factor][:samples] for row in signals])


@given(
    st.integers(1, 9),
    st.integers(1, 300),
    st.integers(0, 40),
    st.integers(0, 40),
    st.integers(1, 100),
    st.integers(0, 1000),
)
def test_it_is_a_convolution_decimated(factor, used, before, behind, samples, seed):
    rng = np.random.default_rng(seed)
    taps = np.concatenate([np.zeros(before), rng.standard_normal(used), np.zeros(behind)])
    needed = (samples - 1) * factor + taps.size
    signals = rng.standard_normal((3, needed))
    filter_ = decimator(taps, factor)
    room = np.pad(signals, ((0, 0), (0, max(0, filter_.reach(samples) - needed))))
    filtered = decimate(filter_, room, samples)
    expected = by_convolution(taps, signals, factor, samples)
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-13 * np.abs(taps).sum())


@pytest.mark.parametrize("late", [0, 5, 4000])
def test_taps_of_zero_cost_nothing(late):
    """A filter that is centred late is as small as one that is not."""
    taps = np.zeros(8001)
    taps[late : late + 129] = 1.0
    assert decimator(taps, 4).toeplitz_pieces.size == decimator(np.ones(129), 4).toeplitz_pieces.size


def test_no_taps_give_nothing():
    filter_ = decimator(np.zeros(33), 4)
    assert not decimate(filter_, np.ones((2, filter_.reach(20))), 20).any()
