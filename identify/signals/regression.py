"""Least squares at every spectral line over many blocks, whose spectra are never in memory all at once."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError

Spectra = Callable[[Sequence[int]], Complex[np.ndarray, "channels blocks lines"]]
"""Spectra of the blocks with these numbers; the last channel is the response, the others are the inputs."""
BLOCKS_AT_ONCE = 16
"""Blocks whose spectra are in memory at once."""
CHUNK_LINES = 128
"""Lines that are computed at once, so that they stay in the processor's cache."""
MAX_PAIRS = 20
"""Pairs of neighbouring blocks whose influence is computed."""


def line_by_line(
    spectra: Spectra, blocks: int
) -> tuple[Complex[np.ndarray, "lines inputs"], Complex[np.ndarray, "lines inputs inputs"]]:
    """Weights of the inputs in the response at each line, and the inverse of the inputs' normal matrix.

    From cross-spectra summed in double precision, with every channel scaled to one: the relative rounding error grows
    with the square of the inputs' condition number, to 1e-8 at 1e4.

    Raises RigError if the inputs are linearly dependent at a line.
    """
    normal = np.zeros((0, 0, 0), dtype=complex)
    for first in range(0, blocks, BLOCKS_AT_ONCE):
        block_spectra = spectra(range(first, min(first + BLOCKS_AT_ONCE, blocks)))
        channels, _, lines = block_spectra.shape
        if first == 0:
            normal = np.zeros((lines, channels, channels), dtype=complex)
        for chunk in _chunks(lines):
            rows = _by_line(block_spectra, chunk)
            normal[chunk] += rows.conj().transpose(0, 2, 1) @ rows
    inputs = normal.shape[1] - 1
    weights = np.empty((len(normal), inputs), dtype=complex)
    inverse = normal[:, :inputs, :inputs]
    for chunk in _chunks(len(normal)):
        scale = np.sqrt(np.einsum("lii->li", normal[chunk]).real[:, :inputs])
        scale[scale == 0] = 1.0
        scales = scale[:, :, None] * scale[:, None, :]
        try:
            scaled_inverse = np.linalg.inv(normal[chunk, :inputs, :inputs] / scales)
        except np.linalg.LinAlgError as error:
            raise RigError(
                "the force and the contacts' displacements are the same at some frequency, up to a factor; look for "
                "channels that are copies, dead, or not of this rig"
            ) from error
        weights[chunk] = (scaled_inverse @ (normal[chunk, :inputs, inputs:] / scale[:, :, None]))[:, :, 0] / scale
        inverse[chunk] = scaled_inverse / scales
    return weights, inverse


def influences(
    spectra: Spectra,
    block_numbers: Sequence[int],
    weights: Complex[np.ndarray, "lines inputs"],
    inverse: Complex[np.ndarray, "lines inputs inputs"],
    quantities_of: Callable[[Complex[np.ndarray, "some blocks inputs"], slice], Float[np.ndarray, "blocks quantities"]],
) -> Float[np.ndarray, "chosen quantities"]:
    """Influence of each block on the estimate: the change if it is left out, to first order (jackknife).

    `quantities_of` maps the changes of the weights at some lines to those of the quantities of interest, linearly.
    """
    batches = []
    for first in range(0, len(block_numbers), BLOCKS_AT_ONCE):
        block_spectra = spectra(block_numbers[first : first + BLOCKS_AT_ONCE])
        chunk_sums = []
        for chunk in _chunks(len(weights)):
            rows = _by_line(block_spectra, chunk)
            inputs, response = rows[:, :, :-1], rows[:, :, -1]
            weight_changes = inputs.conj() @ inverse[chunk].transpose(0, 2, 1)
            leverage = np.sum(inputs * weight_changes, axis=2).real
            residual = response - (inputs @ weights[chunk, :, None])[:, :, 0]
            weight_changes *= -(residual / np.maximum(1 - leverage, 1e-3))[:, :, None]
            chunk_sums.append(quantities_of(weight_changes, chunk))
        batches.append(np.sum(chunk_sums, axis=0))
    return np.concatenate(batches)


def variance_of_sum(
    influence: Callable[[Sequence[int]], Float[np.ndarray, "chosen quantities"]], blocks: int
) -> Float[np.ndarray, " quantities"]:
    """Jackknife variance of quantities that all blocks influence, where each block correlates with the next.

    From all blocks, or from pairs of neighbours spread evenly over the record.
    """
    pair_starts = np.unique(np.linspace(0, blocks - 2, min(MAX_PAIRS, blocks - 1)).round().astype(int))
    block_numbers = np.union1d(pair_starts, pair_starts + 1)
    block_influences = influence([int(block) for block in block_numbers])
    index = np.searchsorted(block_numbers, pair_starts)
    independent = blocks * np.mean(block_influences**2, axis=0)
    with_neighbours = independent + 2 * (blocks - 1) * np.mean(
        block_influences[index] * block_influences[index + 1], axis=0
    )
    return np.maximum(with_neighbours, independent / 4)


def _chunks(lines: int) -> list[slice]:
    """Slices of the lines."""
    return [slice(first, min(first + CHUNK_LINES, lines)) for first in range(0, lines, CHUNK_LINES)]


def _by_line(
    spectra: Complex[np.ndarray, "channels blocks lines"], lines: slice
) -> Complex[np.ndarray, "some blocks channels"]:
    """Spectra on a slice of the lines, with the line as the first axis."""
    return np.ascontiguousarray(spectra[:, :, lines].transpose(2, 1, 0))
