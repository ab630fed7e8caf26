"""NIFO: regression with the contact force as a further input, at each frequency (paper, equations 4, 5, 23 to 28)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float

from identify.linear.modal import ModalEquation, receptance
from identify.signals.spectra import Blocks, WindowedTerm
from rig.errors import RigError

NifoForm = Literal["weak", "paper"]
SpectraOfBlocks = Callable[[Sequence[int]], Complex[np.ndarray, "channels blocks lines"]]
"""Spectra of the blocks with these numbers; the last channel is the response, the others are the inputs."""
BLOCKS_PER_BATCH = 16
"""Blocks whose spectra are in memory at once."""
CHUNK_LINES = 128
"""Lines that are computed at once, so that they stay in the processor's cache."""
MAX_PAIRS = 20
"""Pairs of neighbouring blocks whose influence is computed."""


@dataclass(frozen=True)
class Nifo:
    """Result of NIFO in one modal equation.

    frf is q over the modal force (s^2); stiffness_n_per_m is the complex contact stiffness of each contact that takes
    part, and contact_indices are their indices. stiffness_error_n_per_m is the standard error of the spectral means.
    """

    equation: ModalEquation
    contact_indices: tuple[int, ...]
    frequency_hz: Float[np.ndarray, " lines"]
    frf: Complex[np.ndarray, " lines"]
    stiffness_n_per_m: Complex[np.ndarray, "contacts lines"]
    stiffness_error_n_per_m: Float[np.ndarray, " contacts"]
    average_count: int
    resolution_hz: float

    @property
    def mean_n_per_m(self) -> Float[np.ndarray, " contacts"]:
        """Spectral mean of the real part."""
        return self.stiffness_n_per_m.real.mean(axis=1)

    @property
    def deviation_n_per_m(self) -> Float[np.ndarray, " contacts"]:
        """Rms over frequency of the deviation from the spectral mean."""
        return np.sqrt(np.mean(np.abs(self.stiffness_n_per_m - self.mean_n_per_m[:, None]) ** 2, axis=1))

    def nominal_frf(self) -> Complex[np.ndarray, " lines"]:
        """FRF of the mode as the rig's description has it."""
        return receptance(self.equation.frequency_hz, self.equation.damping_ratio, self.frequency_hz)


def nifo(
    equation: ModalEquation,
    force_n: Float[np.ndarray, " samples"],
    penetration_m: Float[np.ndarray, "contacts samples"],
    blocks: Blocks,
    form: NifoForm = "weak",
) -> Nifo:
    """Regression of the modal coordinate on the modal force and the penetrations, line by line over the blocks.

    The paper's form is Q = H (phi_F F - sum_j phi_j k_j P_j) with spectra under the window w; it leaks, as the window
    does not commute with the derivatives in the equation of motion. The weak form keeps the window's derivatives: with
    Q' and Q'' the spectra of q under w' and w'' ::

        Q = H (phi_F F - Q'' + 2 i omega Q' - sum_j phi_j k_j P_j) + 2 zeta omega_0 H Q'

    which is exact for any motion, since w and w' vanish at a block's ends.

    Contacts that are not visible in the equation, or that never close, take no part. Raises RigError if there are not
    more blocks than unknowns.
    """
    contact_indices = tuple(j for j, visible in enumerate(equation.is_visible) if visible and np.any(penetration_m[j]))
    unknown_count = 1 + len(contact_indices) + (form == "weak")
    if len(blocks.starts) <= unknown_count:
        raise RigError(
            f"{len(blocks.starts)} blocks for {unknown_count} unknowns a line; use shorter blocks or record longer"
        )
    displacement = equation.displacement
    channel_terms = [[WindowedTerm(force_n, factor=equation.shape_at_force)]]
    channel_terms += [[WindowedTerm(penetration_m[j], factor=equation.shape_at_contacts[j])] for j in contact_indices]
    if form == "weak":
        channel_terms[0].append(WindowedTerm(displacement, derivative_order=2, factor=-1.0))
        channel_terms.append([WindowedTerm(displacement, derivative_order=1)])
    channel_terms.append([WindowedTerm(displacement)])
    derivative_factor = 2j * 2 * np.pi * blocks.frequency_hz

    def channel_spectra(block_indices: Sequence[int]) -> Complex[np.ndarray, "channels blocks lines"]:
        spectra = blocks.spectra_of_sums(channel_terms, [blocks.starts[k] for k in block_indices])
        if form == "weak":
            spectra[0] += derivative_factor * spectra[-2]
        return spectra

    input_weights, inverse_normals = weights_by_line(channel_spectra, len(blocks.starts))
    frf, contact_columns = input_weights[:, 0], slice(1, 1 + len(contact_indices))
    stiffness_n_per_m = -input_weights[:, contact_columns] / frf[:, None]

    def mean_stiffness_influence(
        weight_changes: Complex[np.ndarray, "chunk blocks unknowns"], chunk: slice
    ) -> Float[np.ndarray, "blocks contacts"]:
        """Changes of the spectral means of the stiffness k = -w / H by those of the weights w and of the FRF H."""
        contact_weight_changes, frf_changes = weight_changes[:, :, contact_columns], weight_changes[:, :, :1]
        stiffness_changes = -(
            (contact_weight_changes + stiffness_n_per_m[chunk, None] * frf_changes) / frf[chunk, None, None]
        )
        return stiffness_changes.real.sum(axis=0) / frf.size

    def block_influences(block_indices: Sequence[int]) -> Float[np.ndarray, "blocks contacts"]:
        return influences(channel_spectra, block_indices, input_weights, inverse_normals, mean_stiffness_influence)

    mean_variances = jackknife_variance(block_influences, len(blocks.starts))
    return Nifo(
        equation=equation,
        contact_indices=contact_indices,
        frequency_hz=blocks.frequency_hz,
        frf=frf,
        stiffness_n_per_m=stiffness_n_per_m.T,
        stiffness_error_n_per_m=np.sqrt(mean_variances),
        average_count=len(blocks.starts),
        resolution_hz=blocks.resolution_hz,
    )


def fit_mode(nifo_result: Nifo) -> tuple[float, float]:
    """Natural frequency (Hz) and damping ratio fitted to the FRF: 1/H = omega_0^2 - omega^2 + 2 i zeta omega_0 omega.

    Linear least squares of H (omega_0^2 + i omega g) = 1 + omega^2 H, so that resonance and noise weigh as in H.
    """
    omega = 2 * np.pi * nifo_result.frequency_hz
    columns = np.stack([nifo_result.frf, 1j * omega * nifo_result.frf], axis=1)
    target = 1 + omega**2 * nifo_result.frf
    real_columns, real_target = np.concatenate([columns.real, columns.imag]), np.concatenate([target.real, target.imag])
    (natural_omega_squared, damping_rate), *_ = np.linalg.lstsq(real_columns, real_target, rcond=None)
    natural_rad_per_s = float(np.sqrt(max(float(natural_omega_squared), 0.0)))
    damping_ratio = float(damping_rate) / (2 * natural_rad_per_s) if natural_rad_per_s > 0 else 0.0
    return natural_rad_per_s / (2 * np.pi), damping_ratio


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
