"""Blocks of a record, windows and their spectra; other sampling rates; the band of the force."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import msgspec
import numpy as np
import scipy
from jaxtyping import Complex, Float

from rig.errors import RigError
from rig.model.sensing import PASSBAND

WINDOW_EXPONENTS = {"hann": 2, "sin4": 4, "sin6": 6}
"""Exponent p of the window sin^p, by its name."""
RAMP_SAMPLES = 512
"""Samples over which a resampled signal is led to zero at its ends."""
EDGE_SHARE = 0.9
"""Share of a band from which on a low-pass falls. Set by hand: its ringing is below the noise after some samples."""


class Averaging(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Division of a record into blocks.

    The window is sin^p(pi t / T) over a block of length T; p = 2 is the Hann window. Without a block length the record
    is cut into `averages` overlapping blocks.
    """

    averages: int = 40
    block_s: float | None = None
    overlap: float = 0.5
    window: str = "hann"
    band_hz: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.averages < 2:
            raise RigError(f"averages is {self.averages}; give 2 or more")
        if self.block_s is not None and not (np.isfinite(self.block_s) and self.block_s > 0):
            raise RigError(f"the block is {self.block_s} s; give a value above zero")
        if not 0 <= self.overlap < 1:
            raise RigError(f"overlap is {self.overlap}; give a value from 0 to below 1")
        if self.window not in WINDOW_EXPONENTS:
            raise RigError(f"no window {self.window!r}; there are {', '.join(WINDOW_EXPONENTS)}")
        if self.band_hz is not None and not 0 <= self.band_hz[0] < self.band_hz[1] < np.inf:
            raise RigError(f"the band {self.band_hz[0]} to {self.band_hz[1]} Hz is empty; give 0 <= low < high")


@dataclass(frozen=True)
class WindowedTerm:
    """A signal under the window, or under its first or second time derivative, times a factor."""

    signal: Float[np.ndarray, " samples"]
    derivative_order: int = 0
    factor: float = 1.0


@dataclass(frozen=True)
class Blocks:
    """Blocks of a record: their first samples, their length in samples, and the spectral lines in use."""

    starts: tuple[int, ...]
    block_samples: int
    window: str
    sample_rate_hz: float
    lines: slice

    @property
    def frequency_hz(self) -> Float[np.ndarray, " lines"]:
        return np.arange(self.block_samples // 2 + 1)[self.lines] * (self.sample_rate_hz / self.block_samples)

    @property
    def resolution_hz(self) -> float:
        return self.sample_rate_hz / self.block_samples

    def spectra(
        self, signal: Float[np.ndarray, " samples"], derivative_order: int = 0
    ) -> Complex[np.ndarray, "blocks lines"]:
        """Fourier transforms of the blocks under the window, or under its first or second time derivative."""
        return self.spectra_of_sums([[WindowedTerm(signal, derivative_order)]], self.starts)[0]

    def spectra_of_sums(
        self, channel_terms: Sequence[Sequence[WindowedTerm]], starts: Sequence[int]
    ) -> Complex[np.ndarray, "channels blocks lines"]:
        """Fourier transforms of several channels, each a sum of terms, in the blocks that begin at `starts`."""
        windows = window_derivatives(self.window, self.block_samples, self.sample_rate_hz)
        window_weights = [[term.factor * windows[term.derivative_order] for term in terms] for terms in channel_terms]
        windowed_channels = np.empty((len(channel_terms), self.block_samples))
        spectra = np.empty((len(channel_terms), len(starts), self.lines.stop - self.lines.start), dtype=complex)
        for block_index, first_sample in enumerate(starts):
            block_samples = slice(first_sample, first_sample + self.block_samples)
            for row, channel_weights, terms in zip(windowed_channels, window_weights, channel_terms, strict=True):
                np.multiply(channel_weights[0], terms[0].signal[block_samples], out=row)
                for weight, term in zip(channel_weights[1:], terms[1:], strict=True):
                    np.add(row, weight * term.signal[block_samples], out=row)
            spectra[:, block_index] = scipy.fft.rfft(windowed_channels, axis=1)[:, self.lines]
        return spectra


def blocks(sample_count: int, sample_rate_hz: float, averaging: Averaging, band_hz: tuple[float, float]) -> Blocks:
    """Blocks that cover `sample_count` samples, with the lines in the band.

    Raises RigError if a block is longer than the record or the band holds no line.
    """
    if averaging.block_s is None:
        block_samples = int(sample_count / (1 + (averaging.averages - 1) * (1 - averaging.overlap)))
    else:
        block_samples = round(averaging.block_s * sample_rate_hz)
    block_samples -= block_samples % 2
    if not 16 <= block_samples <= sample_count:
        raise RigError(
            f"a block of {block_samples / sample_rate_hz:.4g} s does not fit a record with "
            f"{sample_count / sample_rate_hz:.4g} usable seconds; choose another block or record longer"
        )
    if band_hz[0] >= band_hz[1]:
        raise RigError(
            f"the force, or what the sensors show, begins at {band_hz[0]:.4g} Hz, and {sample_rate_hz:g} samples a "
            f"second show the motion up to {band_hz[1]:.4g} Hz; excite below that, or sample faster"
        )
    resolution_hz = sample_rate_hz / block_samples
    first_line = int(np.ceil(band_hz[0] / resolution_hz - 1e-9))
    stop_line = int(np.floor(band_hz[1] / resolution_hz + 1e-9)) + 1
    if stop_line <= first_line or stop_line > block_samples // 2:
        raise RigError(
            f"the band {band_hz[0]:.4g} to {band_hz[1]:.4g} Hz holds no lines at a resolution of {resolution_hz:.4g} "
            f"Hz and {sample_rate_hz:g} samples a second; choose another band or block"
        )
    hop_samples = max(1, int(block_samples * (1 - averaging.overlap) + 1e-6))
    starts = tuple(range(0, sample_count - block_samples + 1, hop_samples))
    return Blocks(starts, block_samples, averaging.window, sample_rate_hz, slice(first_line, stop_line))


def window_derivatives(window_name: str, block_samples: int, sample_rate_hz: float) -> Float[np.ndarray, "3 length"]:
    """sin^p(pi t / T) and its first and second derivatives in time (1, 1/s, 1/s^2)."""
    exponent, phase_rad = WINDOW_EXPONENTS[window_name], np.pi * np.arange(block_samples) / block_samples
    rate_rad_per_s = np.pi * sample_rate_hz / block_samples
    sine, cosine = np.sin(phase_rad), np.cos(phase_rad)
    return np.stack(
        [
            sine**exponent,
            rate_rad_per_s * exponent * sine ** (exponent - 1) * cosine,
            rate_rad_per_s**2 * exponent * ((exponent - 1) * sine ** (exponent - 2) * cosine**2 - sine**exponent),
        ]
    )


def oversampled(signals: Float[np.ndarray, "*rows samples"], factor: int) -> Float[np.ndarray, "*rows more"]:
    """Band-limited signals at `factor` times their rate."""
    ramped = _with_ramped_ends(signals, 1)
    fine_signals = scipy.signal.resample(ramped, factor * ramped.shape[-1], axis=-1)
    return np.asarray(fine_signals[..., factor * RAMP_SAMPLES : factor * (RAMP_SAMPLES + signals.shape[-1])])


def decimated(
    signals: Float[np.ndarray, "*rows samples"], factor: int, is_tapered: bool = False
) -> Float[np.ndarray, "*rows fewer"]:
    """Every factor-th sample after a low-pass at half the new rate, ideal or tapered by `low_pass_edge_gain`; the ends
    of a record are smoothed."""
    if factor == 1:
        return signals
    ramped = _with_ramped_ends(signals, factor)
    new_length = ramped.shape[-1] // factor
    subsequences = np.moveaxis(ramped.reshape(*ramped.shape[:-1], new_length, factor), -1, -2)
    low_spectra = np.einsum("pk,...pk->...k", _phase_factors(new_length, factor), scipy.fft.rfft(subsequences))
    if new_length % 2 == 0:
        low_spectra[..., -1] *= 2  # half the new rate stands for both signs, as in scipy.signal.resample
    if is_tapered:
        low_spectra *= low_pass_edge_gain(np.linspace(0, 1, new_length // 2 + 1))
    new_count = -(-signals.shape[-1] // factor)
    return np.asarray(scipy.fft.irfft(low_spectra / factor, new_length)[..., RAMP_SAMPLES : RAMP_SAMPLES + new_count])


def at_force_rate(signals: Float[np.ndarray, "*rows samples"], decimation: int) -> Float[np.ndarray, "*rows fewer"]:
    """Every `decimation`-th sample of signals, low-passed as separated forces are: to half the new rate, or, if that is
    the recorded one, to `PASSBAND` of it, above which the sensors' own filters act; both by `low_pass_edge_gain`."""
    if decimation > 1:
        return decimated(signals, decimation, is_tapered=True)
    ramped = _with_ramped_ends(signals, 1)
    spectra = scipy.fft.rfft(ramped)
    spectra *= low_pass_edge_gain(np.linspace(0, 0.5 / PASSBAND, spectra.shape[-1]))
    low_passed = scipy.fft.irfft(spectra, ramped.shape[-1])
    return np.asarray(low_passed[..., RAMP_SAMPLES : RAMP_SAMPLES + signals.shape[-1]])


def low_pass_edge_gain(band_share: Float[np.ndarray, " lines"]) -> Float[np.ndarray, " lines"]:
    """Gain of a low-pass at shares of its band: 1, and from `EDGE_SHARE` on a cosine that falls to 0 at its end.

    An ideal low-pass rings at its edge for the whole record, of what the record's ends cut off.
    """
    falling_share = np.clip((band_share - EDGE_SHARE) / (1 - EDGE_SHARE), 0.0, 1.0)
    return np.asarray(np.cos(np.pi / 2 * falling_share) ** 2)


@lru_cache(maxsize=4)
def _phase_factors(new_length: int, factor: int) -> Complex[np.ndarray, "factor lines"]:
    """Phase factors exp(-2 pi i j k / (new_length factor)) of subsequence j at line k.

    With them the low lines of a transform of length * factor samples are sums of the transforms of every factor-th
    sample, each from another first one on: no other line is computed, and all transforms are short.
    """
    phase_products = np.arange(factor)[:, None] * np.arange(new_length // 2 + 1)
    return np.asarray(np.exp(-2j * np.pi * phase_products / (new_length * factor)))


def _with_ramped_ends(signals: Float[np.ndarray, "*rows samples"], factor: int) -> Float[np.ndarray, "*rows more"]:
    """Signals led to zero at both ends, as the Fourier transform is periodic, at a length that transforms fast."""
    sample_count, rise_samples = signals.shape[-1], RAMP_SAMPLES * factor
    padded_length = factor * scipy.fft.next_fast_len(-(-sample_count // factor) + 2 * RAMP_SAMPLES, real=True)
    fall_samples = padded_length - sample_count - rise_samples
    ramped = np.empty((*signals.shape[:-1], padded_length))
    ramped[..., :rise_samples] = signals[..., :1] * (np.arange(rise_samples) / rise_samples)
    ramped[..., rise_samples : rise_samples + sample_count] = signals
    ramped[..., rise_samples + sample_count :] = signals[..., -1:] * (np.arange(fall_samples)[::-1] / fall_samples)
    return ramped


def force_band_hz(
    force_n: Float[np.ndarray, "*forces samples"], sample_rate_hz: float, outside_share: float = 1e-3
) -> tuple[float, float]:
    """Band that holds all but `outside_share` of the force's power at either end, Hz; of several forces the union.

    Raises RigError if no force differs from zero, or one is constant.
    """
    forces_n = np.atleast_2d(force_n)
    acting_forces = [row_n for row_n in forces_n if np.any(row_n)] or forces_n[:1]
    lows_hz, highs_hz = zip(
        *(_single_force_band_hz(row_n, sample_rate_hz, outside_share) for row_n in acting_forces), strict=True
    )
    return min(lows_hz), max(highs_hz)


def _single_force_band_hz(
    force_n: Float[np.ndarray, " samples"], sample_rate_hz: float, outside_share: float
) -> tuple[float, float]:
    """Band of one force, Hz."""
    power_to = np.cumsum(np.abs(np.fft.rfft(force_n)) ** 2)
    if not power_to[-1] > 0:
        raise RigError("the exciting force is zero throughout; record its channel, or give --band")
    low_line, high_line = np.searchsorted(power_to, [outside_share * power_to[-1], (1 - outside_share) * power_to[-1]])
    if not high_line:
        raise RigError("the exciting force is constant; record one that vibrates, or take its mean off")
    resolution_hz = sample_rate_hz / force_n.size
    return float(low_line * resolution_hz), float(high_line * resolution_hz)
