"""The spectral lines of a record at which the contact forces are separated."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float

from identify.signals.kinematics import CORNER_HZ, TAPER_S, taper

SMOOTHED_HZ = 1.0
LEAST = 1e-3


@dataclass(frozen=True)
class Lines:
    """The lines of a record that ends in silence, up to the band of forces at every `factor`-th sample."""

    length: int
    factor: int
    rate_hz: float
    tapered: bool = True

    @property
    def omega(self) -> Float[np.ndarray, " lines"]:
        """The lowest is a small share of a line above zero, where a displacement is an acceleration over -omega^2."""
        lines = np.maximum(np.arange(self.length // self.factor // 2 + 1), LEAST)
        return np.asarray(2 * np.pi * lines * self.rate_hz / self.length)

    @property
    def slow(self) -> Bool[np.ndarray, " lines"]:
        return self.omega < 2 * np.pi * CORNER_HZ

    def spectra(self, signals: Float[np.ndarray, "*rows samples"]) -> Complex[np.ndarray, "*rows lines"]:
        """Spectra with the end tapered off and silence behind, so that what rings on does not wrap to the start."""
        if self.tapered:
            signals = signals * taper(signals.shape[-1], round(TAPER_S * self.rate_hz))
        return np.asarray(np.fft.rfft(signals, self.length)[..., : self.omega.size])

    def in_time(self, spectra: Complex[np.ndarray, "*rows lines"], samples: int) -> Float[np.ndarray, "*rows fewer"]:
        ends = np.concatenate([spectra[..., :1].real, spectra[..., 1:]], axis=-1)
        return np.asarray(np.fft.irfft(ends, self.length // self.factor)[..., :samples] / self.factor)

    @property
    def alike(self) -> int:
        """Count of neighbouring lines that are taken to be alike."""
        return max(1, round(SMOOTHED_HZ * self.length / self.rate_hz))
