"""Forces: their band, their root mean square, and that they are the same force at every step."""

import numpy as np
import pytest
from scipy.signal import periodogram

from rig.errors import RigError
from rig.simulation.excitation import QUIET_S, RISE_S, excitation_of, force_history, force_signal

STEP_S = 2.0**-11
KINDS = ["gaussian", "burst", "sweep", "multisine", "free_decay"]


def history(kind, duration_s=33.0, step_s=STEP_S, **changes):
    settings = {"rms_n": 3.0, "low_hz": 20.0, "high_hz": 80.0} | changes
    return force_history(excitation_of(kind, **settings), duration_s, step_s)


def excited(kind, **changes):
    return history(kind, **changes)[round(QUIET_S / STEP_S) :]


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_second_is_quiet_and_the_force_sets_in_without_a_jump(kind):
    force = history(kind)
    quiet = round(QUIET_S / STEP_S)
    assert force.size == round(33 / STEP_S)
    np.testing.assert_allclose(force[: quiet + 1], 0, atol=1e-12)
    # a band up to 80 Hz and five times its rms: no step changes by more than such a wave does
    assert np.abs(np.diff(force)).max() < 2 * np.pi * 80 * STEP_S * 5 * 3.0


@pytest.mark.parametrize("kind", ["gaussian", "burst", "sweep", "multisine"])
def test_power_lies_in_the_band(kind):
    frequency_hz, density = periodogram(excited(kind), 1 / STEP_S, window="hann")
    inside = (frequency_hz > 19) & (frequency_hz < 81)
    assert density[~inside].sum() < 2e-3 * density.sum()
    third = np.array([density[(frequency_hz >= a) & (frequency_hz < a + 20)].sum() for a in (20, 40, 60)])
    if kind != "sweep":  # a window over a sweep favours the middle of the band
        np.testing.assert_allclose(third / third.sum(), 1 / 3, atol=0.04)


@pytest.mark.parametrize(("kind", "tolerance"), [("gaussian", 1e-12), ("burst", 1e-12), ("sweep", 1e-12)])
def test_rms_over_the_excited_part(kind, tolerance):
    assert np.sqrt(np.mean(excited(kind) ** 2)) == pytest.approx(3.0, rel=tolerance)


def test_rms_of_a_multisine_is_taken_over_a_period_once_it_has_set_in():
    force = excited("multisine")
    period = round(8 / STEP_S)
    assert np.sqrt(np.mean(force[period : 2 * period] ** 2)) == pytest.approx(3.0, rel=1e-12)
    np.testing.assert_allclose(force[period : 2 * period], force[2 * period : 3 * period], atol=1e-10)


def test_gaussian_amplitudes():
    force = excited("gaussian", duration_s=401.0) / 3.0
    independent = 400 * 2 * 60  # band-limited noise has 2 B T independent values
    assert np.mean(force**4) == pytest.approx(3, abs=5 * np.sqrt(96 / independent))
    assert np.mean(np.abs(force) < 1) == pytest.approx(0.6827, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_force_at_any_step(kind):
    coarse = history(kind)
    fine = history(kind, step_s=STEP_S / 4)[::4]
    np.testing.assert_allclose(fine, coarse, atol=1e-5 * 3.0)  # the rms that scales it is a sum over the samples


@pytest.mark.parametrize("kind", ["gaussian", "burst", "multisine"])
def test_the_seed_decides(kind):
    first, repeated, other_seed = (history(kind, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, repeated)
    assert abs(np.corrcoef(first, other_seed)[0, 1]) < 0.1  # sqrt(1 / 2 B T) is 0.016


def test_bursts_pause():
    force = excited("burst")
    time_s = np.arange(force.size) * STEP_S
    phase = np.mod(time_s, 4.0) / 4.0
    assert not force[phase > 0.6].any()
    assert np.abs(force[phase < 0.6]).max() > 3.0


def test_a_free_decay_begins_with_one_half_sine():
    force = excited("free_decay")
    blow_s = 1 / (2 * 80.0)
    time_s = np.arange(force.size) * STEP_S
    assert not force[time_s >= blow_s].any()
    impulse = force.sum() * STEP_S
    assert impulse == pytest.approx(3.0 * np.sqrt(2) * blow_s * 2 / np.pi, rel=0.02)


def test_noise_rises_within_its_rise_time():
    force = excited("gaussian")
    late = round(RISE_S / STEP_S)
    steady = np.sqrt(np.mean(force[late : 20 * late] ** 2))
    assert np.sqrt(np.mean(force[: late // 8] ** 2)) < 0.05 * steady


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"kind": "mallet"}, "no excitation 'mallet'; there are gaussian, burst, sweep, stepped_sine, multisine,"),
        ({"rms_n": -1.0}, "rms_n is -1.0"),
        ({"rms_n": float("nan")}, "rms_n is nan"),
        ({"low_hz": 80.0}, "the band 80.0 to 80.0 Hz is empty"),
        ({"high_hz": float("inf")}, "the band 20.0 to inf Hz is empty"),
        ({"seed": -1}, "seed is -1"),
        ({"duration_s": 1.0}, "duration is 1.0 s; give more than 1.0 s"),
        ({"duration_s": float("nan")}, "duration is nan s"),
        ({"step_s": 0.0}, "step is 0.0 s"),
        ({"step_s": 0.01}, "step is 0.01 s; 80.0 Hz needs"),
        ({"low_hz": 20.1, "high_hz": 20.2, "duration_s": 2.0}, "no line of 20.1 to 20.2 Hz fits 1 s; record longer"),
    ],
)
def test_a_force_that_cannot_be_is_refused(changes, sentence):
    with pytest.raises(RigError) as caught:
        history(**{"kind": "gaussian"} | changes)
    assert sentence in str(caught.value)


def long_force(duration_s=1100.0, step_s=STEP_S, **changes):
    settings = {"rms_n": 3.0, "low_hz": 20.0, "high_hz": 80.0} | changes
    return force_signal(excitation_of("gaussian", **settings), duration_s, step_s)


def test_a_long_force_is_the_same_however_it_is_sliced_and_stepped():
    force = long_force()
    full = force[:]
    assert full.size == len(force) == round(1100 / STEP_S)
    pieces = [force[first : first + 77777] for first in range(0, len(force), 77777)]
    np.testing.assert_array_equal(np.concatenate(pieces), full)
    np.testing.assert_allclose(long_force(step_s=STEP_S / 2)[:][::2], full, atol=1e-10)


def test_a_long_force_has_its_level_and_its_band_everywhere():
    full = long_force()[:]
    assert not full[: round(QUIET_S / STEP_S)].any()
    levels = [piece.std() for piece in np.array_split(full[round(QUIET_S / STEP_S) :], 10)]
    np.testing.assert_allclose(levels, 3.0, rtol=0.05)
    frequency_hz, density = periodogram(full, 1 / STEP_S, window="hann")
    assert density[(frequency_hz < 19) | (frequency_hz > 81)].sum() < 1e-4 * density.sum()


def test_a_force_that_is_not_long_is_an_array():
    assert isinstance(
        force_signal(excitation_of("gaussian", rms_n=3.0, low_hz=20.0, high_hz=80.0), 30.0, STEP_S), np.ndarray
    )


def test_a_long_force_beyond_the_step_is_refused():
    with pytest.raises(RigError, match="needs a step"):
        long_force(high_hz=0.3 / STEP_S)


@pytest.mark.parametrize("kind", ["hammer", "stepped_sine"])
def test_hits_and_steps_have_their_rms_and_are_the_same_at_any_step(kind):
    settings = {"low_hz": 0.5, "high_hz": 80.0}
    force = excited(kind, **settings)
    assert np.sqrt(np.mean(force**2)) == pytest.approx(3.0, rel=1e-12)
    fine = history(kind, step_s=STEP_S / 4, **settings)[round(4 * QUIET_S / STEP_S) :: 4]
    np.testing.assert_allclose(fine, force, atol=2e-2 * np.abs(force).max())  # a hit lasts 13 samples


def test_the_spectrum_of_a_hit_is_flat_to_above_its_band():
    force = excited("hammer", low_hz=0.0)
    frequency_hz = np.fft.rfftfreq(force.size, STEP_S)
    size = np.abs(np.fft.rfft(force)) / np.abs(force.sum())
    assert np.all(size[frequency_hz <= 1.15 * 80] > 10 ** (-3 / 20))
    assert size[np.argmin(np.abs(frequency_hz - 240))] < 0.03


def test_there_are_so_many_hits_a_second():
    force = excited("hammer", low_hz=0.5)
    begins = np.flatnonzero((force[1:] > 0) & (force[:-1] == 0)) * STEP_S
    assert len(begins) == 16
    assert np.all(np.diff(begins) > 1.5)
    assert np.all(force >= 0)


def test_a_stepped_sine_holds_each_frequency_and_never_jumps():
    force = excited("stepped_sine", duration_s=41.0)
    assert np.abs(np.diff(force)).max() < 2 * np.pi * 80 * STEP_S * 3.0 * np.sqrt(2) * 1.01
    for step, frequency_hz in ((4, 20 + 60 * 4 / 19), (15, 20 + 60 * 15 / 19)):
        held = force[round((2 * step + 0.2) / STEP_S) : round((2 * step + 1.8) / STEP_S)]
        crossings = np.count_nonzero(np.diff(np.sign(held)) != 0)
        assert crossings / 2 / 1.6 == pytest.approx(frequency_hz, abs=0.7)
