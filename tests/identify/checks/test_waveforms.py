"""Each check of a waveform on noise in a band: silent on it as it is, and by name on what was done to it."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from identify.checks import waveforms

RATE = 2000.0


@pytest.fixture
def row() -> np.ndarray:
    """10 s at rest for a second, then motion from 2 to 200 Hz of one unit rms."""
    rng = np.random.default_rng(1)
    motion = sosfiltfilt(butter(4, [2, 200], "band", fs=RATE, output="sos"), rng.standard_normal(20_000))
    motion[:2000] = 0
    return motion / motion.std() + 1e-4 * rng.standard_normal(motion.size)


@pytest.fixture
def force(row) -> np.ndarray:
    force_n = np.random.default_rng(2).standard_normal(row.size)
    force_n[:2000] = 0
    return force_n


def causes(row, force, other_rows=()):
    """All findings of one channel."""
    checks = (
        waveforms.dead_finding("x", row),
        waveforms.clipped_finding("x", row),
        waveforms.quantised_finding("x", row),
        waveforms.held_samples_finding("x", row, force),
        waveforms.spikes_finding(
            "x",
            waveforms.relative_neighbour_deviation(row),
            [waveforms.relative_neighbour_deviation(r) for r in other_rows],
        ),
        waveforms.hum_finding("x", RATE, row, force),
        waveforms.noise_finding("x", RATE, row, force),
        waveforms.drift_finding("x", RATE, row),
        waveforms.offset_finding("x", row),
        waveforms.initial_motion_finding("x", RATE, row, 0.02),
    )
    return [f.cause for f in checks if f is not None]


def changed(row, samples, values):
    changed_row = row.copy()
    changed_row[samples] = values
    return changed_row


TIME_S = np.arange(20_000) / RATE
SPOILT = {
    "dead": lambda r: np.full_like(r, 0.2),
    "clipped": lambda r: np.clip(r, -1.5, 1.5),
    "quantised": lambda r: np.round(r / 0.2) * 0.2,
    "held samples": lambda r: changed(r, slice(9000, 9030), r[9000]),
    "spikes": lambda r: changed(r, 9000, 15.0),
    "hum": lambda r: r + 0.05 * np.sin(2 * np.pi * 50 * TIME_S),
    "noise": lambda r: r + 0.2 * np.random.default_rng(3).standard_normal(r.size),
    "drift": lambda r: r + 0.5 * np.cos(2 * np.pi * 0.1 * TIME_S),
    "offset": lambda r: r + 0.3,
    "not at rest": lambda r: r[2500:],
}


def test_a_sound_waveform_has_no_finding(row, force):
    assert causes(row, force, [row[::-1]]) == []


@pytest.mark.parametrize("cause", SPOILT)
def test_a_spoilt_waveform_is_named(row, force, cause):
    spoilt = SPOILT[cause](row)
    assert cause in causes(spoilt, force[-spoilt.size :], [row[-spoilt.size :]])


def test_what_other_channels_show_too_is_an_impact(row, force):
    struck = changed(row, 9000, 15.0)
    assert "spikes" not in causes(struck, force, [changed(row[::-1], 9000, 9.0)])


def test_a_jump_like_those_that_other_channels_show_is_an_impact_and_a_larger_one_is_a_spike(row, force):
    rng = np.random.default_rng(4)
    struck, shown = (r + 0.1 * rng.standard_normal(row.size) for r in (row, row[::-1]))
    for k in range(3000, 15000, 1000):
        struck[k] += 4.0
        shown[k] += 3.0 * (k != 9000)  # of one of them the other channel shows nothing
    assert "spikes" in causes(struck, force, [row[::-1]])
    assert "spikes" not in causes(struck, force, [shown])
    assert "spikes" in causes(changed(struck, 9500, 60.0), force, [shown])


def test_motion_before_the_force_is_told_from_noise(row, force):
    early = np.roll(row, -1500)
    assert waveforms.noise_finding("x", RATE, early, force).cause == "force"


def test_copies_are_found_whatever_their_scale(row):
    reversed_row = row[::-1]
    findings = list(waveforms.copy_findings(["a", "b", "c"], [row, reversed_row, -3 * row]))
    assert [(f.cause, f.channels) for f in findings] == [("copy", ("a", "c"))]


def test_a_constant_row_has_no_offset_in_shares_of_its_motion():
    assert waveforms.offset_finding("a", np.ones(9)) is None


def test_a_hum_whose_squares_are_zero_has_no_size():
    row = 1e-310 * np.sin(2 * np.pi * 50 * np.arange(4096) / 512)
    assert waveforms.hum_finding("a", 512.0, row, np.zeros((1, 4096))) is None
    loud = waveforms.hum_finding("a", 512.0, 1e300 * row, np.zeros((1, 4096)))
    assert loud is not None
    assert "tone of 50 Hz" in loud.evidence
