"""Least squares at every spectral line over many blocks, whose spectra are never held all at once."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError

Spectra = Callable[[Sequence[int]], Complex[np.ndarray, "channels blocks lines"]]
"""The spectra of the blocks with these numbers; the last channel is the response, the others are the inputs."""
TOGETHER = 16
"""Blocks whose spectra are held at once."""
CHUNK = 128
"""Lines that are worked on at once, so that they stay in the processor's cache."""
PAIRS = 20
"""Neighbouring blocks whose influence is looked at, where a record has so many."""


def line_by_line(
    spectra: Spectra, blocks: int
) -> tuple[Complex[np.ndarray, "lines inputs"], Complex[np.ndarray, "lines inputs inputs"]]:
    """The weights of the inputs in the response at each line, and the inverse of the inputs' normal matrix.

    From cross-spectra summed in double precision with every channel scaled to one: relative rounding grows with the
    square of the inputs' condition number, to 1e-8 at 1e4.

    Raises RigError if the inputs depend on each other at a line.
    """
    normal = np.zeros((0, 0, 0), dtype=complex)
    for first in range(0, blocks, TOGETHER):
        found = spectra(range(first, min(first + TOGETHER, blocks)))
        channels, _, lines = found.shape
        if first == 0:
            normal = np.zeros((lines, channels, channels), dtype=complex)
        for some in _chunks(lines):
            rows = _by_line(found, some)
            normal[some] += rows.conj().transpose(0, 2, 1) @ rows
    inputs = normal.shape[1] - 1
    weights = np.empty((len(normal), inputs), dtype=complex)
    inverse = normal[:, :inputs, :inputs]
    for some in _chunks(len(normal)):
        scale = np.sqrt(np.einsum("lii->li", normal[some]).real[:, :inputs])
        scale[scale == 0] = 1.0
        both = scale[:, :, None] * scale[:, None, :]
        try:
            solved = np.linalg.inv(normal[some, :inputs, :inputs] / both)
        except np.linalg.LinAlgError as error:
            raise RigError(
                "the force and the contacts' displacements are the same at some frequency, up to a factor; look for "
                "channels that are copies, dead, or not of this rig"
            ) from error
        weights[some] = (solved @ (normal[some, :inputs, inputs:] / scale[:, :, None]))[:, :, 0] / scale
        inverse[some] = solved / both
    return weights, inverse


def influences(
    spectra: Spectra,
    chosen: Sequence[int],
    weights: Complex[np.ndarray, "lines inputs"],
    inverse: Complex[np.ndarray, "lines inputs inputs"],
    summed: Callable[[Complex[np.ndarray, "some blocks inputs"], slice], Float[np.ndarray, "blocks quantities"]],
) -> Float[np.ndarray, "chosen quantities"]:
    """Influence of each block on the estimate: the change by leaving it out, to first order (jackknife).

    `summed` makes the changes of the weights at some lines into those of the quantities asked for, linearly.
    """
    moved = []
    for first in range(0, len(chosen), TOGETHER):
        found = spectra(chosen[first : first + TOGETHER])
        parts = []
        for some in _chunks(len(weights)):
            rows = _by_line(found, some)
            inputs, response = rows[:, :, :-1], rows[:, :, -1]
            pulled = inputs.conj() @ inverse[some].transpose(0, 2, 1)
            leverage = np.sum(inputs * pulled, axis=2).real
            residual = response - (inputs @ weights[some, :, None])[:, :, 0]
            pulled *= -(residual / np.maximum(1 - leverage, 1e-3))[:, :, None]
            parts.append(summed(pulled, some))
        moved.append(np.sum(parts, axis=0))
    return np.concatenate(moved)


def variance_of_sum(
    influence: Callable[[Sequence[int]], Float[np.ndarray, "chosen quantities"]], blocks: int
) -> Float[np.ndarray, " quantities"]:
    """The jackknife's variance of what every block moves, a block correlating with the next, whose samples it shares.

    From all blocks, or from pairs of neighbours evenly over the record.
    """
    left = np.unique(np.linspace(0, blocks - 2, min(PAIRS, blocks - 1)).round().astype(int))
    chosen = np.union1d(left, left + 1)
    moved = influence([int(block) for block in chosen])
    first = np.searchsorted(chosen, left)
    alone = blocks * np.mean(moved**2, axis=0)
    together = alone + 2 * (blocks - 1) * np.mean(moved[first] * moved[first + 1], axis=0)
    return np.maximum(together, alone / 4)


def _chunks(lines: int) -> list[slice]:
    return [slice(first, min(first + CHUNK, lines)) for first in range(0, lines, CHUNK)]


def _by_line(
    spectra: Complex[np.ndarray, "channels blocks lines"], some: slice
) -> Complex[np.ndarray, "some blocks channels"]:
    return np.ascontiguousarray(spectra[:, :, some].transpose(2, 1, 0))
