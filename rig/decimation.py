"""A filter and the taking of every n-th sample behind it, as one product of matrices."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TOGETHER = 16
"""So many samples are had at once; half of what the sensors' filter is long, which wastes a third of the product."""


@dataclass(frozen=True)
class Decimator:
    """y[n] = sum_k h[k] x[n factor + begin + k], for TOGETHER samples at once: y_b = sum_i x_(b+i) T_i.

    x_b are factor * TOGETHER samples from begin + b factor TOGETHER on; pieces holds the T_i, side by side.
    """

    begin: int
    factor: int
    pieces: Float[np.ndarray, "long together_times_pieces"]

    @property
    def count(self) -> int:
        return self.pieces.shape[1] // TOGETHER

    def reach(self, samples: int) -> int:
        """How many samples of x there must be for so many of y; what lies behind the last tap counts with zero."""
        return self.begin + (-(-samples // TOGETHER) + self.count - 1) * len(self.pieces)


def decimator(taps: Float[np.ndarray, " taps"], factor: int) -> Decimator:
    """That of y[n] = sum_k taps[k] x[n factor + size - 1 - k]: the convolution where it is whole, decimated.

    Taps of zero at both ends cost nothing.
    """
    used = np.flatnonzero(taps[::-1])
    begin = int(used[0]) if used.size else 0
    response = taps[::-1][begin : int(used[-1]) + 1] if used.size else np.zeros(1)
    long = factor * TOGETHER
    count = -(-(long - factor + response.size) // long)
    toeplitz = np.zeros((count * long, TOGETHER))
    for n in range(TOGETHER):
        toeplitz[n * factor : n * factor + response.size, n] = response
    return Decimator(begin, factor, np.concatenate(np.split(toeplitz, count), axis=1))


def decimated(
    chain: Decimator, signals: Float[np.ndarray, "rows long"], samples: int
) -> Float[np.ndarray, "rows samples"]:
    """So many filtered samples of every row, of which there must be `chain.reach(samples)` at least."""
    rows, count = len(signals), chain.count
    blocks = signals[:, chain.begin : chain.reach(samples)].reshape(rows, -1, len(chain.pieces))
    parts = (blocks @ chain.pieces).reshape(rows, blocks.shape[1], count, TOGETHER)
    some = blocks.shape[1] - count + 1
    whole = parts[:, :some, 0].copy()
    for i in range(1, count):
        whole += parts[:, i : some + i, i]
    return whole.reshape(rows, -1)[:, :samples]
