"""Anti-aliasing and sampling: windowed sinc with linear phase, its delay taken out, a channel's own delay put in."""

import numpy as np
from jaxtyping import Float
from scipy.signal import bilinear, firwin, lfilter, lfilter_zi, upfirdn

PASS, STOP = 0.4, 0.6
"""Of the sampling rate: flat within 1e-4 up to the one, down by 80 dB from the other on."""
HALF = 14.5
"""Half the filter's length, in samples of the recording."""


def taps(factor: int, delay_steps: float, reach: int) -> Float[np.ndarray, " taps"]:
    """The filter over 2 reach + 1 steps; `factor` steps a sample; centred delay_steps late of the middle.

    Delays of part of a step by cubic interpolation, which is exact to 3e-5 in the pass band of a factor of 16.
    """
    half = int(HALF * factor)
    whole = int(np.floor(delay_steps))
    s = delay_steps - whole
    between = [-s * (s - 1) * (s - 2) / 6, (s + 1) * (s - 1) * (s - 2) / 2, -(s + 1) * s * (s - 2) / 2, (s**3 - s) / 6]
    own = np.convolve(firwin(2 * half + 1, 1 / factor, window=("kaiser", 8.8)), between)
    first = reach - half - 1 + whole
    if not 0 <= first <= 2 * reach + 1 - own.size:
        raise ValueError(f"a delay of {delay_steps} steps does not fit a reach of {reach} steps")
    row = np.zeros(2 * reach + 1)
    row[first : first + own.size] = own
    return row


class Sampler:
    """Takes channels at the simulator's rate block by block and keeps the samples of the recording."""

    def __init__(self, factor: int, delays_steps: Float[np.ndarray, " channels"]) -> None:
        self.factor = factor
        self.reach = int(HALF * factor) + 3 + int(np.ceil(np.abs(delays_steps).max(initial=0.0)))
        self._taps = [taps(factor, float(delay), self.reach) for delay in delays_steps]
        self._waiting = np.zeros((len(delays_steps), 0))
        self._done: list[Float[np.ndarray, "channels some"]] = []

    def add(self, values: Float[np.ndarray, "channels steps"]) -> None:
        """The first sample lies `reach` steps after the first step that is ever added."""
        self._waiting = np.concatenate([self._waiting, values], axis=1)
        ready = (self._waiting.shape[1] - 2 * self.reach - 1) // self.factor + 1
        if ready > 0:
            used = self._waiting[:, : 2 * self.reach + 1 + (ready - 1) * self.factor]
            self._done.append(np.array([_filtered(t, x, self.factor) for t, x in zip(self._taps, used, strict=True)]))
            self._waiting = self._waiting[:, ready * self.factor :]

    def samples(self) -> Float[np.ndarray, "channels samples"]:
        return np.concatenate(self._done, axis=1)


def _filtered(
    row: Float[np.ndarray, " taps"], values: Float[np.ndarray, " steps"], factor: int
) -> Float[np.ndarray, " samples"]:
    """The filter at every position where all of it lies on values, `factor` steps apart."""
    lead = row.size - 1
    shift = -lead % factor  # so that the last tap meets a step that is kept
    all_of_it = upfirdn(row, np.concatenate([np.zeros(shift), values]), down=factor)
    first = (lead + shift) // factor
    return all_of_it[first : first + (values.size - row.size) // factor + 1]


class Mounting:
    """A resonant mounting x'' + 2 zeta w x' + w^2 x = 2 zeta w u' + w^2 u, at the simulator's rate, block by block."""

    def __init__(self, frequency_hz: float, damping_ratio: float, step_s: float) -> None:
        omega = 2 * np.pi * frequency_hz
        rate = 2 * damping_ratio * omega
        self._b, self._a = bilinear([rate, omega**2], [1.0, rate, omega**2], 1 / step_s)
        self._state: Float[np.ndarray, " order"] | None = None

    def follow(self, motion: Float[np.ndarray, " steps"]) -> Float[np.ndarray, " steps"]:
        if self._state is None:
            self._state = lfilter_zi(self._b, self._a) * motion[0]
        followed, self._state = lfilter(self._b, self._a, motion, zi=self._state)
        return np.asarray(followed)
