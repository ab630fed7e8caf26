"""A finite impulse response filter followed by decimation, computed as products of matrices."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TOGETHER = 16
"""Output samples per block: half the length of the sensors' filter, so that three products cover it."""


@dataclass(frozen=True)
class Decimator:
    """y[n] = sum_k h[k] x[n factor + begin + k], in blocks of TOGETHER outputs: y_b = sum_i T_i' x_(b+i).

    x_b holds the factor * TOGETHER samples of x from begin + b factor TOGETHER on. `pieces` holds the T_i side by side,
    each a slice of the Toeplitz matrix of h.
    """

    begin: int
    pieces: Float[np.ndarray, "long together_times_pieces"]

    @property
    def count(self) -> int:
        """Number of the T_i."""
        return self.pieces.shape[1] // TOGETHER

    def reach(self, samples: int) -> int:
        """Samples of x that the blocks of so many samples of y span; those behind the last tap are multiplied by 0."""
        return self.begin + (-(-samples // TOGETHER) + self.count - 1) * len(self.pieces)


def decimator(taps: Float[np.ndarray, " taps"], factor: int) -> Decimator:
    """The decimator of y[n] = sum_k taps[k] x[n factor + size - 1 - k]: a full overlap of the taps with x for every n.

    Zero taps at either end cost nothing.
    """
    used = np.flatnonzero(taps[::-1])
    begin = int(used[0]) if used.size else 0
    response = taps[::-1][begin : int(used[-1]) + 1] if used.size else np.zeros(1)
    long = factor * TOGETHER
    count = -(-(long - factor + response.size) // long)
    toeplitz = np.zeros((count * long, TOGETHER))
    for n in range(TOGETHER):
        toeplitz[n * factor : n * factor + response.size, n] = response
    return Decimator(begin, np.concatenate(np.split(toeplitz, count), axis=1))


def decimated(
    filter_: Decimator, signals: Float[np.ndarray, "rows long"], samples: int
) -> Float[np.ndarray, "rows samples"]:
    """The first `samples` filtered samples of every row; rows must hold at least `chain.reach(samples)`."""
    rows, count = len(signals), filter_.count
    blocks = signals[:, filter_.begin : filter_.reach(samples)].reshape(rows, -1, len(filter_.pieces))
    parts = (blocks @ filter_.pieces).reshape(rows, blocks.shape[1], count, TOGETHER)
    some = blocks.shape[1] - count + 1
    whole = parts[:, :some, 0].copy()
    for i in range(1, count):
        whole += parts[:, i : some + i, i]
    return whole.reshape(rows, -1)[:, :samples]
