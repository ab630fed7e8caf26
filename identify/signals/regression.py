"""Least squares at every spectral line over many blocks, whose spectra are never in memory all at once."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Complex, Float

from rig.errors import RigError

SpectraOfBlocks = Callable[[Sequence[int]], Complex[np.ndarray, "channels blocks lines"]]
"""Spectra of the blocks with these numbers; the last channel is the response, the others are the inputs."""
BLOCKS_PER_BATCH = 16
"""Blocks whose spectra are in memory at once."""
CHUNK_LINES = 128
"""Lines that are computed at once, so that they stay in the processor's cache."""
MAX_PAIRS = 20
"""Pairs of neighbouring blocks whose influence is computed."""


def weights_by_line(
    spectra_of: SpectraOfBlocks, block_count: int
) -> tuple[Complex[np.ndarray, "lines inputs"], Complex[np.ndarray, "lines inputs inputs"]]:
    """Weights of the inputs in the response at each line, and the inverse of the inputs' normal matrix.

    From cross-spectra summed in double precision, with every channel scaled to one: the relative rounding error grows
    with the square of the inputs' condition number, to 1e-8 at 1e4.

    Raises RigError if the inputs are linearly dependent at a line.
    """
    normal_matrices = np.zeros((0, 0, 0), dtype=complex)
    for first_block in range(0, block_count, BLOCKS_PER_BATCH):
        block_spectra = spectra_of(range(first_block, min(first_block + BLOCKS_PER_BATCH, block_count)))
        channel_count, _, line_count = block_spectra.shape
        if first_block == 0:
            normal_matrices = np.zeros((line_count, channel_count, channel_count), dtype=complex)
        for line_slice in _line_slices(line_count):
            line_spectra = _lines_first(block_spectra, line_slice)
            normal_matrices[line_slice] += line_spectra.conj().transpose(0, 2, 1) @ line_spectra
    input_count = normal_matrices.shape[1] - 1
    input_weights = np.empty((len(normal_matrices), input_count), dtype=complex)
    inverse_normals = normal_matrices[:, :input_count, :input_count]
    for line_slice in _line_slices(len(normal_matrices)):
        input_norms = np.sqrt(np.einsum("lii->li", normal_matrices[line_slice]).real[:, :input_count])
        input_norms[input_norms == 0] = 1.0
        norm_products = input_norms[:, :, None] * input_norms[:, None, :]
        try:
            scaled_inverses = np.linalg.inv(normal_matrices[line_slice, :input_count, :input_count] / norm_products)
        except np.linalg.LinAlgError as error:
            raise RigError(
                "the force and the contacts' displacements are the same at some frequency, up to a factor; look for "
                "channels that are copies, dead, or not of this rig"
            ) from error
        input_weights[line_slice] = (
            scaled_inverses @ (normal_matrices[line_slice, :input_count, input_count:] / input_norms[:, :, None])
        )[:, :, 0] / input_norms
        inverse_normals[line_slice] = scaled_inverses / norm_products
    return input_weights, inverse_normals


def influences(
    spectra_of: SpectraOfBlocks,
    block_numbers: Sequence[int],
    input_weights: Complex[np.ndarray, "lines inputs"],
    inverse_normals: Complex[np.ndarray, "lines inputs inputs"],
    quantities_of: Callable[[Complex[np.ndarray, "some blocks inputs"], slice], Float[np.ndarray, "blocks quantities"]],
) -> Float[np.ndarray, "chosen quantities"]:
    """Influence of each block on the estimate: the change if it is left out, to first order (jackknife).

    `quantities_of` maps the changes of the weights at some lines to those of the quantities of interest, linearly.
    """
    batch_influences = []
    for first_index in range(0, len(block_numbers), BLOCKS_PER_BATCH):
        block_spectra = spectra_of(block_numbers[first_index : first_index + BLOCKS_PER_BATCH])
        influence_sums = []
        for line_slice in _line_slices(len(input_weights)):
            line_spectra = _lines_first(block_spectra, line_slice)
            input_spectra, response_spectra = line_spectra[:, :, :-1], line_spectra[:, :, -1]
            weight_changes = input_spectra.conj() @ inverse_normals[line_slice].transpose(0, 2, 1)
            leverage = np.sum(input_spectra * weight_changes, axis=2).real
            residual = response_spectra - (input_spectra @ input_weights[line_slice, :, None])[:, :, 0]
            weight_changes *= -(residual / np.maximum(1 - leverage, 1e-3))[:, :, None]
            influence_sums.append(quantities_of(weight_changes, line_slice))
        batch_influences.append(np.sum(influence_sums, axis=0))
    return np.concatenate(batch_influences)


def jackknife_variance(
    influences_of: Callable[[Sequence[int]], Float[np.ndarray, "chosen quantities"]], block_count: int
) -> Float[np.ndarray, " quantities"]:
    """Jackknife variance of quantities that all blocks influence, where each block correlates with the next.

    From all blocks, or from pairs of neighbours spread evenly over the record.
    """
    pair_starts = np.unique(np.linspace(0, block_count - 2, min(MAX_PAIRS, block_count - 1)).round().astype(int))
    block_numbers = np.union1d(pair_starts, pair_starts + 1)
    block_influences = influences_of([int(block) for block in block_numbers])
    pair_rows = np.searchsorted(block_numbers, pair_starts)
    independent_variance = block_count * np.mean(block_influences**2, axis=0)
    neighbour_variance = independent_variance + 2 * (block_count - 1) * np.mean(
        block_influences[pair_rows] * block_influences[pair_rows + 1], axis=0
    )
    return np.maximum(neighbour_variance, independent_variance / 4)


def _line_slices(line_count: int) -> list[slice]:
    """Slices of the lines."""
    return [
        slice(first_line, min(first_line + CHUNK_LINES, line_count)) for first_line in range(0, line_count, CHUNK_LINES)
    ]


def _lines_first(
    spectra: Complex[np.ndarray, "channels blocks lines"], line_slice: slice
) -> Complex[np.ndarray, "some blocks channels"]:
    """Spectra on a slice of the lines, with the line as the first axis."""
    return np.ascontiguousarray(spectra[:, :, line_slice].transpose(2, 1, 0))
