"""Transform of a record: its window, padding and lines."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.fft import next_fast_len, rfft

from identify.gaps.residual.extent import RecordBeginning
from identify.signals.kinematics import taper
from rig.model.description import Rig
from rig.model.modes import modes_of
from rig.recording import Recording

RING_S, LONGEST_RING_S, DECAY_TIMES = 12.0, 60.0, 20.0
"""Padding in which beams ring down before the transform wraps around, s; without contacts DECAY_TIMES of the slowest
mode, within both bounds, so that with two fifths of its damping it falls to 3e-4."""


@dataclass(frozen=True)
class RecordTransform:
    """Transform of windowed samples, padded to `padded_length`, and the lines for a rate lower by `decimation`."""

    sample_rate_hz: float
    padded_length: int
    decimation: int
    window: Float[np.ndarray, " samples"]

    @property
    def line_count(self) -> int:
        """Number of lines from zero to the highest frequency."""
        return self.padded_length // self.decimation // 2 + 1

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        """Circular frequencies of the lines, rad/s."""
        omega = 2 * np.pi * np.arange(self.line_count) * self.sample_rate_hz / self.padded_length
        omega[0] = 0.01 * omega[1]  # stands for the mean, which powers of omega would lose
        return omega

    @property
    def omega_above_band(self) -> Float[np.ndarray, " morelines"]:
        """Circular frequencies from the last of the lines to half the sample rate, rad/s."""
        line_numbers = np.arange(self.line_count - 1, self.padded_length // 2 + 1)
        return 2 * np.pi * self.sample_rate_hz / self.padded_length * line_numbers

    def spectrum(self, signal: Float[np.ndarray, "*rows samples"]) -> Complex[np.ndarray, "*rows all"]:
        """Spectrum of a signal under the window, up to half the sample rate."""
        return np.asarray(rfft(signal * self.window, self.padded_length))

    def window_correction(
        self, signal: Float[np.ndarray, " samples"]
    ) -> tuple[Complex[np.ndarray, " lines"], Complex[np.ndarray, " lines"]]:
        """Windowed velocity and acceleration less the derivatives of a windowed displacement x: -w' x and
        w'' x - 2 (w' x)'."""
        window_slope = np.gradient(self.window) * self.sample_rate_hz
        window_curvature = np.gradient(window_slope) * self.sample_rate_hz
        spectra = rfft(np.stack([window_slope, window_curvature]) * signal, self.padded_length)[:, : self.line_count]
        return -spectra[0], spectra[1] - 2j * self.omega * spectra[0]


def transform_of(recording: Recording, beginning: RecordBeginning, decimation: int) -> RecordTransform:
    """Transform of the lowest lines; the record fades out, and in unless it starts quiet or with a blow."""
    rate_hz, sample_count = recording.rig.sample_rate_hz, recording.samples
    ringing_sample_count = round(_ring_down_padding_s(recording.rig) * rate_hz)
    padded_length = decimation * next_fast_len(-(-(sample_count + ringing_sample_count) // decimation), real=True)
    window = taper(sample_count, max(2, round(beginning.fade_length_s * rate_hz)))
    if beginning.zero_known and not beginning.fits_initial_state:  # differentiated twice, a kink in w'' would ring
        window = np.sin(np.pi / 2 * window) ** 2
    if beginning.fits_initial_state:
        window[0] = 0.5  # half a sample: the signal starts there
    elif not beginning.starts_quiet:
        window = window * window[::-1]
    return RecordTransform(rate_hz, padded_length, decimation, window)


def _ring_down_padding_s(rig: Rig) -> float:
    """Padding in which a rig rings down, s: without contacts until its slowest mode has decayed."""
    if rig.contacts:
        return RING_S
    decay_rates_per_s = []
    for body in rig.bodies:
        modes, mode_count = modes_of(rig, body), body.max_modes
        decay_rates_per_s += (2 * np.pi * modes.frequencies_hz(mode_count) * modes.damping_ratios(mode_count)).tolist()
    slowest_decay_per_s = min((rate for rate in decay_rates_per_s if rate > 0), default=np.inf)
    return float(np.clip(DECAY_TIMES / slowest_decay_per_s, RING_S, LONGEST_RING_S))
